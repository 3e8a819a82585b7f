"""The closed loop's matrices against the blocks themselves, and against closed forms."""

from collections import deque

import numpy as np
import pytest
from experiments_at_hand import of_parts
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_parameters import LIMIT_ROWS
from seft_ros.design.planned_tests import PlannedTest, SampledLoop
from seft_ros.design.stability_verdict import predicted_modes
from seft_ros.force_controller.force_control import ForceController
from seft_ros.reference_force.reference_force_block import ReferenceForce
from seft_ros.reference_force.reference_force_parameters import OWN_METHODS

M, C, K = 52.7, 800.3, 2.11e5
FACTS = {
    "specimen.mass": M,
    "specimen.damping": C,
    "specimen.stiffness": K,
    "actuator.oil_stiffness": M * (2.0 * np.pi * 90.0) ** 2 - K,
    "actuator.leakage": 50.0,
    "actuator.flow_gain": 0.0403,
    "actuator.valve_frequency": 70.0,
    "actuator.valve_damping": 0.6,
    "actuator.dead_time": 0.001,
    "actuator.delay": 0.009,
    "actuator.response.numerator": [1.0],
    "actuator.response.dead_time": 0.012,
}
SERVO = {"/**": {"actuator.kind": "servo_hydraulic_linear"}}
IDEAL = {"actuator.kind": "ideal", "actuator.delay": 0.0}
COUPLED = {"specimen.mass": [52.7, 40.0], "specimen.stiffness": [2.0e5, -3.0e4, -3.0e4, 2.4e5]}
LINEAR = [name for name in OWN_METHODS if name != "target_motion"]  # test_design_frozen_methods.py
LATE = {
    "rig": {
        "simulated.sensors.acceleration_lag": 7e-4,
        "simulated.sensors.displacement_lag": 0.0047,
        "simulated.sensors.force_lag": 0.004,
        "simulated.sensors.force_filter": 150.0,
        "simulated.sensors.force_scale": 0.9,
    },
    "/**": {
        **{f"calibration.{name}_lag": 0.004 for name in ("displacement", "acceleration")},
        "calibration.force_scale": 0.95,
    },
}
"""Channels that wait do so for whole samples, for which preflight's delay is exact."""
BASE = {"/**": FACTS | {f"limits.{name}": 1e9 for name in LIMIT_ROWS}}
DERIVED = {"/**": {"sensors.velocity": "derived"}}


def delayed(delay):
    """Rig with a delay that is not the known one."""
    return {"/**": {"actuator.kind": "delay"}, "rig": {"simulated.actuator.delay": delay}}


def experiment(*parts, rate=500.0, axes=("x",), **reference):
    """Experiment of the paper's rig, and what parts say otherwise, by node."""
    named = {name.replace("__", "."): value for name, value in reference.items()}
    more = [("/**", "rate", rate), ("/**", "axes", list(axes))]
    return of_parts(BASE, *parts, {"reference_force": named}, more=more)


def elsewhere(test):
    """Experiment without the section of its rig."""
    return Experiment({node: own for node, own in test.sections.items() if node != "rig"})


def blocks_displacements(test, motion, steps):
    """What the blocks do: displacements, shape (steps, n), under the motion and after it."""
    axes, timebase = test.axes, test.timebase
    rig = Rig(test["rig"], axes, timebase)
    reference = ReferenceForce.from_parameters(test["reference_force"], axes, timebase)
    control = ForceController.from_parameters(
        test["force_controller"] | {"limits.command": 1e12}, axes, timebase
    )
    ground = np.vstack([motion, np.zeros((steps + reference.preview + 1, len(axes)))])
    state, found = rig.reset(), []
    coming = deque([np.zeros(len(axes))] * test["reference_force"]["loop_delay"])
    for k in range(steps):
        found.append(state[0].copy())
        coming.append(reference.step(ground[k : k + 1 + reference.preview], state))
        force = coming.popleft()
        drive = control.step(force, state)
        state = rig.step(drive if rig.drive == "valve_command" else force)
    return np.array(found)


def loop_displacements(loop, motion, steps):
    """The same by powers of the loop's matrix."""
    width = loop.ground.shape[1]
    ground = np.concatenate([motion.ravel(), np.zeros((steps + 1) * len(motion[0]) + width)])
    q, found = np.zeros(len(loop.matrix)), []
    for k in range(steps):
        found.append(loop.displacement @ q)
        first = k * motion.shape[1]
        q = loop.matrix @ q + loop.ground @ ground[first : first + width]
    return np.array(found)


def assert_same(test, steps=120):
    motion = np.random.default_rng(1).standard_normal((20, len(test.axes)))
    blocks = blocks_displacements(test, motion, steps)
    loop = loop_displacements(PlannedTest(test).loops()[0], motion, steps)
    assert np.abs(blocks).max() > 0
    np.testing.assert_allclose(loop, blocks, rtol=1e-9, atol=1e-9 * np.abs(blocks).max())


@pytest.mark.parametrize("method", LINEAR)
@pytest.mark.parametrize("rig", [delayed(0.0101), SERVO], ids=["delay", "servo"])
def test_powers_of_the_matrix_are_what_the_blocks_do(method, rig):
    test = experiment(rig, mass_ratio=0.7, compensation__method=method)
    assert_same(test)


@pytest.mark.parametrize(
    ("parts", "axes"),
    [
        ([{"/**": COUPLED | {"loop_delay": 3}}, SERVO], "xy"),
        ([{"/**": IDEAL}], "x"),
        ([{"/**": COUPLED}, delayed(0.0034)], "xy"),
        ([{"/**": COUPLED}, SERVO], "xy"),
        ([SERVO, {"force_controller": {"feedback": False}}], "x"),
        ([SERVO, {"force_controller": {"numerator": [1e-4], "denominator": [1.0]}}], "x"),
        ([SERVO, LATE], "x"),
        ([SERVO, {"/**": COUPLED | {"actuator.dead_time": 0.0007}}, LATE], "xy"),
        ([delayed(0.0033), LATE, DERIVED], "x"),
        ([SERVO, {"rig": {"simulated.actuator.viscous_friction": 300.0}}], "x"),
        ([delayed(0.01), DERIVED], "x"),
        ([SERVO, {"/**": COUPLED}, DERIVED], "xy"),
    ],
)
def test_so_they_are_of_other_rigs_and_sensors(parts, axes):
    test = experiment(*parts, axes=tuple(axes), mass_ratio=0.4, compensation__method="model")
    assert_same(test)


def test_so_they_are_of_an_eft_test():
    assert_same(experiment(SERVO, method="eft", compensation__method="model"))


def test_a_rig_that_is_not_linear_is_taken_at_its_small_signal_limit():
    linear = PlannedTest(experiment(SERVO, mass_ratio=0.5))
    kinds = {"specimen.kind": "bouc_wen", "specimen.yield_displacement": 0.005}
    yielding = {"rig": {f"simulated.{name}": value for name, value in kinds.items()}}
    whole = PlannedTest(experiment(yielding, mass_ratio=0.5))
    assert whole.rig.small_signal and not linear.rig.small_signal
    for ratio in (0.1, 1.0, 3.0):
        assert whole.loops(mass_ratio=ratio)[0].dominant() == pytest.approx(
            linear.loops(mass_ratio=ratio)[0].dominant(), rel=1e-9
        )


@pytest.mark.parametrize("method", ["none", "model"])
def test_a_rig_elsewhere_of_which_the_truth_is_known_has_its_own_loop(method):
    own = experiment(SERVO, mass_ratio=1.0, compensation__method=method)
    rig, identified = PlannedTest(own), PlannedTest(elsewhere(own))
    assert (rig.rig.plant.source, identified.rig.plant.source) == ("rig", "identified")
    found, exact = (planned_test.loops()[0] for planned_test in (identified, rig))
    motion = np.ones((5, 1))
    expected = loop_displacements(exact, motion, 60)
    np.testing.assert_allclose(
        loop_displacements(found, motion, 60), expected, atol=1e-6 * np.abs(expected).max()
    )


@settings(max_examples=15)
@given(size=st.integers(60, 90), density=st.floats(0.002, 0.05), seed=st.integers(0, 1000))
def test_a_loop_taken_apart_has_the_eigenvalues_of_the_whole(size, density, seed):
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((size, size)) * (rng.random((size, size)) < density)
    matrix += np.diag(rng.uniform(0.5, 1.5, size))
    found = SampledLoop(matrix, np.zeros((size, 1)), np.zeros((1, size))).eigenvalues()
    assert len(found) == size
    power = [np.trace(np.linalg.matrix_power(matrix, k)) for k in (1, 2, 5)]
    assert [np.sum(found**k).real for k in (1, 2, 5)] == pytest.approx(power, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("alpha", [0.2, 0.5, 0.9])
def test_a_small_delay_adds_the_known_false_damping(alpha):
    """To the first order in delay and damping: alpha w_n T / (2 (1 + alpha)^1.5).

    T is the delay, the sample that answers, half a sample of hold, and half a sample times alpha:
    the sampled acceleration holds the force's newest step, -alpha m a, in full already.
    """
    delay, rate, damping = 0.0002, 10000.0, 20.0
    damped = {"/**": {"specimen.damping": damping}}
    test = experiment(delayed(delay), damped, rate=rate, mass_ratio=alpha)
    (mode,) = predicted_modes(PlannedTest(test))
    natural = np.sqrt(K / M)
    assert mode.exact_hz == pytest.approx(natural / np.sqrt(1 + alpha) / (2 * np.pi), rel=1e-9)
    exact = damping / (2 * np.sqrt(K * M * (1 + alpha)))
    assert mode.exact_damping == pytest.approx(exact, rel=1e-9)
    whole = delay + (3 + alpha) / (2 * rate)
    expected = alpha * natural * whole / (2 * (1 + alpha) ** 1.5)
    assert mode.false_damping == pytest.approx(expected, rel=0.02)
    assert abs(mode.frequency_error) < 0.001


def test_modes_of_several_axes_are_those_of_the_whole_structure():
    """Without a computed mass and with a perfect actuator the test is the structure itself."""
    ideal = {"/**": COUPLED | IDEAL}
    modes = predicted_modes(PlannedTest(experiment(ideal, rate=5000.0, axes=("x", "y"))))
    k = np.reshape(COUPLED["specimen.stiffness"], (2, 2))
    squares = np.sort(np.linalg.eigvals(np.diag([1 / 52.7, 1 / 40.0]) @ k).real)
    expected = np.sqrt(squares) / (2 * np.pi)
    assert [mode.exact_hz for mode in modes] == pytest.approx(expected, rel=1e-3)
    for mode in modes:
        exact = pytest.approx((mode.exact_hz, mode.exact_damping), rel=1e-9)
        assert (mode.hz, mode.damping) == exact


def test_a_rig_that_nobody_knows_has_no_plan():
    with pytest.raises(InputError, match="seft identify"):
        PlannedTest(elsewhere(experiment({"/**": {"actuator.flow_gain": 0.0}})))
    sections = experiment().sections
    del sections["reference_force"]
    with pytest.raises(InputError, match="runs elsewhere"):
        PlannedTest(Experiment(sections))
