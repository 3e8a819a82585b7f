"""Relations of the channels, sample by sample: their sides, thresholds, and the followed valve."""

import math

import numpy as np
import pytest
from detector_samples import (
    ACTUATOR,
    ALL,
    DT,
    MASS,
    NOISE,
    PAST,
    N,
    detect,
    detectors,
    faded,
    largest_recent,
    mean,
    noise_of_a_rig,
    shares_of,
)
from scipy.signal import lfilter
from seft_plant_sim.channels import Derivation
from seft_plant_sim.judge import detectors as rows
from seft_plant_sim.judge.detector_step import begin_detectors
from seft_plant_sim.judge.relation_following import remember
from seft_plant_sim.judge.valve_following import UNCERTAIN_VALVE, doubt, follow_valve, under_load

RESOLUTION = 1e-9
"""Less than any change of a channel in these tests, and not of no effect."""


def followed(p, relation, i, change, integral, per_delay, rough):
    """Differences and thresholds of the sums of a relation, and its estimates, by matrices."""
    is_oil = relation == rows.OIL
    fade, white = (p.oil_fade, 1.0) if is_oil else (p.fade, p.correlated[relation])
    noise, estimate = p.sums[relation, i] / 6.0, np.zeros(3)
    covariance = np.diag(p.deviation[relation, :, i] ** 2)
    scatter, weight, whole, sums = (rows.UNDESCRIBED[relation] / 6.0) ** 2, 1.0, 0.0, np.zeros(4)
    found = []
    for k in range(len(change)):
        sums = fade * sums + [change[k], integral[k], per_delay[k], DT]
        by = sums[1:]
        off = sums[0] - sums[1] - estimate @ by
        whole = max(abs(sums[0]), abs(sums[1]), p.memory * whole)
        left = max(scatter, 0.0) * whole**2
        known = np.sqrt(noise**2 + by @ covariance @ by + left)
        bias = min(p.deviation[relation, 2, i], 6.0 * np.sqrt(covariance[2, 2]))
        most = 6.0 * noise + bias * sums[3] + rows.TOLERANCES[relation] * whole
        found.append((abs(off), min(6.0 * known, most) + rough[k]))
        covariance = covariance + np.diag(p.drift[relation, :, i])
        doubt = white * noise**2 + p.correlated[relation] * ((rough[k] / 6.0) ** 2 + left)
        gain = covariance @ by / (doubt + by @ covariance @ by)
        if whole <= 20.0 * (noise + rough[k] / 6.0):
            gain[:2] = 0.0
        joseph = np.eye(3) - np.outer(gain, by)
        covariance = joseph @ covariance @ joseph.T + doubt * np.outer(gain, gain)
        estimate = np.clip(estimate + gain * off, *(p.most[relation, :, i] * [[-1.0], [1.0]]))
        size = whole**2 + (20.0 * noise) ** 2
        counts = whole**2 / size * DT / 0.05
        weight = min(weight + counts, 60.0)
        scatter += counts / weight * ((min(off**2, 4.0 * known**2) - noise**2) / size - scatter)
    return np.array(found).T, estimate


def flows(commands, past):
    """Flow of the valves before each sample, m/s; the newest command came with the one before."""
    sent = np.vstack([np.zeros((3, N)), commands])
    each = (part * sent[2 - k : -1 - k] for k, part in enumerate(past.T))
    return ACTUATOR[:, 0] * sum(each)


@pytest.mark.parametrize("drive", [0.0, 4.0])
def test_each_relation_is_followed_and_held_against_its_threshold(drive):
    p, state = detectors(ALL)
    samples, commands = noise_of_a_rig(300)
    commands = (0.1 if drive else 1.0) * commands
    commands += drive * (1.0 - np.cos(0.1 * np.arange(300)))[:, np.newaxis]
    if drive:  # the valves' gains are 5 % larger than assumed
        moves = 1.05 * flows(commands, PAST[:, 0])
        samples[:, 0] += DT * np.cumsum(moves, axis=0)
        speed = mean(np.vstack([moves, moves[-1:]]))
        samples[:, 1] += speed
        samples[:, 2] += np.gradient(speed, DT, axis=0)
    state.judge.resolution[:] = RESOLUTION
    seen = shares_of(p, state, samples, commands)
    assert not state.judge.counts.any()
    assert not seen[0].any()  # of a first sample there is nothing to compare
    x, v, a, f = samples.transpose(1, 0, 2)
    bends = np.abs(np.diff(a, axis=0, n=2, prepend=a[:1]))
    rises = 0.5 * DT * largest_recent(bends, p.fade)
    oil, leakage = ACTUATOR[:, 1], ACTUATOR[:, 2]
    flow, later = (flows(commands, PAST[:, row])[1:] for row in range(2))
    load = np.sqrt(1.0 - np.sign(flow) * mean(f) / ACTUATOR[:, 3])
    force = (np.diff(f, axis=0) + DT * leakage * mean(f)) / oil
    none = np.zeros_like(rises)
    moved = DT * mean(v) - DT**2 / 12.0 * np.diff(a, axis=0)
    sides = (
        (np.diff(x, axis=0), moved, -np.diff(v, axis=0), none + 2.0 * RESOLUTION),
        (np.diff(v, axis=0), DT * mean(a), -np.diff(a, axis=0), rises + 2.0 * RESOLUTION),
        (
            np.diff(x, axis=0) + force,
            DT * load * flow,
            DT * load * later,
            2.0 * RESOLUTION * (1.0 + 1.0 / oil),
        ),
    )
    for row, (change, integral, per_delay, rough) in enumerate(sides):
        for i in range(N):
            both = (each[:, i] for each in (change, integral, per_delay))
            rough_of = np.broadcast_to(rough, change.shape)[:, i]
            (off, threshold), estimate = followed(p, row, i, *both, rough_of)
            np.testing.assert_allclose(seen[1:, row, i], off / threshold, rtol=1e-6, atol=1e-9)
            np.testing.assert_allclose(state.estimated[row, :, i], estimate, rtol=1e-6, atol=1e-12)
    assert seen[:, : rows.SECOND_ORDER_WORK].max() < 1.0
    off = state.estimated[rows.OIL, 0] - (0.05 if drive else 0.0)
    assert (abs(off) < 4.0 * np.sqrt(state.covariance[rows.OIL, :, 0, 0])).all()


def test_a_held_force_jumps_and_the_acceleration_with_it():
    p, state = detectors(ALL, has_valve=False)
    samples, commands = noise_of_a_rig(200)
    jumps = 500.0 * np.random.default_rng(8).normal(size=(200, N))
    gained = np.linalg.solve(MASS, jumps.T).T
    speed = DT * np.cumsum(np.vstack([np.zeros((1, N)), mean(gained)]), axis=0)
    moves = DT * np.cumsum(np.vstack([np.zeros((1, N)), mean(speed)]), axis=0)
    samples += np.stack([moves, speed, gained, jumps], axis=1)
    state.judge.resolution[:] = RESOLUTION
    seen = shares_of(p, state, samples, commands)
    assert not state.judge.counts.any()
    _, v, a, f = samples.transpose(1, 0, 2)
    jump = np.linalg.solve(MASS, np.diff(f, axis=0).T).T
    bends = np.abs(np.diff(a, axis=0, n=2, prepend=a[:1]))
    held = np.maximum(np.abs(jump), np.abs(faded(jump, p.fade)))
    rough = 0.5 * DT * np.maximum(largest_recent(bends, p.fade), held) + 2.0 * RESOLUTION
    for i in range(N):
        sides = np.diff(v, axis=0)[:, i], DT * mean(a)[:, i], -np.diff(a, axis=0)[:, i]
        (off, threshold), _ = followed(p, 1, i, *sides, rough[:, i])
        np.testing.assert_allclose(seen[1:, 1, i], off / threshold, rtol=1e-6, atol=1e-9)
    assert not seen[:, rows.OIL].any()  # there is no oil


def test_without_a_mass_a_held_force_says_nothing_of_the_acceleration():
    p, _ = detectors(ALL, has_valve=False, mass=np.zeros((N, N)))
    assert not p.by_force.any()


@pytest.mark.parametrize("axis", [0, 1])
def test_a_valve_that_closes_or_jams_is_found(axis):
    p, state = detectors([each for each in ALL if "frozen" in each])
    commands, samples = np.full((90, N), 4.0), np.zeros((90, 4, N))
    speed, ends = 4.0 * ACTUATOR[:, 0] * PAST[:, 0].sum(axis=1), []
    for closes in (True, False):
        commands[60:, axis] = 4.0 if closes else 0.0
        samples[:, 1], samples[:, 2:] = speed, 0.0
        if closes:  # or is stuck
            samples[60, 1:3, axis] = 0.5 * speed[axis], -speed[axis] / DT
            samples[61:, 1, axis] = 0.0
            samples[60, 3] = MASS @ samples[60, 2]
        samples[1:, 0] = DT * np.cumsum(mean(samples[:, 1]), axis=0)
        state.sent[:], state.judge.resolution[:] = 4.0, RESOLUTION
        found = []
        for k in range(90):
            found.append(detect(p, state, 1 + k, samples[k], commands[max(k - 1, 0)]))
        end = next(k for k, each in enumerate(found) if each >= 0)
        ends.append(end)
        assert found[end] == rows.OIL * N + axis
        begin_detectors(p, state)
    assert ends == [67, 68]


def test_of_a_velocity_that_was_replaced_the_displacement_says_nothing():
    p, state = detectors(ALL)
    samples, commands = noise_of_a_rig(30)
    samples[20, 1, 0] += 100.0 * NOISE[1, 0]
    seen = shares_of(p, state, samples, commands)[:, 0]
    assert state.judge.counts[1].tolist() == [1, 0]
    assert np.flatnonzero(seen[1:, 0] == 0.0).tolist() == [19, 20]
    assert (seen[1:, 1] > 0.0).all()


def test_nothing_is_followed_while_its_relation_is_off():
    for row in range(3):
        p, state = detectors(ALL)
        samples, commands = noise_of_a_rig(20)
        shares_of(p, state, samples, commands)
        state.counts[row, 1] = 9
        before = state.estimated.copy(), state.scatter.copy()
        shares_of(p, state, samples[:1], commands[:1], [20])
        for old, new in zip(before, (state.estimated, state.scatter), strict=True):
            still = (new == old).all(axis=1)
            assert not still[:, 0].any()
            assert still[:, 1].tolist() == [row == each for each in range(3)]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_bias_is_followed_as_far_as_it_is_no_fault(sign):
    p, state = detectors(ALL)
    samples = np.zeros((2000, 4, N))
    samples[:, 1] = sign * np.array([1.0, 2.5]) * NOISE[1]
    for k in range(2000):
        state.counts[:] = 0
        detect(p, state, k, samples[k])
    found = state.estimated[0, 2]
    np.testing.assert_allclose(found, -sign * np.array([1.0, 2.0]) * NOISE[1], 0.02)
    assert not state.estimated[0, :2].any()  # nothing moves


def test_what_grows_slowly_does_not_become_usual():
    scatter = np.array([[1e-4], [30.0]])
    for _ in range(25):
        remember(scatter, 0, 1.0, 0.01, 1.0, 1e-4, DT)
    assert scatter[0, 0] < 2e-4
    for _ in range(25):
        remember(scatter, 0, 0.0, 0.01, 1.0, 1e-4, DT)
    assert scatter[0, 0] < 1.5e-4


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("late", [0.0, 2e-3])
def test_a_derived_velocity_may_be_late(late, sign):
    derivation = Derivation(0.625 / 2.024e-3, 0.4) if late else Derivation(0.0, 0.0)
    unknown = {"mass": np.zeros((N, N)), "actuator": np.zeros((N, 4))}
    p, state = detectors(ALL, derivation=derivation, **unknown)
    samples, commands = np.zeros((2, 4, N)), np.zeros((2, N))
    samples[:, :3, 1] = sign * np.array([[0.0, 1.0, 10.0], [2.024e-3, 1.025, 12.0]])
    state.judge.resolution[:] = RESOLUTION
    seen = shares_of(p, state, samples, commands, [1, 2])[1, :2, 1]
    assert not state.judge.counts.any()
    sides = (
        ([2.024e-3], [0.5 * DT * (2.025 - DT / 6.0 * 2.0)], [-0.025]),
        ([0.025], [0.5 * DT * 22.0], [-2.0]),
    )
    roughs = late * 0.025, (0.5 * DT + late) * 2.0
    for row, (side, rough) in enumerate(zip(sides, roughs, strict=True)):
        ((off,), (threshold,)), _ = followed(p, row, 1, *side, [rough + 2.0 * RESOLUTION])
        assert seen[row] == pytest.approx(off / threshold, rel=1e-9)
    apart = 4e-3 if late else 2e-3
    np.testing.assert_allclose(p.most[:2, 1], apart)


def test_the_errors_of_a_valve_and_its_oil_are_those_of_least_squares():
    rng = np.random.default_rng(1)
    by, white = rng.normal(size=(40, 3)) * [1.0, 50.0, 0.3], rng.normal(size=40)
    moved = by[:, 0] + by[:, 2] + by @ [0.07, 1e-3, -0.1] + 0.1 * white
    errors, c, work = np.zeros((1, 3)), np.diag(np.square(UNCERTAIN_VALVE))[None], np.empty(3)
    for signals in np.column_stack([by, moved]):
        follow_valve(errors[0], c[0], signals, 0.01, work)
    information = by.T @ by / 0.01 + np.diag([0.15**-2, 2e-3**-2, 0.2**-2])
    expected = np.linalg.solve(information, by.T @ (moved - by[:, 0] - by[:, 2]) / 0.01)
    np.testing.assert_allclose(errors[0], expected, rtol=1e-9)
    np.testing.assert_allclose(c[0], np.linalg.inv(information), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_is_followed_of_a_valve_has_bounds(sign):
    errors, c, work = np.zeros((1, 3)), np.diag(np.square(UNCERTAIN_VALVE))[None], np.empty(3)
    for _ in range(100):
        for one in range(3):
            signals = np.zeros(4)
            signals[one] = 1.0
            signals[3] = 9.0 * sign + (one != 1)
            follow_valve(errors[0], c[0], signals, 1e-9, work)
    np.testing.assert_array_equal(errors[0], [0.3 * sign, 5e-3 * sign, 0.5 * sign])


def test_the_doubt_of_a_flow_is_the_noise_of_velocity_and_of_the_smoothed_change_of_force():
    found = doubt(*np.array([[3.0], [8.0], [2.0], [0.25]]), 0.5)
    np.testing.assert_allclose(found, 9.0 + 16.0**2)  # a sample is longer than 0.1 s
    of_velocity = doubt(*np.array([[1.0], [0.0], [1.0], [1.0]]), 0.002)
    np.testing.assert_allclose(of_velocity, 50.0)


def test_a_valve_under_load():
    assert under_load(1.0, 36.0, 100.0) == 0.8
    assert under_load(-1.0, -36.0, 100.0) == 0.8
    assert under_load(1.0, -44.0, 100.0) == 1.2
    assert under_load(0.0, 44.0, 100.0) == 1.2
    assert under_load(1.0, 99.0, 100.0) == math.sqrt(0.2)  # so much pressure is always left
    assert under_load(1.0, 99.0, math.inf) == 1.0


def test_thresholds_are_six_times_what_noise_makes_of_each_relation():
    p, _ = detectors()
    impulse = np.eye(1, 4000)[0]

    def rms(weights, factor=0.0):
        return math.sqrt(np.sum(lfilter(weights, [1.0, -factor], impulse) ** 2))

    x, v, a, f = NOISE
    fade = math.exp(-DT / 0.05)
    for row, (jump, rate) in enumerate([(x, v), (v, a)]):
        of_sums = 6.0 * np.hypot(jump * rms([1.0, -1.0], fade), DT * rate * rms([0.5, 0.5], fade))
        np.testing.assert_allclose(p.most[row, 2], 2.0 * rate, rtol=1e-9)
        np.testing.assert_allclose(p.sums[row], of_sums, rtol=1e-9)
    oil = f / ACTUATOR[:, 1]
    of_oil = 6.0 * np.hypot(x, oil) * rms([1.0, -1.0], math.exp(-DT / 0.2))
    np.testing.assert_allclose(p.sums[rows.OIL], of_oil, rtol=1e-9)
    rough = 6.0 * rms([1.0, -2.0, 1.0]) * np.sqrt(f**2 + MASS**2 @ a**2)
    np.testing.assert_allclose(p.rough, rough, rtol=1e-9)
    assert (p.short, p.memory) == (math.exp(-DT / 0.015), math.exp(-DT / 0.3))
    assert detectors(dt=0.004)[0].short == math.exp(-1.0 / 7.0)
