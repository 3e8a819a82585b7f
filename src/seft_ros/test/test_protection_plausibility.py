import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.config.facts import CHANNELS
from seft_plant_sim.compiled import is_finite
from seft_ros.protection.protected_force import PlausibleForce, is_plausible, not_finite

DT = 0.002


def forces(largest=1000.0, fastest=1e5, axes=("north", "east"), dt=DT):
    return PlausibleForce(largest, fastest, axes, dt)


def fault(limits, force):
    """What is wrong with the force of a step; None if nothing is."""
    return None if is_plausible(limits.limits, limits.recent, force) else limits.describe(force)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_fastest_change_from_both_sides(sign):
    limits = forces()
    assert fault(limits, np.array([sign * 200.0, 0.0])) is None  # from rest
    assert fault(limits, np.array([sign * 400.0, 0.0])) is None
    assert fault(limits, np.array([sign * 600.01, 0.0])) == (
        f"reference force changes by {sign * 100005:.5g} N/s on axis north, beyond the limit of "
        "100000 N/s"
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_the_least_excess_is_a_fault_and_what_is_at_its_limit_is_not_named(axis, sign):
    name, limits = ("north", "east")[axis], forces(fastest=1e9)
    force = np.full(2, 1000.0)
    assert fault(limits, force) is None
    force[axis] = sign * math.nextafter(1000.0, 2000.0)
    message = f"reference force {sign * 1000.0:.5g} N on axis {name} is beyond the limit of 1000 N"
    assert fault(limits, force) == message
    limits = forces()
    force[:] = limits.limits[1]
    assert fault(limits, force) is None
    limits.recent[:] = 0.0
    force[axis] *= sign * (1.0 + np.finfo(float).eps)
    assert fault(limits, force).endswith(f"on axis {name}, beyond the limit of 100000 N/s")


def test_at_a_high_rate_the_change_within_2_ms_counts():
    limits = forces(dt=0.0005)  # 200 N within 4 steps
    for force in (0.0, 195.0, 195.0, 0.0, 190.0, 390.0):
        assert fault(limits, np.array([0.0, force])) is None
    assert fault(limits, np.array([0.0, 397.0])) == (
        "reference force changes by 1.01e+05 N/s on axis east, beyond the limit of 100000 N/s"
    )


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_force_that_is_not_finite_is_named(value):
    assert fault(forces(), np.array([0.0, value])) == f"reference force is {value} N on axis east"


def test_a_fault_leaves_the_last_plausible_force():
    limits = forces()
    fault(limits, np.array([100.0, -100.0]))
    fault(limits, np.array([math.nan, -100.0]))
    assert limits.recent.tolist() == [[100.0, -100.0]]


@given(st.lists(st.floats(-1000.0, 1000.0), min_size=1, max_size=50))
def test_only_what_breaks_a_limit_is_a_fault(values):
    limits, last = forces(axes=("x",)), 0.0
    for value in values:
        found = fault(limits, np.array([value]))
        assert (found is not None) == (abs(value - last) > 1e5 * DT * (1 + 1e-12))
        last = last if found else value


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("row", range(4))
def test_a_measured_state_that_is_not_finite_is_named(row, value):
    state = np.zeros((4, 2))
    state[row, 1] = value
    said = f"measured {CHANNELS[row]} is {value} on axis east"
    assert not_finite(state, ("north", "east")) == said
    assert not is_finite(state, 0)
    assert is_finite(state, row + 1)


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=8, max_size=8))
def test_any_finite_state_is_plausible(values):
    state = np.array(values).reshape(4, 2)
    assert is_finite(state, 0)
    assert not_finite(state, ("a", "b")) == ""
