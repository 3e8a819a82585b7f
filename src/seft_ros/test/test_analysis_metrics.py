import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from seft_ros.analysis import metrics
from seft_ros.analysis.metrics import Agreement, agreement, best_fit_delay, delayed, nrmse, peak

DT = 0.002
TIME = np.arange(4000) * DT
QUICK = settings(max_examples=60)
DELAYS = st.floats(-0.05, 0.05)
SHAPES = st.tuples(st.integers(1, 40), st.integers(1, 3))


def burst(delay=0.0, frequency=9.0, centre=4.0, width=0.7):
    """A wave packet that is practically band-limited and at rest at both ends."""
    t = TIME - centre - delay
    return np.exp(-((t / width) ** 2)) * np.cos(2 * np.pi * frequency * t)


def motion(delay=0.0):
    """Several packets up to 60 Hz, as different as the parts of an earthquake."""
    parts = [(2.0, 9.0, 3.0, 0.6), (1.0, 31.0, 4.0, 0.4)]
    parts += [(-1.5, 4.0, 5.0, 0.5), (0.3, 60.0, 4.5, 0.3)]
    return sum(gain * burst(delay, *shape) for gain, *shape in parts)


def test_nrmse_of_a_gain_is_its_distance_from_one():
    assert nrmse(1.07 * motion(), motion()) == pytest.approx(0.07, rel=1e-12)
    assert nrmse(np.zeros_like(TIME), motion()) == pytest.approx(1.0, rel=1e-12)


def test_axes_are_taken_together():
    reference = np.array([[3.0, 0.0], [0.0, 4.0]])
    y = np.array([[3.0, 1.0], [0.0, 4.0]])
    assert nrmse(y, reference) == pytest.approx(math.sqrt(1 / 25))
    assert peak(-reference) == 4.0


@QUICK
@given(delay=DELAYS, gain=st.floats(0.2, 5.0))
def test_any_delay_is_found_whatever_the_gain(delay, gain):
    assert best_fit_delay(gain * motion(delay), motion(), DT) == pytest.approx(delay, abs=1e-6)


def test_one_delay_is_found_for_all_axes():
    y = np.stack([motion(0.0037), 3 * burst(0.0037)], axis=1)
    reference = np.stack([motion(), 3 * burst()], axis=1)
    assert best_fit_delay(y, reference, DT) == pytest.approx(0.0037, abs=1e-6)


@QUICK
@given(delay=DELAYS)
def test_a_shifted_signal_is_the_signal_at_shifted_times(delay):
    assert np.abs(delayed(motion(), delay, DT) - motion(delay)).max() < 1e-9 * peak(motion())


def test_a_record_that_ends_in_full_swing_does_not_ring():
    swing = np.sin(2 * np.pi * 7.0 * TIME) * np.minimum(TIME, 1.0)
    exact = np.sin(2 * np.pi * 7.0 * (TIME - 0.0137)) * np.clip(TIME - 0.0137, 0.0, 1.0)
    assert nrmse(delayed(swing, 0.0137, DT), exact) < 1e-6
    assert best_fit_delay(exact, swing, DT) == pytest.approx(0.0137, abs=5e-5)


def test_once_aligned_a_pure_delay_is_no_error():
    assert nrmse(motion(0.0137), motion()) > 0.5
    assert metrics.nrmse_aligned(motion(0.0137), motion(), DT, 0.0137) < 1e-9
    assert metrics.nrmse_aligned(1.05 * motion(0.0137), motion(), DT, 0.0137) == pytest.approx(0.05)


def test_a_negative_delay_needs_no_samples_beyond_the_end():
    swing = np.sin(2 * np.pi * 7.0 * TIME) * np.minimum(TIME, 1.0)
    ahead = np.sin(2 * np.pi * 7.0 * (TIME + 0.01)) * np.minimum(TIME + 0.01, 1.0)
    ahead[-5:] = 77.0  # after the reference's end
    assert metrics.nrmse_aligned(ahead, swing, DT, -0.01) < 1e-3


@QUICK
@given(hnp.arrays(np.float64, SHAPES, elements=st.floats(-9, 9)), st.integers(0, 99))
def test_aligning_never_makes_it_worse(reference, seed):
    y = np.random.default_rng(seed).normal(size=reference.shape)
    found = agreement(y, reference, DT)
    if math.isfinite(found.nrmse):
        assert found.nrmse_aligned <= found.nrmse
    else:
        assert math.isnan(found.nrmse_aligned)


@QUICK
@given(st.floats(1e-150, 1e150))
def test_units_do_not_matter(scale):
    one = agreement(1.1 * motion(0.004), motion(), DT)
    other = agreement(scale * 1.1 * motion(0.004), scale * motion(), DT)
    assert other.nrmse == pytest.approx(one.nrmse)
    assert other.nrmse_aligned == pytest.approx(one.nrmse_aligned)
    assert other.delay_s == pytest.approx(one.delay_s, abs=1e-9)


def test_a_constant_has_no_delay():
    found = agreement(np.full(50, 3.3), np.full(50, 3.0), DT)
    assert found == Agreement(pytest.approx(0.1), pytest.approx(0.1), 3.3, 3.0, 0.0)


EMPTY = np.empty((0, 2))


@pytest.mark.parametrize(("y", "reference"), [(motion(), 0.0 * TIME), (EMPTY, EMPTY)])
def test_against_zeros_and_without_samples_errors_and_delay_are_undefined(y, reference):
    found = agreement(y, reference, DT)
    assert np.isnan([found.nrmse, found.nrmse_aligned, found.delay_s]).all()
    assert math.isnan(found.peak) == math.isnan(found.reference_peak) == (not len(y))


def test_a_response_of_zeros_is_all_error_and_has_no_delay():
    found = agreement(np.zeros_like(TIME), motion(), DT)
    assert found.nrmse == pytest.approx(1.0)
    assert math.isnan(found.delay_s)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_not_finite_makes_the_errors_undefined(value):
    y = motion()
    y[7] = value
    found = agreement(y, motion(), DT)
    assert np.isnan([found.nrmse, found.nrmse_aligned, found.delay_s]).all()
    assert not math.isfinite(found.peak)
    assert math.isnan(best_fit_delay(y, motion(), DT))


def test_lost_steps_are_bridged_for_the_delay_and_left_out_of_the_errors():
    steps = np.delete(np.arange(len(TIME)), [5, 900, 901, 2000, 2001, 2002])
    found = agreement(motion(0.0037)[steps], motion(), DT, steps)
    assert found.delay_s == pytest.approx(0.0037, abs=2e-5)
    assert found.nrmse_aligned < 2e-3
    assert found.nrmse == nrmse(motion(0.0037)[steps], motion()[steps])
