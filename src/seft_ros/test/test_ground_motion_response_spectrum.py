"""Response spectrum, summary and figure of a ground motion, against closed forms."""

from io import BytesIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_ros.ground_motion.response_spectrum import (
    motion_figure,
    motion_summary,
    response_spectrum,
)

G = 9.80665


@pytest.mark.parametrize("damping", [0.0, 0.02, 0.05, 0.7])
def test_a_step_overshoots_as_the_closed_form_says(damping):
    # x = a / w^2 (1 - ...), with its first peak half a damped period after the step
    period = np.array([0.1, 0.5, 2.0])
    root = np.sqrt(1 - damping**2)
    expected = 3.0 * (1 + np.exp(-damping * np.pi / root))
    for one in period:
        dt = one / root / 2 / 50  # the peak falls on sample 50
        spectrum = response_spectrum(np.full(400, 3.0), dt, [one], damping)
        np.testing.assert_allclose(spectrum, expected, rtol=1e-12)


def test_a_ramp_without_damping_follows_the_closed_form():
    # x = -r / w^2 (t - sin(w t) / w), largest at the end
    dt, period, rate = 0.01, 1.7, 4.0
    t, w = 3.0, 2 * np.pi / period
    spectrum = response_spectrum(rate * dt * np.arange(301), dt, [period], 0.0)
    np.testing.assert_allclose(spectrum, rate * (t - np.sin(w * t) / w), rtol=1e-12)


def test_period_zero_gives_the_peak_ground_acceleration():
    assert response_spectrum([0.0, -3.0, 1.0], 0.01, [0.0, 0.5])[0] == 3.0


def test_every_sample_counts_across_the_blocks_of_the_computation():
    # an impulse-like triangle late in a long record: free vibration of amplitude a dt / w
    dt, period = 0.001, 1.0
    a = np.zeros(4000)
    a[2500] = 5.0
    w = 2 * np.pi / period
    expected = w**2 * 5.0 * dt / w
    np.testing.assert_allclose(response_spectrum(a, dt, [period], 0.0), expected, rtol=1e-5)


@given(st.lists(st.floats(-10, 10), min_size=2, max_size=40), st.floats(0.1, 10))
def test_the_spectrum_scales_with_the_motion_and_with_time(motion, factor):
    periods = np.array([0.05, 0.3, 2.0])
    spectrum = response_spectrum(motion, 0.01, periods)
    scaled = response_spectrum(factor * np.array(motion), 0.01, periods)
    slowed = response_spectrum(motion, 0.01 * factor, periods * factor)
    np.testing.assert_allclose(scaled, factor * spectrum, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(slowed, spectrum, rtol=1e-9, atol=1e-12)


def test_the_summary_integrates_a_linear_motion_exactly_and_per_axis():
    samples = np.array([[0.0, 1.0], [3.0, -1.0], [0.0, 0.0]])
    summary = motion_summary(samples, 0.5)
    # of t^2 from 0 to 3 in half a second, twice; then 1/6 + 1/6 for the line through zero
    assert summary["arias_intensity"] == pytest.approx(
        [np.pi / (2 * G) * 3.0, np.pi / (2 * G) * (1 / 6 + 1 / 6)]
    )
    assert summary["peak_acceleration"] == [3.0, 1.0]


def test_a_motion_of_zeros_has_a_summary_too():
    summary = motion_summary(np.zeros((5, 1)), 0.01)
    assert summary["arias_intensity"] == [0.0]
    assert summary["significant_duration"] == [0.0]


@pytest.mark.parametrize("axes", [["x"], ["x", "y"]])
def test_the_figure_labels_every_axis_with_its_units(axes):
    rng = np.random.default_rng(1)
    figure = motion_figure(rng.normal(size=(500, len(axes))), 0.01, axes, "a title")
    figure.savefig(BytesIO(), format="png")
    *panels, spectra = figure.axes
    assert len(panels) == len(axes)
    assert all("m/s²" in panel.get_ylabel() for panel in figure.axes)
    assert panels[-1].get_xlabel() == "time / s"
    assert spectra.get_xlabel() == "natural period / s"
    assert len(spectra.lines) == len(axes)


def test_a_figure_of_zeros_can_be_drawn():
    motion_figure(np.zeros((3, 1)), 0.01, ["x"], "nothing").savefig(BytesIO(), format="png")
