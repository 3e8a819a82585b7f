"""Vibration that the loop makes is seen before it is strong; what the structure does is none."""

import dataclasses
import math

import numpy as np
import pytest
from experiments_at_hand import load
from scipy.signal import butter, lfilter, sosfilt
from seft_msgs_py.arrays import clear, zeros
from seft_msgs_py.config.parameter_table import group
from seft_msgs_py.errors import InputError
from seft_plant_sim.computed.computed_substructure import ComputedSubstructure
from seft_plant_sim.whole_structure import reference_response
from seft_ros.protection.instability import (
    InstabilityWatch,
    WatchParameters,
    WatchState,
    watch_step,
)
from seft_ros.reference_force.compensator import MethodInputs
from seft_ros.reference_force.reference_force_block import method_inputs

RATIO, FLOOR = 5.0, 0.3


def known_of(mass, computed, damping, stiffness, dt=0.002):
    return MethodInputs(mass, ComputedSubstructure.lumped(computed), damping, stiffness, dt, {})


ONE = known_of(*(np.array([[value]]) for value in (52.7, 52.7, 800.0, 2.11e5)))


def watch(known=ONE, lowest=0.0):
    axes = [f"axis{i}" for i in range(known.axes)]
    return InstabilityWatch(known, axes, RATIO, FLOOR, lowest)


def states_of(known, acceleration, restoring=0.0):
    """States of a test, as far as the watch looks: a, and f = M_e a + r."""
    states = np.zeros((len(acceleration), 4, known.axes))
    states[:, 2] = acceleration
    states[:, 3] = acceleration @ known.mass.T + restoring
    return states


def first_fault(guard, ground_motion, states):
    """Step of the first fault and its text; None."""
    for step, (ground, state) in enumerate(zip(ground_motion, states, strict=True)):
        if watch_step(guard.parameters, guard.state, ground, state):
            return step, guard.describe()
    return None


def motion(seed, steps, axes, strength=8.0):
    """Noise that swells and dies away: rough, and as strong as an earthquake."""
    noise = np.random.default_rng(seed).standard_normal((steps, axes))
    envelope = np.sin(np.pi * np.arange(steps) / steps) ** 2
    return strength * envelope[:, np.newaxis] * noise


def vibration(steps, dt, hz, growth, start=1e-3):
    time = np.arange(steps) * dt
    return (start * np.exp(growth * time) * np.sin(math.tau * hz * time))[:, np.newaxis]


@pytest.mark.parametrize("hz", [22.0, 35.0, 90.0, 200.0])
@pytest.mark.parametrize("growth", [2.0, 7.0, 30.0])
def test_a_growing_vibration_is_seen_while_it_is_weak(hz, growth):
    acceleration = vibration(5000, ONE.dt, hz, growth)
    acceleration = acceleration[np.abs(acceleration[:, 0]) < 200.0]
    step, fault = first_fault(watch(), np.zeros_like(acceleration), states_of(ONE, acceleration))
    assert np.abs(acceleration[: step + 1]).max() < 30.0
    assert "on axis axis0" in fault
    assert "(limit 5)" in fault


def test_a_knock_is_no_fault():
    acceleration = np.zeros((1000, 1))
    acceleration[500:502] = 8.0
    assert first_fault(watch(), np.zeros_like(acceleration), states_of(ONE, acceleration)) is None


def test_a_new_test_begins_at_rest():
    acceleration = vibration(1000, ONE.dt, 35.0, 10.0)
    ground = np.zeros_like(acceleration)
    guard, states = watch(), states_of(ONE, acceleration)
    first = first_fault(guard, ground, states)
    clear(guard.state)
    assert first is not None
    assert first_fault(guard, ground, states) == first


@pytest.mark.parametrize("config", ["demo", "three_storey_frame", "two_pier_bridge", "water_tower"])
def test_in_a_perfect_test_both_accelerations_are_one_and_pass_butterworths_high_pass(config):
    test = load(config=config)
    n, section = len(test.axes), test["reference_force"] | {"instability.lowest": 30.0}
    known = method_inputs(section, test.axes, test.timebase)
    guard = InstabilityWatch(known, test.axes, **group(section, "instability"))
    ground = motion(1, 600, n)
    exact = reference_response(test, ground)
    filtered, whole = np.empty((600, 2, n)), np.empty((600, n))
    parameters = guard.parameters._replace(average=0.0)  # no mean: exact
    for step, state in enumerate(exact.states):
        watch_step(parameters, guard.state, ground[step], state)
        filtered[step] = np.sqrt(guard.state.squares[:2])
        whole[step] = guard.state.result[-n:]
    sections = butter(4, 30.0, "high", fs=500, output="sos")
    wanted = np.abs(sosfilt(sections, exact.acceleration, axis=0))
    np.testing.assert_allclose(filtered[:, 1], wanted, atol=1e-9)
    np.testing.assert_allclose(filtered[:, 0], wanted, atol=1e-3 * np.abs(wanted).max())
    largest = np.abs(exact.acceleration).max()
    np.testing.assert_allclose(whole, exact.acceleration, atol=1e-3 * largest)


def bare_step(patience, ratio=2.0, least=1e-4, axes=2, share=1.0):
    """A watch whose filter passes a share of all; the structure's acceleration is x."""
    product = np.eye(5 * axes, axes, k=-axes)
    state = zeros(WatchState, {"inputs": 5 * axes, "outputs": axes, "n": axes})
    state.squares[2], weights = least, np.array([[share, 0.0, 0.0, 0.0, 0.0], np.eye(1, 5)[0]])
    return WatchParameters(product, weights, 0.75, 0.875, patience, ratio, least), state


@pytest.mark.parametrize("share", [1.0, 0.2])
def test_mean_squares_are_held_against_the_largest_that_was_expected(share):
    parameters, state = bare_step(1e9, share=share)
    rng = np.random.default_rng(2)
    strength = np.array([3.0, 0.1])[:, np.newaxis, np.newaxis]
    whole, found = strength * rng.normal(size=(2, 90, 2)) * rng.choice([0.0, 1.0], (2, 90, 1))
    whole[60:] = 0.0
    found[30:] *= 100.0
    of_explained, of_found, of_whole = (
        lfilter([0.25], [1.0, -0.75], each**2, axis=0)
        for each in (share * whole, share * found, whole)
    )
    fading = 0.875 ** np.arange(91)[:, np.newaxis]
    now = np.maximum(np.maximum(of_explained, 0.09 * of_whole), 1e-4)
    expected = (np.maximum.accumulate(np.vstack([[1e-4] * 2, now]) / fading) * fading)[1:]
    excess = (of_found / expected).max(axis=1) / 4.0
    above = 0.0
    for k in range(90):
        measured = np.array([whole[k], [9.0, 9.0], found[k], [9.0, 9.0]])
        assert not watch_step(parameters, state, np.ones(2), measured)
        rows = of_explained[k], of_found[k], expected[k], of_whole[k]
        np.testing.assert_allclose(state.squares, rows, rtol=1e-9)
        above = above + min(excess[k], 10.0) if excess[k] > 1.0 else 0.0
        assert state.above[0] == pytest.approx(above, rel=1e-9)
    assert excess.max() > 10.0 > 1.0 > excess.min()


def test_vibration_at_the_ratio_is_none_and_beyond_it_counts_until_the_patience_is_used_up():
    parameters, state = bare_step(6.0, least=1.0, axes=1)
    parameters = parameters._replace(average=0.0)  # no mean: exact
    faults = []
    for found in (2.0, 3.0, 2.0, 3.0, -3.0, 3.0, 20.0):  # 2 is at the limit, 9 / 4 beyond
        measured = np.array([[0.0], [0.0], [found], [0.0]])
        faults.append((watch_step(parameters, state, np.zeros(1), measured), state.above[0]))
    above = [0.0, 2.25, 0.0, 2.25, 4.5, 6.75, 16.75]
    assert faults == [(each >= 6.0, each) for each in above]
    parameters, state = bare_step(4.5, least=1.0, axes=1)
    parameters, measured = parameters._replace(average=0.0), np.array([[0.0], [0.0], [3.0], [0.0]])
    assert [watch_step(parameters, state, np.zeros(1), measured) for _ in range(2)] == [False, True]


def test_what_does_not_shake_is_no_vibration_however_small_the_ratio_is():
    parameters, state = bare_step(6.0, ratio=0.5, axes=1)
    assert not watch_step(parameters, state, np.zeros(1), np.zeros((4, 1)))
    assert state.above[0] == 0.0


def test_times_become_factors_and_numbers_of_steps():
    found = watch().parameters
    assert found.average == pytest.approx(math.exp(-0.002 / 0.1), rel=1e-12)
    assert found.memory == pytest.approx(math.exp(-2.0 * 0.002 / 2.0), rel=1e-12)
    assert found.patience == pytest.approx(50.0, rel=1e-12)
    assert (found.ratio, found.least) == (RATIO, FLOOR**2)


def test_the_band_begins_above_the_specimen_s_frequency_and_at_most_at_a_quarter_of_the_rate():
    def lowest(stiffness):
        one = known_of(*(np.array([[value]]) for value in (1.0, 1.0, 0.0, stiffness)))
        guard = watch(one)
        guard.state.squares[:] = 1.0
        return float(guard.describe().split()[3])

    hz = (2.0 * math.pi * np.array([0.0, 0.0, 0.01, 10.0, 62.4, 62.6, 1000.0])) ** 2
    hz[0] = -1.0  # it bends away
    assert [lowest(one) for one in hz] == [0.0, 0.0, 0.02, 20.0, 125.0, 125.0, 125.0]


@pytest.mark.parametrize("dt", [0.002, 0.01])
def test_a_band_beyond_what_is_sampled_is_refused_with_the_largest(dt):
    one = dataclasses.replace(ONE, dt=dt)
    watch(one, lowest=0.4499 / dt)
    with pytest.raises(InputError) as message:
        watch(one, lowest=0.45 / dt)
    most, rate = {0.002: ("225", "500"), 0.01: ("45", "100")}[dt]
    assert f"{most} Hz is beyond what is sampled at {rate} Hz; take less than {most} Hz" in str(
        message.value
    )


def test_the_message_names_the_axis_with_the_largest_ratio():
    two = known_of(*(np.kron(np.eye(2), part) for part in (52.7, 52.7, 800.0, 2.11e5)))
    guard = watch(two)
    guard.state.squares[1], guard.state.squares[2] = (100.0, 36.0), (25.0, 0.25)
    assert guard.describe() == (
        "instability: acceleration above 20.1 Hz on axis axis1 is 6 m/s^2 RMS, 12 times that of "
        "the structure under the measured restoring force (limit 5)"
    )
