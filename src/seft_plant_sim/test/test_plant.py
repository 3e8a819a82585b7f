"""The sampled plant against closed forms, and against an ODE solver that knows no sampling."""

import itertools

import numpy as np
import pytest
from bare_rig import BareRig
from scipy.integrate import solve_ivp
from seft_msgs_py.errors import InputError
from seft_plant_sim.actuator import Hydraulics
from seft_plant_sim.continuous_model import delayed_force, servo_hydraulic
from seft_plant_sim.specimen import Specimen

DT = 0.002
PAPER = Specimen(np.array([[52.7]]), np.array([[903.5]]), np.array([[2.11e5]]))
COUPLED = Specimen(
    np.array([[60.0, 5.0, 0.0], [5.0, 45.0, -3.0], [0.0, -3.0, 30.0]]),
    np.array([[900.0, -200.0, 0.0], [-200.0, 700.0, -100.0], [0.0, -100.0, 300.0]]),
    np.array([[3.0e5, -1.0e5, 0.0], [-1.0e5, 2.5e5, -0.8e5], [0.0, -0.8e5, 0.9e5]]),
)
HYDRAULIC = {
    "oil_stiffness": [1.664e7, 1.2e7, 2.0e7],
    "leakage": [20.0, 0.0, 35.0],
    "flow_gain": [0.038527, 0.05, 0.02],
    "valve_frequency": [60.0, 80.0, 45.0],
    "valve_damping": [0.7, 1.0, 0.5],
}
DELAYS = [0.0, 0.001, 0.0027, 0.010, 0.0113]


def hydraulic(specimen, dead_time):
    values = {name: np.array(row[: specimen.axes]) for name, row in HYDRAULIC.items()}
    unused = ("opening_limit", "force_capacity", "friction", "friction_velocity", "stroke")
    values |= {name: np.full(specimen.axes, np.inf) for name in unused}
    values["viscous_friction"] = np.zeros(specimen.axes)
    return servo_hydraulic(specimen, Hydraulics(**values, dead_time=dead_time), linear=True)


def run(plant, commands):
    """Samples of a plant, shape (N + 1, 4, n): sample k + 1 follows command k."""
    return np.array([plant.reset(), *(plant.step(command) for command in commands)])


def solved(specimen, commands, delay, valve):
    """The same by `solve_ivp`, from one change of the drive to the next.

    Command k acts from t[k + 1] + delay until the next does.
    """
    count, n = commands.shape
    mass, damping, stiffness = specimen.mass, specimen.damping, specimen.stiffness
    p = {name: np.array(row[:n]) for name, row in HYDRAULIC.items()}
    wv = 2 * np.pi * p["valve_frequency"]

    def acceleration(x, v, force):
        return np.linalg.solve(mass, force - damping @ v - stiffness @ x)

    def slope(_, z, u):
        if not valve:
            x, v = z.reshape(2, n)
            return np.concatenate([v, acceleration(x, v, u)])
        x, v, f, w, wdot = z.reshape(5, n)
        flow = p["oil_stiffness"] * (p["flow_gain"] * w - v) - p["leakage"] * f
        spool = wv * (wv * (u - w) - 2 * p["valve_damping"] * wdot)
        return np.concatenate([v, acceleration(x, v, f), flow, wdot, spool])

    changes = [(k + 1) * DT + delay for k in range(count)]
    samples = [k * DT for k in range(count + 1)]
    times = sorted({round(t, 12) for t in (*changes, *samples) if t <= samples[-1] + 1e-12})
    z, drive = np.zeros(n * (5 if valve else 2)), np.zeros(n)
    result = []
    for begin, end in itertools.pairwise([*times, None]):
        for k, change in enumerate(changes):
            if abs(change - begin) < 1e-9:
                drive = commands[k]
        if any(abs(begin - t) < 1e-9 for t in samples):
            force = z[2 * n : 3 * n] if valve else drive
            result.append([z[:n], z[n : 2 * n], acceleration(z[:n], z[n : 2 * n], force), force])
        if end is not None:
            z = solve_ivp(
                slope, (begin, end), z, "DOP853", args=(drive,), rtol=1e-11, atol=1e-13
            ).y[:, -1]
    return np.array(result)


@pytest.mark.parametrize("specimen", [PAPER, COUPLED], ids=["1 axis", "3 axes"])
@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize("kind", ["delay", "servo_hydraulic"])
def test_samples_are_those_of_the_continuous_system(kind, delay, specimen):
    valve = kind == "servo_hydraulic"
    commands = np.random.default_rng(7).normal(size=(22, specimen.axes)) * (1 if valve else 1000)
    model = hydraulic(specimen, delay) if valve else delayed_force(specimen, delay)
    expected = solved(specimen, commands, delay, valve)
    scale = np.abs(expected).max(axis=(0, 2), keepdims=True)
    ours = run(BareRig(model, DT), commands)
    np.testing.assert_allclose(ours / scale, expected / scale, rtol=0, atol=1e-9)


def test_free_decay_has_the_frequency_and_damping_of_the_paper():
    plant = BareRig(delayed_force(PAPER, 0.0), DT)
    samples = run(plant, np.array([[1000.0]] * 50 + [[0.0]] * 500))
    x = samples[60:, 0, 0]
    # free vibration obeys x[k+1] = 2 e^-d cos(p) x[k] - e^-2d x[k-1]
    (first, second), *_ = np.linalg.lstsq(np.column_stack([x[1:-1], x[:-2]]), x[2:], rcond=None)
    decay = -np.log(-second) / 2
    turn = np.arccos(first / 2 / np.exp(-decay))
    w = np.hypot(decay, turn) / DT
    assert w / (2 * np.pi) == pytest.approx(10.07, abs=0.005)
    assert decay / DT / w == pytest.approx(0.1355, abs=0.00005)


def test_an_undamped_specimen_swings_on_without_loss():
    specimen = Specimen(PAPER.mass, np.zeros((1, 1)), PAPER.stiffness)
    plant = BareRig(delayed_force(specimen, 0.0), DT)
    run(plant, np.full((100, 1), 1000.0))
    samples = np.array([plant.step(np.zeros(1)) for _ in range(50_000)])[1:, :, 0]
    energy = 52.7 * samples[:, 1] ** 2 / 2 + 2.11e5 * samples[:, 0] ** 2 / 2
    np.testing.assert_allclose(energy, energy[0], rtol=1e-8)


def test_static_deflection_is_force_over_stiffness():
    forces = np.array([1000.0, -500.0, 300.0])
    for specimen in (PAPER, COUPLED):
        f = forces[: specimen.axes]
        for delay in (0.0, 0.0027):
            last = run(BareRig(delayed_force(specimen, delay), DT), np.tile(f, (3000, 1)))[-1]
            np.testing.assert_allclose(last[0], np.linalg.solve(specimen.stiffness, f), rtol=1e-9)
            np.testing.assert_allclose(last[1:3], 0.0, atol=1e-9)
            np.testing.assert_array_equal(last[3], f)


def test_a_held_valve_ends_where_flow_and_leakage_balance():
    last = run(BareRig(hydraulic(PAPER, 0.001), 0.02), np.full((6000, 1), 0.01))[-1, :, 0]
    force = 1.664e7 * 0.038527 * 0.01 / 20.0
    np.testing.assert_allclose(last, [force / 2.11e5, 0.0, 0.0, force], rtol=1e-6, atol=1e-6)


def test_an_ideal_actuator_applies_each_command_at_the_next_sample():
    commands = np.random.default_rng(3).normal(size=(50, 3))
    samples = run(BareRig(delayed_force(COUPLED, 0.0), DT), commands)
    np.testing.assert_array_equal(samples[1:, 3], commands)
    x, v, a, f = np.moveaxis(samples, 1, 0)
    balance = a @ COUPLED.mass + v @ COUPLED.damping + x @ COUPLED.stiffness
    np.testing.assert_allclose(balance, f, atol=1e-9)
    np.testing.assert_array_equal(samples[1, :2], 0.0)  # nothing has moved yet


@pytest.mark.parametrize(
    ("delay", "steps"), [(0.0, 0), (0.001, 1), (0.002, 1), (0.0027, 2), (0.010, 5), (0.0113, 6)]
)
def test_a_delayed_force_is_the_command_of_one_step_and_the_delay_before(delay, steps):
    commands = np.random.default_rng(4).normal(size=(40, 1))
    force = run(BareRig(delayed_force(PAPER, delay), DT), commands)[:, 3]
    np.testing.assert_array_equal(force[1 + steps :], commands[: len(commands) - steps])
    np.testing.assert_array_equal(force[: 1 + steps], 0.0)


@pytest.mark.parametrize("rate", [100.0, 512.0, 1000.0, 2000.0])
def test_a_delay_of_whole_samples_is_whole_at_any_rate(rate):
    dt = 1 / rate
    for steps in (1, 3, 29, 300):
        plant = BareRig(delayed_force(PAPER, steps * dt), dt)
        force = run(plant, np.arange(1.0, 400.0)[:, np.newaxis])[:, 3, 0]
        assert np.flatnonzero(force)[0] == 1 + steps


def test_reset_brings_back_the_very_same_samples():
    commands = np.random.default_rng(5).normal(size=(30, 3))
    plant = BareRig(hydraulic(COUPLED, 0.0113), DT)
    first = run(plant, commands)
    run(plant, commands[::-1])
    np.testing.assert_array_equal(run(plant, commands), first)


def test_a_sample_is_not_changed_by_later_steps_nor_by_the_command_array():
    plant = BareRig(hydraulic(PAPER, 0.001), DT)
    command = np.ones(1)
    sample = plant.step(command)
    kept = sample.copy()
    for _ in range(5):
        plant.step(np.full(1, 9.0))
    np.testing.assert_array_equal(sample, kept)
    with pytest.raises(InputError, match="a delay of 2001 s is 1000500 samples long"):
        BareRig(delayed_force(PAPER, 2001.0), DT)
