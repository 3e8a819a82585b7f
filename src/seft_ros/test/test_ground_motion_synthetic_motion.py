"""Synthetic ground motions against their spectrum, and excitations for identification."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import Timebase
from seft_ros.ground_motion.ground_motion_block import GROUND_MOTION_TABLE, GroundMotion
from seft_ros.ground_motion.synthetic_motion import (
    envelope,
    excitation,
    motion_filter,
    stationary_motion,
    synthetic_motion,
)
from seft_ros.identification.rig_tests import Motions

FILTERS = {
    "ground_frequency": 2.5,
    "ground_damping": 0.6,
    "filter_frequency": 0.25,
    "filter_damping": 0.6,
}
SHAPE = {"rise": 2.0, "plateau_end": 8.0, "decay": 0.35}
MOTION = {"seed": 3, "duration": 20.0, "dt": 0.005, "peak": 3.0, **FILTERS, **SHAPE}


def motion_spectrum(frequencies):
    return np.abs(motion_filter(np.array(frequencies), **FILTERS)) ** 2


def test_the_spectrum_has_the_values_of_kanai_tajimi_and_clough_penzien():
    # at f = f_g:  |H_kt|^2 = (1 + 4 z^2) / (4 z^2);  the high-pass with r = f / f_f = 10:
    # |H_cp|^2 = r^4 / ((1 - r^2)^2 + 4 z^2 r^2)
    kanai_tajimi = (1 + 4 * 0.36) / (4 * 0.36)
    clough_penzien = 1e4 / (99**2 + 1.44 * 100)
    np.testing.assert_allclose(motion_spectrum(2.5), kanai_tajimi * clough_penzien)


def test_the_average_periodogram_of_many_seeds_is_the_target_spectrum():
    steps, dt, seeds = 2000, 0.01, 400
    periodograms = [
        np.abs(np.fft.rfft(stationary_motion(seed, steps, dt, **FILTERS))) ** 2 / steps
        for seed in range(seeds)
    ]
    average = np.mean(periodograms, axis=0)
    target = motion_spectrum(np.fft.rfftfreq(steps, dt))
    # each ordinate scatters by 1 / sqrt(400) = 5 %, a band of 20 by 1.1 %
    bands = average[1:981].reshape(-1, 20).mean(axis=1) / target[1:981].reshape(-1, 20).mean(axis=1)
    np.testing.assert_allclose(bands, 1, atol=0.05)
    assert average[0] < 1e-20


def test_the_envelope_rises_stays_and_decays():
    times = [0, 1, 2, 5, 8, 8 + 1 / 0.35]
    np.testing.assert_allclose(envelope(times, **SHAPE), [0, 0.25, 1, 1, 1, np.exp(-1)])
    np.testing.assert_array_equal(envelope([0, 1, 99], 0, 0, 0), [1, 1, 1])


def test_a_seed_is_a_motion():
    first = synthetic_motion(**MOTION)
    np.testing.assert_array_equal(first, synthetic_motion(**MOTION))
    assert np.abs(first - synthetic_motion(**{**MOTION, "seed": 4})).max() > 1


@given(st.integers(0, 2**63), st.floats(0.1, 50), st.sampled_from([1.0, 3.3, 20.0]))
def test_the_largest_acceleration_is_the_peak_and_the_length_the_duration(seed, peak, duration):
    motion = synthetic_motion(**{**MOTION, "seed": seed, "peak": peak, "duration": duration})
    assert np.abs(motion).max() == pytest.approx(peak, rel=1e-12)
    assert len(motion) == round(duration / 0.005) + 1


@pytest.mark.parametrize(
    ("given", "what"),
    [
        ({"plateau_end": 1.0}, "synthetic.plateau_end is 1 s"),
        ({"duration": 0.01}, "synthetic.duration is 0.01 s"),
        ({"dt": 0.25, "ground_frequency": 2.0}, "below half the sampling rate"),
        ({"rise": 1e200, "plateau_end": 1e200}, "a motion that is zero"),
    ],
)
def test_contradictions_are_refused_by_name(given, what):
    with pytest.raises(InputError) as caught:
        synthetic_motion(**{**MOTION, **given})
    assert what in str(caught.value)


DT = 0.002
BAND = (1.0, 100.0)
STEPS = 20_000


@pytest.mark.parametrize("axes", [1, 2])
def test_it_goes_from_rest_to_rest_with_zero_mean_and_unit_rms(axes):
    samples = excitation(STEPS, axes, DT, BAND, 1)
    assert samples.shape == (STEPS, axes)
    np.testing.assert_array_equal(samples[[0, -1]], 0.0)
    assert np.abs(np.diff(samples[:5], axis=0)).max() < 1e-3
    np.testing.assert_allclose(samples.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.mean(samples**2, axis=0), 1.0, rtol=1e-12)


def test_a_seed_gives_the_same_bits_and_axes_are_independent():
    first = excitation(STEPS, 3, DT, BAND, 5)
    np.testing.assert_array_equal(first, excitation(STEPS, 3, DT, BAND, 5))
    assert np.abs(first - excitation(STEPS, 3, DT, BAND, 6)).max() > 1
    alone = excitation(STEPS, 1, DT, BAND, 5)
    np.testing.assert_allclose(first[:, :1], alone, atol=1e-12)
    correlation = np.corrcoef(first.T)
    assert np.abs(correlation - np.eye(3)).max() < 0.05


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"band": (0.0, 10.0)}, "--band"),
        ({"band": (10.0, 5.0)}, "--band is 10 to 5 Hz"),
        ({"band": (1.0, 250.0)}, "half the rate, 250 Hz"),
        ({"steps": 1000}, "needs 4 s"),
    ],
)
def test_what_makes_no_excitation_is_refused(words, message):
    given = {"steps": STEPS, "axes": 1, "dt": DT, "band": BAND, "seed": 0}
    with pytest.raises(InputError, match=message):
        excitation(**{**given, **words})


@pytest.mark.parametrize("rate", [200.0, 500.0, 2000.0])
def test_ground_motion_reads_the_record_bit_for_bit(tmp_path, rate):
    section = {"rate": rate, "axes": ["x", "y"], "specimen.mass": 1.0}
    experiment, band, seed = Experiment({"reference_force": section}), (2.0, 60.0), 1
    Motions(experiment, band, seed).write(tmp_path / "record.csv", 5000 / rate)
    samples = -3.7 * excitation(5000, 2, 1 / rate, band, seed)
    section = {row.name: row.default for row in GROUND_MOTION_TABLE.rows.values()}
    section |= {"file": str(tmp_path / "record.csv"), "column": [0, 1], "unit": "m/s2"}
    section |= {"dt": 1 / rate, "tail": 0.0, "influence": 3.7}
    motion = GroundMotion(section, ("x", "y"), Timebase.from_rate(rate))
    np.testing.assert_array_equal(motion.samples, samples)
