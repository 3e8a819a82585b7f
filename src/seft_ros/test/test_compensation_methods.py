"""What holds for all compensation methods, and each against its equation.

Each is the linear filter that it says it is: test_compensation_substructure.py.
"""

from itertools import pairwise
from types import SimpleNamespace

import compensators
import numpy as np
import pytest
from compensators import DT, C, K, compensator, run
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from seft_msgs_py.errors import InputError
from seft_ros.reference_force.compensator import RegisteredCompensator

LINEAR = ("none", "model", "restoring")
DELAYS = st.floats(0.0031, 0.0399)


@pytest.mark.parametrize("method", LINEAR)
def test_axes_that_are_not_coupled_are_tests_of_their_own(method):
    compensators.assert_axes_are_apart(method)


@given(delay=DELAYS, step=st.integers(0, 5))
@settings(max_examples=25)
def test_without_computed_mass_the_known_ground_motion_is_all(delay, step):
    compensators.assert_known_motion_is_all("model", delay, step)


def test_a_method_without_its_delay_says_where_to_get_it():
    with pytest.raises(InputError, match=r"actuator.delay is 0, .* model needs .* seft identify"):
        compensator("model", actuator__delay=0.0)


def test_what_a_method_of_another_package_lacks_is_reported():
    one_more = SimpleNamespace(step=lambda motion, state: [0.0] * 2)
    for own, why in (
        (SimpleNamespace(), r"theirs has no step\(ground_motion, state\)"),
        (one_more, r"the force of theirs has the shape \(2,\), but must have \(1,\)"),
    ):
        with pytest.raises(InputError, match=why):
            RegisteredCompensator("theirs", lambda own=own: own, axes=1)


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
@settings(max_examples=20)
def test_the_model_predicts_as_the_exact_solution_of_the_whole_structure(delay, seed):
    rng = np.random.default_rng(seed)
    mass = np.array([[60.0, 10.0], [10.0, 40.0]])
    damping, stiffness = C * np.array([[2, -1], [-1, 1]]), K * np.array([[2, -1], [-1, 1]])
    motion, state = rng.normal(0, 3, (50, 2)), np.zeros((4, 2))
    state[0], state[1] = rng.normal(0, 2e-3, 2), rng.normal(0, 0.15, 2)
    values = {"mass": mass, "damping": damping, "stiffness": stiffness}
    values = {f"specimen__{name}": matrix.ravel().tolist() for name, matrix in values.items()}
    one = compensator("model", ("x", "y"), delay=delay, mass_ratio=1.5, **values)
    force = run(one, motion, [state])[0]
    a, ground = whole_structure(2.5 * mass, damping, stiffness, state[:2].ravel(), motion, delay)
    expected = -2.5 * mass @ ground - 1.5 * mass @ a
    scale = np.abs(K * state[0]).max() + np.abs(mass @ motion[:25].T).max()
    np.testing.assert_allclose(force / scale, expected / scale, atol=0.02)
