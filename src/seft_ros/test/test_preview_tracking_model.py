"""The sampled force loop of preview_inverse against its response in s."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_msgs_py.errors import InputError
from seft_ros.reference_force.compensation.preview.tracking_model import TrackingModel

DT = 0.002
DELAYED = {"compensation.delay": 0.013, "tracking.numerator": [0.0], "tracking.denominator": [1.0]}


def response(model, hz, dt=DT):
    """Frequency response of the sampled loop."""
    z = np.exp(2j * np.pi * hz * dt)
    matrices = z[:, None, None] * np.eye(len(model.a)) - model.a
    return np.linalg.solve(matrices, model.b[None, :, None])[..., 0] @ model.c


def held(numerator, denominator, dead_time, hz, dt=DT, aliases=3000):
    """Response to straight lines between samples: Poisson's sum over all aliases of it."""
    turns = hz[:, None] * dt + np.arange(-aliases, aliases + 1)
    s = 2j * np.pi * turns / dt
    loop = np.polyval(numerator, s) / np.polyval(denominator, s) * np.exp(-s * dead_time)
    return (loop * np.sinc(turns) ** 2).sum(axis=1)


def polynomial(real, pairs):
    """Polynomial in s of real poles (1/s) and pairs of (natural frequency, damping ratio)."""
    product = np.ones(1)
    for pole in real:
        product = np.polymul(product, [1.0 / pole, 1.0])
    for w, damping in pairs:
        product = np.polymul(product, [1.0 / w**2, 2 * damping / w, 1.0])
    return product


PAIRS = st.lists(st.tuples(st.floats(10.0, 700.0), st.floats(0.05, 1.0)), max_size=3)
REAL = st.lists(st.floats(10.0, 900.0), max_size=2)
HZ = np.array([0.5, 2.0, 7.3, 20.0, 61.0, 130.0, 249.0])


@given(REAL, PAIRS, st.floats(-300.0, 300.0), st.floats(1.0, 12.0))
@settings(max_examples=60, deadline=None)
def test_it_answers_straight_lines_between_samples_as_the_loop_in_s_does(real, pairs, zero, delay):
    denominator = polynomial(real, pairs)
    numerator = np.array([zero / 3e4, 0.9]) if len(denominator) > 2 else np.array([0.9])
    model = TrackingModel.sampled(numerator, denominator, delay * DT, DT)
    exact = held(numerator, denominator, delay * DT, HZ)
    np.testing.assert_allclose(response(model, HZ), exact, atol=3e-4)


def test_below_a_tenth_of_the_sampling_rate_it_is_the_identified_response():
    """Phase exact, magnitude less by sinc^2 of the straight lines."""
    hz, dead_time = np.linspace(0.5, 50.0, 100), 0.00437
    denominator = polynomial([60.0], [(90.0, 0.5), (570.0, 0.1)])
    s = 2j * np.pi * hz
    exact = np.exp(-s * dead_time) / np.polyval(denominator, s)
    ratio = response(TrackingModel.sampled(np.ones(1), denominator, dead_time, DT), hz) / exact
    assert np.abs(np.angle(ratio)).max() < 1e-3
    np.testing.assert_allclose(np.abs(ratio), np.sinc(hz * DT) ** 2, rtol=1e-3)


@given(st.integers(1, 250), st.floats(-3.0, 3.0), st.sampled_from([250.0, 500.0, 1000.0, 2048.0]))
@settings(max_examples=40, deadline=None)
def test_a_whole_delay_is_one(steps, gain, rate):
    model = TrackingModel.sampled(np.array([gain]), np.ones(1), steps / rate, 1 / rate)
    states, forces = np.zeros(len(model.a)), []
    rng = np.random.default_rng(steps)
    wanted = rng.normal(size=steps + 20)
    for u in wanted:
        forces.append(model.c @ states)
        states = model.a @ states + model.b * u
    expected = np.concatenate([np.zeros(steps), gain * wanted[:20]])
    np.testing.assert_allclose(forces, expected, atol=1e-12)


@given(st.floats(1.0, 20.0))
@settings(max_examples=30, deadline=None)
def test_between_samples_a_delay_blends_two_of_them(delay):
    model = TrackingModel.sampled(np.ones(1), np.ones(1), delay * DT, DT)
    z = np.exp(2j * np.pi * HZ * DT)
    whole = np.ceil(delay - 1e-9)
    late = 1.0 - (whole - delay)
    blended = late * z**-whole + (1 - late) * z ** (1 - whole)
    np.testing.assert_allclose(response(model, HZ), blended, atol=1e-9)


@given(st.floats(1.0, 20.0), st.floats(20.0, 400.0))
@settings(max_examples=30, deadline=None)
def test_its_delay_is_dead_time_and_lag(steps, pole):
    model = TrackingModel.sampled(np.ones(1), np.array([1 / pole, 1.0]), steps * DT, DT)
    lag = np.arctan(2 * np.pi / pole) / (2 * np.pi)
    assert model.delay(DT) == pytest.approx(steps * DT + lag, rel=1e-4)


def test_its_states_are_of_equal_size():
    """However unlike the coefficients: white forces make each state vary by one."""
    denominator = polynomial([60.0], [(25.0, 0.5), (90.0, 0.4), (570.0, 0.05)])
    model = TrackingModel.sampled(np.ones(1), denominator, 0.0045, DT)
    spread = np.zeros_like(model.a)
    drive = model.b.copy()
    for _ in range(5000):
        spread += np.outer(drive, drive)
        drive = model.a @ drive
    np.testing.assert_allclose(np.diag(spread), 1.0, rtol=1e-6)


@pytest.mark.parametrize("dead_time", [0.002, 0.002 * (1 - 1e-13), 0.002 * (1 + 1e-13)])
@pytest.mark.parametrize("denominator", [[1.0], [0.01, 1.0]])
def test_one_period_of_dead_time_may_be_rounded(dead_time, denominator):
    numerator, denominator = np.ones(1), np.array(denominator)
    model = TrackingModel.sampled(numerator, denominator, dead_time, DT)
    exact = held(numerator, denominator, 0.002, HZ, aliases=20000)
    np.testing.assert_allclose(response(model, HZ), exact, atol=3e-5)


@pytest.mark.parametrize(
    ("numerator", "denominator", "dead_time", "message"),
    [
        ([1.0, 0.0, 1.0], [1.0, 1.0], 0.004, "improper: numerator of degree 2 over denominator"),
        ([1.0], [1.0, -3.0], 0.004, "unstable pole"),
        ([1.0], [1.0, 0.0], 0.004, "unstable pole"),
        ([1.0], [0.1, 1.0], 0.0, "dead_time is 0 s, but must be more than 0"),
        ([1.0], [0.1, 1.0], 0.6, "at most 250 samples"),
        ([1.0], [0.1, 1.0], 0.0015, "answers at once"),
        ([1.0], [1.0], 0.0019, "answers at once"),
    ],
)
def test_a_response_that_makes_no_loop_is_wrong_input(numerator, denominator, dead_time, message):
    with pytest.raises(InputError, match=message) as caught:
        TrackingModel.sampled(np.array(numerator), np.array(denominator), dead_time, DT)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("reference_force: tracking")


def test_where_the_loop_is_not_known_it_is_the_delay_that_is_compensated():
    model = TrackingModel.from_options(DELAYED | {"tracking.dead_time": 0.0}, DT)
    assert model.delay(DT) == pytest.approx(0.013, rel=1e-9)


def test_nothing_known_is_wrong_input_that_tells_where_to_get_it():
    nothing = DELAYED | {"compensation.delay": 0.0, "tracking.dead_time": 0.0}
    with pytest.raises(InputError, match=r"needs tracking.*seft identify") as caught:
        TrackingModel.from_options(nothing, DT)
    assert "\n" not in str(caught.value)


def test_leading_zeros_do_not_matter():
    options = {
        "tracking.numerator": [0.0, 0.0, 1.0],
        "tracking.denominator": [0.0, 0.02, 1.0],
        "tracking.dead_time": 0.0045,
    }
    model = TrackingModel.from_options(options, DT)
    exact = held([1.0], [0.02, 1.0], 0.0045, HZ)
    np.testing.assert_allclose(response(model, HZ), exact, atol=3e-4)
