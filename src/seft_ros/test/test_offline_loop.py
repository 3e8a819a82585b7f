"""The offline loop against a simulation written anew, and against the paper's numbers."""

from pathlib import Path

import numpy as np
import pytest
from experiments_at_hand import load, simulated
from seft_plant_sim.rig_step import PERSISTENT
from seft_plant_sim.sensors import BLOCK
from seft_ros.test_run.compiled_loop import build_blocks
from seft_ros.test_run.offline import simulate_test

ROOT = Path(__file__).parents[3]
PERFECT = (
    "rig:sensors.adc_bits:=0",
    *(
        f"rig:sensors.{name}_{row}:=0"
        for name in ("position", "velocity", "acceleration", "force")
        for row in ("noise", "bias", "range")
    ),
)
"""Sensors that measure the truth."""
LINEAR = (
    "rig:actuator.kind:=servo_hydraulic_linear",
    "rig:actuator.oil_stiffness:=1.664e7",
    "rig:actuator.oil_column_frequency:=0",
    "rig:actuator.leakage:=20",
    "rig:actuator.flow_gain:=0.038527",
    "rig:actuator.valve_frequency:=60",
    "rig:actuator.valve_damping:=0.7",
    "rig:actuator.dead_time:=0.001",
    "rig:actuator.viscous_friction:=0",
    *(f"{node}.damping:=903.5" for node in ("rig:specimen", "reference_force:model")),
)
"""A linear rig with the poles of Eq. 3.1."""
QUIET = (*LINEAR, *PERFECT)
DELAY = ("rig:actuator.kind:=delay", "rig:actuator.delay:=0.01")

M, C, K = 52.7, 903.5, 2.11e5
H = 0.001  # half a step: the valve's dead time


UNWATCHED = "reference_force:instability.ratio:=0.0"
"""Lets a loop go unstable as by its equations."""


def run(*words):
    """Record of an experiment, and its samples of rig/state, shape (N, 4, n)."""
    record = simulated(load(UNWATCHED, *words))
    return record, record.series["rig/state"].values


def with_ratio(alpha):
    return f"reference_force:mass_ratio:={alpha}"


def ground_of(record):
    return record.series["ground_motion"].values[:, 0, 0].tolist()


class Servo:
    """The linear actuator and its specimen by modes, in steps of 1 ms."""

    drive = "valve"

    def __init__(self):
        oil, leakage, flow, wv, zv = 1.664e7, 20.0, 0.038527, 2 * np.pi * 60.0, 0.7
        a = np.array(
            [
                [0, 1, 0, 0, 0],
                [-K / M, -C / M, 1 / M, 0, 0],
                [0, -oil, -leakage, oil * flow, 0],
                [0, 0, 0, 0, 1],
                [0, 0, 0, -(wv**2), -2 * zv * wv],
            ]
        )
        values, modes = np.linalg.eig(a)
        inverse = np.linalg.inv(modes)
        self.free = (modes * np.exp(values * H) @ inverse).real
        self.forced = (modes * (np.expm1(values * H) / values) @ inverse).real[:, 4] * wv**2
        self.z = np.zeros(5)
        self.old = self.now = 0.0

    def advance(self, command):
        """To the next sample: the drive changes half way, when the dead time is over."""
        for u in (self.old, self.now):
            self.z = self.free @ self.z + self.forced * u
        self.old, self.now = self.now, command
        x, v, f = self.z[:3].tolist()
        return x, v, (f - C * v - K * x) / M, f


def by_hand(motion, alpha, plant):
    """The test of Eq. 2.4 and 2.5 with Eq. 3.1, sample after sample, in plain floats."""
    s = 2 / (2 * H)
    a0, a1, a2 = s**2 + 17.14 * s + 4002, 2 * 4002 - 2 * s**2, s**2 - 17.14 * s + 4002
    e1 = e2 = u1 = u2 = reference = 0.0
    state, samples = (0.0, 0.0, 0.0, 0.0), []
    for k, ground in enumerate(motion):
        if k:
            state = plant.advance(u1 if plant.drive == "valve" else reference)
        samples.append(state)
        reference = -(1 + alpha) * M * ground - alpha * M * state[2]
        error = reference - state[3]
        u = (37 * (error + 2 * e1 + e2) - a1 * u1 - a2 * u2) / a0
        u = max(-10.0, min(10.0, u))  # the recursion goes on from what the valve does
        e2, e1, u2, u1 = e1, error, u1, u
    return np.array(samples)


@pytest.mark.parametrize("alpha", [0.0, 0.5, 1.0])
def test_the_rig_of_the_paper_moves_as_in_a_simulation_written_anew(alpha):
    record, states = run(*QUIET, with_ratio(alpha))
    expected = by_hand(ground_of(record), alpha, Servo())
    assert len(states) == len(expected)
    scale = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(states[:, :, 0] / scale, expected / scale, atol=1e-6)


def test_a_delay_of_10_ms_is_stable_below_a_mass_ratio_of_one_and_not_at_one():
    """A neutral delay equation: alpha_c = 1 - (2 f_n T)^2 with the loop's own 3 ms in T."""
    critical = 1 - (2 * 10.07 * 0.013) ** 2
    words = (*QUIET, *DELAY, "ground_motion:tail:=20")
    for alpha in (0.9, critical - 0.01):
        record, states = run(*words, with_ratio(alpha))
        x = np.abs(states[:, 0, 0])
        assert record.trip is None
        assert x[-1000:].max() < 1e-9 * x.max()
    for alpha in (critical + 0.01, 1.0):
        assert run(*words, with_ratio(alpha))[0].trip is not None


@pytest.mark.parametrize(
    "words",
    [
        (with_ratio(1.6), "supervisor:limits.acceleration:=30"),
        (with_ratio(0.5), "supervisor:limits.displacement:=0.003"),
        (with_ratio(0.0), "rig:limits.force:=500"),
        (with_ratio(0.0), "rig:limits.velocity:=0.1"),
    ],
)
def test_a_test_ends_with_the_sample_that_breaks_a_limit(words):
    record, states = run(*words)
    names = ("displacement", "velocity", "acceleration", "force")
    limits = np.array([record.experiment["rig"][f"limits.{name}"] for name in names])
    beyond = (np.abs(states[:, :, 0]) > limits).any(axis=1)
    # the rig's own limits stand behind those of the judged samples
    last = 1 if words[1].startswith("supervisor") else PERSISTENT
    assert np.flatnonzero(beyond).tolist() == list(range(len(states) - last, len(states)))
    assert record.trip.step == len(states) - 1
    assert record.trip.time_s == pytest.approx(record.trip.step * 0.002)
    assert record.trip.reason.split()[0] in words[1]
    for series in record.series.values():
        np.testing.assert_array_equal(series.steps, np.arange(len(states)))


def test_a_limit_of_the_rig_broken_from_rest_on_ends_the_test_at_once():
    record, states = run(*PERFECT, "rig:sensors.force_noise:=1000", "rig:limits.force:=0.001")
    assert len(states) == PERSISTENT
    assert record.trip.step == PERSISTENT - 1


def test_the_same_experiment_gives_the_same_bits_and_another_seed_others():
    one, two, other = (run(with_ratio(0.5), f"rig:seed:={seed}")[1] for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, two)
    assert not np.array_equal(one, other)


def test_progress_is_told_in_steps():
    experiment = load()
    told = []
    simulate_test(experiment, build_blocks(experiment), told.append)
    assert told == [BLOCK, 2 * BLOCK, 8501]
