import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_ros.analysis.tracking import (
    relative_tracking_indicator,
    tracking_indicator,
)

QUICK = settings(max_examples=40)
CYCLE = 2 * np.pi * np.arange(2001) / 2000


def published(command, measured):
    """The recursion as it is printed, sample by sample."""
    area, complement, indicator = 0.0, 0.0, [0.0]
    for k in range(len(command) - 1):
        area += 0.5 * (command[k + 1] + command[k]) * (measured[k + 1] - measured[k])
        complement += 0.5 * (measured[k + 1] + measured[k]) * (command[k + 1] - command[k])
        indicator.append(0.5 * (area - complement))
    return indicator


@pytest.mark.parametrize("lag", [0.3, -0.3, 0.0, 1.2])
def test_a_sine_that_lags_encloses_its_ellipse_in_each_cycle(lag):
    found = tracking_indicator(3.0 * np.sin(CYCLE), 2.0 * np.sin(CYCLE - lag))
    assert found[-1] == pytest.approx(np.pi * 3.0 * 2.0 * np.sin(lag), rel=1e-5, abs=1e-12)


def test_it_rises_while_the_measured_signal_lags_and_falls_while_it_leads():
    assert (np.diff(tracking_indicator(np.sin(CYCLE), np.sin(CYCLE - 0.1))) > 0).all()
    assert (np.diff(tracking_indicator(np.sin(CYCLE), np.sin(CYCLE + 0.1))) < 0).all()


def test_hand_values_of_a_unit_square():
    command, measured = np.array([0.0, 1.0, 1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0, 1.0, 0.0])
    assert tracking_indicator(command, measured).tolist() == [0.0, 0.0, 0.5, 1.0, 1.0]
    assert tracking_indicator(measured, command).tolist() == [0.0, 0.0, -0.5, -1.0, -1.0]


@QUICK
@given(st.integers(0, 2**32 - 1))
def test_it_is_the_published_recursion(seed):
    command, measured = np.random.default_rng(seed).standard_normal((2, 30))
    assert tracking_indicator(command, measured) == pytest.approx(published(command, measured))


@QUICK
@given(st.floats(-5.0, 5.0), st.integers(0, 2**32 - 1))
def test_a_gain_alone_encloses_nothing(gain, seed):
    command = np.random.default_rng(seed).standard_normal(50)
    assert tracking_indicator(command, gain * command) == pytest.approx(0.0, abs=1e-11)


@QUICK
@given(st.floats(1e-3, 1e3), st.integers(0, 2**32 - 1))
def test_relative_to_the_peak_it_does_not_know_the_unit(scale, seed):
    command, measured = np.random.default_rng(seed).standard_normal((2, 30))
    one = relative_tracking_indicator(command, measured)
    assert relative_tracking_indicator(scale * command, scale * measured) == pytest.approx(
        one, rel=1e-9, abs=1e-12
    )
    assert one == pytest.approx(
        tracking_indicator(command, measured)[-1] / np.abs(command).max() ** 2, abs=1e-12
    )


def test_axes_are_columns():
    command = np.stack([np.sin(CYCLE), np.sin(CYCLE)], axis=1)
    measured = np.stack([np.sin(CYCLE - 0.2), np.sin(CYCLE + 0.2)], axis=1)
    found = tracking_indicator(command, measured)
    assert found.shape == command.shape
    assert found[-1] == pytest.approx(np.pi * np.sin([0.2, -0.2]), rel=1e-5)


@pytest.mark.parametrize(
    ("command", "measured"),
    [
        (np.zeros(9), np.ones(9)),
        (np.ones(1), np.ones(1)),
        (np.empty(0), np.empty(0)),
        (np.arange(9.0), np.full(9, np.nan)),
    ],
)
def test_what_makes_no_sense_is_nan(command, measured):
    assert np.isnan(relative_tracking_indicator(command, measured))


def test_shapes_that_differ_are_refused():
    with pytest.raises(ValueError, match="same shape"):
        tracking_indicator(np.ones(5), np.ones(4))
