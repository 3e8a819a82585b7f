"""The stop of an interlock: after a trip, and the fallback stop of a rig without an answer."""

import math

import numpy as np
import pytest
from interlocks_at_hand import SPEED, Scripted, left, sample_of, stepped, target_of, watched


class Planned(Scripted):
    """One that can stop along its plan, in three steps."""

    def stop(self, plan):
        return np.arange(3.0, 0.0, -1.0)[:, np.newaxis] * plan[0, 1]


def ways():
    """The stops of a controller without a plan and of one with it, after its fourth answer."""
    last, own = np.array([4.0, 8.0]), np.arange(3.0, 0.0, -1.0)[:, np.newaxis] * SPEED
    closing = np.array([left(taken) for taken in range(1, 7)])
    return np.outer(closing, last), np.vstack([last, own, np.outer(closing, own[-1])])


def answered(controller):
    """An interlock that has answered the steps 0 to 3."""
    guarded = watched(controller, limits=(1.0, 1.0, 1.0, 1e3))
    for step in range(4):
        stepped(guarded, step, target_of(step), sample_of(step))
    return guarded


@pytest.mark.parametrize("kind", [Scripted, Planned])
def test_after_a_trip_it_goes_along_the_stop_and_its_end_lasts(kind):
    guarded = answered(kind())
    fallback = ways()[1] if kind is Planned else np.zeros((0, 2))  # the rig closes by itself
    np.testing.assert_allclose(guarded.stop(3), fallback, atol=1e-15)
    guarded.trip(5, "stopped")
    guarded.trip(6, "too late to be the reason")
    assert (guarded.reason, guarded.step_index) == ("stopped", 5)
    last = np.array([4.0, 8.0])  # a trip from outside: plan and sensors may be wrong
    for age in range(8):
        command = stepped(guarded, 5 + age, target_of(5 + age), sample_of(5 + age))
        np.testing.assert_allclose(command, left(age + 1) * last, atol=1e-15)
    guarded.reset()
    assert not guarded.stop(0).any()


@pytest.mark.parametrize("beyond_limit", [False, True])
@pytest.mark.parametrize("kind", [Scripted, Planned])
def test_while_sensors_and_valve_are_fault_free_a_trip_follows_the_plan(kind, beyond_limit):
    guarded, wanted = answered(kind()), ways()[kind is Planned]
    for age in range(len(wanted) + 3):
        points, sample = target_of(4 + age), sample_of(4 + age)
        if age == 0:
            wrong = sample[2] if beyond_limit else points[0, 2]
            wrong[:] = -1.1 if beyond_limit else math.nan
        command = stepped(guarded, 4 + age, points, sample)
        np.testing.assert_allclose(command, wanted[min(age, len(wanted) - 1)], atol=1e-15)
    np.testing.assert_array_equal(guarded.stop(6), guarded.stop(4)[2:])
    assert guarded.stop(99).shape == (1, 2)
    assert ("acceleration -1.1 m/s^2 on axis east" in guarded.reason) == beyond_limit


def test_a_plan_that_takes_a_valve_at_its_limit_is_not_followed():
    guarded, last = answered(Planned()), np.array([4.0, 8.0])
    guarded.controller.stop = lambda plan: np.array([[0.1, 10.0], [0.1, 0.1]])
    sample = sample_of(4)
    sample[2] = -1.1
    for age in range(8):
        command = stepped(guarded, 4 + age, target_of(4 + age), sample)
        np.testing.assert_allclose(command, left(age) * last, atol=1e-15)
