import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.topics import REFERENCE_FORCE, TARGET, VALVE_COMMAND, RigAxes, Timebase
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_plant_sim.command import Command, MessagesAhead

AXES = ("east", "north")
TIMEBASE = Timebase.from_rate(500.0)
CODEC = TrajectoryCodec(VALVE_COMMAND, AXES, TIMEBASE)


def command_at(step):
    command = Command(CODEC, 10.0)
    command.current = step
    return command


def message(step, *values):
    return CODEC.encode(step, np.array(values))


def test_the_newest_answer_is_held():
    command = command_at(0)
    np.testing.assert_array_equal(command.value, [0.0, 0.0])
    command.take(message(0, 1.0, -10.0))
    command.current = 7
    command.take(message(5, 10.0, 10.0))
    assert command.step == 5
    np.testing.assert_array_equal(command.value, [10.0, 10.0])
    command.reset()
    assert (command.step, command.current) == (-1, -1)
    np.testing.assert_array_equal(command.value, [0.0, 0.0])


@pytest.mark.parametrize(("trusted", "first"), [(109, 105), (104, 100), (11, 10), (9, None)])
def test_a_stop_is_that_of_the_last_trusted_step_of_those_kept(trusted, first):
    command = Command(CODEC, 10.0, is_plan=True)
    command.current = 109
    for step in range(0, 106, 5):
        points = 0.01 * (step + np.arange(120.0))[:, np.newaxis, np.newaxis] * np.ones(2)
        command.take(CODEC.encode_points(step, points[:, 0]))
    if first is None:  # twenty are kept
        assert command.plan(trusted) == ()
        return
    commands, before = command.plan(trusted)
    np.testing.assert_array_equal(commands[:, 0], 0.01 * (first + np.arange(109.0 - first, 120.0)))
    np.testing.assert_allclose(before, 1.08, atol=1e-12)


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        (message(6, 1.0, 1.0), "valve_command of step 6, but the rig is at step 5"),
        (message(10**9, 1.0, 1.0), "but the rig is at step 5"),
        (message(3, 1.0, 1.0), "step 3 after that of step 3: stale, duplicated or out of order"),
        (message(0, 1.0, 1.0), "step 0 after that of step 3"),
        (message(4, 1.0, math.nextafter(10, 11)), "on axis north, beyond the limit of 10 V"),
        (message(4, -1e300, 0.0), "is -1e+300 V on axis east"),
        (message(4, 1.0, 2.0).replace(np.float64(2.0).tobytes(), b"\xff" * 8), "nan"),
        (message(4, 1.0, 2.0).replace(b"north", b"south"), "axes are"),
        (TrajectoryCodec(VALVE_COMMAND, ("east",), TIMEBASE).encode(4, np.zeros(1)), "axes are"),
        (b"\x00\x00" + message(4, 1.0, 1.0)[2:], "no little-endian CDR"),
        (b"", "0 bytes"),
        (b"\x00\x01\x00\x00garbage", "bytes can't be read"),
    ],
)
def test_what_does_not_fit_is_refused_and_nothing_changes(raw, words):
    command = command_at(5)
    command.take(message(3, 2.0, 3.0))
    with pytest.raises(WireError, match=re.escape(words)):
        command.take(raw)
    assert command.step == 3
    np.testing.assert_array_equal(command.value, [2.0, 3.0])


def test_nothing_is_taken_before_a_test():
    command = Command(CODEC, 10.0)
    with pytest.raises(WireError, match="at step -1"):
        command.take(message(0, 1.0, 1.0))


def target(step):
    """A target of five points, whose forces are its step and the coming ones; east is negative."""
    forces = (step + np.arange(5.0))[:, np.newaxis] * [-1.0, 1.0]
    points = np.stack([np.full((5, 2), 99.0), np.full((5, 2), 98.0), forces], axis=1)
    return TrajectoryCodec(TARGET, AXES, TIMEBASE).encode_points(step, points)


def test_of_a_target_the_force_of_the_first_point_is_applied():
    command = Command(TrajectoryCodec(REFERENCE_FORCE, AXES, TIMEBASE), 7.0)
    command.current = 5
    command.take(target(5))  # forces of up to 9 N to come, of which this rig receives nothing
    command.current = 7
    np.testing.assert_array_equal(command.value, [-5.0, 5.0])


def test_over_a_link_it_is_the_one_of_the_message_that_the_delay_tells():
    command = Command(TrajectoryCodec(REFERENCE_FORCE, AXES, TIMEBASE), 9.0, loop_delay=2)
    for step in range(4):
        command.current = step
        command.take(target(step))
    np.testing.assert_array_equal(command.value, [-3.0, 3.0])  # sent at step 1 for step 3
    assert (command.step, command.answered) == (5, 3)
    command.current = 9
    np.testing.assert_array_equal(command.value, [-5.0, 5.0])  # the last that is settled
    command.reset()
    assert (command.step, command.answered, command.current) == (1, -1, -1)


def test_of_several_rigs_each_takes_the_command_of_its_axes():
    rig = RigAxes("b", ("b/north",), (1,))
    codec = TrajectoryCodec(VALVE_COMMAND, ("a/east", "b/north"), TIMEBASE)
    command = Command(codec, 10.0, rig=rig)
    command.current = 1
    np.testing.assert_array_equal(command.value, [0.0])
    command.take(codec.encode(0, np.array([99.0, -3.0])))  # the other's is no matter of this rig
    np.testing.assert_array_equal(command.value, [-3.0])
    with pytest.raises(WireError, match="11 V on axis b/north, beyond the limit of 10 V"):
        command.take(codec.encode(1, np.array([0.0, 11.0])))


D = 3
NOTHING = np.zeros((1 + D, 1))


def points(step):
    return np.full((1 + D, 1), float(step))


@given(st.lists(st.integers(0, D), min_size=10, max_size=40))
def test_when_a_message_came_does_not_matter_if_it_came_in_time(late):
    """It is there by the step that uses it, and none overtakes another."""
    there = np.maximum.accumulate(np.arange(len(late)) + late)
    ahead = MessagesAhead(D, NOTHING)
    for step in range(len(late)):
        for sent in np.flatnonzero(there == step):
            ahead.add(int(sent), points(sent))
        age, found = ahead.of(step)
        assert age == min(D, step + 1)
        assert found[0, 0] == (step - D if step >= D else 0.0)


def test_where_one_is_missing_the_next_counts_and_then_the_last():
    ahead = MessagesAhead(D, NOTHING)
    for step in (0, 1, 3):
        ahead.add(step, points(step))
    assert ahead.of(D + 1)[0] == D
    assert ahead.of(D + 2)[0] == D - 1
    assert ahead.of(D + 3)[0] == D
    age, found = ahead.of(D + 10)
    assert age == D + 7
    assert found[0, 0] == 3.0
