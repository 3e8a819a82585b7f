import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_ros.analysis.tracking import frequency_evaluation_index

DT = 0.002
COUNT = 5000
TIME = np.arange(COUNT) * DT
QUICK = settings(max_examples=40)


def sine(frequency, delay=0.0, amplitude=1.0):
    return amplitude * np.sin(2 * np.pi * frequency * (TIME - delay))


def burst(delay=0.0):
    t = TIME - 5.0 - delay
    return np.exp(-((t / 0.7) ** 2)) * np.cos(2 * np.pi * 9.0 * t)


@pytest.mark.parametrize("delay", [0.0037, -0.0037, 0.0, 0.04, 0.11])
def test_a_sine_gives_its_gain_and_delay_exactly(delay):
    found = frequency_evaluation_index(sine(4.0), sine(4.0, delay, 1.07), DT)
    assert found.amplitude == pytest.approx(1.07, rel=1e-12)
    assert found.delay_s == pytest.approx(delay, abs=1e-13)
    assert found.frequency_hz == pytest.approx(4.0, rel=1e-12)
    assert found.phase_rad == pytest.approx(-2 * np.pi * 4.0 * delay, abs=1e-11)


def test_a_lag_beyond_a_quarter_period_is_not_folded_back():
    found = frequency_evaluation_index(sine(4.0), sine(4.0, 0.1), DT)
    assert found.phase_rad == pytest.approx(-0.8 * np.pi)  # the plain arctan says 0.2 pi
    assert found.delay_s == pytest.approx(0.1)


def test_a_wave_packet_delayed_by_3_7_ms_is_3_7_ms_late():
    found = frequency_evaluation_index(burst(), 0.9 * burst(0.0037), DT)
    assert found.delay_s == pytest.approx(0.0037, abs=2e-6)
    assert found.amplitude == pytest.approx(0.9, rel=2e-3)
    assert found.frequency_hz == pytest.approx(9.0, rel=1e-3)


def test_two_sines_are_weighted_by_the_squares_of_their_amplitudes():
    command = sine(2.0, amplitude=3.0) + sine(10.0, amplitude=1.0)
    measured = sine(2.0, 0.01, 3.3) + sine(10.0, 0.02, 0.5)
    found = frequency_evaluation_index(command, measured, DT)
    a, b = 9.0, 1.0
    index = (
        1.1 * a * np.exp(-2j * np.pi * 2.0 * 0.01) + 0.5 * b * np.exp(-2j * np.pi * 10.0 * 0.02)
    ) / (a + b)
    frequency = (2.0 * a + 10.0 * b) / (a + b)
    assert found.amplitude == pytest.approx(abs(index), rel=1e-9)
    assert found.frequency_hz == pytest.approx(frequency, rel=1e-9)
    assert found.delay_s == pytest.approx(-np.angle(index) / (2 * np.pi * frequency), rel=1e-9)


def test_hand_values_of_four_samples():
    # spectra at 0 and 1/(4 dt): command 2, -1+1j; measured 1, -1; Nyquist's is left out
    command, measured = np.array([0.0, 1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0, 0.0])
    found = frequency_evaluation_index(command, measured, 0.25)
    index = (1 * 2 + -1 * (-1 + 1j)) / (4 + 2)  # command's bin at 1 Hz is -1-1j
    assert found.amplitude == pytest.approx(abs(index))
    assert found.phase_rad == pytest.approx(np.angle(index))
    assert found.frequency_hz == pytest.approx(2 / 6)


@QUICK
@given(st.floats(1e-3, 1e3), st.floats(0.2, 5.0), st.integers(0, 2**32 - 1))
def test_scaling_both_signals_changes_nothing_and_a_gain_the_amplitude_only(scale, gain, seed):
    rng = np.random.default_rng(seed)
    command, measured = rng.standard_normal((2, 64))
    one = frequency_evaluation_index(command, measured, DT)
    other = frequency_evaluation_index(scale * command, gain * scale * measured, DT)
    assert other.amplitude == pytest.approx(gain * one.amplitude, rel=1e-9)
    assert other.phase_rad == pytest.approx(one.phase_rad, rel=1e-9)
    assert other.frequency_hz == pytest.approx(one.frequency_hz, rel=1e-9)


@QUICK
@given(st.integers(3, 99), st.integers(0, 2**32 - 1))
def test_identical_signals_have_amplitude_one_and_no_delay(count, seed):
    signal = np.random.default_rng(seed).standard_normal(count)
    found = frequency_evaluation_index(signal, signal, DT)
    assert found.amplitude == pytest.approx(1.0, rel=1e-12)
    assert found.delay_s == pytest.approx(0.0, abs=1e-12)


def test_each_axis_is_evaluated_on_its_own():
    command = np.stack([sine(4.0), 100 * sine(7.0)], axis=1)
    measured = np.stack([sine(4.0, 0.003), 50 * sine(7.0, -0.002)], axis=1)
    found = frequency_evaluation_index(command, measured, DT)
    assert found.delay_s == pytest.approx([0.003, -0.002])
    assert found.amplitude == pytest.approx([1.0, 0.5])


@pytest.mark.parametrize(
    ("command", "measured"),
    [
        (np.zeros(50), np.ones(50)),
        (np.ones(50), np.full(50, np.nan)),
        (np.full(50, np.inf), np.ones(50)),
        (np.empty(0), np.empty(0)),
    ],
)
def test_what_makes_no_sense_is_nan(command, measured):
    found = frequency_evaluation_index(command, measured, DT)
    assert math.isnan(found.amplitude)
    assert math.isnan(found.delay_s)


def test_a_constant_command_has_an_amplitude_and_no_delay():
    found = frequency_evaluation_index(np.ones(1), np.full(1, 0.9), DT)
    assert found.amplitude == pytest.approx(0.9)
    assert math.isnan(found.delay_s)


def test_nothing_measured_is_amplitude_zero():
    assert frequency_evaluation_index(sine(4.0), np.zeros(COUNT), DT).amplitude == 0.0


def test_shapes_that_differ_are_refused():
    with pytest.raises(ValueError, match="same shape"):
        frequency_evaluation_index(np.ones((5, 1)), np.ones(5), DT)
