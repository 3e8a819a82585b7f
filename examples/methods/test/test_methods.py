"""What holds for all methods, each against its equation, and as seft runs them."""

import json
from pathlib import Path

import numpy as np
import pytest
from compensators import (
    DELAY,
    DT,
    C,
    K,
    M,
    assert_axes_are_apart,
    assert_known_motion_is_all,
    compensator,
    noise,
    run,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_methods.settings import SETTINGS
from seft_msgs_py.errors import InputError

PREDICTORS = ("polynomial", "linear_acceleration", "smith", "inverse")
CLASSICAL = (*PREDICTORS, "ats")
ADAPTIVE = [(name, False) for name in CLASSICAL] + [(name, True) for name in PREDICTORS]
DELAYS = st.floats(0.0031, 0.0399)


@pytest.mark.parametrize(("method", "estimate"), ADAPTIVE)
def test_a_method_is_the_linear_filter_that_it_says_it_is(method, estimate):
    values = {"specimen__mass": [5.0, 1.0, 1.0, 4.0], "mass_ratio": 0.7}
    settings = {"order": 3, "estimate_delay": estimate}
    one = compensator(method, ("x", "y"), settings=settings, **values)
    linear, (motion, states) = one.linear(), noise(2, 40)  # too short to adapt to
    matrix, s, expected = linear.matrix(), np.zeros(len(linear.a)), []
    for k, y in enumerate(states):
        window = motion[k : k + 1 + linear.preview]
        force, s = np.split(matrix @ np.concatenate([s, y.ravel(), window.ravel()]), [y.shape[1]])
        expected.append(force)
    np.testing.assert_allclose(run(one, motion, states), expected, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("method", PREDICTORS)
def test_a_method_that_follows_the_delay_starts_as_at_a_given_delay(method):
    """Its gains stand on a grid of delays, 13.7 ms is between two of them."""
    motion, states = noise(1, 20)
    given_delay, followed = (
        run(compensator(method, settings=settings, delay=0.0137), motion, states)
        for settings in ({}, {"estimate_delay": True})
    )
    scale = np.abs(given_delay).max()
    np.testing.assert_allclose(followed / scale, given_delay / scale, atol=2e-3)


@pytest.mark.parametrize(("method", "estimate"), ADAPTIVE)
def test_a_reset_makes_the_next_test_the_same_bit_by_bit(method, estimate):
    one = compensator(method, settings={"estimate_delay": estimate}, mass_ratio=0.5)
    motion, states = noise(1, 900)
    states[:, 3] = np.roll(run(one, motion, states), 9, axis=0)  # something to adapt to
    first, estimates = run(one, motion, states), one.estimates()
    if estimates:
        assert not np.array_equal(estimates["delay"], [DELAY])
    np.testing.assert_array_equal(run(one, motion, states), first)
    for name, value in one.estimates().items():
        np.testing.assert_array_equal(value, estimates[name])


@pytest.mark.parametrize(("method", "estimate"), ADAPTIVE)
def test_axes_that_are_not_coupled_are_tests_of_their_own(method, estimate):
    assert_axes_are_apart(method, settings={"estimate_delay": estimate})


@pytest.mark.parametrize("method", PREDICTORS)
@given(delay=DELAYS, step=st.integers(0, 5))
@settings(max_examples=25)
def test_without_computed_mass_the_known_ground_motion_is_all(method, delay, step):
    assert_known_motion_is_all(method, delay, step)


@pytest.mark.parametrize("method", CLASSICAL)
def test_a_method_without_its_delay_says_where_to_get_it(method):
    with pytest.raises(InputError, match=f"{method} needs the delay .* seft identify"):
        compensator(method, delay=1.5 * DT)


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        ({"delay_range": [0.02, 0.03]}, r"delay_range is \[0.02, 0.03\], .* at 0.0103 s"),
        ({"delay_range": [0.02, 0.01]}, "must be two delays in s, the shorter first"),
        ({"excitation": 0.0}, "excitation is 0.0, but must be greater than zero"),
        ({"band": [5.0, 250.0]}, "below half the sampling rate, 250 Hz"),
        ({"band": ["low"]}, "must be a number"),
        ({"delay_rang": 0.01}, "there is no setting delay_rang; did you mean delay_range?"),
    ],
)
@pytest.mark.parametrize("method", ["smith", "ats"])
def test_an_adaptation_that_makes_no_sense_is_refused(method, settings, why):
    with pytest.raises(InputError, match=rf"^reference_force: compensation\..*{why}"):
        compensator(method, settings={"estimate_delay": True, **settings})


@pytest.mark.parametrize("order", [0, 4])
def test_a_polynomial_is_of_first_to_third_order(order):
    with pytest.raises(InputError, match="order is"):
        compensator("polynomial", settings={"order": order})


def test_bounds_of_the_delay_are_those_of_the_force_loop_as_the_delay_is():
    """A link's delay of 13 ms and the loop's own of 1.5 ms are added to both."""
    settings = {"estimate_delay": True, "delay_range": [0.01, 0.02]}
    one = compensator("smith", settings=settings, rate=1000, loop_delay=13)
    assert one.estimates()["delay"] == pytest.approx([DELAY + 0.013])
    assert one.preview == 35


@pytest.mark.parametrize(("damping", "stiffness"), [(0.0, K), (C, 0.0), (0.0, 0.0)])
def test_smith_refuses_a_model_that_would_never_forget(damping, stiffness):
    with pytest.raises(InputError, match="smith needs a model that comes to rest"):
        compensator("smith", specimen__damping=damping, specimen__stiffness=stiffness)


@given(st.integers(1, 3), DELAYS, st.lists(st.floats(-9, 9), min_size=4, max_size=4))
@settings(max_examples=50)
def test_a_polynomial_is_extrapolated_exactly(order, delay, coefficients):
    times = DT * np.arange(70)
    course = np.polynomial.Polynomial([*coefficients[: order + 1]], domain=[0, 0.1])
    states = np.zeros((70, 4, 1))
    states[:, 2, 0] = course(times)
    one = compensator("polynomial", settings={"order": order}, delay=delay)
    force = run(one, np.zeros((120, 1)), states)
    assert force[-1, 0] == pytest.approx(-M * course(times[-1] + delay), abs=1e-6)


@given(DELAYS, st.lists(st.floats(-1, 1), min_size=4, max_size=4), st.floats(0.1, 10))
@settings(max_examples=50)
def test_an_acceleration_that_varies_linearly_is_predicted_exactly(delay, start, alpha):
    """The ground motion is the one that lets the structure move on a cubic parabola."""
    x, v, a, slope = np.array(start) * [1e-3, 0.1, 5.0, 100.0]
    later = a + slope * delay
    end_v = v + a * delay + slope * delay**2 / 2
    end_x = x + v * delay + a * delay**2 / 2 + slope * delay**3 / 6
    total = (1 + alpha) * M
    ground = -later - (C * end_v + K * end_x) / total
    one = compensator("linear_acceleration", delay=delay, mass_ratio=alpha)
    motion, state = np.full((50, 1), ground), np.array([[x], [v], [a], [1e9]])
    force = run(one, motion, [state])[0, 0]
    assert force == pytest.approx(-total * ground - alpha * M * later, rel=1e-9, abs=1e-6)


@given(DELAYS, st.integers(0, 99))
def test_the_inverse_undoes_the_first_order_actuator(delay, seed):
    motion, states = noise(1, 60, seed)
    alpha_c = 1 + delay / DT
    commands = run(compensator("inverse", delay=delay), 0 * motion, states)[:, 0]
    restoring, applied = states[:, 3, 0] - M * states[:, 2, 0], 0.0
    for command, r in zip(commands, restoring, strict=True):
        applied = (command + (alpha_c - 1) * applied) / alpha_c
        assert applied == pytest.approx(r / 2, rel=1e-6, abs=1e-6)


def test_the_readme_names_every_method_and_setting_with_its_default():
    text = (Path(__file__).parents[1] / "README.md").read_text()
    for name in CLASSICAL:
        assert f"| `{name}` |" in text
    for row in SETTINGS:
        assert f"| `{row.name}` | {json.dumps(row.default)} |" in text
