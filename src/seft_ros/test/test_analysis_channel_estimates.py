"""Mass, scales and lags from samples alone, of a specimen whose law is made up here."""

import numpy as np
import pytest
from seft_ros.analysis.channel_estimates import motion_frequency, noise_of, relation, with_motion
from seft_ros.analysis.mass_estimate import inertia
from seft_ros.analysis.specimen_law import fine_law

DT, MASS = 0.002, 40.0
NOISE = np.array([3e-6, 5e-4, 0.03, 2.0])  # m, m/s, m/s^2, N


def samples(*, lag=(0.0,) * 4, scale=(1.0,) * 4, seconds=16.0, size=1.0, seed=1):
    """Samples of a specimen with a softening spring and a weak slider, shape (N, 4, 1).

    Its motion is a sum of sines, so that each channel is exact at any time.
    """
    rng = np.random.default_rng(seed)
    frequency = rng.uniform(1.5, 40.0, 60)
    amplitude = size * 4e-3 / (1.0 + (frequency / 6.0) ** 3) / np.sqrt(10)
    phase = rng.uniform(0.0, 2 * np.pi, 60)
    w = 2 * np.pi * frequency

    def motion(times, order):
        turned = np.outer(times, w) + phase + order * np.pi / 2
        return np.cos(turned) @ (amplitude * w**order)

    times = DT * np.arange(round(seconds / DT))
    x, v, a = (motion(times - lag[order], order) for order in range(3))
    own = motion(times - lag[3], 0)
    slider, z = np.zeros(len(times)), 0.0
    for k, moved in enumerate(np.diff(own), start=1):
        z = min(max(z + moved, -3e-4), 3e-4)
        slider[k] = z
    spring = 1.2e5 * 6e-3 * np.tanh(own / 6e-3) + 8e4 * slider
    force = MASS * motion(times - lag[3], 2) + 300.0 * motion(times - lag[3], 1) + spring
    exact = np.stack([x, v, a, force], axis=1) * scale
    return (exact + NOISE * rng.standard_normal(exact.shape))[:, :, np.newaxis]


def estimate(y, known=MASS, mass=None, deformation=None):
    """Mass over the known one, of one axis or several."""
    mass = np.array([[known]]) if mass is None else mass
    springs = np.eye(len(mass)) if deformation is None else deformation
    moved = (y[:, 0] @ springs.T).T
    laws = [fine_law(e, noise_of(e[:, np.newaxis])[0]) for e in moved]
    return inertia(y, mass, springs, laws, DT, motion_frequency(y))[0]


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("known", [40.0, 44.0])
def test_mass_is_found_within_its_standard_error(seed, known):
    found = estimate(samples(seed=seed), known)
    assert found.scale_error[0] < 0.01
    assert found.scale[0] == pytest.approx(MASS / known, abs=3 * found.scale_error[0])
    assert found.lag[0] == pytest.approx(0.0, abs=3 * found.lag_error[0])


def test_lag_of_the_force_is_found():
    found = estimate(samples(lag=(0.0, 0.0, 0.0, 8e-4)))
    assert found.lag_error[0] < 1e-4
    assert found.lag[0] == pytest.approx(8e-4, abs=3 * found.lag_error[0])


def test_noise_of_the_velocity_is_taken_for_neither_mass_nor_lag():
    y = samples()
    y[:, 1, 0] += 0.015 * np.random.default_rng(5).standard_normal(len(y))
    found = estimate(y)
    assert found.scale[0] == pytest.approx(1.0, abs=2e-3)
    assert found.lag[0] == pytest.approx(0.0, abs=2e-5)
    assert found.lag_error[0] < 1e-5


@pytest.mark.parametrize(("channel", "order"), [(1, 1), (2, 2)])
def test_scale_and_lag_against_the_displacement_are_found(channel, order):
    lag, scale = [0.0] * 4, [1.0] * 4
    lag[channel], scale[channel] = 7e-4, 1.013
    y = samples(lag=lag, scale=scale)
    found = relation(y[:, channel], y[:, 0], order, DT, motion_frequency(y))
    assert found.scale_error[0, 0] < 1e-3
    assert found.scale[0, 0] == pytest.approx(1.013, abs=1e-3)
    assert found.lag[0] == pytest.approx(7e-4, abs=2e-5)


def test_the_standard_error_of_few_cycles_is_that_of_their_noise():
    rng, t = np.random.default_rng(7), DT * np.arange(4000) - 4.0
    envelope, w = np.exp(-((t / 0.25) ** 2)), 2 * np.pi * 3.0
    x = (1e-3 * envelope * np.sin(w * t))[:, np.newaxis]
    v = 1e-3 * envelope * (w * np.cos(w * t) - 2 * t / 0.25**2 * np.sin(w * t))
    noisy = [(v + 1e-3 * rng.standard_normal(4000))[:, np.newaxis] for _ in range(60)]
    found = [relation(y, x, 1, DT, 3.0) for y in noisy]
    spread = np.std([each.scale[0, 0] for each in found])
    assert np.mean([each.scale_error[0, 0] for each in found]) == pytest.approx(spread, rel=0.2)


def test_samples_of_a_test_that_ended_at_once_show_no_relation():
    y = samples()[:3]
    y[:, 0] = 1e-12 * np.arange(3.0)[:, np.newaxis]
    assert relation(y[:, 2], y[:, 0], 2, DT, motion_frequency(y)) is None


@pytest.mark.parametrize("of_a", [0.0, 0.05])
def test_slow_accelerations_are_known_by_the_displacement(of_a):
    t, rng = 0.002 * np.arange(4000), np.random.default_rng(1)
    x = 1e-3 * np.sin(2 * np.pi * 3.0 * t) + 1e-4 * np.sin(2 * np.pi * 20.0 * t)
    a = -((6 * np.pi) ** 2) * 1e-3 * np.sin(2 * np.pi * 3.0 * t)
    a -= (40 * np.pi) ** 2 * 1e-4 * np.sin(2 * np.pi * 20.0 * t)
    samples = np.zeros((4000, 4, 1))
    samples[:, 0, 0] = x + 5e-6 * rng.normal(size=4000)
    samples[:, 2, 0] = a + of_a * rng.normal(size=4000)
    found = with_motion(samples, np.array([[5e-6], [0.0], [of_a], [0.0]]), 0.002)[:, 2, 0]
    slow = np.convolve(found - a, np.hanning(101) / np.hanning(101).sum(), "valid")  # below 10 Hz
    assert np.std(slow) < 0.1 * of_a / np.sqrt(33) + 1e-12
    assert np.std(found - a) <= of_a


def test_tilt_is_the_part_of_another_axis():
    y = np.concatenate([samples(seed=1), samples(seed=2)], axis=2)
    y[:, 2, 0] += 0.05 * y[:, 2, 1]
    found = relation(y[:, 2], y[:, 0], 2, DT, motion_frequency(y))
    assert found.scale == pytest.approx(np.array([[1.0, 0.05], [0.0, 1.0]]), abs=2e-3)


def test_axes_that_move_exactly_alike_show_no_tilt():
    y = np.repeat(samples(), 2, axis=2)
    found = relation(y[:, 2], y[:, 0], 2, DT, motion_frequency(y))
    assert found.scale == pytest.approx(np.eye(2), abs=2e-3)


def test_masses_of_a_frame_are_found_by_the_equations_of_its_storeys():
    one, two = samples(seed=4), samples(seed=5)  # deformations of the storeys
    deformation = np.array([[1.0, 0.0], [-1.0, 1.0]])
    y = np.empty((len(one), 4, 2))
    y[:, :3, 0], y[:, :3, 1] = one[:, :3, 0], one[:, :3, 0] + two[:, :3, 0]
    storeys = np.stack([each[:, 3, 0] - MASS * each[:, 2, 0] for each in (one, two)], axis=1)
    y[:, 3] = storeys @ deformation + np.array([30.0, 50.0]) * y[:, 2]
    found = estimate(y, mass=np.diag([33.0, 50.0]), deformation=deformation)
    assert found.scale == pytest.approx([30 / 33, 1.0], abs=0.01)
    assert (np.abs(found.scale - [30 / 33, 1.0]) < 4 * found.scale_error).all()


def test_of_a_quiet_or_a_short_test_nothing_is_known():
    for y in (samples(size=1e-3), samples(seconds=0.4)):
        frequency = motion_frequency(y)
        assert estimate(y) is None
        assert relation(y[:, 2], y[:, 0], 2, DT, frequency) is None
