"""What the checks of a rig's driver see in samples."""

import numpy as np
import pytest
from experiments_at_hand import load
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.messages import Status
from seft_msgs_py.wire.topics import RIG_STATE, VALVE_COMMAND
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_plant_sim import whole_structure
from seft_plant_sim.command import Command
from seft_plant_sim.simulated.rig import Rig
from seft_ros.conformance import message_checks, motion_checks
from seft_ros.conformance.driver import (
    CHECK_KINDS,
    Guard,
    Samples,
    Trial,
    finding_line,
    found,
    not_run,
    summarise_findings,
)
from seft_ros.conformance.motion_checks import BadCommands, MotionDrive

RATE = 500.0
DT = 1 / RATE
G = 9.80665


EXPERIMENT = load("actuator.kind:=servo_hydraulic_linear")
SPECIMEN = whole_structure.tested_specimen(EXPERIMENT)
DRIVE = MotionDrive(DT, 0.2)


def moved(drive=DRIVE, later=0):
    """Samples of the rig under the drive; commands are applied so many steps late."""
    rig = Rig.from_parameters(EXPERIMENT["rig"], EXPERIMENT.axes, EXPERIMENT.timebase)
    commands = np.concatenate([np.zeros(later), drive.commands])
    states = [rig.reset()]
    states += [rig.step(np.array([value])).copy() for value in commands[: drive.steps - 1]]
    steps = np.arange(drive.steps)
    drives = np.concatenate([[0.0], drive.commands[:-1]])[:, np.newaxis]
    return Samples(steps, np.array(states)[:, :4], drives, steps * DT)


@pytest.fixture(scope="module")
def samples():
    return moved()


def scaled(samples, row, factor):
    values = samples.values.copy()
    values[:, row] *= factor
    return samples._replace(values=values)


def units_of(samples, specimen=SPECIMEN):
    findings = motion_checks.check_units(samples, DRIVE, specimen)
    return {finding.check: finding for finding in findings}


def test_channels_that_fit_one_another_pass(samples):
    findings = units_of(samples)
    assert {finding.verdict for finding in findings.values()} == {"passed"}
    assert findings["velocity of displacement"].measured["ratio"] == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize(
    ("row", "factor", "check", "culprit", "why"),
    [
        (0, 1e3, "velocity of displacement", "displacement", "a thousandth of SI's (mm"),
        (0, 1 / 0.0254, "velocity of displacement", "displacement", "inches"),
        (0, -1.0, "velocity of displacement", "displacement", "the sign is reversed"),
        (1, 1e3, "velocity of displacement", "velocity", "a thousandth of SI's"),
        (1, -1.0, "acceleration of velocity", "velocity", "the sign is reversed"),
        (2, 1 / G, "acceleration of velocity", "acceleration", "the unit is g, not m/s^2"),
        (2, -1 / G, "acceleration of velocity", "acceleration", "and the sign is reversed"),
        (2, -1.0, "acceleration of velocity", "acceleration", "the sign is reversed"),
        (3, 1e-3, "force of specimen", "", "kN"),
        (3, -1.0, "force of specimen", "", "the sign is reversed"),
        (3, 1.5, "force of specimen", "", "times too large"),
    ],
)
def test_a_wrong_unit_or_sign_is_found_and_named(samples, row, factor, check, culprit, why):
    finding = units_of(scaled(samples, row, factor))[check]
    assert finding.verdict == "failed"
    assert finding.remedy.startswith(culprit)
    assert why in finding.remedy


def test_a_channel_of_another_time_is_no_derivative(samples):
    values = samples.values.copy()
    values[:, 2] = np.roll(values[:, 2], 10, axis=0)
    late = samples._replace(values=values)
    finding = units_of(late)["acceleration of velocity"]
    assert (finding.verdict, "not of one time" in finding.remedy) == ("failed", True)


def test_without_a_specimen_that_is_known_the_force_is_not_assessed(samples):
    assert units_of(samples, None)["force of specimen"].verdict == "not run"


def test_a_valve_that_is_reversed_is_found(samples):
    assert motion_checks.check_moves(samples, DRIVE).verdict == "passed"
    reversed_valve = samples._replace(values=-samples.values)
    finding = motion_checks.check_moves(reversed_valve, DRIVE)
    assert (finding.verdict, "reverse the valve's sign" in finding.remedy) == ("failed", True)


def test_a_rig_without_pressure_does_not_move():
    still = moved(MotionDrive(DT, 1e-9))
    finding = motion_checks.check_moves(still, DRIVE)
    assert (finding.verdict, "is the pressure on?" in finding.remedy) == ("failed", True)


@pytest.mark.parametrize(
    ("later", "lag", "expected"),
    [(0, 0.0, "passed"), (6, 0.0, "failed"), (6, 0.012, "passed"), (12, 0.012, "failed")],
)
def test_commands_that_are_applied_late_are_found(later, lag, expected):
    finding = motion_checks.check_answer_delay(moved(later=later), DRIVE, lag)
    assert finding.verdict == expected


def test_a_rig_that_tells_another_drive_than_was_sent_is_found(samples):
    assert motion_checks.check_answer_delay(samples, DRIVE, 0.0).verdict == "passed"
    early = samples._replace(drives=np.roll(samples.drives, -1, axis=0))
    finding = motion_checks.check_answer_delay(early, DRIVE, 0.0)
    assert (finding.verdict, "tells another drive" in finding.result) == ("failed", True)


def test_a_rig_that_drifts_is_not_at_rest(samples):
    assert motion_checks.check_rest(samples, DRIVE).verdict == "passed"
    values = samples.values.copy()
    values[:, 0] += 1e-3 * samples.times[:, np.newaxis]
    drifting = samples._replace(values=values)
    assert motion_checks.check_rest(drifting, DRIVE).verdict == "failed"


def at(times):
    return Samples(
        np.arange(len(times)),
        np.zeros((len(times), 4, 1)),
        np.zeros((len(times), 1)),
        np.asarray(times),
    )


def timing(times, stalls=()):
    found = message_checks.check_timing(at(times), DT, stalls)
    return {finding.check: finding.verdict for finding in found}


def test_lateness_and_period_are_assessed_by_half_a_period_and_a_hundredth():
    due = np.arange(1000) * DT
    jitter = np.random.default_rng(1).uniform(0, 0.2 * DT, 1000)
    assert timing(due + jitter) == {"period": "passed", "late states": "passed"}
    late = due + 0.8 * DT * (np.arange(1000) % 5 == 0)
    assert timing(late)["late states"] == "failed"
    rare = due + 0.8 * DT * (np.arange(1000) % 50 == 7)
    assert timing(rare)["late states"] == "failed"
    assert timing(1.05 * due)["period"] == "failed"


def test_a_rig_may_wait_for_its_first_answer():
    times = np.arange(1000) * DT
    times[1:] += 5 * DT
    assert timing(times) == {"period": "passed", "late states": "passed"}
    times[2:] += 5 * DT
    assert timing(times)["late states"] == "failed"


def test_what_this_host_was_late_with_is_not_the_rigs():
    times = np.arange(1000) * DT
    times[400:440] = times[440]
    assert timing(times)["late states"] == "failed"
    assert timing(times, [(0.8, 0.885)])["late states"] == "passed"
    everywhere = [(0.1 * k, 0.1 * k + 0.05) for k in range(20)]
    assert timing(times, everywhere)["late states"] == "passed"
    late = times + 0.8 * DT * (np.arange(1000) % 5 == 0)
    assert timing(late, everywhere)["late states"] == "failed"


def states(count=20, offset_ns=0):
    codec = TrajectoryCodec(RIG_STATE, EXPERIMENT.axes, EXPERIMENT.timebase)
    raws = [codec.encode(step, np.full((5, 1), 0.5)) for step in range(count)]
    if offset_ns:
        raws = [
            raw[:8]
            + (int.from_bytes(raw[8:12], "little") + offset_ns).to_bytes(4, "little")
            + raw[12:]
            for raw in raws
        ]
    return Trial(states=[(0.01 * k, raw) for k, raw in enumerate(raws)])


def test_stamps_are_whole_periods_from_zero():
    period_ns = EXPERIMENT.timebase.period_ns
    assert message_checks.check_stamps(states(), period_ns).verdict == "passed"
    off = message_checks.check_stamps(states(offset_ns=1000), period_ns)
    assert (off.verdict, off.measured["off_ns"]) == ("failed", 1000.0)
    trial = states()
    del trial.states[7]
    gap = message_checks.check_stamps(trial, period_ns)
    assert "message 7 is stamped" in gap.result


def test_axes_and_values_are_looked_at():
    good = states()
    assert message_checks.check_form(good, EXPERIMENT.axes).verdict == "passed"
    other = message_checks.check_form(good, ("north",))
    assert "axes are ['x'], not ['north']" in other.result
    (_, raw) = good.states[3]
    good.states[3] = (0.03, raw.replace(np.float64(0.5).tobytes(), np.float64("nan").tobytes()))
    assert "message 3: positions are [nan]" in message_checks.check_form(good, ("x",)).result


def test_a_description_of_another_rate_or_pace_is_refused():
    said = {"rate": RATE, "axes": ["x"]}
    check = message_checks.check_description
    assert check({"parameters": said}, EXPERIMENT).verdict == "passed"
    assert check(None, EXPERIMENT).verdict == "failed"
    assert "rate is 100" in check({"parameters": said | {"rate": 100.0}}, EXPERIMENT).result
    assert "lockstep" in check({"parameters": said | {"pace": "lockstep"}}, EXPERIMENT).result


def test_every_bad_command_is_refused_by_the_simulated_rig():
    codec = TrajectoryCodec(VALVE_COMMAND, EXPERIMENT.axes, EXPERIMENT.timebase)
    bad, command = BadCommands(codec, 0.2), Command(codec, 10.0)
    refused = dict.fromkeys(CHECK_KINDS, 0)
    for step in range(bad.steps):
        command.current = step
        kind = next(
            (k for n, k in enumerate(CHECK_KINDS) if step in range(bad.steps)[bad.block(n)]), ""
        )
        for raw in bad.answers(step):
            try:
                command.take(raw)
            except WireError:
                refused[kind] += 1
        assert command.value[0] == 0.0
    assert all(count >= 10 for count in refused.values()), refused


def status(phase, **values):
    return Status("rig", 0, phase, values={"phase": phase, **values})


@pytest.mark.parametrize(
    ("at", "phase", "expected"),
    [(1.03, "tripped", "passed"), (1.9, "tripped", "failed"), (1.03, "running", "failed")],
)
def test_a_trip_is_in_time_or_not(at, phase, expected):
    trial = Trial(marks={"silent": 1.0}, statuses=[(at, status(phase, reason="no command"))])
    finding = motion_checks.check_watchdog(trial, 0.02, "valve_command")
    assert finding.verdict == expected


def test_the_guard_believes_two_sensors_or_a_limit():
    guard = Guard(EXPERIMENT, travel=2e-3, force=500.0)
    rest, moving = np.zeros((4, 1)), np.zeros((4, 1))

    def look(displacement, force):
        guard.reset()
        for _ in range(25):
            assert guard.fault(rest) == ""
        moving[0], moving[3] = displacement, force
        return guard.fault(moving)

    assert look(0.001, 100.0) == ""
    assert look(0.01, 100.0) == ""  # one sensor alone, within the limits
    assert "moved 0.01 m" in look(0.01, 800.0)
    assert "beyond the limit of 0.076 m" in look(0.2, 0.0)
    assert "beyond the limit" in look(np.nan, 0.0)


def test_a_rig_conforms_where_nothing_failed():
    good, bad = found("a", True, "fine", "do this"), found("b", False, "bad", "do this", x_s=1.0)
    assert summarise_findings([good, not_run("c", "why")])["conforms"] is True
    result = summarise_findings([good, bad])
    assert (result["conforms"], result["passed"], result["failed"]) == (False, 1, 1)
    assert "-> do this" in finding_line(bad).plain
    assert "->" not in finding_line(good).plain
    assert summarise_findings([])["conforms"] is False
