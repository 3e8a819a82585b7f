"""The motion that brings a rig to rest: the target slowed down, and the specimen unloaded."""

import math

import numpy as np
import pytest
from scipy.linalg import eigh
from seft_ros.force_controller.stop_path import path_to_rest, slow_down, stop_path

DT = 0.002
POINTS = 26
STOREYS = 2e5 * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])


def test_a_target_that_slows_down_stays_on_its_path():
    w, time, mass = 2 * math.pi * 3.0, DT * np.arange(POINTS), np.array([[50.0]])
    force = 100.0 * w * np.cos(w * time) - mass[0, 0] * w**2 * np.sin(w * time)
    plan = np.stack([np.sin(w * time), w * np.cos(w * time), force], axis=1)
    stop = stop_path(mass, np.array([[1e6]]), POINTS - 1, DT)
    steps = 2 * (POINTS - 1)
    assert stop.steps == stop.slowing == steps == round(0.1 / DT)
    slowed = np.empty((steps + 10, 3, 1))
    slow_down(stop, np.ascontiguousarray(plan[:, :, np.newaxis]), slowed)
    x, v, r = slowed[:, :, 0].T
    np.testing.assert_allclose(r, 100.0 * w * np.sqrt(1 - x**2), atol=0.02 * mass[0, 0] * w**2)
    half = 0.5 * w * np.sqrt(1 - x[steps // 2] ** 2)
    np.testing.assert_allclose(v[: steps // 2 + 1 : steps // 2], [w, half], rtol=1e-3)
    np.testing.assert_allclose(np.gradient(x, DT)[1:-1], v[1:-1], atol=0.05)
    assert x[-1] == pytest.approx(np.sin(w * time[-1]))
    np.testing.assert_allclose(v[steps:], 0.0, atol=1e-12)


def stopped(stiffness, phase, assumed=None):
    """Stop a structure with twice as much computed mass, which vibrates in its slowest mode.

    Its specimen is elastic. Gives the peak force of the test, and path and force of the stop.
    """
    mass = 50.0 * np.eye(len(stiffness))
    square, modes = eigh(stiffness, 3.0 * mass)
    w, mode, time = math.sqrt(square[0]), modes[:, 0], DT * np.arange(POINTS)
    x, v = np.cos(w * time + phase), -w * np.sin(w * time + phase)
    by_x = (stiffness - w**2 * mass) @ mode
    plan = np.stack([np.outer(x, mode), np.outer(v, mode), np.outer(x, by_x)], axis=1)
    stop = stop_path(mass, stiffness if assumed is None else assumed, POINTS - 1, DT)
    path = np.empty((stop.steps + 10, 3, len(stiffness)))
    path_to_rest(stop, plan, path)
    acceleration = np.gradient(path[:, 1], DT, axis=0)
    return np.abs(by_x).max(), path, path[:, 0] @ stiffness + acceleration @ mass


@pytest.mark.parametrize("phase", np.linspace(0.0, 2.0 * math.pi, 9)[1:])
@pytest.mark.parametrize("stiffness", [np.array([[2e5]]), STOREYS])
def test_a_stop_takes_no_more_force_than_the_test_and_leaves_none(stiffness, phase):
    peak, path, force = stopped(stiffness, phase)
    x, v, planned = path.transpose(1, 0, 2)
    off = np.gradient(x, DT, axis=0)[1:-1] - v[1:-1]
    assert np.abs(off).max() < 0.02 * np.abs(v).max()
    assert np.abs(force).max() < 1.1 * peak
    assert np.abs(planned).max() < 1.1 * peak
    assert np.abs(force[-5:]).max() < 0.02 * peak
    assert np.abs(planned[-5:]).max() < 0.02 * peak
    np.testing.assert_array_equal(v[-5:], 0.0)


def test_a_specimen_that_is_stiffer_than_assumed_rests_where_the_test_has_begun():
    stiff = np.array([[4e5]])
    peak, path, force = stopped(stiff, 0.3, assumed=stiff / 2)
    assert np.abs(path[-1, 0]).max() < 1e-12
    assert np.abs(force).max() < 1.1 * peak


def test_a_mode_that_is_too_slow_to_be_unloaded_is_held():
    _, path, _ = stopped(np.diag([2e5, 20.0]), 0.0)
    assert np.isfinite(path).all()
    assert path[-1, 0, 1] == pytest.approx(path[0, 0, 1], rel=0.01)
    assert path[0, 0, 1] > 0.05
    assert len(path) - 10 == round(0.1 / DT)
