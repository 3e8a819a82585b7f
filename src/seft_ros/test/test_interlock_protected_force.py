import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from seft_ros.interlock.plausibility import PlausibleForce, PlausibleState
from seft_ros.interlock.protected_force import ProtectedForce
from seft_ros.interlock.ramp_down import RampDown

DT = 0.002
MOTION, STATE = np.zeros((1, 1)), np.zeros((4, 1))


class Guard:
    """Asks for the ramp at a step."""

    def __init__(self, at):
        self.at, self.asked = at, 0

    def reset(self):
        self.asked = 0

    def step(self, ground_motion, state):
        assert ground_motion.shape == (1,)
        assert state.shape == (4, 1)
        self.asked += 1
        return "energy grows" if self.asked > self.at else None


def protected(forces, guards=(), ramp=10, largest=1e4, fastest=1e9):
    """A reference force that gives these one after the other, protected."""
    given = iter(forces)
    block = SimpleNamespace(
        preview=0,
        estimates=dict,
        learn=lambda: None,
        reset=lambda: None,
        step=lambda motion, state: np.array([next(given)]),
    )
    plausible = PlausibleForce(largest, fastest, ("x",), DT)
    return ProtectedForce(block, plausible, [PlausibleState(("x",)), *guards], RampDown(ramp))


def run(force, steps, state=STATE):
    return [float(force.step(MOTION, state)[0]) for _ in range(steps)]


def ramp(steps):
    way = RampDown(steps)
    way.begin()
    return [way.next() for _ in range(steps)]


def test_while_nothing_is_wrong_it_gives_the_force_itself():
    forces = [1.0, -2.5, 0.1 + 0.2]
    assert run(protected(forces), 3) == forces


def test_asked_to_come_down_it_follows_the_test_scaled():
    force = protected([100.0, 100.0, 200.0, 300.0, 400.0], ramp=4)
    run(force, 1)
    force.ramp_down()
    expected = [f * factor for f, factor in zip((100, 200, 300, 400), ramp(4), strict=True)]
    assert run(force, 4) == expected
    assert force.at_rest
    assert force.cause is None


def test_a_guard_that_sees_something_begins_the_ramp_in_that_step():
    guard = Guard(at=2)
    force = protected([100.0] * 20, [guard])
    assert run(force, 2) == [100.0, 100.0]
    assert force.cause is None
    assert run(force, 10) == [100.0 * factor for factor in ramp(10)]
    assert force.cause == "energy grows"
    assert force.steps_ramped == 10
    assert guard.asked == 3  # it is latched


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e5])
def test_a_force_that_is_not_plausible_is_never_given(bad):
    force = protected([100.0, 110.0, bad, 120.0, bad, *[50.0] * 20])
    assert run(force, 2) == [100.0, 110.0]
    assert run(force, 10) == [110.0 * factor for factor in ramp(10)]
    assert force.cause.startswith("reference force")
    assert run(force, 3) == [0.0] * 3


def test_a_state_that_is_not_finite_brings_the_force_down():
    force = protected([100.0] * 20)
    run(force, 1)
    state = STATE.copy()
    state[2] = np.nan
    assert run(force, 10, state) == [100.0 * factor for factor in ramp(10)]
    assert force.cause == "measured acceleration is nan on axis x"


def test_a_fault_within_the_ramp_holds_the_last_force_and_is_the_cause_of_a_stop():
    force = protected([100.0, 100.0, np.nan, 500.0], ramp=4)
    run(force, 1)
    force.ramp_down()
    assert run(force, 3) == [100.0 * factor for factor in ramp(4)[:3]]
    assert force.cause == "reference force is nan N on axis x"


def test_without_ground_motion_the_ramp_goes_on_without_a_jump():
    force = protected([100.0, 100.0, 105.0, 500.0], ramp=50)
    run(force, 1)
    force.ramp_down()
    way = [100.0, *run(force, 2)]
    way += [float(force.step_without_motion()[0]) for _ in range(20)]
    way += run(force, 1)  # motion that comes again does not bring the force back
    way += [float(force.step_without_motion()[0]) for _ in range(27)]
    assert way[-1] == 0.0
    assert max(abs(b - a) for a, b in itertools.pairwise(way)) < 105.0 * 1.6 / 50 + 5.0
    assert way[3:] == sorted(way[3:], reverse=True)
    assert force.at_rest


def test_the_cause_is_latched_until_the_next_test():
    guard = Guard(at=0)
    force = protected([np.nan, 1.0, 1.0], [guard], ramp=1)
    run(force, 2)
    assert force.cause == "reference force is nan N on axis x"
    force.reset()
    assert (force.cause, force.ramping, force.at_rest, guard.asked) == (None, False, False, 0)
    guard.at = 5
    assert run(force, 1) == [1.0]
