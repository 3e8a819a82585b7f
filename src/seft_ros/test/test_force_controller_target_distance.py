"""The distance to the target, sample by sample: its threshold, and when it is none."""

import math

import numpy as np
import pytest
from seft_plant_sim.judge.guard import DRIVE_ROW
from seft_ros.force_controller.target_distance import (
    begin_tracking,
    off_target,
    track_all,
    tracking_arrays,
)

DT, N = 0.002, 2
NOISE = np.array([[1e-5, 2e-5], [2e-3, 1e-3], [0.1, 0.2], [5.0, 3.0]])


def tracking(limit=10.0, acts=True, dt=DT):
    """The detector of two axes, which has begun."""
    p, state = tracking_arrays(NOISE, limit, acts, dt)
    begin_tracking(state)
    return p, state


def sample(displacement, drive=(0.0, 0.0)):
    """A sample of rig/state that is elsewhere in no other row."""
    found = np.zeros((DRIVE_ROW + 1, N))
    found[0], found[DRIVE_ROW] = displacement, drive
    return found


def doubt():
    """Distance by noise, six times its RMS in sums of both sides, and by the velocity's bias."""
    fade, (x, v, _, _) = math.exp(-DT / 0.05), NOISE
    fading = fade ** np.arange(4000)
    jump, mean = (
        math.sqrt(np.sum(np.convolve(fading, weights)[:4000] ** 2))
        for weights in ([1.0, -1.0], [0.5, 0.5])
    )
    return 6.0 * np.hypot(jump * x, mean * DT * v) + 2.0 * v * DT / (1.0 - fade)


def test_it_is_compared_with_the_largest_recent_motion_of_its_axis():
    p, state = tracking()
    at, found, largest = (0.004, 0.003), [], np.zeros(N)
    for step in range(10):
        target = np.array([0.004, -0.01 if step < 1 else -0.0099])
        state.shares[:] = 0.0
        found.append(off_target(p, state, step, target, sample(at)))
        of_both = np.maximum(np.abs(target), at)
        largest = np.maximum(of_both, math.exp(-DT / 0.3) * largest)
        share = np.abs(target - at) / (doubt() + 0.5 * largest)
        np.testing.assert_allclose(state.shares, share, rtol=1e-9)
    assert found == [-1] * 9 + [1]
    np.testing.assert_allclose(state.found[:, 1], [0.0129, 0.0129 / share[1]], rtol=1e-9)


def test_a_target_must_be_followed_but_not_while_the_valve_is_at_its_limit():
    p, state = tracking(limit=1e-6)
    target, found = np.array([0.25, 0.0]), []
    for k in range(200):
        state.shares[:] = 0.0
        drive = 0.0, -1e-6 if k == 101 else 0.9e-6
        found.append(off_target(p, state, k, target, sample((1e-9 * (k % 3), 0.0), drive)))
        limited = 101 <= k <= 101 + 50
        share = (0.25 - 1e-9 * (k % 3)) / (doubt()[0] + 0.5 * 0.25)
        assert state.shares[0] == pytest.approx(0.0 if limited else share, rel=1e-9)
        if k >= 99:
            state.counts[:] = 0
    assert found[:10] == [-1] * 9 + [0]


def test_it_only_warns_if_it_is_told_to_and_lasts_as_long_at_any_rate():
    for dt, lasts in ((DT, 10), (0.004, 5), (0.001, 20)):
        p, state = tracking(dt=dt)
        found = [off_target(p, state, k, np.full(N, 0.01), sample(0.0)) for k in range(30)]
        assert found == [-1] * (lasts - 1) + [0] * (31 - lasts)
    p, state = tracking(acts=False)
    assert {off_target(p, state, k, np.full(N, 0.01), sample(0.0)) for k in range(30)} == {-1}
    assert (state.shares > 1.8).all()
    begin_tracking(state)
    assert not state.shares.any()
    assert not state.counts.any()


def test_a_whole_test_gives_the_shares_of_its_samples():
    p, state = tracking(limit=0.5)
    rng, steps = np.random.default_rng(5), np.array([*range(30), *range(33, 53)])
    targets, seen = (
        0.1 * rng.normal(size=(50, N)),
        0.01 * rng.normal(size=(50, DRIVE_ROW + 1, N)),
    )
    seen[7, DRIVE_ROW, 1] = -0.5
    for step, target, measured in zip(steps, targets, seen, strict=True):
        off_target(p, state, step, target, measured)
    expected = [values.copy() for values in state]
    for values in state:
        values[:] = 7
    state.found[:] = expected[3]  # it is reported only at a trip
    begin_tracking(state)
    track_all(p, state, steps, targets, seen)
    for values, again in zip(expected, state, strict=True):
        np.testing.assert_array_equal(values, again)
    assert state.limited_at == 7
