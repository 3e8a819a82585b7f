"""Relations of the channels, sample by sample: their sides, thresholds, and the followed valve."""

import math

import numpy as np
import pytest
from detector_samples import (
    ACTUATOR,
    ALL,
    DT,
    MASS,
    NO_TARGET,
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
from seft_ros.protection import detectors as rows
from seft_ros.protection.channel_relations import hold, look_at_sides, take_command
from seft_ros.protection.detector_step import begin_detectors
from seft_ros.protection.valve_following import begin_following, doubt, follow_valve, under_load

RESOLUTION = 1e-9
"""Less than any change of a channel in these tests, and not of no effect."""


def relation(p, row, one, other, rough, tolerance, in_sums=0.0):
    """Shares of the sums of a relation, and of its single steps as the third one has them."""
    bias, right, left = np.zeros(N), [], p.bias[row] / (1.0 - p.fade)
    for k in range(len(one)):
        right.append(other[k] + bias)
        bias = bias + (1.0 - p.memory) * (one[k] - right[k])
        bias = np.clip(bias, -p.bias[row], p.bias[row])
    other, unknown = np.array(right), p.memory ** np.arange(1, 1 + len(one))[:, np.newaxis] * left
    sums = faded(one, p.fade), faded(other, p.fade)
    whole = np.maximum(*(largest_recent(each, p.memory) for each in sums))
    single = np.maximum(*(largest_recent(each, p.fade) for each in (one, other)))
    of_sums = p.sums[row] + unknown + p.tolerance[row] * whole + rough + in_sums
    of_steps = p.steps + tolerance * single + rough
    return np.abs(sums[0] - sums[1]) / of_sums, np.abs(one - other) / of_steps


def flows(commands, forces, past):
    """Flow of the valves at each sample, m/s; the newest command came with the sample before."""
    load = np.sqrt(1.0 - np.sign(commands) * forces / ACTUATOR[:, 3])
    sent = np.vstack([np.zeros((3, N)), commands * load])
    each = (part * sent[2 - k : -1 - k] for k, part in enumerate(past.T))
    return ACTUATOR[:, 0] * sum(each)


@pytest.mark.parametrize("drive", [0.0, 4.0])
def test_each_relation_is_held_against_its_threshold(drive):
    p, state = detectors(ALL)
    samples, commands = noise_of_a_rig(200)
    commands = (0.1 if drive else 1.0) * commands
    commands += drive * (1.0 - np.cos(0.1 * np.arange(200)))[:, np.newaxis]
    if drive:  # the valves' gains are 5 % larger than assumed
        moves = 1.05 * flows(commands, samples[:, 3], PAST[0])
        samples[:, 0] += DT * np.cumsum(moves, axis=0)
        samples[:, 1] += moves
        samples[:, 2] += np.gradient(moves, DT, axis=0)
    state.judge.resolution[:] = RESOLUTION
    seen = shares_of(p, state, samples, commands)
    assert not state.judge.counts.any()
    assert not seen[0].any()  # of a first sample there is nothing to compare
    _, v, a, f = samples.transpose(1, 0, 2)
    moved, steps = DT * mean(v), np.diff(samples, axis=0)
    found = relation(p, 0, steps[:, 0], moved, 2.0 * RESOLUTION, 0.1)
    np.testing.assert_allclose(seen[1:, rows.CHANGE], found[0], rtol=1e-9)
    jump = 0.5 * DT * np.abs(steps[:, 2])
    summed = np.maximum(jump, 0.5 * DT * np.abs(faded(steps[:, 2], p.fade)))
    found = relation(p, 1, steps[:, 1], DT * mean(a), 2.0 * RESOLUTION, 0.1, summed)
    np.testing.assert_allclose(seen[1:, rows.CHANGE + 1], found[0], rtol=1e-9)
    flow, later = (flows(commands, f, past) for past in PAST)
    oil, leakage = ACTUATOR[:, 1], ACTUATOR[:, 2]
    other = moved + (steps[:, 3] + DT * leakage * mean(f)) / oil
    one, tolerance = np.empty_like(other), np.empty_like(other)
    errors, covariance = np.zeros((N, 2)), np.zeros((N, 3))
    begin_following(errors, covariance)
    for k, (w, d) in enumerate(zip(mean(flow), mean(later), strict=True)):
        one[k] = DT * (w * (1.0 + errors[:, 0]) + d * errors[:, 1])
        for i in range(N):
            follow_valve(errors[i], covariance[i], w[i], d[i], other[k, i] / DT, p.doubt[i])
        tolerance[k] = 0.1 + 6.0 * np.sqrt(covariance[:, 0])
    held = 2.0 * DT * largest_recent(np.diff(flow, axis=0), p.fade)
    found = relation(p, 2, one, other, 2.0 * RESOLUTION / oil + held, np.minimum(tolerance, 0.35))
    np.testing.assert_allclose(seen[1:, rows.CHANGE + 2], found[0], rtol=1e-9)
    np.testing.assert_allclose(seen[1:, rows.OIL_NOISE], found[1], rtol=1e-9)
    assert seen[:, [rows.CHANGE + 2, rows.OIL_NOISE]].max() < 1.0
    np.testing.assert_allclose(state.errors, errors, rtol=1e-9)
    assert (covariance[:, 0] < 0.04**2).all() == (drive > 0.0)


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
    rise, jump = np.diff(a, axis=0), np.linalg.solve(MASS, np.diff(f, axis=0).T).T
    once = 0.5 * DT * np.maximum(np.abs(rise), np.abs(jump))
    both = (0.5 * DT * np.abs(faded(each, p.fade)) for each in (rise, jump))
    summed = np.maximum(once, np.maximum(*both))
    found = relation(p, 1, np.diff(v, axis=0), DT * mean(a), 2.0 * RESOLUTION, 0.1, summed)
    np.testing.assert_allclose(seen[1:, rows.CHANGE + 1], found[0], rtol=1e-9)
    for balance in (rows.CHANGE + rows.OIL, rows.OIL_NOISE):
        assert not seen[:, balance].any()  # there is no oil


def test_without_a_mass_a_held_force_says_nothing_of_the_acceleration():
    p, _ = detectors(ALL, has_valve=False, mass=np.zeros((N, N)))
    assert not p.by_force.any()


def test_the_flows_that_a_rig_may_hold_are_those_of_the_last_samples():
    flows = np.zeros(3)
    found = [hold(flows, each) for each in (1.0, -2.0, 4.0, 3.0, 3.5, 5.0)]
    assert found == [(0.0, 1.0), (-2.0, 1.0), (-2.0, 4.0), (-2.0, 4.0), (3.0, 4.0), (3.0, 5.0)]
    assert flows.tolist() == [5.0, 3.5, 3.0]


@pytest.mark.parametrize(
    ("other", "share", "counted"),
    [  # sides: 2, other, and 1 to 4 where a command is held; threshold 3, and 5 for missed commands
        (7.5, 3.5 / 3.0, 4),
        (-2.5, 3.5 / 3.0, 4),
        (7.0, 5.0 / 8.0, 0),
        (-2.0, 4.0 / 8.0, 0),
        (-1.0, 3.0 / 8.0, 0),
    ],
)
def test_what_no_command_explains_that_a_rig_may_hold_counts_more(other, share, counted):
    p, state = detectors(ALL, longest_hold=0.006)
    row = rows.OIL_NOISE
    look_at_sides(p, state, row, 1, (2.0, other, 1.0, 4.0), 3.0, 5.0)
    assert state.shares[row, 1] == share
    assert state.counts[row, 1] == counted * 2 // 4
    look_at_sides(p, state, row, 1, (12.0, 2.0, 2.0, 12.0), 3.0, 5.0)
    assert state.shares[row, 1] == 10.0 / 8.0
    assert state.counts[row, 1] == counted * 2 // 4 + 1


def test_what_the_rig_may_hold_is_summed():
    p, state = detectors(ALL, longest_hold=0.006)
    samples, commands = noise_of_a_rig(40)
    flowed = []
    for k in range(40):
        detect(p, state, k, NO_TARGET, samples[k])
        take_command(p, state, commands[k], False)
        flowed.append(state.flows[:, 0].copy())
    assert state.flows.shape == (N, 4)
    window = np.lib.stride_tricks.sliding_window_view(np.vstack([np.zeros((3, N)), flowed]), 4, 0)
    sums = state.sums
    np.testing.assert_allclose(sums[2, 0], faded(flowed, p.fade)[-1], rtol=1e-9)
    np.testing.assert_allclose(sums[2, 2], faded(window.min(axis=2), p.fade)[-1], rtol=1e-9)
    np.testing.assert_allclose(sums[2, 3], faded(window.max(axis=2), p.fade)[-1], rtol=1e-9)
    np.testing.assert_array_equal(sums[:2, 2], sums[:2, 0])
    np.testing.assert_array_equal(sums[:2, 3], sums[:2, 0])


@pytest.mark.parametrize("axis", [0, 1])
def test_a_valve_that_closes_is_found_before_one_that_may_hold_a_command(axis):
    p, state = detectors([each for each in ALL if each != "oil_noise"], longest_hold=0.02)
    commands, samples = np.full((90, N), 4.0), np.zeros((90, 4, N))
    speed = 4.0 * ACTUATOR[:, 0] * PAST[0].sum(axis=1)
    for closes in (True, False):
        commands[60:, axis] = 4.0 if closes else 0.0
        samples[:, 1], samples[:, 2:] = speed, 0.0
        if closes:  # or is stuck, as if the rig held the command
            samples[60, 1:3, axis] = 0.5 * speed[axis], -speed[axis] / DT
            samples[61:, 1, axis] = 0.0
            samples[60, 3] = MASS @ samples[60, 2]
        samples[1:, 0] = DT * np.cumsum(mean(samples[:, 1]), axis=0)
        state.sent[:], state.judge.resolution[:] = 4.0, RESOLUTION
        found = []
        for k in range(90):
            found.append(detect(p, state, k, NO_TARGET, samples[k]))
            take_command(p, state, commands[k], False)
        first = next(k for k, each in enumerate(found) if each >= 0)
        assert found[first] == (rows.OIL_NOISE) * N + axis
        # the flow of the last command leaves the window at 72; a few have counted once before
        assert first == (62 if closes else (74, 72)[axis])
        begin_detectors(state)


def test_a_bias_is_not_followed_while_its_relation_is_off():
    for row, relation_of in ((0, 0), (1, 1), (2, 2), (rows.OIL_NOISE, 2)):
        p, state = detectors(ALL)
        samples, commands = noise_of_a_rig(20)
        shares_of(p, state, samples, commands)
        state.counts[row, 1], before = 9, state.bias.copy()
        shares_of(p, state, samples[:1], commands[:1], [20])
        still = (state.bias == before).all(axis=1)
        assert not still[:, 0].any()
        assert still[:, 1].tolist() == [relation_of == each for each in range(3)]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_bias_is_followed_as_far_as_it_is_no_fault(sign):
    p, state = detectors(ALL)
    samples = np.zeros((2000, 4, N))
    samples[:, 1] = sign * np.array([1.0, 2.5]) * NOISE[1]
    for k in range(2000):
        state.counts[:] = 0
        detect(p, state, k, NO_TARGET, samples[k])
    np.testing.assert_allclose(state.bias[0, 0], -sign * DT * np.array([1.0, 2.0]) * NOISE[1], 1e-2)
    np.testing.assert_allclose(state.bias[:, 1], p.memory**1999, 1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("late", [0.0, 2e-3])
def test_a_derived_velocity_may_be_late(late, sign):
    p, state = detectors(ALL, velocity_is_derived=late > 0.0)
    samples, commands = np.zeros((2, 4, N)), np.zeros((2, N))
    samples[:, :3, 1] = sign * np.array([[0.0, 1.0, 10.0], [1.8e-3, 1.03, 12.0]])
    state.judge.resolution[:] = RESOLUTION
    seen = shares_of(p, state, samples, commands)[1, rows.CHANGE : rows.CHANGE + 2, 1]
    assert not state.judge.counts.any()
    moved, gained = 0.5 * DT * 2.03, 0.5 * DT * 22.0
    known = p.sums[:2, 1] + p.memory * p.bias[:2, 1] / (1.0 - p.fade)
    known += 2.0 * RESOLUTION
    threshold = known[0] + 0.1 * moved + late * 0.03
    assert seen[0] == pytest.approx((moved - 1.8e-3) / threshold, rel=1e-9)
    threshold = known[1] + 0.1 * 0.03 + (0.5 * DT + late) * 2.0
    assert seen[1] == pytest.approx((0.03 - gained) / threshold, rel=1e-9)


def test_a_valve_is_not_followed_while_its_balance_is_off():
    for row in (rows.CHANGE + rows.OIL, rows.OIL_NOISE):
        p, state = detectors(ALL)
        samples, commands = noise_of_a_rig(20)
        shares_of(p, state, samples, commands)
        state.counts[row, 1], before = 9, state.errors.copy()
        shares_of(p, state, samples[:1], commands[:1], [20])
        assert (state.errors != before).all(axis=1).tolist() == [True, False]


def test_the_gain_and_delay_of_a_valve_are_those_of_least_squares():
    rng = np.random.default_rng(1)
    flow, later, white = rng.normal(size=(3, 40))
    later *= 50.0
    seen = 1.07 * flow + 1e-3 * later + 0.1 * white
    errors, c = np.ones((1, 2)), np.ones((1, 3))
    begin_following(errors, c)
    for k in range(40):
        follow_valve(errors[0], c[0], flow[k], later[k], seen[k], 0.01)
    by = np.stack([flow, later], axis=1)
    information = by.T @ by / 0.01 + np.diag([0.15**-2, 2e-3**-2])
    expected = np.linalg.solve(information, by.T @ (seen - flow) / 0.01)
    np.testing.assert_allclose(errors[0], expected, rtol=1e-9)
    left = np.linalg.inv(information)
    np.testing.assert_allclose(c[0], [left[0, 0], left[1, 1], left[0, 1]], rtol=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_is_followed_of_a_valve_has_bounds(sign):
    errors, c = np.zeros((1, 2)), np.zeros((1, 3))
    begin_following(errors, c)
    for _ in range(100):
        follow_valve(errors[0], c[0], 1.0, 0.0, 1.0 + 9.0 * sign, 1e-3)
        follow_valve(errors[0], c[0], 0.0, 1.0, 9.0 * sign, 1e-9)
    np.testing.assert_array_equal(errors[0], [0.3 * sign, 5e-3 * sign])


def test_the_doubt_of_a_flow_is_the_noise_of_velocity_and_of_the_change_of_force():
    found = doubt(np.array([3.0]), np.array([8.0]), np.array([2.0]), 0.5)
    np.testing.assert_allclose(found, 9.0 + 2.0 * 8.0**2)  # a sample is longer than 0.1 s
    np.testing.assert_allclose(doubt(np.ones(1), np.zeros(1), np.ones(1), 0.002), 50.0)


def test_a_valve_under_load():
    assert under_load(1.0, 36.0, 100.0) == 0.8
    assert under_load(-1.0, -36.0, 100.0) == 0.8
    assert under_load(1.0, -44.0, 100.0) == 1.2
    assert under_load(0.0, 44.0, 100.0) == 1.2
    assert under_load(1.0, 99.0, 100.0) == math.sqrt(0.2)  # so much pressure is always left
    assert under_load(1.0, 99.0, math.inf) == 1.0


def test_where_a_sample_was_lost_the_command_was_held():
    p, state = detectors()
    samples, commands = noise_of_a_rig(40)
    held = np.repeat(commands, [1] * 19 + [3] + [1] * 20, axis=0)
    for step in range(21):
        detect(p, state, step, NO_TARGET, samples[min(step, 19)])
        take_command(p, state, held[step], False)
    sent, flow = state.sent.copy(), None
    begin_detectors(state)
    for step in range(20):
        detect(p, state, step, NO_TARGET, samples[step])
        take_command(p, state, commands[step], False)
    detect(p, state, 22, NO_TARGET, samples[20])
    flow = ACTUATOR[:, 0] * (PAST[0] * state.sent).sum(axis=1)
    np.testing.assert_array_equal(state.sent[:, 0], state.sent[:, 1])
    np.testing.assert_array_equal(state.sent[:, 0], sent[:, 0])
    np.testing.assert_allclose(state.flow[1], flow, rtol=1e-14)


def test_thresholds_are_six_times_what_noise_makes_of_each_relation():
    p, _ = detectors()
    impulse = np.eye(1, 4000)[0]

    def rms(weights, factor=0.0):
        return math.sqrt(np.sum(lfilter(weights, [1.0, -factor], impulse) ** 2))

    x, v, a, f = NOISE
    fade = math.exp(-DT / 0.05)
    for row, (jump, rate) in enumerate([(x, v), (v, a), (f / ACTUATOR[:, 1], v)]):
        of_sums, of_steps = (
            6.0 * np.hypot(jump * rms([1.0, -1.0], k), DT * rate * rms([0.5, 0.5], k))
            for k in (fade, 0.0)
        )
        np.testing.assert_allclose(p.bias[row], 2.0 * DT * rate, rtol=1e-9)
        np.testing.assert_allclose(p.sums[row], of_sums, rtol=1e-9)
        if row == rows.OIL:
            np.testing.assert_allclose(p.steps, of_steps, rtol=1e-9)
    rough = 6.0 * rms([1.0, -2.0, 1.0]) * np.sqrt(f**2 + MASS**2 @ a**2)
    np.testing.assert_allclose(p.rough, rough, rtol=1e-9)
    assert (p.short, p.memory) == (math.exp(-DT / 0.015), math.exp(-DT / 0.3))
    assert detectors(dt=0.004)[0].short == math.exp(-1.0 / 7.0)
