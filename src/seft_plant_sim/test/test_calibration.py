"""What is known of the channels, taken out of the samples."""

import numpy as np
import pytest
from bare_rig import driven, make_rig, rig_section, transfer
from scipy.signal import lfilter
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.errors import InputError
from seft_plant_sim.calibration import (
    all_pass,
    as_published,
    calibrate,
    calibration_of,
    zeroed_at_rest,
)
from seft_plant_sim.rig_parameters import common_lag
from seft_plant_sim.simulated.continuous_model import Sensed
from seft_plant_sim.simulated.rig import continuous_model

DT = 0.002
X, V, A, F = range(4)


def known(*, ranges=None, resolution=None, velocity="measured", axes=("x",), places=None, **values):
    named = {f"calibration.{name}": value for name, value in values.items()}
    section, own = rig_section(sensors__velocity=velocity, **named), places or range(len(axes))
    return calibration_of(section, axes, own, DT, ranges, resolution)


def corrected(samples, **values):
    """Pass samples (N, 4, n) through a calibration."""
    calibration, state = known(axes=("x", "y")[: samples.shape[2]], **values)
    found = np.empty_like(samples)
    for step, sample in enumerate(samples):
        calibrate(calibration, state, step, np.ascontiguousarray(sample), found[step])
    return found


TILT = np.array([[1.0, 0.03], [-0.05, 0.99]])


def tilted(seed=4, steps=60):
    """True samples (N, 4, 2), and what tilted accelerometers, one of scale 1.1, show of them."""
    true = np.random.default_rng(seed).normal(size=(steps, 4, 2))
    shown = true.copy()
    shown[:, A] = true[:, A] @ TILT.T * [1.0, 1.1]
    known = {"tilt": TILT.ravel().tolist(), "acceleration_scale": [1.0, 1.1]}
    return true, shown, known


def test_it_undoes_a_tilt_exactly():
    true, shown, values = tilted()
    np.testing.assert_allclose(corrected(shown, **values), true, rtol=0.0, atol=1e-13)


def test_what_a_tilted_accelerometer_can_not_show_leaves_the_other_axis_its_last_one():
    true, shown, values = tilted()
    for value in (np.nan, np.inf, 30.0):
        wrong = shown.copy()
        wrong[30, A, 0] = value
        found = corrected(wrong, ranges=np.full((4, 2), 30.0), **values)
        np.testing.assert_equal(found[30, A, 0], value)
        held = np.linalg.solve(TILT, [shown[29, A, 0], shown[30, A, 1] / 1.1])[1]
        assert found[30, A, 1] == pytest.approx(held, abs=1e-13)
        np.testing.assert_allclose(np.delete(found, 30, 0), np.delete(true, 30, 0), atol=1e-13)


def test_it_undoes_scale_and_bias_exactly():
    rng = np.random.default_rng(1)
    true = rng.normal(size=(50, 4, 2))
    scale = np.array([[1.02, 1.0], [0.5, 0.5], [2.0, 2.0], [0.97, 1.01]])
    bias = np.array([[1e-4, -2e-4], [0.25, 0.25], [0.0, 0.5], [20.0, -5.0]])
    values = {f"{name}_scale": row.tolist() for name, row in zip(CHANNELS, scale, strict=True)}
    values |= {f"{name}_bias": row.tolist() for name, row in zip(CHANNELS, bias, strict=True)}
    found = corrected(scale * true + bias, **values)
    np.testing.assert_allclose(found, true, rtol=1e-13, atol=1e-13)


def waits(calibration):
    """Wait of each channel at low frequency, in samples, shape (4, n)."""
    numerator, denominator = np.einsum("j,pjrn->prn", np.arange(4.0), calibration.taps)
    return calibration.whole + (numerator - denominator) / calibration.taps[0].sum(axis=0)


def test_the_rest_of_a_wait_is_where_its_delay_is_flattest():
    for wait in np.linspace(0.2, 6.0, 59):
        calibration, _ = known(force_lag=wait * DT)
        assert waits(calibration)[X, 0] == pytest.approx(wait)
        rest = wait - calibration.whole[X, 0]
        assert rest == pytest.approx(0.0, abs=1e-9) or 0.2 - 1e-9 <= rest < 1.2 + 1e-9
        if rest > 0.1:
            assert calibration.taps[0, :2, X, 0] == pytest.approx(all_pass(rest)[0])
        assert (calibration.whole[F, 0], calibration.taps[0, 0, F, 0]) == (0, 1.0)


FILTERS = {"acceleration": (100.0, 0.7071), "force": (60.0, 0.87), "displacement": (150.0, 1.0)}


def low_pass(hz, natural, damping):
    """Response of a low-pass of second order."""
    s = 1j * np.asarray(hz) / natural
    return 1.0 / (1.0 + 2.0 * damping * s + s * s)


def test_channels_with_filters_and_lags_all_get_one_response():
    """That of the slowest filter and of the largest lag, up to 0.2 times the rate."""
    values = {f"{name}_filter": hz for name, (hz, _) in FILTERS.items()}
    values |= {f"{name}_filter_damping": damping for name, (_, damping) in FILTERS.items()}
    lags = {"velocity_lag": 0.0033, "displacement_lag": 0.0004}
    calibration, _ = known(**values, **lags)
    for hz, most in ((3.0, 1e-3), (20.0, 5e-3), (50.0, 0.03), (100.0, 0.15)):
        s = 2j * np.pi * hz
        sensors = [low_pass(hz, *FILTERS[name]) if name in FILTERS else 1.0 for name in CHANNELS]
        sensors *= np.exp(-s * np.array([lags.get(f"{name}_lag", 0.0) for name in CHANNELS]))
        powers = np.exp(-s * DT * np.arange(4.0))
        numerator, denominator = np.einsum("j,pjrn->prn", powers, calibration.taps)[:, :, 0]
        wait = np.exp(-s * DT * calibration.whole[:, 0])
        expected = low_pass(hz, *FILTERS["force"]) * np.exp(-s * 0.0033)
        found = sensors * wait * numerator / denominator
        np.testing.assert_allclose(found, expected, rtol=most)
    section = rig_section(**{f"calibration.{name}": v for name, v in (values | lags).items()})
    assert common_lag(section) == pytest.approx(0.0033 + 2 * 0.87 / (2 * np.pi * 60.0))


def test_a_filtered_channel_is_calibrated_as_it_is_designed():
    """An impulse after a constant: its response is that of the taps."""
    samples = np.ones((60, 4, 1))
    samples[20, X] = 2.0
    calibration, _ = known(acceleration_filter=80.0, displacement_lag=0.0005)
    found = corrected(samples, acceleration_filter=80.0, displacement_lag=0.0005)[:, X, 0]
    numerator, denominator = calibration.taps[:, :, X, 0]
    expected = 1.0 + lfilter(numerator, denominator, np.arange(40) == 0)
    np.testing.assert_allclose(found[20:], expected, atol=1e-12)
    np.testing.assert_allclose(found[:20], 1.0, atol=1e-12)


def test_what_waits_keeps_the_steps_of_its_converter_and_repeats_what_repeats():
    """So that a frozen sensor, and the resolution, are still seen."""
    step, rng = 0.01, np.random.default_rng(3)
    coarse = np.rint(rng.normal(scale=0.02, size=(400, 4, 1)) / step) * step
    coarse[300:] = coarse[300]
    for wait in (0.0011, 0.0017, 0.0026):
        values = {"force_lag": wait, "acceleration_scale": 1.25}
        found = corrected(coarse, resolution=np.full((4, 1), step), **values)[:, A, 0] * 1.25
        assert np.abs(np.diff(found))[np.diff(found) != 0.0].min() > 0.99 * step
        np.testing.assert_allclose(found / step, np.rint(found / step), atol=1e-9)
        np.testing.assert_array_equal(found[308:], found[308])
        assert found[308] == pytest.approx(coarse[300, A, 0], abs=1e-12)


def test_the_latest_channel_of_all_axes_counts_and_is_reported():
    values = {"calibration.force_lag": [0.001, 0.003], "calibration.displacement_lag": 0.002}
    section = rig_section(**values)
    assert common_lag(section) == 0.003
    one, _ = calibration_of(section, ("east/x", "west/x"), [0], DT)
    np.testing.assert_allclose(waits(one)[:, 0] * DT, [0.001, 0.003, 0.003, 0.002], atol=1e-12)


def test_a_constant_comes_out_as_it_is_from_the_first_sample_on():
    found = corrected(np.full((20, 4, 1), 3.0), force_lag=0.0027, displacement_scale=1.5)
    np.testing.assert_allclose(found[:, X, 0], 2.0, rtol=1e-12)
    np.testing.assert_allclose(found[:, V:, 0], 3.0, rtol=1e-12)


def test_what_is_no_number_or_at_the_end_of_the_range_is_corrected_and_leaves_no_trace():
    sine = np.sin(2 * np.pi * 5.0 * DT * np.arange(1000))
    samples = np.repeat(sine, 4).reshape(-1, 4, 1)
    fault_free = corrected(samples, force_lag=0.0047, acceleration_scale=1.01)
    for value in (np.nan, np.inf, 9.0, -9.0):
        wrong = samples.copy()
        wrong[300, A] = value
        ranges = np.full((4, 1), 9.0)
        found = corrected(wrong, force_lag=0.0047, acceleration_scale=1.01, ranges=ranges)
        # after the whole samples of its wait
        np.testing.assert_equal(found[302, A, 0], value / 1.01)
        assert np.isfinite(np.delete(found, 302, axis=0)).all()
        np.testing.assert_allclose(found[340:], fault_free[340:], atol=1e-9)


def test_errors_name_the_parameter():
    with pytest.raises(InputError, match=r"^/\*\*: calibration.force_scale is 0"):
        known(force_scale=0.0)
    with pytest.raises(InputError, match=r"velocity_lag is given, but sensors.velocity is derived"):
        known(velocity_lag=0.001, velocity="derived")
    with pytest.raises(InputError, match=r"^/\*\*: calibration.displacement_bias: 3 values for 2"):
        known(axes=("x", "y"), displacement_bias=[0.0, 1.0, 2.0])
    with pytest.raises(InputError, match=r"calibration.tilt \[\[1.0, 1.0\].*show the same"):
        known(axes=("x", "y"), tilt=[1.0, 1.0, 1.0, 1.0])
    with pytest.raises(InputError, match=r"calibration.tilt .* mixes axes of different rigs"):
        known(axes=("east/x", "west/x"), places=[1], tilt=[1.0, 0.0, 0.03, 1.0])


def test_a_rig_publishes_corrected_samples():
    """Its errors are known, so that it publishes those of a fault-free one, all of them late."""
    errors = {"force_scale": 1.03, "acceleration_scale": 0.98, "displacement_lag": 0.004}
    known = {f"calibration__{name}": v for name, v in (errors | {"force_bias": 12.0}).items()}
    one, other = (driven(make_rig(**values), np.ones(100))[:, :4] for values in ({}, known))
    np.testing.assert_allclose(other[2:], one[:-2], rtol=1e-9, atol=1e-9)


def test_a_derived_velocity_is_that_of_the_calibrated_displacement():
    scaled = {"calibration__displacement_scale": 1.5}
    rigs = (make_rig(sensors__velocity="derived", **values) for values in (scaled, {}))
    one, other = (driven(rig, np.ones(60)) for rig in rigs)
    np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


def test_as_a_linear_model_what_waits_is_late():
    model = continuous_model(rig_section(), ("x",))
    values = {"calibration.force_lag": 0.0031, "calibration.velocity_scale": 2.0}
    found = as_published(model, rig_section(**values), ("x",)).sensed
    assert isinstance(found, Sensed)
    np.testing.assert_allclose(found.late, [0.0031, 0.0031, 0.0031, 0.0])
    np.testing.assert_allclose(found.c[V], model.c[V] / 2.0)
    np.testing.assert_array_equal(found.c[F], model.c[F])


def test_as_a_linear_model_all_have_the_slowest_filter():
    values = {"force_filter": 60.0, "acceleration_filter": 100.0}
    values["acceleration_filter_damping"] = 1.0
    both = {f"{where}.{n}": v for where in ("sensors", "calibration") for n, v in values.items()}
    section, plain = rig_section(**both), continuous_model(rig_section(), ("x",))
    found = as_published(continuous_model(section, ("x",)), section, ("x",))
    for hz in (5.0, 60.0, 200.0):
        expected = low_pass(hz, 60.0, 0.7071) * transfer(plain, hz)
        np.testing.assert_allclose(transfer(found, hz), expected, rtol=1e-9)


def test_as_a_linear_model_a_known_tilt_is_taken_out():
    axes, tilt = ("x", "y"), TILT.ravel().tolist()
    values = {"axes": list(axes), "sensors.tilt": tilt, "calibration.tilt": tilt}
    section, plain = rig_section(**values), continuous_model(rig_section(axes=list(axes)), axes)
    found = as_published(continuous_model(section, axes), section, axes).sensed
    np.testing.assert_allclose(found.c, plain.c, atol=1e-9 * np.abs(plain.c).max())


def test_biases_are_the_means_at_rest_that_are_more_than_noise():
    noise = np.random.default_rng(1).standard_normal((500, 4, 2))
    noise -= noise.mean(axis=0)
    bias = np.zeros((4, 2))
    bias[F], bias[X, 1] = (5.0, 0.17), 0.19  # 0.18 is four standard errors
    section, facts = zeroed_at_rest(rig_section(), ("x", "y", "z"), (0, 2), noise + bias)
    assert facts["samples"] == 500
    assert facts["subtracted"]["force"] == pytest.approx([5.0, 0.0])
    assert facts["subtracted"]["displacement"] == pytest.approx([0.0, 0.19])
    assert section["calibration.force_bias"] == pytest.approx([5.0, 0.0, 0.0])
    assert section["calibration.displacement_bias"] == pytest.approx([0.0, 0.0, 0.19])
    assert not any(map(any, facts["left"].values()))


def test_a_bias_that_is_known_stays_and_what_is_left_is_reported():
    given = rig_section(calibration__force_bias=[12.0])
    samples = np.full((100, 4, 1), 33.0)
    section, facts = zeroed_at_rest(given, ("x",), (0,), samples)
    assert section["calibration.force_bias"] == [12.0]
    assert (facts["subtracted"]["force"], facts["left"]["force"]) == ([0.0], [21.0])


@pytest.mark.parametrize("options", [{}, {"sensors__velocity": "derived"}])
def test_a_rig_zeroes_its_sensors_at_rest_but_not_what_goes_wrong_later(options):
    bias = {"sensors__displacement_bias": 3e-4, "sensors__acceleration_bias": 0.1}
    errors = {**bias, "sensors__displacement_range": 0.1, "sensors__force_bias": 5.0}
    fault = {"faults": ["force add 7.0 at 0.0"]}

    def samples(**values):
        rig = make_rig(**{"sensors__force_noise": 3.0, **options, **fault, **values})
        return rig.zeroed, driven(rig, np.ones(50))

    none, fault_free = samples()
    zeroed, found = samples(**errors, calibration__zeroing=1.0)
    assert none is None
    mean = zeroed["subtracted"]["force"][0]
    assert abs(mean - 5.0) < 4 * 3.0 / np.sqrt(500.0)
    np.testing.assert_allclose(found[:, :F], fault_free[:, :F], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found[:, F] - fault_free[:, F], 5.0 - mean, rtol=0.0, atol=1e-9)
