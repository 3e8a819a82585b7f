"""Excitations: their spectrum, their rest at both ends, and the record that keeps every bit."""

import numpy as np
import pytest
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.timebase import Timebase
from seft_ros.design.rig_tests import write_excitation
from seft_ros.ground_motion.ground_motion_block import TABLE, GroundMotion
from seft_ros.ground_motion.synthetic_motion import SIGNALS, excitation

DT = 0.002
BAND = (1.0, 100.0)
STEPS = 20_000


@pytest.mark.parametrize("signal", SIGNALS)
@pytest.mark.parametrize("axes", [1, 2])
def test_it_goes_from_rest_to_rest_with_zero_mean_and_unit_rms(signal, axes):
    samples = excitation(signal, STEPS, axes, DT, BAND, 1)
    assert samples.shape == (STEPS, axes)
    np.testing.assert_array_equal(samples[[0, -1]], 0.0)
    assert np.abs(np.diff(samples[:5], axis=0)).max() < 1e-3
    np.testing.assert_allclose(samples.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.mean(samples**2, axis=0), 1.0, rtol=1e-12)


@pytest.mark.parametrize("signal", SIGNALS)
def test_its_power_lies_in_the_band_so_that_an_integrating_valve_does_not_drift(signal):
    samples = excitation(signal, STEPS, 1, DT, BAND, 1)[:, 0]
    power = np.abs(np.fft.rfft(samples)) ** 2
    f = np.fft.rfftfreq(STEPS, DT)
    assert power[f < BAND[0] / 1.6].sum() < 2e-3 * power.sum()
    assert power[f > BAND[1] * 1.3].sum() < 2e-3 * power.sum()
    drift = np.cumsum(samples) * DT
    assert np.abs(drift).max() < 6 / (2 * np.pi * BAND[0])


def test_the_random_signal_is_flat_over_the_band():
    samples = excitation("random", 200_000, 1, DT, BAND, 3)[:, 0]
    power = np.abs(np.fft.rfft(samples)) ** 2
    f = np.fft.rfftfreq(len(samples), DT)
    bands = [power[(f >= low) & (f < low + 9)].mean() for low in range(1, 91, 9)]
    assert max(bands) < 1.15 * min(bands)


def test_a_seed_gives_the_same_bits_and_axes_are_independent():
    first = excitation("random", STEPS, 3, DT, BAND, 5)
    np.testing.assert_array_equal(first, excitation("random", STEPS, 3, DT, BAND, 5))
    assert np.abs(first - excitation("random", STEPS, 3, DT, BAND, 6)).max() > 1
    alone = excitation("random", STEPS, 1, DT, BAND, 5)
    np.testing.assert_allclose(first[:, :1], alone, atol=1e-12)
    correlation = np.corrcoef(first.T)
    assert np.abs(correlation - np.eye(3)).max() < 0.05


def test_sweeps_take_the_axes_one_after_the_other():
    samples = excitation("chirp", STEPS, 2, DT, BAND, 1)
    moving = np.abs(samples) > 0.1
    assert not (moving[:, 0] & moving[:, 1]).any()
    assert np.flatnonzero(moving[:, 0])[-1] < np.flatnonzero(moving[:, 1])[0]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ({"signal": "sine"}, "one of random, chirp"),
        ({"band": (0.0, 10.0)}, "--band"),
        ({"band": (10.0, 5.0)}, "--band is 10 to 5 Hz"),
        ({"band": (1.0, 250.0)}, "half the rate, 250 Hz"),
        ({"steps": 1000}, "needs 4 s"),
        ({"steps": 3000, "signal": "chirp", "axes": 2}, "needs 8 s"),
    ],
)
def test_what_makes_no_excitation_is_refused(words, told):
    given = {"signal": "random", "steps": STEPS, "axes": 1, "dt": DT, "band": BAND, "seed": 0}
    with pytest.raises(InputError, match=told):
        excitation(**{**given, **words})


@pytest.mark.parametrize("rate", [200.0, 500.0, 2000.0])
def test_ground_motion_reads_the_record_bit_for_bit(tmp_path, rate):
    samples = 3.7 * excitation("random", 5000, 2, 1 / rate, (2.0, 60.0), 1)
    write_excitation(tmp_path / "record.csv", samples, ("x", "y"))
    section = {row.name: row.default for row in TABLE.rows.values()}
    section |= {"file": str(tmp_path / "record.csv"), "column": [0, 1], "unit": "m/s2"}
    section |= {"dt": 1 / rate, "tail": 0.0}
    motion = GroundMotion.from_parameters(section, ("x", "y"), Timebase.from_rate(rate))
    np.testing.assert_array_equal(motion.samples, samples)
