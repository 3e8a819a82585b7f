"""What holds for all compensation methods, and each against its equation."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from seft_msgs_py.config.parameter_table import resolve
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import Timebase
from seft_ros.reference_force.compensation_methods import (
    COMPENSATION_METHODS,
    TargetMotion,
    model,
    none,
    restoring,
)
from seft_ros.reference_force.reference_force_block import method_inputs
from seft_ros.reference_force.reference_force_parameters import REFERENCE_FORCE_TABLE

M, C, K, DT, DELAY = 52.7, 800.3, 2.11e5, 0.002, 0.0133
LINEAR = ("none", "model", "restoring")
DELAYS = st.floats(0.0021, 0.0399)


def compensator(method, axes=("x",), rate=500, **values):
    """Compensator of these parameters; a double underscore stands for a dot."""
    values = {
        "model__mass": M,
        "model__damping": C,
        "model__stiffness": K,
        "compensation__delay": DELAY,
        "mass_ratio": 1.0,
        "compensation__method": method,
        **values,
    }
    given_values = REFERENCE_FORCE_TABLE.check(
        {name.replace("__", "."): v for name, v in values.items()}
    )
    section = resolve({"reference_force": REFERENCE_FORCE_TABLE}, {"reference_force": given_values})
    known = method_inputs(section["reference_force"], axes, Timebase.from_rate(rate))
    return COMPENSATION_METHODS[method](known)


def run(one, motion, states):
    """Forces of a test, shape (N, n)."""
    one.reset()
    window = 1 + one.preview
    return np.array([one.step(motion[k : k + window], y) for k, y in enumerate(states)])


def noise(axes, steps=300, seed=1):
    rng = np.random.default_rng(seed)
    scale = np.array([[1e-3], [0.1], [5.0], [300.0]])
    return rng.normal(0, 3, (steps + 50, axes)), rng.normal(0, 1, (steps, 4, axes)) * scale


@pytest.mark.parametrize("method", LINEAR)
def test_a_method_is_the_linear_filter_that_it_says_it_is(method):
    one = compensator(method, ("x", "y"), model__mass=[5.0, 1.0, 1.0, 4.0], mass_ratio=0.7)
    motion, states = noise(2, 40)
    matrix, size = one.linear().matrix(), len(one.linear().a)
    s, expected = np.zeros(size), []
    for k, y in enumerate(states):
        window = motion[k : k + 1 + one.linear().preview]
        force, s = np.split(matrix @ np.concatenate([s, y.ravel(), window.ravel()]), [2])
        expected.append(force)
    np.testing.assert_allclose(run(one, motion, states), expected, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("method", LINEAR)
def test_axes_that_are_not_coupled_are_tests_of_their_own(method):
    masses, stiffness = [52.7, 20.0, 300.0], [2.11e5, 9e4, 3e6]
    motion, states = noise(3, 900)
    states[:, 3] = np.roll(-motion[:900] * masses, 5, axis=0)
    values = {"model__mass": masses, "model__stiffness": stiffness, "mass_ratio": 0.4}
    together = run(compensator(method, ("x", "y", "z"), **values), motion, states)
    for axis in range(3):
        own = {"model__mass": masses[axis], "model__stiffness": stiffness[axis], "mass_ratio": 0.4}
        one = slice(axis, axis + 1)
        alone = run(compensator(method, **own), motion[:, one], states[:, :, one])
        scale = np.abs(alone).max()
        np.testing.assert_allclose(together[:, one] / scale, alone / scale, atol=1e-9)


@given(delay=DELAYS, step=st.integers(0, 5))
@settings(max_examples=25)
def test_without_computed_mass_the_known_ground_motion_is_all(delay, step):
    motion, states = noise(1, 10)
    force = run(compensator("model", compensation__delay=delay, mass_ratio=0.0), motion, states)
    ahead = np.interp(step * DT + delay, DT * np.arange(len(motion)), motion[:, 0])
    assert force[step, 0] == pytest.approx(-M * ahead, rel=1e-9)


def test_a_method_without_its_delay_says_where_to_get_it():
    with pytest.raises(InputError, match=r"model needs compensation.delay, .* seft identify"):
        compensator("model", compensation__delay=0.0)


def whole_structure(mass, damping, stiffness, start, motion, delay):
    """Acceleration after a delay from a start (x, v), ground motion linear between steps of DT."""
    n = len(mass)
    a = np.zeros((4 * n, 4 * n))  # x, v, ground acceleration and its slope
    a[:n, n : 2 * n] = a[2 * n : 3 * n, 3 * n :] = np.eye(n)
    a[n : 2 * n] = np.linalg.solve(mass, np.hstack([-stiffness, -damping, -mass, 0 * mass]))
    z, left = start, delay
    for now, then in pairwise(motion):
        part = min(DT, left)
        z = (expm(a * part) @ np.concatenate([z, now, (then - now) / DT]))[: 2 * n]
        left -= part
        ground = now + (then - now) * part / DT
        if left < 1e-12:
            break
    return np.linalg.solve(mass, -damping @ z[n:] - stiffness @ z[:n]) - ground, ground


@given(DELAYS, st.integers(0, 99))
@settings(max_examples=40)
def test_the_model_predicts_as_the_exact_solution_of_the_whole_structure(delay, seed):
    rng = np.random.default_rng(seed)
    mass = np.array([[60.0, 10.0], [10.0, 40.0]])
    damping, stiffness = C * np.array([[2, -1], [-1, 1]]), K * np.array([[2, -1], [-1, 1]])
    motion, state = rng.normal(0, 3, (50, 2)), np.zeros((4, 2))
    state[0], state[1] = rng.normal(0, 2e-3, 2), rng.normal(0, 0.15, 2)
    values = {
        "model__mass": mass.ravel().tolist(),
        "model__damping": damping.ravel().tolist(),
        "model__stiffness": stiffness.ravel().tolist(),
    }
    one = compensator("model", ("x", "y"), compensation__delay=delay, mass_ratio=1.5, **values)
    force = run(one, motion, [state])[0]
    a, ground = whole_structure(2.5 * mass, damping, stiffness, state[:2].ravel(), motion, delay)
    expected = -2.5 * mass @ ground - 1.5 * mass @ a
    scale = np.abs(K * state[0]).max() + np.abs(mass @ motion[:25].T).max()
    np.testing.assert_allclose(force / scale, expected / scale, atol=0.02)


def test_each_name_is_that_of_its_method():
    own = {"none": none, "model": model, "restoring": restoring, "target_motion": TargetMotion}
    assert {name: COMPENSATION_METHODS[name] for name in own} == own
