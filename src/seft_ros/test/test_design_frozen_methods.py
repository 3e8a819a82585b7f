"""The loop of `target_motion` and `velocity_feedforward`: its matrix and margins hold in tests."""

from functools import cache, partial

import numpy as np
import pytest
from experiments_at_hand import of_parts
from seft_msgs_py.config.facts import CHANNELS
from seft_plant_sim.judge.valve_following import LARGEST_GAIN_ERROR
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_parameters import LIMIT_ROWS
from seft_ros.design.planned_tests import PlannedTest, frozen_target
from seft_ros.design.preflight_tables import summarise_preflight
from seft_ros.design.stability_margins import HIGHEST_MASS_RATIO, find_margins
from seft_ros.design.stability_verdict import check_stability
from seft_ros.force_controller.velocity_feedforward import VelocityFeedforward
from seft_ros.reference_force.reference_force_block import method_inputs
from seft_ros.reference_force.target_motion import TargetMotion
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test
from test_design_closed_loop import elsewhere, loop_displacements

K = 2.11e5
QUIET = {f"simulated.sensors.{name}_noise": 0.0 for name in CHANNELS} | {
    "simulated.sensors.adc_bits": 0
}
BASE = {
    "/**": {f"limits.{name}": 1e12 for name in LIMIT_ROWS}
    | {"limits.command": 1e9, "actuator.kind": "servo_hydraulic_linear", "actuator.friction": 0.0},
    "rig": {"detectors.warn_only": "all"},  # valves that are not as known
}
COUPLED = {
    "/**": {
        "axes": ["x", "y"],
        "specimen.mass": [52.7, 40.0],
        "specimen.stiffness": [2.1e5, -2.0e4, -2.0e4, 2.4e5],
    },
    "rig": {"simulated.specimen.stiffness": [2.0e5, -3.0e4, -3.0e4, 2.4e5]},
}
SMALL, USUAL = 1e-6, 1.0
"""RMS ground acceleration, m/s^2: nothing stands out of the noise that sensors are believed to
have, and a usual test."""


experiment = partial(of_parts, BASE, config="demo")


def test_motion(test, size, steps=2000, held=None, noise=True):
    """Ground motion, and samples of shape (steps, 4, n); ``held``: what valves are taken for."""
    rig = test["rig"] | ({} if noise else QUIET)
    rig = Rig(rig, test.axes, test.timebase)
    target = TargetMotion(method_inputs(test["reference_force"], test.axes, test.timebase))
    control = VelocityFeedforward(test["force_controller"], test.axes, test.timebase)
    if held is not None:
        control.state.errors[:] = held
        control.state.covariance[:] = 0.0
    ground = np.zeros((steps + target.preview + 1, len(test.axes)))
    motion = np.random.default_rng(1).standard_normal((200, len(test.axes)))
    ground[20:220] = size * motion
    state, found = rig.reset(), []
    for k in range(steps):
        found.append(state[:4].copy())
        state = rig.step(
            control.step(target.step(ground[k : k + 1 + target.preview], state[:4]), state[:4])
        )
        if not np.abs(state).max() < 1e9:
            found += [np.full_like(found[0], np.inf)] * (steps - 1 - k)
            break
    return ground, np.array(found)


test_motion.__test__ = False


def grows(test, size, **options):
    force = test_motion(test, size, **options)[1][:, 3]
    middle, last = (np.abs(part).max() for part in np.array_split(force[300:], 2))
    return bool(not np.isfinite(last) or last > middle)


@cache
def planned():
    planned_test = PlannedTest(experiment())
    return planned_test, find_margins(planned_test)


def slower(part):
    added = part * (planned()[1].dead_time.value - 0.001)
    return {"rig": {"simulated.actuator.dead_time": 0.001 + added}}


def stronger(factor):
    return {"rig": {"simulated.actuator.flow_gain": 0.0403 * factor}}


@pytest.mark.parametrize("parts", [(), (COUPLED,)], ids=["one axis", "two axes"])
def test_the_frozen_steps_are_met_to_rounding(parts):
    """Of a target with the force as known, on any measured motion."""
    test = experiment(*parts)
    planned_test, n = PlannedTest(test), len(test.axes)
    method = planned_test.compensator()
    known = frozen_target(method, measured=False)
    model = method.parameters.model
    zero = np.zeros_like(model.prior)
    model = model._replace(prior=zero, drift=zero, change=zero, surprise=np.inf)
    model = model._replace(stuck=np.zeros_like(model.stuck))
    method.parameters = method.parameters._replace(model=model)
    method.reset()
    s, random = np.zeros(len(known.a)), np.random.default_rng(3)
    scale = np.array([1e-2, 1e-1, 1.0, 1e3])[:, np.newaxis]
    ground = random.standard_normal((60 + method.preview, n))
    for k in range(50):
        y = scale * random.standard_normal((4, n)) * (k > 0)
        coming = ground[k : k + 1 + method.preview] * (k > 0)
        points = method.step(coming, y)
        expected = known.c @ s + known.d @ y.ravel() + known.e @ coming.ravel()
        s = known.a @ s + known.b @ y.ravel() + known.h @ coming.ravel()
        size = np.abs(points).max(axis=(0, 2))[:, np.newaxis].clip(1e-300)
        expected = expected.reshape(points.shape)
        np.testing.assert_allclose(points / size, expected / size, atol=1e-9)


def test_a_measured_force_moves_the_target_by_what_the_stiffness_makes_of_it():
    """r* = f + K x* = 0 at rest; one part in 10,000 is what is known."""
    target = frozen_target(planned()[0].compensator(), measured=True)
    still = np.linalg.solve(np.eye(len(target.a)) - target.a, target.b)
    by_force = (target.c @ still + target.d)[0, 3]
    assert by_force == pytest.approx(-1.0 / K, rel=2e-4)
    known = frozen_target(planned()[0].compensator(), measured=False)
    still = np.linalg.solve(np.eye(len(known.a)) - known.a, known.b)
    assert np.abs((known.c @ still + known.d)[0]).max() < 1e-12


@pytest.mark.parametrize(("part", "unstable"), [(0.97, False), (1.03, True)])
def test_critical_dead_time_and_gain_are_those_of_a_small_test(part, unstable):
    assert grows(experiment(slower(part)), SMALL, steps=4000, noise=False) is unstable
    highest = planned()[1].gain.highest.value
    assert grows(experiment(stronger(part * highest)), SMALL, noise=False) is unstable


@pytest.mark.parametrize(("part", "unstable"), [(0.97, False), (1.03, True)])
def test_the_sure_ones_are_those_of_a_controller_that_takes_valves_for_the_worst(part, unstable):
    margins = planned()[1]
    added = part * (margins.sure_dead_time.value - 0.001)
    late = {"rig": {"simulated.actuator.dead_time": 0.001 + added}}
    strong = stronger(part * margins.robust_gain.highest.value)
    for change in (late, strong):
        worst = (-LARGEST_GAIN_ERROR, -0.005, 0.0)
        assert grows(experiment(change), SMALL, held=worst, noise=False) is unstable


@pytest.mark.parametrize("factor", [0.001, 3.0])
def test_so_it_is_with_any_local_stiffness_from_0_to_3_times_the_known_one(factor):
    margins = planned()[1]
    found = margins.stiffness, margins.followed
    assert all(one.lowest is one.highest is None for one in found)
    assert margins.stiffness.searched == (0.0, 3.0)
    local = {"rig": {"simulated.specimen.stiffness": factor * K}}
    for size in (SMALL, USUAL):
        assert not grows(experiment(local), size, steps=4000, noise=False)


def test_so_it_is_at_any_mass_ratio():
    assert planned()[1].mass_ratio is None
    heavy = {"reference_force": {"mass_ratio": HIGHEST_MASS_RATIO}}
    for size in (SMALL, USUAL):
        assert not grows(experiment(heavy), size, steps=6000, noise=False)


def test_the_verdict_and_its_numbers():
    planned_test, margins = planned()
    found = check_stability(planned_test)
    assert found.verdict == "stable"
    assert "follows the specimen" in found.promise
    numbers = summarise_preflight(planned_test, found)
    assert (numbers["basis"], numbers["critical_mass_ratio"]) == ("exact", None)
    assert 0.005 < numbers["critical_delay_s"] < 0.0053
    assert 0.0042 < numbers["sure_delay_s"] == margins.sure_dead_time.value < 0.0044
    assert numbers["gain"]["highest"] == pytest.approx(2.86, abs=0.01)
    assert numbers["robust_gain"]["highest"] == pytest.approx(2.0, abs=0.01)
    assert abs(numbers["false_damping_ratio"]) < 1e-4


def test_a_rig_that_is_not_simulated_is_what_is_known_of_it():
    test = experiment()
    known = elsewhere(test)
    for changes in ({}, {"stiffness": 0.5}, {"dead_time": 0.01, "any_valve": True}):
        exact = PlannedTest(test).growth_rate(**changes)
        assert PlannedTest(known).growth_rate(**changes) == pytest.approx(exact, rel=1e-6)
    assert PlannedTest(known).rig.plant.source == "identified"


@pytest.mark.parametrize("delay", [0, 4])
def test_with_a_delay_of_the_loop_the_matrix_is_what_the_offline_loop_does(delay):
    quiet = {"rig": QUIET, "ground_motion": {"peak_force": 1e-4}}
    late = {"/**": {"loop_delay": delay}}
    test = experiment(quiet, late)
    planned_test, blocks = PlannedTest(test), build_blocks(test)
    loop = planned_test.loops()[0]
    assert len(loop.matrix) < 80
    recording = simulate_test(test, blocks)
    assert recording.trip is None
    found = recording.series["rig/state"].values[:1500, 0]
    expected = loop_displacements(loop, np.asarray(blocks.ground_motion.known), 1500)
    largest = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3 * largest)


def test_a_transfer_function_takes_the_force_of_the_first_point():
    planned_test = PlannedTest(experiment({"force_controller": {"method": "transfer_function"}}))
    filters = planned_test.compensation()
    assert filters.d.shape[0] == 3 * (1 + planned_test.compensator().preview)
    assert not planned_test.follows_valves and np.isfinite(planned_test.growth_rate())
