"""Detectors of faults: each fault of the hardware ends a test soon, no fault-free test ends by
them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from experiments_at_hand import load, simulated
from rig_faults import FAULTS, LATE, MISSED, SlowHost, lines_of
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.errors import InputError
from seft_plant_sim.judge.detector_list import WARNING
from seft_plant_sim.rig import Rig
from seft_ros.analysis.summary import detector_shares
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test

PLAN = (
    *("reference_force:compensation.method:=target_motion", "reference_force:mass_ratio:=1.0"),
    *("force_controller:method:=velocity_feedforward", "ground_motion:peak_force:=500.0"),
)
TRUE = "rig:simulated."
KIND, SPECIMEN = f"{TRUE}specimen.kind:=", f"{TRUE}specimen."
BILINEAR = (f"{KIND}bilinear", f"{SPECIMEN}yield_displacement:=0.003")
GAP = (f"{KIND}gap", f"{SPECIMEN}gap.width:=0.003", f"{SPECIMEN}gap.stiffness:=2.11e5")
OBEYS = "actuator.kind:=delay", "actuator.delay:=0.01"
STICKS = f"{KIND}friction", f"{SPECIMEN}friction.force:=300.0"
NOISE = np.array([5e-6, 1e-3, 0.05, 3.0])
SOON, LARGEST, UNCHANGED = 0.05, 1.5, 0.01
IN_TIME, HARMLESS, TOO_LATE, HARD = "in time", "harmless", "late", "hard"
SEEN_ANYWHERE = (  # faults that end a test in time wherever they come; of others see safety.md
    *(f"displacement {fault}" for fault in ("dead", "frozen", "flipped", "off by its peak")),
    *(f"displacement {fault}" for fault in ("halved", "doubled", "dead but for noise")),
    *(f"velocity {fault}" for fault in ("dead", "frozen", "flipped", "off by its peak", "noisy")),
    *(f"velocity {fault}" for fault in ("halved", "doubled", "dead but for noise")),
    *(f"acceleration {fault}" for fault in ("dead", "frozen", "doubled", "off by its peak")),
    *("force frozen", "converter frozen"),
    *("cable of all sensors broken", "axes dead but for noise"),
)
MOST = 12  # faults of which a test at its fastest may be too late, or the oil hammer


@cache
def fault_free(words):
    """A test without a fault, its blocks, the largest value of each channel, and its recording."""
    experiment, known = load(*words), {}
    recording = simulate_test(experiment, build_blocks(experiment, known))
    assert recording.trip is None
    largest = np.abs(recording.measured.values).max(axis=(0, 2))
    return experiment, known, largest, recording


def with_fault(fault, words, at):
    """Run a test with a fault from a step on: its recording, and what came of it, see `verdict`."""
    experiment, known, largest, right = fault_free(words)
    lines = lines_of(fault, at * experiment.timebase.dt, NOISE, largest)
    faulty = experiment.changed({"rig": {"faults": lines}})
    recording = simulate_test(faulty, build_blocks(faulty, known))
    return recording, verdict(recording, largest[3], right)


def of_sensor(line):
    """Say whether a fault is one of a sensor."""
    return line.rpartition("/")[2].startswith(CHANNELS)


def fault_free_sensors(recording):
    """Give what fault-free sensors would have measured in a test, shape (N, 4, n)."""
    experiment = recording.experiment
    faults = [line for line in experiment["rig"]["faults"] if not of_sensor(line)]
    section = experiment["rig"] | {"faults": faults or ""}
    rig = Rig(section, experiment.axes, experiment.timebase)
    commands = recording.series["valve_command"].values[:-1, 0]
    rig.reset()
    found = [rig.measured]
    for command in commands:
        rig.step(command)
        found.append(rig.measured)
    return np.array(found)


def verdict(recording, largest_force, fault_free_recording):
    """Say whether a test with a fault ended in time and gently, or the fault did nothing to it."""
    if recording.simulated.force_peak > LARGEST * largest_force:
        return HARD
    sampled, noise = fault_free_sensors(recording), NOISE[:, np.newaxis]
    right = fault_free_recording.measured.values[: len(sampled)]
    beyond = (np.abs(recording.measured.values - sampled) > 6.0 * noise).any(axis=(1, 2))
    if not beyond.any():  # not a fault of a sensor: it shows in the motion
        beyond = (np.abs(sampled - right) > 6.0 * noise).any(axis=(1, 2))
    felt = int(beyond.argmax()) if beyond.any() else None
    if recording.trip is None:
        off = sampled[:, 0] - right[:, 0]
        moves = np.sqrt(np.mean(off**2) / np.mean(right[:, 0] ** 2))
        return HARMLESS if felt is None or moves < UNCHANGED else TOO_LATE
    late = 0 if felt is None else (len(sampled) - 1 - felt) * recording.experiment.timebase.dt
    return IN_TIME if late <= SOON + 1e-9 else TOO_LATE


@pytest.mark.parametrize(("specimen", "at"), [((), 1000), (BILINEAR, 1700), (GAP, 2300)])
def test_faults_of_the_hardware_end_a_test_soon(specimen, at):
    words = (*PLAN, *specimen)
    missed = {fault for fault in FAULTS if with_fault(fault, words, at)[1] in (TOO_LATE, HARD)}
    assert not missed & set(SEEN_ANYWHERE)
    assert len(missed) <= MOST


@pytest.mark.parametrize(
    "specimen",
    [
        (),
        BILINEAR,
        (f"{KIND}bouc_wen", f"{SPECIMEN}yield_displacement:=0.002"),
        (f"{KIND}flag", f"{SPECIMEN}yield_displacement:=0.003"),
        (f"{KIND}gap", f"{SPECIMEN}gap.width:=0.003", f"{SPECIMEN}gap.stiffness:=2.11e5"),
        (f"{KIND}friction", f"{SPECIMEN}friction.force:=190.0"),
        (f"{KIND}duffing", f"{SPECIMEN}duffing.cubic:=3.0e9"),
        ("specimen.stiffness:=1.3e5", f"{TRUE}specimen.stiffness:=2.11e5"),
        ("actuator.flow_gain:=0.045", f"{TRUE}actuator.flow_gain:=0.0403"),
        ("actuator.dead_time:=0.003", f"{TRUE}actuator.dead_time:=0.001"),
        ("/**:sensors.adc_bits:=12",),
        tuple(f"{TRUE}sensors.{name}_filter:=100.0" for name in CHANNELS),
        ("calibration.force_lag:=0.003",),
        ("sensors.velocity:=derived",),
        *(((f"{SPECIMEN}kind:=linear", f"rate:={rate}")) for rate in (250.0, 2000.0)),
        tuple(f"sensors.{name}_noise:=0.0" for name in ("displacement", "velocity", "force")),
    ],
)
def test_no_fault_free_test_ends_by_a_detector(specimen):
    for seed in (1, 3):  # 2 needs more flow than the valve has, and is faster than the limit
        experiment = load(*PLAN, *specimen, f"ground_motion:synthetic.seed:={seed}")
        assert simulated(experiment).trip is None


QUIET = (*(f"sensors.{name}_noise:=0.0" for name in CHANNELS), "sensors.adc_bits:=0")


@pytest.mark.parametrize("method", ["model", "target_motion"])
@pytest.mark.parametrize(("ratio", "delay"), [(0.5, 0.01), (1.0, 0.01), (1.0, 0.0113)])
def test_no_fault_free_test_on_a_rig_that_obeys_forces_comes_near_a_detector(method, ratio, delay):
    """Without noise and converter: all that is left is the motion between the samples."""
    experiment = load(
        *("actuator.kind:=delay", f"actuator.delay:={delay}", *QUIET),
        *(f"limits.{name}:=1.0e+9" for name in ("velocity", "acceleration_rate")),
        *(f"reference_force:mass_ratio:={ratio}", f"reference_force:compensation.method:={method}"),
    )
    recording = simulated(experiment)
    assert recording.trip is None
    shares = detector_shares(recording)
    assert max(shares.values()) < WARNING
    assert shares["oil_balance"] == 0.0


@pytest.mark.parametrize(
    "fault", [*(f"{channel} flipped" for channel in CHANNELS), "valve reversed"]
)
def test_wrong_polarity_ends_a_test_within_millimetres(fault):
    recording, _ = with_fault(fault, PLAN, 0)
    assert recording.trip is not None
    most = {"force flipped": 4e-3, "acceleration flipped": 1.3e-3}.get(fault, 1e-3)
    assert recording.simulated.displacement_peak < most


@pytest.mark.parametrize("row", range(4))
def test_a_spike_of_one_sample_is_passed_over(row):
    _, known, largest, right = fault_free(PLAN)
    spike = f"{CHANNELS[row]} add {0.3 * largest[row]} at 2.468 for 1"
    experiment = load(*PLAN, f"rig:faults:={spike}")
    recording = simulate_test(experiment, build_blocks(experiment, known))
    assert recording.trip is None
    sent, planned = (each.series["valve_command"].values[:, 0, 0] for each in (recording, right))
    spiked = abs(sent[1234] - planned[1234])
    assert row > 1 or spiked < 0.05 * np.abs(planned).max()  # the motion goes on as planned
    assert recording.simulated.force_peak < 1.2 * largest[3]


def test_until_the_rig_ends_a_test_and_closes_its_valve_the_motion_goes_on_as_planned():
    recording = simulated(load(*PLAN, "rig:faults:=displacement add 0.005 at 3.0"))
    commands = recording.series["valve_command"].values[1500:, 0, 0]
    planned = fault_free(PLAN)[3].series["valve_command"].values[1500:, 0, 0][: len(commands)]
    largest = np.abs(fault_free(PLAN)[3].series["valve_command"].values).max()
    assert np.abs(commands - planned).max() < 0.05 * largest
    assert len(commands) == 3
    assert "displacement_wrong" in recording.trip.reason


def test_a_detector_may_warn_alone():
    words = (*PLAN, "rig:detectors.warn_only:=tracking, displacement_velocity")
    (drift,) = lines_of("displacement drifting", 3.0, NOISE, fault_free(PLAN)[2])
    recording = simulated(load(*words, f"rig:faults:={drift}"))
    assert recording.trip is None or "displacement_velocity" not in recording.trip.reason
    assert detector_shares(recording)["displacement_velocity"] > 1.0
    with pytest.raises(InputError, match="no detector 'speed'; there are displacement_velocity"):
        build_blocks(load("rig:detectors.warn_only:=speed"))


def test_a_lost_state_is_no_fault():
    """The interlock does not see each state, and the rig holds the last command meanwhile."""
    blocks = build_blocks(load(*PLAN))
    rig, force, interlock = blocks.rig, blocks.reference_force, blocks.force_controller
    known, window = blocks.ground_motion.known, 1 + force.preview
    state, command = rig.reset(), np.zeros(1)
    for step in range(blocks.ground_motion.steps - 1):
        points = force.step(known[step : step + window], state[:4])
        if step % 23:
            command = interlock.step(step, points, state)
        state = rig.step(command)
        assert interlock.reason == ""
        assert rig.violation is None


@pytest.mark.parametrize("how", [LATE, MISSED])
def test_a_rig_that_misses_commands_has_no_fault(how):
    experiment, known, _, _ = fault_free(PLAN)
    blocks = build_blocks(experiment, known)
    host = SlowHost(blocks.rig, how, blocks.force_controller)
    recording = simulate_test(experiment, replace(blocks, rig=host))
    assert recording.trip is None


@pytest.mark.parametrize("words", [PLAN, (*PLAN, *OBEYS, *STICKS)])
def test_shares_of_a_recording_are_those_of_the_test(words):
    experiment = load(*words)
    blocks = build_blocks(experiment)
    recording = simulate_test(experiment, blocks)
    shares = detector_shares(recording)
    assert shares.pop("tracking") == blocks.force_controller.off_target
    of_rig = blocks.rig.guard.state.detectors.shares[:, 0]
    np.testing.assert_array_equal(list(shares.values()), of_rig)
