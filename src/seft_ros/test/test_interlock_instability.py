"""Vibration that the ground motion does not explain is seen before it is strong; other is not."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, sosfilt
from seft_plant_sim.computed_substructure import ComputedSubstructure
from seft_ros.interlock.instability import InstabilityWatch
from seft_ros.reference_force.compensation.compensator import Knowledge

RATIO, FLOOR = 5.0, 0.3


def known_of(mass, computed, damping, stiffness, dt=0.002):
    return Knowledge(mass, ComputedSubstructure.lumped(computed), damping, stiffness, dt, {})


ONE = known_of(*(np.array([[value]]) for value in (52.7, 52.7, 800.0, 2.11e5)))


def watch(known=ONE, ratio=RATIO, lowest=0.0):
    axes = [f"axis{i}" for i in range(known.axes)]
    return InstabilityWatch(known, axes, ratio, FLOOR, lowest)


def first_fault(guard, ground_motion, acceleration):
    """Step of the first fault and its text; None."""
    for step, (ground, a) in enumerate(zip(ground_motion, acceleration, strict=True)):
        if (fault := guard.step(ground, a.copy())) is not None:
            return step, fault
    return None


def response(known, ground_motion):
    """Acceleration of the whole structure, relative to the ground; held between steps."""
    n, substeps = known.axes, 20
    x, v = np.zeros(n), np.zeros(n)
    found = []
    inverse, dt = np.linalg.inv(known.total_mass), known.dt / substeps
    for ground in ground_motion:
        found.append(-ground - inverse @ (known.damping @ v + known.stiffness @ x))
        for _ in range(substeps):
            v = v + dt * (-ground - inverse @ (known.damping @ v + known.stiffness @ x))
            x = x + dt * v
    return np.array(found)


def motion(seed, steps, axes, strength=8.0):
    """Noise that swells and dies away: rough, and as strong as an earthquake."""
    noise = np.random.default_rng(seed).standard_normal((steps, axes))
    envelope = np.sin(np.pi * np.arange(steps) / steps) ** 2
    return strength * envelope[:, np.newaxis] * noise


def vibration(steps, dt, hz, growth, start=1e-3):
    time = np.arange(steps) * dt
    return (start * np.exp(growth * time) * np.sin(math.tau * hz * time))[:, np.newaxis]


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 1000),
    axes=st.integers(1, 3),
    mass_ratio=st.floats(0.0, 10.0),
    rate=st.sampled_from([250.0, 500.0, 1000.0]),
    wrong=st.floats(0.7, 1.4),
)
def test_strong_motion_that_a_rough_model_explains_is_no_fault(seed, axes, mass_ratio, rate, wrong):
    couple = 2 * np.eye(axes) - np.eye(axes, k=1) - np.eye(axes, k=-1)
    mass = 50.0 * np.eye(axes)
    known = known_of(mass, mass_ratio * mass, 400.0 * couple, 2e5 * couple, 1 / rate)
    ground = motion(seed, 400, axes)
    true = dataclasses.replace(known, stiffness=wrong * known.stiffness)
    noise = 0.05 * np.random.default_rng(seed + 1).standard_normal(ground.shape)
    assert first_fault(watch(known), ground, response(true, ground) + noise) is None


@pytest.mark.parametrize("hz", [22.0, 35.0, 90.0, 200.0])
@pytest.mark.parametrize("growth", [2.0, 7.0, 30.0])
def test_a_growing_vibration_is_seen_while_it_is_weak(hz, growth):
    acceleration = vibration(5000, ONE.dt, hz, growth)
    acceleration = acceleration[np.abs(acceleration[:, 0]) < 200.0]
    step, fault = first_fault(watch(), np.zeros_like(acceleration), acceleration)
    assert np.abs(acceleration[: step + 1]).max() < 30.0
    assert "on axis axis0" in fault
    assert "(limit 5)" in fault


def test_it_is_seen_in_the_middle_of_strong_motion():
    ground = motion(3, 3000, 1)
    exact = response(ONE, ground)
    growing = vibration(3000, ONE.dt, 35.0, 7.0, start=1e-6)
    step, _ = first_fault(watch(), ground, exact + growing)
    assert np.abs(growing[: step + 1]).max() < 8 * np.abs(exact).max()


def test_the_axis_that_vibrates_is_named():
    two = known_of(*(np.kron(np.eye(2), part) for part in (52.7, 52.7, 800.0, 2.11e5)))
    growing = np.hstack([np.zeros((2000, 1)), vibration(2000, 0.002, 40.0, 7.0)])
    _, fault = first_fault(watch(two), np.zeros_like(growing), growing)
    assert "on axis axis1" in fault


def test_a_knock_is_no_fault():
    acceleration = np.zeros((1000, 1))
    acceleration[500:502] = 8.0
    assert first_fault(watch(), np.zeros_like(acceleration), acceleration) is None


def test_vibration_below_the_band_is_no_matter_of_this_guard():
    acceleration = vibration(2000, ONE.dt, 5.0, 0.0, start=10.0)
    acceleration *= np.minimum(np.arange(2000) / 500, 1)[:, np.newaxis]
    assert first_fault(watch(), np.zeros_like(acceleration), acceleration) is None


def test_a_ratio_of_zero_switches_it_off():
    acceleration = vibration(3000, ONE.dt, 35.0, 5.0)
    assert first_fault(watch(ratio=0.0), np.zeros_like(acceleration), acceleration) is None


def test_a_new_test_begins_at_rest():
    acceleration = vibration(1000, ONE.dt, 35.0, 10.0)
    ground = np.zeros_like(acceleration)
    guard = watch()
    first = first_fault(guard, ground, acceleration)
    guard.reset()
    assert first is not None
    assert first_fault(guard, ground, acceleration) == first


def test_both_accelerations_pass_butterworths_high_pass():
    guard = watch(lowest=30.0)
    ground = motion(1, 600, 1)
    measured = np.random.default_rng(2).standard_normal((600, 1))
    filtered = np.empty((600, 2))
    for k in range(600):
        work = guard.state.work.copy()
        work[-2:] = ground[k, 0], measured[k, 0]
        filtered[k] = (work @ guard.parameters.product)[-2:]
        guard.step(ground[k], measured[k])
    sections = butter(4, 30.0, "high", fs=500, output="sos")
    np.testing.assert_allclose(filtered[:, 1], sosfilt(sections, measured[:, 0]), atol=1e-9)
    exact = sosfilt(sections, response(ONE, ground)[:, 0])
    assert np.abs(filtered[:, 0] - exact).max() < 0.02 * np.abs(exact).max()
