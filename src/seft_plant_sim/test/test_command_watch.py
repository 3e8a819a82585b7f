"""A rig that has been without a new command, or stood still, obeys none any more."""

import pytest
from seft_msgs_py.wire.topics import VALVE_COMMAND
from seft_plant_sim.rig_timing import CommandWatch

PERIOD, TIMEOUT = 0.002, 0.02
ALLOWED = 10  # steps


@pytest.fixture
def watch():
    found = CommandWatch(VALVE_COMMAND, PERIOD, TIMEOUT)
    found.begin(100.0)
    return found


def look(watch, step, answered, late=0.0):
    """Look at the end of a step's period, or later."""
    return watch.fault(100.0 + (step + 1) * PERIOD + late, step, answered)


def test_a_rig_that_is_answered_in_time_goes_on(watch):
    assert not any(look(watch, step, step) for step in range(1000))


def test_a_rig_whose_answers_are_always_a_step_late_goes_on(watch):
    assert not any(look(watch, step, step - 1) for step in range(1000))


def test_commands_that_settle_coming_steps_may_be_lost_as_long_as_they_are_settled(watch):
    assert not any(look(watch, step, 30) for step in range(31 + ALLOWED))
    assert look(watch, 31 + ALLOWED, 30).startswith("no new valve_command for 0.02 s (the last is")


@pytest.mark.parametrize("missing", [1, ALLOWED, ALLOWED + 1])
def test_commands_may_fail_to_come_for_the_timeout_and_no_longer(watch, missing):
    assert not any(look(watch, step, step) for step in range(50))
    faults = [look(watch, 50 + lost, 49) for lost in range(missing)]
    assert not any(faults[:ALLOWED])
    assert bool(faults[-1]) == (missing > ALLOWED)
    if missing <= ALLOWED:
        assert not look(watch, 50 + missing, 50 + missing)


@pytest.mark.parametrize("answered", [9, 8])
@pytest.mark.parametrize("stood_still", [0.0215, 0.3, 1.0, 3600.0])
def test_a_rig_that_stood_still_obeys_nothing_though_its_commands_are_there(
    watch, answered, stood_still
):
    assert not any(look(watch, step, step) for step in range(9))
    fault = look(watch, 9, answered, stood_still)
    assert fault.startswith("the rig stood still for")


def test_a_rig_that_was_held_up_for_less_than_the_timeout_goes_on(watch):
    assert not any(look(watch, step, step, late=0.018) for step in (0, 1, 2))


def test_a_period_beyond_the_timeout_is_what_counts():
    watch = CommandWatch(VALVE_COMMAND, 0.1, 0.02)
    watch.begin(0.0)
    assert not watch.fault(0.1, 0, 0)
    assert not watch.fault(0.2, 1, 0)
    assert watch.fault(0.3, 2, 0)


def test_a_rig_that_has_waited_in_vain_says_so_at_once(watch):
    assert watch.fault(100.0, 0, -1, in_vain=True).startswith("no new valve_command")
