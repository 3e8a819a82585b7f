import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from experiments_at_hand import load
from seft_plant_sim.computed.computed_substructure import ComputedSubstructure
from seft_ros.protection.instability import InstabilityWatch
from seft_ros.protection.protected_force import (
    PlausibleForce,
    ProtectedForce,
    RampDown,
    extrapolated,
)
from seft_ros.reference_force.compensator import MethodInputs

DT = 0.002
MOTION, STATE = np.zeros((1, 1)), np.zeros((4, 1))


KNOWN = MethodInputs(
    *(np.array([[52.7]]), ComputedSubstructure.lumped(np.array([[52.7]]))),
    *(np.array([[800.0]]), np.array([[2.11e5]]), DT, {}),
)
SHAKEN = np.array([[0.0], [0.0], [1e3], [52.7e3]])
"""Inertia is all that the force does: nothing that the structure would feel."""


def watch():
    """One that sees a shaken specimen at the third step."""
    made = InstabilityWatch(KNOWN, ("x",), 5.0, 0.3, 0.0)
    made.parameters = made.parameters._replace(patience=25.0)
    return made


def protected(forces, ramp=10, largest=1e4, fastest=1e9, loop_delay=0):
    """A reference force that gives these one after the other, protected."""
    given = iter(forces)
    block = SimpleNamespace(
        preview=0,
        compensator=None,
        provides_target=False,
        shape=(1, 1),
        estimates=dict,
        reset=lambda: None,
        step=lambda motion, state, progress: np.array([[[next(given)]]]),
    )
    plausible = PlausibleForce(largest, fastest, ("x",), DT)
    return ProtectedForce(block, plausible, watch(), RampDown(ramp, loop_delay), loop_delay)


def run(force, steps, state=STATE, motion=MOTION):
    return [force.step(motion, state).item() for _ in range(steps)]


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
    force.ramp.begin()
    expected = [f * factor for f, factor in zip((100, 200, 300, 400), ramp(4), strict=True)]
    assert run(force, 4) == expected
    assert force.ramp.finished
    assert force.cause is None


def test_vibration_begins_the_ramp_in_the_step_in_which_it_is_seen():
    force = protected([100.0] * 20)
    assert run(force, 2, SHAKEN) == [100.0, 100.0]
    assert force.cause is None
    assert run(force, 1, SHAKEN) == [100.0 * ramp(10)[0]]
    cause = force.cause
    assert cause.startswith("instability")
    assert run(force, 9, -SHAKEN) == [100.0 * factor for factor in ramp(10)[1:]]
    assert force.cause == cause  # it is latched
    assert force.ramp.taken == 10


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
    force.ramp.begin()
    assert run(force, 3) == [100.0 * factor for factor in ramp(4)[:3]]
    assert force.cause == "reference force is nan N on axis x"


@pytest.mark.parametrize("row", range(4))
def test_of_two_causes_in_a_step_the_force_is_reported_and_without_motion_no_state_is(row):
    bad = STATE.copy()
    bad[row] = np.nan
    force = protected([np.nan, 100.0])
    run(force, 1, bad)
    assert force.cause == "reference force is nan N on axis x"
    force.reset()
    force.ramp.begin()
    run(force, 2, bad, None)
    assert force.cause is None
    run(force, 1, bad)
    assert force.cause.startswith("measured ")


def test_a_new_test_knows_no_force_of_the_one_before():
    force = protected([100.0, 100.0, np.nan, 150.0], fastest=110.0 / DT, ramp=4)
    assert run(force, 2) == [100.0, 100.0]
    force.reset()
    assert run(force, 1) == [0.0]
    force.reset()
    assert run(force, 1) == [0.0]  # 150 N from rest is too fast
    assert force.cause.startswith("reference force changes by 75000 N/s")


def test_a_reset_is_one_of_all_parts():
    force, target = protected_target(ramp=4)
    force.ramp.begin()
    force.step(MOTION, STATE)
    force.reset()
    assert (target.progresses, force.ramp.taken, force.ramp.begun) == ([], 0, False)
    assert (force.ramp.whole, force.estimates()) == (6, {})
    links = protected([1.0, 2.0, 3.0], loop_delay=2)
    links.step(MOTION, STATE)
    links.reset()
    assert links.step(MOTION, STATE).ravel().tolist() == [0.0, 0.0, 2.0]


def test_it_is_made_of_its_section():
    limits = ("/**:limits.force:=900.0", "/**:limits.force_rate:=1.0e4")
    experiment = load(*limits, "reference_force:ramp_down_time:=0.1")
    section, axes, timebase = experiment["reference_force"], experiment.axes, experiment.timebase
    for delay in (0, 3):
        section["loop_delay"] = delay
        force = ProtectedForce.from_parameters(section, axes, timebase)
        np.testing.assert_allclose(force.parameters.limits, [900.0, 20.0])
        assert (force.parameters.ramp_steps, force.ramp.whole) == (50, 50 + delay)
        assert force.parameters.watch.ratio == section["instability.ratio"]
        motion = np.zeros((1 + force.preview, 1))
        assert len(force.step(motion, STATE)) == 1 + delay
    assert force.kind == ProtectedForce.from_parameters(section, axes, timebase).kind is not None


def test_a_computed_model_is_asked_and_its_failure_is_the_cause():
    force, asked = protected([np.nan, 1.0], ramp=1), []
    force.ask_model()  # there is none
    model = SimpleNamespace(ask_model=lambda: asked.append(1), failure="the model has ended")
    force.reference_force.compensator = model
    force.ask_model()
    assert asked == [1]
    assert force.cause is None
    run(force, 1)
    assert force.cause == "the model has ended"


def test_without_ground_motion_the_ramp_goes_on_without_a_jump():
    force = protected([100.0, 100.0, 105.0, 500.0], ramp=50)
    run(force, 1)
    force.ramp.begin()
    way = [100.0, *run(force, 2)]
    way += run(force, 20, motion=None)
    way += run(force, 1)  # motion that comes again does not bring the force back
    way += run(force, 27, motion=None)
    assert way[-1] == 0.0
    assert max(abs(b - a) for a, b in itertools.pairwise(way)) < 105.0 * 1.6 / 50 + 5.0
    assert way[3:] == sorted(way[3:], reverse=True)
    assert force.ramp.finished


def test_over_a_link_the_forces_that_are_settled_are_sent_again():
    force = protected([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], ramp=2, loop_delay=2)
    forces = [force.step(MOTION, STATE).ravel().tolist() for _ in range(4)]
    assert forces == [[0, 0, 1], [0, 1, 2], [1, 2, 3], [2, 3, 4]]
    force.ramp.begin()
    forces = [force.step(MOTION, STATE).ravel().tolist() for _ in range(2)]
    assert forces == [[3, 4, pytest.approx(2.5)], [4, pytest.approx(2.5), 0]]
    assert not force.ramp.finished  # the forces before are still to be applied
    assert run_settled(force, 2) == [pytest.approx(2.5), 0.0]
    assert force.ramp.finished


def run_settled(force, steps):
    return [force.step(None, STATE)[0].item() for _ in range(steps)]


def test_states_that_were_lost_are_bridged_in_a_straight_line():
    force, seen = protected([0.0] * 9, loop_delay=3), []
    inner = force.reference_force.step

    def step(motion, state, progress):
        seen.append(state[0, 0])
        return inner(motion, state, progress)

    force.reference_force.step = step
    force.bridge([MOTION], STATE + 1.0)  # nothing was before
    force.bridge([MOTION] * 3, STATE + 9.0)
    force.step(MOTION, STATE + 9.0)
    assert seen == [1.0, 3.0, 5.0, 7.0, 9.0]


class Target:
    """A target that goes on at 1 m/s times the progress, with a force of 100 N times that."""

    preview, provides_target, shape, compensator = 4, True, (5, 3), None

    def __init__(self):
        self.progresses, self.motions, self.odd = [], [], None

    def reset(self):
        self.progresses.clear()

    estimates = dict

    def step(self, motion, state, progress):
        self.progresses.append(progress)
        self.motions.append(motion.copy())
        points = np.empty((5, 3, 1))
        points[:, 0, 0] = len(self.progresses) + np.arange(5.0)
        points[:, 1], points[:, 2] = progress, 100.0 * progress
        if self.odd is not None:
            points[:] = self.odd
        return points


def protected_target(ramp=10):
    target = Target()
    plausible = PlausibleForce(1e4, 1e9, ("x",), DT)
    return ProtectedForce(target, plausible, watch(), RampDown(ramp, 2), loop_delay=2), target


def test_a_target_is_slowed_down_and_its_points_are_not_scaled():
    force, target = protected_target(ramp=4)
    force.step(MOTION, STATE)
    force.ramp.begin()
    given = [force.step(MOTION, STATE) for _ in range(4)]
    assert target.progresses == [1.0, *ramp(4)]
    assert [points[0, :, 0].tolist() for points in given] == [
        [step, progress, 100.0 * progress]
        for step, progress in zip(range(2, 6), ramp(4), strict=True)
    ]
    assert given[0].shape == (5, 3, 1)  # over a link, too, it tells the coming motion itself


def test_a_target_without_ground_motion_goes_on_to_rest_as_if_there_were_none():
    force, target = protected_target(ramp=4)
    force.ramp.begin()
    for _ in range(4):
        force.step(None, STATE)
    assert target.progresses == ramp(4)
    assert not np.any(target.motions)
    assert {motion.shape for motion in target.motions} == {(5, 1)}
    assert force.cause is None


@pytest.mark.parametrize("odd", [np.nan, 2e4])
def test_a_target_whose_force_is_not_plausible_brakes_and_is_scaled_down(odd):
    force, target = protected_target(ramp=4)
    force.step(MOTION, STATE)
    last = force.step(MOTION, STATE)[:1]
    target.odd = odd
    given = [force.step(MOTION, STATE) for _ in range(4)]
    for age, factor in enumerate(ramp(4), 1):
        np.testing.assert_array_equal(given[age - 1], extrapolated(last, age, 5, DT) * factor)
    assert force.cause.startswith("reference force")
    assert len(target.progresses) == 3  # it is not asked again: what it remembers may be odd, too


def test_a_target_that_fails_in_the_ramp_goes_on_from_where_it_is():
    force, target = protected_target(ramp=8)
    force.ramp.begin()
    last = [force.step(MOTION, STATE) for _ in range(4)][-1][:1]
    target.odd = np.nan
    for age, factor in enumerate(np.array(ramp(8)[4:]) / ramp(8)[3], 1):
        found = force.step(MOTION, STATE)
        np.testing.assert_allclose(found, extrapolated(last, age, 5, DT) * factor, atol=1e-12)


def test_a_target_that_rests_after_its_ramp_and_fails_asks_for_no_force():
    force, target = protected_target(ramp=2)
    force.step(MOTION, STATE)
    force.ramp.begin()
    for _ in range(2):
        force.step(MOTION, STATE)
    force.state.point[0, 2] = 50.0  # that a yielded specimen still takes
    target.odd = np.nan
    assert not force.step(MOTION, STATE)[:, 2].any()
    assert force.cause.startswith("reference force is nan")
