"""From messages of the loop to what is shown of one test after another."""

import numpy as np
import pytest
from experiments_at_hand import load
from recordings_at_hand import of_rig, recording_of
from seft_msgs_py.wire.topics import GROUND_MOTION, REFERENCE_FORCE, RIG_STATE
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_plant_sim.whole_structure import reference_response, whole_structure
from seft_ros.analysis import equivalent_motion
from seft_ros.analysis.equivalent_motion import (
    EquivalentMotion,
    assumed_structure,
    motion_difference,
)
from seft_ros.ground_motion.response_spectrum import response_spectrum
from seft_ros.monitor.intake import Intake

EXPERIMENT = load()
AXES, TIMEBASE = EXPERIMENT.axes, EXPERIMENT.timebase
MOTION = np.random.default_rng(2).normal(size=(400, 1))
MS = 1_000_000


def codec(topic):
    return TrajectoryCodec(topic, AXES, TIMEBASE)


def states(steps):
    values = np.zeros((6, 1))
    found = []
    for step in steps:
        values[:4, 0] = step, 0.0, 2 * step, 3 * step
        found.append((codec(RIG_STATE).encode(step, values), 2 * MS * step))
    return found


def forces(steps, late=MS // 2, ahead=1):
    points = np.arange(ahead, dtype=np.float64)[:, np.newaxis]
    encode = codec(REFERENCE_FORCE).encode_points
    return [(encode(s, 4.0 * s + points), 2 * MS * s + late) for s in steps]


def motion(first, values):
    return [(codec(GROUND_MOTION).encode_points(first, values), 0)]


@pytest.fixture
def intake():
    found = Intake(AXES, TIMEBASE)
    found.describe(EXPERIMENT.sections)
    return found


def recent(intake, part):
    """What is shown of a signal once all that came has been taken in."""
    intake.samples([[]], [])
    return intake.history.recent().values[:, part][:, 0]


def test_measured_and_reference_force_of_a_step_stand_together(intake):
    intake.samples([states(range(50))], forces(range(49)))
    (last,) = intake.samples([[]], [])
    assert last.first + len(last.values) == 50
    signals = intake.signals
    np.testing.assert_allclose(recent(intake, signals.measured["force"]), 3 * np.arange(50))
    reference = recent(intake, signals.reference["force"])
    np.testing.assert_allclose(reference[:49], 4 * np.arange(49))
    assert np.isnan(reference[49])
    np.testing.assert_allclose(recent(intake, signals.answer)[:49], 0.5)


def test_of_previews_the_step_s_own_force_counts(intake):
    intake.samples([states(range(9))], forces(range(9), ahead=5))
    reference = recent(intake, intake.signals.reference["force"])
    np.testing.assert_allclose(reference, 4 * np.arange(9))


def test_an_answer_before_its_question_is_two_clocks_and_not_shown(intake):
    intake.samples([states(range(9))], forces(range(9), late=-MS))
    assert np.isnan(recent(intake, intake.signals.answer)).all()


def test_the_exact_response_comes_with_the_motion(intake):
    intake.motion(motion(0, MOTION[:150]) + motion(150, MOTION[150:]))
    for start in range(0, 400, 40):
        intake.samples([states(range(start, start + 40))], [])
    wanted = reference_response(EXPERIMENT, MOTION)
    for name in ("displacement", "acceleration"):
        found = recent(intake, intake.signals.reference[name])
        exact = getattr(wanted, name)[:, 0]
        np.testing.assert_allclose(found, exact, atol=1e-5 * np.abs(exact).max())
    assert intake.reference_note == ""


def test_the_motion_that_is_tested_is_shown_as_in_the_report(intake, monkeypatch):
    # but for what is folded down, which only the motion's frequency tells
    monkeypatch.setattr(equivalent_motion, "without_folding", lambda samples, *_: samples)
    values = reference_response(EXPERIMENT, MOTION).states
    values[:, 3] *= 1.2
    wanted, samples = motion_difference(recording_of(EXPERIMENT, MOTION, values)), of_rig(values)
    intake.motion(motion(0, MOTION))
    encode = codec(RIG_STATE).encode
    for start in range(0, 400, 57):
        part = [(encode(k, samples[k]), 0) for k in range(start, min(start + 57, 400))]
        intake.samples([part], [])
    assert intake.own_motion["asked"]  # shown once a second, so from its first samples alone
    found = intake._live_motion.summary()
    assert found["response_nrmse"] == pytest.approx(wanted.response_nrmse, rel=1e-6)
    assumed = assumed_structure(EXPERIMENT)
    own = EquivalentMotion(whole_structure(assumed), TIMEBASE.dt).advance(values)[:, 0]
    tested = response_spectrum(own, TIMEBASE.dt, 1 / np.array(found["frequency_hz"]))
    np.testing.assert_allclose(found["tested"][0], tested, rtol=1e-3)


def test_who_comes_in_the_middle_shows_what_follows(intake):
    new = intake.samples([states(range(5000, 5100))], [])
    assert new[0].first == 5000
    intake.motion(motion(0, np.resize(MOTION, (6000, 1))))  # latched; comes a little later
    intake.samples([states(range(5100, 5200))], [])  # some of the way to catch up
    intake.samples([states(range(5200, 5300))], [])
    found = recent(intake, intake.signals.reference["displacement"])
    assert np.isnan(found[:190]).all()
    assert np.isfinite(found[200:]).all()


def test_step_zero_begins_a_test_and_its_own_motion(intake):
    intake.motion(motion(0, MOTION))
    intake.samples([states(range(100))], [])
    intake.motion(motion(0, 2 * MOTION))  # for the next test, while the last still runs
    intake.samples([states(range(100, 200))], [])
    assert intake.number == 1
    intake.samples([states(range(60))], [])
    assert intake.number == 2
    assert intake.history.head == 60
    exact = 2 * reference_response(EXPERIMENT, MOTION).displacement[:60, 0]
    found = recent(intake, intake.signals.reference["displacement"])
    np.testing.assert_allclose(found, exact, atol=1e-5 * np.abs(exact).max())


def test_old_steps_of_somebody_else_are_left_out_unless_a_test_is_expected(intake):
    intake.samples([states(range(100))], [])
    intake.samples([states(range(10, 20))], [])
    assert (intake.number, intake.history.head) == (1, 100)
    intake.clear()
    assert (intake.number, intake.history.head, len(intake.history.recent().values)) == (2, 0, 0)
    intake.samples([states(range(3, 20))], [])
    assert (intake.number, intake.history.head) == (2, 20)


def test_a_long_gap_is_passed_over(intake):
    intake.samples([states([0, 1, 2, 10**6, 10**6 + 1])], [])
    intake.samples([[]], [])
    assert intake.history.recent().first == 10**6
    assert intake.history.envelope.origin == 0


def test_garbage_is_counted_and_does_not_hide_the_others(intake):
    messages = states(range(4))
    messages[1:1] = [(b"", 0), (b"\0" * 3, 0), (b"\xff" * len(messages[0][0]), 0)]
    intake.samples([messages], [(b"x" * 40, 0)])
    intake.samples([[]], [])
    assert intake.refused == 4
    assert intake.history.head == 4


def test_a_structure_that_is_not_described_has_a_note():
    intake = Intake(AXES, TIMEBASE)
    intake.samples([states(range(3))], [])
    assert "described" in intake.reference_note


def test_each_axis_has_its_own_columns():
    intake = Intake(("x", "y"), TIMEBASE)
    values = np.arange(12.0).reshape(6, 2)
    raw = TrajectoryCodec(RIG_STATE, ("x", "y"), TIMEBASE).encode(0, values)
    intake.samples([[(raw, 0)]], [])
    intake.samples([[]], [])
    (row,) = intake.history.recent().values
    for name, expected in (("displacement", [0, 1]), ("acceleration", [4, 5]), ("force", [6, 7])):
        assert row[intake.signals.measured[name]].tolist() == expected
        assert np.isnan(row[intake.signals.reference[name]]).all()


def test_of_a_specimen_that_yields_the_response_is_said_to_be_near():
    kind = (
        "rig:simulated.specimen.kind:=bilinear",
        "rig:simulated.specimen.yield_displacement:=0.004",
    )
    intake = Intake(AXES, TIMEBASE)
    intake.describe(load(*kind).sections)
    intake.motion(motion(0, MOTION))
    intake.samples([states(range(100))], [])
    assert "yields" in intake.reference_note
    assert np.isfinite(recent(intake, intake.signals.reference["displacement"])).all()
