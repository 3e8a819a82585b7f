import pytest
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.messages import Status
from seft_msgs_py.wire.topics import Timebase
from seft_ros.test_run.state_machine import SampleOrder

TIMEBASE = Timebase.from_rate(500.0)


def order(last=-1):
    found = SampleOrder(TIMEBASE)
    found.last = last
    return found


def told(state, **values):
    return Status("experiment", 0, state, values=values)


@pytest.mark.parametrize("step", [8, 9, 17, 8 + 4999])
def test_what_may_come_next(step):
    order(last=7).check("rig/state", step)


@pytest.mark.parametrize(("step", "words"), [(7, "was answered"), (0, "was answered")])
def test_what_is_stale(step, words):
    with pytest.raises(WireError, match=words):
        order(last=7).check("rig/state", step)


def test_a_stamp_from_far_in_the_future_is_refused():
    with pytest.raises(WireError, match="rig/state of step 1000000000 after step 7: far in the"):
        order(last=7).check("rig/state", 10**9)
    with pytest.raises(WireError, match="far in the future"):
        order(last=7).check("rig/state", 7 + 5001)


def test_in_lockstep_steps_come_one_by_one():
    found = order(last=7)
    found.follow(told("running", pace="lockstep"))
    found.check("rig/state", 8)
    with pytest.raises(WireError, match="far in the future"):
        found.check("rig/state", 9)
    found.follow(told("done"))
    found.follow(told("running", pace="realtime"))
    found.check("rig/state", 9)


def test_a_test_begins_once_each_time_that_one_has_ended():
    found = order()
    found.follow(told("running", steps="100"))
    assert found.steps == 100
    assert found.begins(0)
    found.last = 50
    assert not found.begins(0)
    assert found.last == 50
    found.follow(told("ramping_down"))
    assert not found.begins(0)
    assert found.steps == 100
    found.follow(told("done", steps="100"))
    assert found.steps == 0
    assert not found.begins(1)
    assert found.begins(0)
    assert found.last == -1


def test_a_sign_of_life_that_comes_late_does_not_begin_a_test_anew():
    found = order()
    found.follow(told("ready"))
    assert found.begins(0)
    found.follow(told("ready"))
    found.follow(told("running", steps="100"))
    assert not found.begins(0)


def test_without_a_supervisor_each_first_sample_begins_a_test():
    found = order()
    assert found.begins(0)
    found.last = 0
    assert not found.begins(0)
    found.last = 10
    assert found.begins(0)


@pytest.mark.parametrize("steps", ["", "x", "-3", "9" * 400, "1.0"])
def test_a_number_of_steps_that_is_none_is_not_taken_in(steps):
    found = order()
    found.follow(told("running", steps=steps))
    assert found.steps == 0
