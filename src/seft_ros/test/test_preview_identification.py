"""What preview_inverse learns of specimen and force loop while a test runs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from seft_ros.reference_force.compensation.preview.specimen_identification import (
    LARGEST_DAMPING,
    STIFFNESS_RANGE,
    SpecimenIdentification,
)
from seft_ros.reference_force.compensation.preview.tracking_identification import (
    TrackingIdentification,
)

DT, NOISE = 0.002, 25.0
MASS = np.array([[52.7, 1.0, 0.5], [1.0, 60.0, 2.0], [0.5, 2.0, 45.0]])
STIFFNESS = 1e5 * np.array([[2.1, -0.3, 0.1], [-0.3, 1.8, -0.2], [0.1, -0.2, 2.4]])
DAMPING = 1e2 * np.array([[8.0, -1.0, 0.5], [-1.0, 7.0, -0.5], [0.5, -0.5, 9.0]])


def specimen(n, stiffness=1.0, damping=1.0):
    """Identification of n axes that starts with these factors on what is true."""
    k, c = stiffness * STIFFNESS[:n, :n], damping * DAMPING[:n, :n]
    return SpecimenIdentification(MASS[:n, :n], c, k, NOISE * np.eye(n), DT)


def shaken(n, seconds=12.0, seed=1):
    """Motion (x, v) and restoring force of a specimen under random forces, no noise."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, seconds, DT)
    hz, phase = rng.uniform(1.0, 12.0, (40, n)), rng.uniform(0, 2 * np.pi, (40, n))

    def rate(t, y):
        force = 250.0 * np.sin(2 * np.pi * hz * t + phase).sum(axis=0)
        pull = STIFFNESS[:n, :n] @ y[:n] + DAMPING[:n, :n] @ y[n:]
        return np.concatenate([y[n:], np.linalg.solve(MASS[:n, :n], force - pull)])

    motion = solve_ivp(rate, (0, seconds), np.zeros(2 * n), t_eval=times, rtol=1e-6).y.T
    return motion, motion @ np.hstack([STIFFNESS[:n, :n], DAMPING[:n, :n]]).T


MOTIONS = {n: shaken(n) for n in (1, 2, 3)}


def learn(one, motion, force, noise=NOISE, seed=2):
    rng = np.random.default_rng(seed)
    for y, r in zip(motion, force + rng.normal(0, np.sqrt(noise), force.shape), strict=True):
        one.step(y, r)
        one.bounded()
    return one.restoring


@pytest.mark.parametrize("n", [2, 3])
def test_what_noise_makes_of_a_right_start_is_no_contradiction_but_a_wrong_one_is(n):
    for stiffness, expected in ((1.0, False), (0.9, True)):
        one = specimen(n, stiffness)
        learn(one, *MOTIONS[n])
        assert one.contradicts() is expected
        one.take()
        assert not one.contradicts()


def test_one_axis_is_always_followed():
    one = specimen(1)
    assert one.contradicts()
    learn(one, *MOTIONS[1])
    assert one.contradicts()


@pytest.mark.parametrize("stiffness", [0.8, 1.0, 1.2])
@pytest.mark.parametrize("damping", [0.5, 2.0])
@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_wrong_start_is_forgotten(n, stiffness, damping):
    found = learn(specimen(n, stiffness, damping), *MOTIONS[n])
    k, c = STIFFNESS[:n, :n], DAMPING[:n, :n]
    assert np.abs(found[:, :n] - k).max() < 0.01 * k.max()
    assert np.abs(found[:, n:] - c).max() < 0.03 * c.max()


def test_axes_that_move_alike_are_told_apart_no_further_than_the_motion_tells():
    """What is expected of the next sample is right, though the parameters are not all known."""
    n, one = 3, specimen(3, 0.8, 2.0)
    motion = np.kron(MOTIONS[1][0], np.array([1.0, 0.5, 0.3]))
    force = motion @ np.hstack([STIFFNESS, DAMPING]).T
    found = learn(one, motion, force)
    errors = motion @ found.T - force
    assert np.sqrt(np.mean(errors**2)) < 0.01 * np.sqrt(np.mean(force**2))
    for half in (found[:, :n], found[:, n:]):
        np.testing.assert_array_equal(half, half.T)


def test_it_is_least_squares_with_what_was_known_as_one_more_measurement():
    motion, force = MOTIONS[1]
    strong = motion[500:1500], force[500:1500] + np.random.default_rng(1).normal(0, 5, (1000, 1))
    one = specimen(1, 0.9, 1.4)
    one._excitation = 1e12  # all samples count
    for y, r in zip(*strong, strict=True):
        one.step(y, r)
    spread = np.array([0.3 * 0.9 * STIFFNESS[0, 0], 1.4 * DAMPING[0, 0]])
    start = np.array([0.9 * STIFFNESS[0, 0], 1.4 * DAMPING[0, 0]])
    rows = np.vstack([strong[0] / np.sqrt(NOISE), np.diag(1 / spread)])
    right = np.concatenate([strong[1][:, 0] / np.sqrt(NOISE), start / spread])
    wanted = np.linalg.lstsq(rows, right, rcond=None)[0]
    np.testing.assert_allclose(one.bounded()[0], wanted, rtol=1e-6)


def test_the_variance_that_it_returns_covers_its_errors():
    motion, force = MOTIONS[1]
    one = specimen(1, 1.2, 0.5)
    noisy = force + np.random.default_rng(3).normal(0, np.sqrt(NOISE), force.shape)
    sigmas = []
    for y, r, exact in zip(motion, noisy, force, strict=True):
        expected = one.bounded() @ y
        one.step(y, r)
        sigmas.append((expected - exact)[0] / np.sqrt(one.variance[0] + 1e-12))
    assert np.percentile(np.abs(sigmas), 95) < 3.0


@given(st.integers(0, 2**32), st.floats(0.0, 1.0), st.sampled_from([1, 3]))
@settings(max_examples=20, deadline=None)
def test_of_noise_alone_nothing_is_learnt(seed, part, n):
    one = specimen(n, 1.1, 0.8)
    start = one.restoring.copy()
    rng = np.random.default_rng(seed)
    scale = np.repeat([5e-6, 1e-3], n)
    motion = rng.normal(size=(400, 2 * n)) * scale
    learn(one, motion, np.zeros((400, n)), part * NOISE, seed)
    np.testing.assert_array_equal(one.restoring, start)


@given(st.integers(0, 2**32), st.floats(-8.0, 8.0))
@settings(max_examples=20, deadline=None)
def test_what_is_used_stays_symmetric_and_within_bounds(seed, scale):
    one, rng = specimen(3), np.random.default_rng(seed)
    k, c = np.diag(STIFFNESS), np.diag(DAMPING)
    motion = rng.normal(size=(100, 6)) * np.repeat([3e-3, 0.1], 3)
    for y in motion:
        one.step(y, scale * np.hstack([STIFFNESS, DAMPING]) @ y + rng.normal(0, 300, 3))
        found = one.bounded()
        for half in (found[:, :3], found[:, 3:]):
            np.testing.assert_array_equal(half, half.T)
        stiffness, damping = np.diag(found[:, :3]), np.diag(found[:, 3:])
        assert (STIFFNESS_RANGE[0] * k <= stiffness).all()
        assert (stiffness <= STIFFNESS_RANGE[1] * k).all()
        assert (damping >= 0.0).all() and (damping <= LARGEST_DAMPING * c + 1e-9).all()


def test_a_reset_forgets_what_was_learnt():
    one = specimen(2, 0.8, 2.0)
    start = one.restoring.copy()
    first = learn(one, *(part[:2000] for part in MOTIONS[2])).copy()
    one.reset()
    np.testing.assert_array_equal(one.restoring, start)
    np.testing.assert_array_equal(learn(one, *(part[:2000] for part in MOTIONS[2])), first)


def expected_forces(steps=15_000, axes=2, seed=4):
    """Forces that a model of the loop expects, smooth."""
    rng, times = np.random.default_rng(seed), DT * np.arange(steps)[:, None, None]
    hz, phase = rng.uniform(1.0, 8.0, (30, axes)), rng.uniform(0, 2 * np.pi, (30, axes))
    turns = 2 * np.pi * hz * times + phase
    return 60.0 * np.sin(turns).sum(axis=1), 60.0 * (2 * np.pi * hz * np.cos(turns)).sum(axis=1)


def follow(one, model, forces):
    for y, f in zip(model, forces, strict=True):
        one.deviation(y, f)
        one.update(np.zeros(len(one.gain)))
    return one.gain, one.advance


@pytest.mark.parametrize("gain", [(-0.05, 0.03), (0.02, -0.01)])
@pytest.mark.parametrize("delay", [(-2e-3, 1e-3), (5e-4, -1.5e-3)])
def test_gain_and_delay_of_a_loop_beside_its_model_are_found(gain, delay):
    model, rate = expected_forces()
    noise = np.random.default_rng(5).normal(0, 5.0, model.shape)
    forces = (1 + np.array(gain)) * model - np.array(delay) * rate + noise
    one = TrackingIdentification(2, np.full(2, 25.0), DT)
    found, advance = follow(one, model, forces)
    # the rate of the model is taken backwards, by which half a step of it looks like gain
    np.testing.assert_allclose(found, gain, atol=4e-3)
    np.testing.assert_allclose(advance, -np.array(delay), atol=1e-4)


def test_what_the_parameters_explain_is_no_deviation():
    model, _ = expected_forces(400)
    one = TrackingIdentification(2, np.ones(2), DT)
    one.gain[:], one.advance[:] = (0.03, -0.02), (1e-3, 5e-4)
    rate = np.diff(model, axis=0, prepend=0.0) / DT
    forces = model * 1.03 + rate * 1e-3, model * 0.98 + rate * 5e-4
    for k in range(400):
        seen = one.deviation(model[k], np.array([forces[0][k, 0], forces[1][k, 1]]) + 7.0)
        np.testing.assert_allclose(seen, 7.0, atol=1e-9)


@given(st.integers(0, 2**32), st.floats(0.0, 1e6), st.floats(0.0, 1e6))
@settings(max_examples=25, deadline=None)
def test_gain_and_delay_stay_bounded_and_finite_whatever_is_measured(seed, scale, answer):
    one, rng = TrackingIdentification(2, np.full(2, 25.0), DT), np.random.default_rng(seed)
    for _ in range(200):
        one.deviation(scale * rng.normal(size=2), answer * rng.normal(size=2))
        one.update(np.zeros(len(one.gain)))
        assert (np.abs(one.gain) <= 0.1).all()
        assert (np.abs(one.advance) <= 4e-3).all()


def test_of_a_quiet_loop_nothing_is_learnt():
    """Model force none, measured force noise."""
    one, rng = TrackingIdentification(2, np.full(2, 25.0), DT), np.random.default_rng(6)
    gain, advance = follow(one, np.zeros((2000, 2)), rng.normal(0, 5.0, (2000, 2)))
    assert not gain.any() and not advance.any()


def test_a_loop_that_changes_is_followed_again():
    model, rate = expected_forces(40_000, axes=1)
    forces = model.copy()
    forces[20_000:] -= 8e-4 * rate[20_000:]
    one = TrackingIdentification(1, np.full(1, 25.0), DT)
    follow(one, model[:20_000], forces[:20_000])
    assert abs(one.advance[0]) < 1e-5
    _, advance = follow(one, model[20_000:], forces[20_000:])
    assert advance[0] == pytest.approx(-8e-4, rel=0.25)
