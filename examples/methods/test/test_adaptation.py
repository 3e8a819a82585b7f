"""Estimates on line: delay of the actuator, and coefficients of its time series."""

import numpy as np
import pytest
from compensators import force_section
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, lfilter
from seft_methods.delay_estimate import DelayEstimator, band_pass
from seft_methods.settings import read_settings
from seft_methods.time_series import Ats, parabola_weights
from seft_msgs_py.wire.topics import Timebase
from seft_plant_sim.computed.computed_substructure import ComputedSubstructure
from seft_ros.reference_force.compensator import MethodInputs
from seft_ros.reference_force.reference_force_block import method_inputs

DT, OWN, BOUNDS, RATE = 0.002, 0.011, (0.005, 0.04), 0.01
LOOP = 1.5 * DT
START = OWN + LOOP


def estimator(axes=1):
    one, options = np.eye(axes), {"actuator.delay": OWN}
    settings = read_settings({"delay_range": [end - LOOP for end in BOUNDS], "delay_rate": RATE})
    return DelayEstimator(
        MethodInputs(
            one, ComputedSubstructure.lumped(np.zeros((axes, axes))), one, one, DT, options
        ),
        settings,
    )


def broad_band(steps, seed=1):
    """Force of 300 N RMS up to 15 Hz, strong and weak by turns."""
    white = np.random.default_rng(seed).normal(size=steps)
    course = lfilter(*butter(2, [0.8, 15.0], "bandpass", fs=1 / DT), white)
    course *= 1 + 0.7 * np.sin(2 * np.pi * 0.9 * DT * np.arange(steps))
    return 300 * course / course.std()


def delayed(course, delay):
    spectrum = np.fft.rfft(course, 2 * len(course))
    turns = np.fft.rfftfreq(2 * len(course), DT) * delay
    return np.fft.irfft(spectrum * np.exp(-2j * np.pi * turns))[: len(course)]


def follow(one, reference, measured):
    """Estimates after every step."""
    found = []
    for p, q in zip(reference, measured, strict=True):
        one.step(np.atleast_1d(p), np.atleast_1d(q))
        found.append(one.delay.copy())
    return np.array(found)


def test_the_band_pass_is_that_of_butterworth():
    matrix, signals = band_pass([1.0, 12.0], DT), np.random.default_rng(1).normal(size=(400, 3))
    high, low = butter(2, 1.0, "highpass", fs=1 / DT), butter(2, 12.0, fs=1 / DT)
    expected = lfilter(*low, lfilter(*high, signals, axis=0), axis=0)
    states, found = np.zeros((4, 3)), []
    for sample in signals:
        *states, passed = matrix @ np.vstack([states, sample])
        found.append(passed)
    np.testing.assert_allclose(found, expected, atol=1e-9)


@given(st.floats(0.006, 0.038), st.floats(0.5, 2.0), st.integers(0, 999))
@settings(max_examples=15)
def test_any_delay_is_found_whatever_the_amplitude(delay, amplitude, seed):
    force = broad_band(2500, seed)
    found = follow(estimator(), force, amplitude * delayed(force, delay))
    assert found[-1] == pytest.approx(delay, abs=1e-4)


def test_sensor_noise_alone_moves_nothing():
    noise = np.random.default_rng(1).normal(0, 10, (5000, 2))
    noise[:, 0] += 0.8 * noise[:, 1]  # what is fed back
    assert np.all(follow(estimator(), noise[:, 0], noise[:, 1]) == START)


def test_forces_that_are_not_alike_move_nothing():
    assert np.all(follow(estimator(), broad_band(2500, 1), broad_band(2500, 2)) == START)


def test_the_estimate_moves_no_faster_than_its_rate_and_stays_in_its_bounds():
    force = broad_band(4000)
    for delay, end in ((0.001, BOUNDS[0]), (0.06, None), (0.03, 0.03)):
        found = follow(estimator(), force, delayed(force, delay))[:, 0]
        steps = np.abs(found[10:] - found[:-10])
        assert steps.max() <= RATE * DT * 10 * (1 + 1e-9)
        assert BOUNDS[0] <= found.min() <= found.max() <= BOUNDS[1]
        if end is not None:
            assert found[-1] == pytest.approx(end, abs=1e-4)


def test_values_that_are_not_finite_are_left_out():
    force = broad_band(3000)
    measured = delayed(force, 0.009)
    measured[[100, 700, 701]] = np.nan, np.inf, 1e300
    found = follow(estimator(), force, measured)
    assert np.isfinite(found).all()
    reached = follow(estimator(), force, np.where(np.abs(measured) < 1e9, measured, np.nan))
    assert reached[-1] == pytest.approx(0.009, abs=5e-4)


@given(st.lists(st.floats(-9, 9), min_size=3, max_size=3), st.integers(3, 20))
def test_a_parabola_has_its_derivatives(coefficients, count):
    c0, c1, c2 = coefficients
    times = -DT * np.arange(count)
    found = parabola_weights(count, DT) @ (c0 + c1 * times + c2 * times**2)
    np.testing.assert_allclose(found, [c0, c1, 2 * c2], rtol=1e-6, atol=1e-5)


def ats():
    method = {"compensation__method": "ats", "actuator__delay": OWN}
    section = force_section(specimen__mass=50.0, specimen__stiffness=2e5, mass_ratio=1.0, **method)
    return Ats(method_inputs(section, ("x",), Timebase.from_rate(500)))


def force_response(one, frequencies_hz):
    """Frequency response from f, where the acceleration is zero, to f_r, over that of f*."""
    linear = one.linear()
    found = []
    for z in np.exp(2j * np.pi * frequencies_hz * DT):
        s = np.linalg.solve(z * np.eye(len(linear.a)) - linear.a, linear.b[:, 3])
        found.append((linear.c[0] @ s + linear.d[0, 3]) / 0.5)
    return np.array(found)


@pytest.mark.parametrize("delay", [0.006, 0.012, 0.016])
@pytest.mark.parametrize("amplitude", [0.85, 1.1])
def test_ats_becomes_the_inverse_of_an_actuator_with_two_lags(delay, amplitude):
    """f + delay f' + (delay / 2)^2 f'' = amplitude f_r: what the series itself can say."""
    one, pole = ats(), np.exp(-2 * DT / delay)
    gain, (_, a1, a2) = amplitude * (1 - pole) ** 2, np.poly([pole, pole])
    last = before = 0.0
    for wanted in broad_band(4000):
        state = np.array([[0.0], [0.0], [0.0], [last]])
        force = one.step(np.array([[-wanted / 50]]), state)[0]
        last, before = gain * force - a1 * last - a2 * before, last
    hz = np.array([2.0, 4.0, 7.0])
    z = np.exp(2j * np.pi * hz * DT)
    actuator = gain * z / np.polyval([1.0, a1, a2], z)  # z^2, and a step until it is measured
    error = np.abs(force_response(one, hz) * actuator - 1)
    assert error.max() < 0.08
    assert error[-1] < 0.25 * np.abs(actuator[-1] - 1)


def test_coefficients_of_ats_keep_within_bounds_and_rates():
    one, force = ats(), broad_band(3000)
    measured, found = 3.0 * delayed(force, 0.05), []
    for k in range(len(force)):
        one.step(np.array([[-force[k] / 50]]), np.array([[0.0], [0.0], [0.0], [measured[k]]]))
        estimates = one.estimates()
        found.append([estimates["delay"][0], estimates["amplitude"][0]])
    delay, amplitude = np.array(found).T
    assert np.isfinite(found).all()
    assert 1 / 1.3 - 1e-9 <= amplitude.min() <= amplitude.max() <= 1 / 0.7 + 1e-9
    assert np.abs(np.diff(1 / amplitude)).max() <= 0.5 * 0.05 * (1 + 1e-9)
    assert np.abs(np.diff(delay / amplitude)).max() <= RATE * 0.05 * (1 + 1e-9)


def test_ats_leaves_out_what_is_not_finite_and_does_nothing_in_the_quiet():
    one, noise = ats(), np.random.default_rng(1).normal(0, 3, 3000)
    for k, f in enumerate(noise):
        f = np.nan if k == 700 else f
        one.step(np.zeros((1, 1)), np.array([[0.0], [0.0], [0.0], [f]]))
    assert one.estimates() == {"delay": [START], "amplitude": [1.0]}
