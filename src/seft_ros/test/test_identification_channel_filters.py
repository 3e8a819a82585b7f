"""Filters of single channels, from lines of spectra: synthetic ones, of two coupled axes."""

import numpy as np
import pytest
from seft_msgs_py.config.facts import CHANNELS
from seft_plant_sim.channels import ACCELERATION, DISPLACEMENT, FORCE, VELOCITY
from seft_ros.identification.channel_filters import ChannelFilters, channel_filters

DT = 0.002
MASS = np.array([[60.0, 4.0], [4.0, 45.0]])
STIFFNESS = np.array([[3e5, -1e5], [-1e5, 2e5]])
STICKS = 4e5
"""Stiffness of a friction under small and fast motion, N/m."""
NOISE = np.array([5e-8, 1e-5, 3e-3, 0.15])[:, np.newaxis]


def with_noise(values, noise, seed=1):
    rng = np.random.default_rng(seed)
    return values + noise * (rng.normal(size=values.shape) + 1j * rng.normal(size=values.shape))


def lines(filters=(), common=(), sticks=0.0, noise=NOISE):
    """Lines of two drives, with these filters (row, axis, Hz, damping), and one that all have."""
    hz = np.tile(np.arange(0.75, 195.0, 0.5), 2)
    s = (2j * np.pi * hz)[:, np.newaxis]
    rng = np.random.default_rng(2)
    drive = np.repeat(np.eye(2) + 0.2 * rng.normal(size=(2, 2)), len(hz) // 2, axis=0)
    x = 1e-3 * drive / (1.0 + s / 30.0) ** 2
    force = s * s * x @ MASS + x @ STIFFNESS + 700.0 * s * x
    force += sticks * s / (s + 2 * np.pi * 12.0) * x
    whole = np.stack([x, s * x, s * s * x, force], axis=1)
    known = ChannelFilters.none(2)
    for row, axis, natural, damping in filters:
        known.filter[row, axis], known.filter_damping[row, axis] = natural, damping
    passed = known.response(2 * np.pi * hz)
    for natural, damping in common:
        u = s / (2 * np.pi * natural)
        passed = passed / (1.0 + 2 * damping * u + u**2)[:, :, np.newaxis]
    noise = np.broadcast_to(noise, whole.shape)
    return 2 * np.pi * hz, with_noise(whole * passed, noise), noise, known


def found_in(w, amplitude, noise, derived=False, dt=DT):
    return channel_filters(w, amplitude, noise, dt, (MASS, 0.005 * np.ones((2, 2))), derived)


def test_a_filter_beyond_what_was_excited_is_but_a_lag_at_any_rate():
    *of, _ = lines([(FORCE, 1, 300.0, 0.7071)])
    found = found_in(*of, dt=DT / 2)
    assert not found.filter.any()
    assert found.force_lag[1] == pytest.approx(2 * 0.7071 / (2 * np.pi * 300.0), rel=0.2)


@pytest.mark.parametrize(
    ("sticks", "filters"),
    [(0.0, [(60.0, 0.7071), (80.0, 1.1)]), (STICKS, [(100.0, 0.87), (80.0, 1.1)])],
)
@pytest.mark.parametrize("row", range(4), ids=CHANNELS)
def test_a_filter_of_a_single_channel_is_found_and_no_other(row, sticks, filters):
    for natural, damping in filters:
        *of, known = lines([(row, 1, natural, damping)], sticks=sticks)
        found = found_in(*of)
        assert np.argwhere(found.filter).tolist() == [[row, 1]]
        hz = np.array([50.0, 90.0] if row > VELOCITY else [25.0, 45.0])
        w = 2 * np.pi * hz
        off = (found.response(w) / known.response(w))[:, row, 1]
        np.testing.assert_allclose(np.abs(off), 1.0, atol=0.08)
        late = np.angle(off) / w  # of a lag beside, which the multisine test finds
        assert abs(late[1] - late[0]) < 0.1 / w[1]
        assert 0.0 < found.filter_error[row, 1] < 0.1 * natural


def test_what_a_filter_buries_in_noise_says_neither_where_it_is_nor_which():
    noisy = NOISE * np.array([20.0, 1.0, 1.0, 1.0])[:, np.newaxis]  # above 70 Hz
    *of, _ = lines([(DISPLACEMENT, 1, 60.0, 0.7071)], noise=noisy)
    found = found_in(*of, dt=DT / 4)
    assert np.argwhere(found.filter).tolist() == [[DISPLACEMENT, 1]]
    for value, error, true in (
        (found.filter, found.filter_error, 60.0),
        (found.filter_damping, found.filter_damping_error, 0.7071),
    ):
        assert value[DISPLACEMENT, 1] == pytest.approx(true, abs=4 * error[DISPLACEMENT, 1])
        assert error[DISPLACEMENT, 1] < 0.05 * true


@pytest.mark.parametrize("sticks", [0.0, STICKS])
def test_where_there_is_none_or_all_have_it_none_is_found(sticks):
    for common in ((), ((90.0, 0.7071),)):
        *of, _ = lines(common=common, sticks=sticks)
        assert not found_in(*of).filter.any()


@pytest.mark.parametrize("lag", [-0.004, 0.0, 0.003])
def test_the_lag_of_the_force_behind_the_acceleration_is_found_whatever_sticks(lag):
    w, amplitude, *of = lines(sticks=STICKS)[:3]
    amplitude[:, FORCE] *= np.exp(-1j * w * lag)[:, np.newaxis]
    found = found_in(w, amplitude, *of)
    assert not found.filter.any()
    assert found.force_lag == pytest.approx([lag, lag], abs=5e-5)


def test_what_several_channels_have_is_told_from_what_one_has_not():
    rows = (DISPLACEMENT, VELOCITY, ACCELERATION)
    *of, known = lines([(row, axis, 70.0, 0.7071) for row in rows for axis in (0, 1)])
    found = found_in(*of)
    assert not found.filter[FORCE].any()
    np.testing.assert_allclose(found.filter[:FORCE], known.filter[:FORCE], rtol=0.08)


def test_what_was_known_stays_unless_it_is_significantly_other():
    found, known = ChannelFilters.none(1), ChannelFilters.none(1)
    found.filter[:, 0], found.filter_error[:, 0] = (60.0, 0.0, 80.0, 0.0), (1.0, 0.0, 1.0, 0.0)
    known.filter[:, 0] = 62.0, 90.0, 60.0, 400.0
    kept = found.apart_from(known, 200.0)
    assert kept.filter[:, 0].tolist() == [62.0, 0.0, 80.0, 400.0]


def test_what_is_not_known_of_a_filter_counts_where_it_passes_the_motion():
    known = ChannelFilters.none(1)
    known.filter[FORCE], known.filter_error[FORCE] = 80.0, 0.8
    low, high = (known.unsure(2 * np.pi * np.array([hz])) for hz in (8.0, 40.0))
    assert (low[:FORCE] == 0.0).all()
    # of 1 / (1 + 2 z u + u^2) with u = i f / f_0 and 1 % of f_0
    u = 0.5j
    wanted = 0.01 * abs((2 * 0.7071 * u + 2 * u**2) / (1 + 2 * 0.7071 * u + u**2))
    assert high[FORCE, 0] == pytest.approx(wanted, rel=0.03)
    assert 0.0 < low[FORCE, 0] < 0.3 * high[FORCE, 0]
    known.filter_damping_error[FORCE] = 0.05
    assert known.unsure(2 * np.pi * np.array([40.0]))[FORCE, 0] > 2 * high[FORCE, 0]
