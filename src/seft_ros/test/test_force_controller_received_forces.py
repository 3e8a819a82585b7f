import itertools

import numpy as np
import pytest
from experiments_at_hand import load
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.topics import Timebase
from seft_ros.force_controller.received_forces import NewestPreview

D, DT = 4, 0.002


def preview(patience=20, in_lockstep=False):
    own = {
        "loop_delay": D,
        "watchdog.reference_timeout": patience * DT,
        "ramp_down_time": 5 * DT,
    }
    newest = NewestPreview(own, 1, Timebase.from_rate(1 / DT))
    newest.reset(in_lockstep)
    return newest


def message(step):
    """Forces are 1, 2, ... from step D on, where the first is settled; sent to step + D."""
    return step, np.maximum(step + np.arange(1.0 + D) + 1 - D, 0.0).reshape(-1, 1, 1)


@given(st.lists(st.booleans(), min_size=30, max_size=60), st.integers(0, D))
def test_whatever_is_late_or_lost_within_the_delay_changes_nothing(arrives, late):
    arriving = [all_lost or step % (1 + D - late) == 0 for step, all_lost in enumerate(arrives)]
    newest = preview()
    for step in range(len(arriving)):
        if step >= late and arriving[step - late]:
            newest.take(*message(step - late))
        force = newest.points(step)
        assert force is not None
        assert force[0].item() == max(step + 1 - D, 0)


def test_before_the_first_message_the_force_is_zero():
    newest = preview()
    assert [newest.points(step)[0].item() for step in range(D)] == [0.0] * D
    assert newest.report().held == 0


def test_beyond_the_delay_a_force_stays_as_it_was_last_sent():
    newest = preview()
    newest.take(*message(0))
    found = [newest.points(step)[0].item() for step in range(10)]
    assert found == [0, 0, 0, 0, 1, 1, 1, 1, 1, 1]
    report = newest.report()
    assert report.held == 5
    assert report.older_than(D) == 5
    assert report.ages == dict.fromkeys(range(10), 1)
    assert not newest.is_lost


def test_a_link_that_stays_silent_brings_the_force_down_softly():
    newest = preview(patience=9)
    newest.take(*message(0))
    forces = [newest.points(step)[0].item() for step in range(15)]
    assert forces[9] == 1
    assert forces[9] > forces[10] > forces[11] > forces[12] > forces[13] > forces[14] == 0.0
    assert newest.is_lost
    newest.take(*message(12))  # too late: the ramp is not taken back
    assert newest.points(15)[0].item() == 0.0
    newest.reset()
    newest.take(*message(0))
    assert newest.points(D)[0].item() == 1.0


HORIZON, SPEED = 3, 0.2


def target(step):
    """A target at 0.2 m/s, sent for D + HORIZON steps ahead; its force is the step's number."""
    steps = step + np.arange(1.0 + D + HORIZON)
    rows = [SPEED * DT * steps, np.full(len(steps), SPEED), steps]
    return step, np.stack(rows, axis=1)[:, :, np.newaxis]


def test_a_step_takes_the_message_of_the_delay_before_whatever_came_since():
    newest = preview()
    for step in range(10):
        newest.take(*target(step))
        points = newest.points(step)
        if step < D:
            assert not points.any()
        else:
            np.testing.assert_array_equal(points, target(step - D)[1][D:])
    newest.take(*target(11))  # that of step 10 is lost
    newest.points(10 + D - 1)
    np.testing.assert_array_equal(newest.points(10 + D), target(11)[1][D - 1 :])


def test_a_target_whose_coming_motion_is_not_known_brakes_without_a_jump():
    newest = preview(patience=100)
    newest.take(*target(0))
    way = [newest.points(step) for step in range(80)][D:]
    for before, after in itertools.pairwise(way):
        assert before.shape == (1 + HORIZON, 3, 1)
        np.testing.assert_allclose(before[1:], after[:-1], rtol=1e-12)
    x, v = np.array([points[0, :2, 0] for points in way]).T
    assert (np.diff(v) <= 0).all()
    assert 0.0 < v[-1] < 0.01 * SPEED
    np.testing.assert_allclose(np.gradient(x, DT)[1:-1], v[1:-1], rtol=0.05)
    assert way[-1][0, 2, 0] == D + HORIZON
    assert newest.report().held == 80 - (1 + D + HORIZON)


def test_a_target_that_is_lost_comes_down_to_where_it_began():
    newest = preview(patience=9)
    newest.take(*target(0))
    way = [newest.points(step) for step in range(15)]
    assert not way[-1].any()
    assert newest.is_lost


def test_in_lockstep_a_step_waits_until_its_force_is_settled():
    newest = preview(in_lockstep=True)
    assert [newest.points(step)[0].item() for step in range(D)] == [0.0] * D
    assert newest.points(D) is None
    newest.take(*message(0))
    assert newest.points(D)[0].item() == 1.0
    assert newest.points(D + 1) is None
    assert newest.report().ages == {1: 1, 2: 1, 3: 1, 4: 2}  # what waited counts once


def test_a_message_that_is_repeated_or_out_of_order_is_refused():
    newest = preview()
    newest.take(*message(3))
    for step in (3, 2):
        with pytest.raises(WireError, match=f"step {step} after that of step 3"):
            newest.take(*message(step))


def test_a_watchdog_shorter_than_the_loops_own_delay_is_refused():
    experiment = load("/**:loop_delay:=60")
    section = experiment["force_controller"]
    words = "reference_timeout is 0.1 s, but the loop's own delay is 0.12 s"
    with pytest.raises(InputError, match=words):
        NewestPreview(section, len(experiment.axes), experiment.timebase)
