"""Detectors, sample by sample: what each sees, its threshold, and what comes of it."""

import math

import numpy as np
import pytest
from scipy.signal import lfilter
from seft_ros.protection import detectors as rows
from seft_ros.protection.detector_step import (
    SOUND,
    SUSPECT,
    begin_detectors,
    detect,
    detect_all,
    hold,
    look_at_restoring_force,
    look_at_sides,
    take_command,
    under_load,
)
from seft_ros.protection.detectors import (
    DETECTORS,
    begin_following,
    describe,
    detector_arrays,
    doubt,
    follow_valve,
    look,
)

DT, N = 0.002, 2
NOISE = np.array([[1e-5, 2e-5], [2e-3, 1e-3], [0.1, 0.2], [5.0, 3.0]])
LIMITS = np.array([0.1, 1.0, 50.0, 2e4])
ACTUATOR = np.array([[0.02, 1e7, 2.0, 2e4], [0.03, 2e7, 3.0, 3e4]])
"""Flow gain, oil stiffness, leakage, capacity."""
PAST = np.array([[[0.7, 0.2, 0.1], [0.5, 0.4, 0.1]], [[-90.0, 80.0, 10.0], [-70.0, 50.0, 20.0]]])
MASS = np.array([[60.0, 5.0], [5.0, 40.0]])
STIFFNESS = np.array([[2e5, -3e4], [-3e4, 1e5]])
COMPUTED = np.array([[90.0, 0.0], [0.0, 70.0]])


def detectors(warn_only=(), **changes):
    """Detectors that have begun, of two axes of which everything is known."""
    known = {
        **{"noise": NOISE, "limits": LIMITS, "ranges": np.zeros((4, N))},
        **{"velocity_is_derived": False, "actuator": ACTUATOR, "past": PAST, "mass": MASS},
        **{"stiffness": STIFFNESS, "computed_mass": COMPUTED, "warn_only": warn_only},
        **{"longest_hold": 0.0, "dt": DT, **changes},
    }
    p, state = detector_arrays(**known)
    begin_detectors(state)
    return p, state


def noise_of_a_rig(samples, seed=3, size=1.0):
    """Samples of sensors that see nothing but noise, and commands that are as small."""
    rng = np.random.default_rng(seed)
    return size * NOISE * rng.normal(size=(samples, 4, N)), 0.05 * rng.normal(size=(samples, N))


NO_TARGET = np.zeros((1, 1, N))


def shares_of(p, state, samples, commands, steps=None, points=NO_TARGET):
    """Part of its threshold that each detector sees at each sample, shape (N, D, n)."""
    found = []
    for place, step in enumerate(range(len(samples)) if steps is None else steps):
        state.shares[:] = 0.0
        assert detect(p, state, step, points, samples[place]) == SOUND
        take_command(p, state, commands[place], False)
        found.append(state.shares.copy())
    return np.array(found)


def faded(values, factor):
    return lfilter([1.0], [1.0, -factor], values, axis=0)


def largest_recent(values, factor):
    scale = factor ** np.arange(len(values))[:, np.newaxis]
    return np.maximum.accumulate(np.abs(values) / scale) * scale


def mean(values):
    return 0.5 * (values[1:] + values[:-1])


def coarse(values):
    """Twice the least change before each."""
    change = np.abs(np.diff(values, axis=0))
    least = np.minimum.accumulate(change, axis=0)
    return np.vstack([np.zeros((1, N)), 2.0 * least[:-1]])


def relation(p, row, one, other, rough, tolerance, in_sums=0.0, in_step=0.0):
    """Shares of the sums and of the single steps of a relation."""
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
    of_steps = p.steps[row] + tolerance * single + rough + in_step
    return np.abs(sums[0] - sums[1]) / of_sums, np.abs(one - other) / of_steps


def flows(commands, forces, past):
    """Flow of the valves at each sample, m/s; the newest command came with the sample before."""
    load = np.sqrt(1.0 - np.sign(commands) * forces / ACTUATOR[:, 3])
    sent = np.vstack([np.zeros((3, N)), commands * load])
    each = (part * sent[2 - k : -1 - k] for k, part in enumerate(past.T))
    return ACTUATOR[:, 0] * sum(each)


ALL = [one.name for one in DETECTORS]


@pytest.mark.parametrize("drive", [0.0, 4.0])
def test_each_relation_is_held_against_its_threshold(drive):
    p, state = detectors(ALL)
    samples, commands = noise_of_a_rig(200)
    commands += drive * np.sin(0.2 * np.arange(200))[:, np.newaxis]
    if drive:  # the valves' gains are 5 % larger than assumed
        moves = 1.05 * flows(commands, samples[:, 3], PAST[0])
        samples[:, 0] += DT * np.cumsum(moves, axis=0)
        samples[:, 1] += moves
        samples[:, 2] += np.gradient(moves, DT, axis=0)
    seen = shares_of(p, state, samples, commands)
    assert not seen[0].any()  # of a first sample there is nothing to compare
    x, v, a, f = samples.transpose(1, 0, 2)
    moved, steps = DT * mean(v), np.diff(samples, axis=0)
    found = relation(p, 0, steps[:, 0], moved, coarse(x), 0.1)
    np.testing.assert_allclose(seen[1:, rows.CHANGE], found[0], rtol=1e-9)
    np.testing.assert_allclose(seen[1:, rows.NOISE], found[1], rtol=1e-9)
    jump = 0.5 * DT * np.abs(steps[:, 2])
    summed = np.maximum(jump, 0.5 * DT * np.abs(faded(steps[:, 2], p.fade)))
    found = relation(p, 1, steps[:, 1], DT * mean(a), coarse(v), 0.1, summed, jump)
    np.testing.assert_allclose(seen[1:, rows.CHANGE + 1], found[0], rtol=1e-9)
    np.testing.assert_allclose(seen[1:, rows.NOISE + 1], found[1], rtol=1e-9)
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
    found = relation(p, 2, one, other, coarse(f) / oil + held, np.minimum(tolerance, 0.35))
    np.testing.assert_allclose(seen[1:, rows.CHANGE + 2], found[0], rtol=1e-9)
    np.testing.assert_allclose(seen[1:, rows.NOISE + 2], found[1], rtol=1e-9)
    assert seen[:, [rows.CHANGE + 2, rows.NOISE + 2]].max() < 1.0
    np.testing.assert_allclose(state.errors, errors, rtol=1e-9)
    assert (covariance[:, 0] < 0.04**2).all() == (drive > 0.0)


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
    row = rows.NOISE + rows.OIL
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
    sound = flows(commands, samples[:, 3], PAST[0])
    for closes in (True, False):
        commands[60:, axis] = 4.0 if closes else 0.0
        samples[:, 1] = sound
        samples[60:, 1, axis] *= not closes  # or is stuck, as if the rig held the command
        found = []
        for k in range(90):
            found.append(detect(p, state, k, NO_TARGET, samples[k]))
            take_command(p, state, commands[k], False)
        first = next(k for k, each in enumerate(found) if each >= 0)
        assert found[first] == (rows.NOISE + rows.OIL) * N + axis
        # the flow of the last command leaves the window at 72; a few have counted once before
        assert first == (62 if closes else (74, 72)[axis])
        begin_detectors(state)


def test_a_bias_is_not_followed_while_its_relation_is_off():
    for row in range(6):
        p, state = detectors(ALL)
        samples, commands = noise_of_a_rig(20)
        shares_of(p, state, samples, commands)
        state.counts[row, 1], before = 9, state.bias.copy()
        shares_of(p, state, samples[:1], commands[:1], [20])
        still = (state.bias == before).all(axis=1)
        assert not still[:, 0].any()
        assert still[:, 1].tolist() == [row % 3 == each for each in range(3)]


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
    samples[:, 1:3, 1] = sign * np.array([[1.0, 10.0], [3.0, 50.0]])
    seen = shares_of(p, state, samples, commands)[1, rows.NOISE : rows.NOISE + 2, 1]
    moved, gained = 0.5 * DT * 4.0, 0.5 * DT * 60.0
    threshold = p.steps[0, 1] + 0.1 * moved + late * 2.0
    assert seen[0] == pytest.approx(moved / threshold, rel=1e-9)
    threshold = p.steps[1, 1] + 0.1 * 2.0 + (0.5 * DT + late) * 40.0
    assert seen[1] == pytest.approx((2.0 - gained) / threshold, rel=1e-9)


def test_a_valve_is_not_followed_while_its_balance_is_off():
    for row in (rows.CHANGE + rows.OIL, rows.NOISE + rows.OIL):
        p, state = detectors(ALL)
        samples, commands = noise_of_a_rig(20)
        shares_of(p, state, samples, commands)
        state.counts[row, 1], before = 9, state.errors.copy()
        shares_of(p, state, samples[:1], commands[:1], [20])
        assert (state.errors != before).all(axis=1).tolist() == [True, False]


def test_a_new_test_knows_nothing_of_the_one_before():
    p, state = detectors(ALL)
    samples, commands = noise_of_a_rig(60, size=40.0)
    samples[20:40:2, 0, 1] = samples[21:41:2, 0, 1]
    points = np.ascontiguousarray(samples[:1, :3])
    first = shares_of(p, state, samples, commands, points=points)
    shares_of(p, state, samples[:40, :, ::-1], commands)
    begin_detectors(state)
    assert not state.shares.any()
    again = shares_of(p, state, samples, commands, points=points)
    np.testing.assert_array_equal(again, first)


def of_what(detector, axis):
    """Samples, and what is wrong in them from sample 60 on, that this detector alone should see."""
    samples, commands = noise_of_a_rig(100, size=0.3)
    wrong = np.zeros((100, 4))
    to_and_fro = (-1.0) ** np.arange(40)
    what = {
        "displacement_velocity": (0, 2e-3),
        "velocity_acceleration": (1, 0.5),
        "oil_balance": (3, 3e4),
        "displacement_noise": (0, 1e-3 * to_and_fro),
        "velocity_noise": (1, 0.5 * to_and_fro),
        "oil_noise": (3, 5e3 * to_and_fro),
        "force_noise": (3, 500.0 * to_and_fro),
        "force_jump": (3, 500.0),
        "force_response": (2, 50.0 * to_and_fro),
    }
    row, off = what[detector]
    wrong[60:, row] = off
    samples[:, :, axis] += wrong
    return samples, commands


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("name", ALL[:6] + ALL[7:10])
def test_what_a_detector_finds_is_told_by_row_and_axis(name, axis):
    p, state = detectors([each for each in ALL if each != name])
    samples, commands = of_what(name, axis)
    found = []
    for k in range(100):
        found.append(detect(p, state, k, NO_TARGET, samples[k]))
        take_command(p, state, commands[k], False)
    first = next(k for k, each in enumerate(found) if each >= 0)
    assert found[first] == ALL.index(name) * N + axis
    assert set(found[:60]) == {SOUND}
    assert 60 < first <= 60 + 2 * p.persistence[ALL.index(name)] + 2


@pytest.mark.parametrize("axis", [0, 1])
def test_work_against_the_specimen_is_told_of_all_axes_at_once(axis):
    p, state = detectors(["force_jump"])
    samples, _ = noise_of_a_rig(90, size=0.3)
    falls = np.maximum(np.arange(90) - 59, 0)
    samples[:, 0, axis] += 1e-3 * falls
    samples[:, 3, axis] -= 300.0 * falls
    p.acts[:] = np.arange(len(ALL)) == rows.SECOND_ORDER_WORK
    found = [detect(p, state, k, NO_TARGET, samples[k]) for k in range(90)]
    assert max(found) == rows.SECOND_ORDER_WORK * N
    assert found.index(max(found)) == 62


SLOW, FAST = 0.1, 1e-3
"""Fastest recent motion, m in a sample, against which 2 mm are little and much."""


@pytest.mark.parametrize(
    ("way", "r", "fastest", "turned", "counted", "part", "stiff"),
    [  # of the specimen: its way on both axes; r before, its last change, and now
        ((1e-3, 2e-3), (100.0, 7.0, 400.0), FAST, 4, 0, 0.35, 6 * 200.0),  # rises with the motion
        ((1e-3, 2e-3), (-100.0, 7.0, -400.0), FAST, 4, 0, 0.35, 6 * 30.0),  # falls with the other's
        ((0.0, 2e-3), (-900.0, 7.0, -1200.0), 8e-3, 4, 0, 0.25, 0.0),
        ((-1e-3, -2e-3), (-100.0, 7.0, -400.0), FAST, 4, 0, 0.35, 6 * 200.0),
        ((0.0, 2e-3), (100.0, -7.0, -400.0), FAST, 4, 0, 0.25, 0.0),  # breaks
        ((0.0, -2e-3), (100.0, -7.0, 400.0), FAST, 4, 0, 0.25, 0.0),
        ((0.0, -2e-3), (-100.0, -7.0, 400.0), FAST, 3, 0, 2.0, 0.0),  # the motion has turned
        ((1e-3, -2e-3), (900.0, -7.0, 400.0), SLOW, 9, 0, 2.0, 6 * 230.0),  # or sticks
        ((0.0, 2e-3), (900.0, 70.0, 400.0), FAST, 9, 1, 0.25, 0.0),  # it has jumped before
    ],
)
def test_how_far_the_force_of_a_specimen_may_jump(way, r, fastest, turned, counted, part, stiff):
    p, state = detectors(ALL)
    state.last[0], measured = [0.25, -0.5], np.zeros((4, N))
    measured[0] = state.last[0] + way
    state.restoring[:, 1] = r
    state.largest[3, 1], state.largest[7, 1] = fastest, 300.0
    state.step[rows.TURN_AT], state.counts[rows.JUMP, 1] = 50 - turned, counted
    largest = 300.0 if counted else max(abs(r[0]), p.memory * 300.0)
    jump = r[2] - r[0] + counted * r[1]
    assert look_at_restoring_force(p, state, 50, measured, 1) == -1
    expected = abs(jump) / (part * largest + p.rough[1] + stiff)
    assert state.shares[rows.JUMP, 1] == pytest.approx(expected, rel=1e-9)
    assert state.largest[7, 1] == largest
    assert not state.shares[:, 0].any()


def test_a_force_that_jumps_back_and_forth_is_counted_as_noise():
    p, state = detectors(ALL)
    measured, now = np.zeros((4, N)), np.array([3000.0, -3000.0])
    measured[2], state.last[2] = now, [4000.0, 5000.0]
    curved = abs(DT**2 * STIFFNESS[1] @ (now + state.last[2]))
    measured[0, 1] = 1.0  # it moves
    count, before = 0.0, 0.0
    for excess, turned in [
        (1, 9),
        (-1, 9),
        (-1, 9),
        (1, 9),
        (0, 9),
        (0, 2),
        (1, 9),
        (-1, 2),
        (1, 2),
        (1, 2),
    ]:
        state.step[rows.TURN_AT], state.largest[7, 1] = 50 - turned, 0.0
        limit = p.rough[1] + curved + (400.0 if turned < 4 else 0.0)
        bend = math.copysign(1.0, excess) * limit * (1.0 + (1e-6 if excess else -1e-6))
        state.restoring[:, 1] = 200.0, 70.0, 270.0 + bend
        state.counts[rows.JUMP, 1] = 0
        look_at_restoring_force(p, state, 50, measured, 1)
        kept = bend if excess else 0.0
        turns = kept * before < 0.0
        count = p.short * count + turns if turns or turned > 3 else count
        before = kept
        np.testing.assert_allclose(state.bends[:, 1], [kept, count], rtol=1e-9, atol=1e-9)
    share = state.shares[rows.ROUGH, 1] * 0.33 / (1.0 - p.short)
    assert share == pytest.approx(count, rel=1e-9)


@pytest.mark.parametrize("axis", [0, 1])
def test_of_several_that_find_something_the_first_is_told(axis):
    p, state = detectors(["force_jump", "force_noise"])
    samples, _ = noise_of_a_rig(12, size=0.3)
    samples[5:, 0, axis] += 0.02
    samples[5:, 1, axis] += 5.0
    found = [detect(p, state, k, NO_TARGET, samples[k]) for k in range(8)]
    assert (state.counts[:2, axis] >= 3).all()
    assert found[5:] == [SUSPECT, SUSPECT, axis]


def test_the_specimen_is_held_against_its_thresholds():
    p, state = detectors()
    samples, commands = noise_of_a_rig(200)
    seen = shares_of(p, state, samples, commands)
    change = np.diff(samples, axis=0)
    r = samples[:, 3] - samples[:, 2] @ MASS
    moved, jump = change[:, 0], np.diff(r, axis=0)
    noise = NOISE[3] ** 2 + MASS**2 @ NOISE[2] ** 2
    sums = np.array(
        [
            (jump * moved).sum(axis=1),
            (moved * (moved @ STIFFNESS)).sum(axis=1),
            2.0 * (noise * moved**2 + (NOISE[0] * jump) ** 2).sum(axis=1),
        ]
    )
    done, elastic, square = faded(sums.T, p.short).T
    share = np.maximum(-done / (0.5 * elastic + 6.0 * np.sqrt(square)), 0.0)
    np.testing.assert_allclose(seen[1:, rows.SECOND_ORDER_WORK, 0], share, rtol=1e-9, atol=1e-15)
    assert not seen[:, rows.SECOND_ORDER_WORK, 1].any()
    inertia = faded((change[:, 2] @ COMPUTED) ** 2, p.short)
    recent_samples, white = 1.0 / (1.0 - p.short), 2.0 * NOISE[3] ** 2
    hiss = 2.0 * COMPUTED**2 @ NOISE[2] ** 2
    is_noise = faded(change[:, 3] ** 2, p.short) < 2.0 * recent_samples * white
    share = np.where(is_noise, inertia / (25.0 * recent_samples * (white + hiss)), 0.0)
    assert 0 < is_noise.sum() < is_noise.size
    np.testing.assert_allclose(seen[1:, rows.NO_RESPONSE], share, rtol=1e-9)


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


def test_a_detector_acts_once_it_is_beyond_its_threshold_for_its_persistence():
    p, state = detectors(["tracking"])
    row, lasts = rows.CHANGE, p.persistence[rows.CHANGE]
    assert lasts == 3
    seen = [1.0, 1.5, 1.25, 1.0, 0.5, 1.5, 1.5, 1.5, 1.75]
    found = [look(p, state, row, 1, 2.0 * each, 2.0) for each in seen]
    assert found == [False] * 7 + [True, True]
    assert state.found.tolist() == [3.5, 2.0]
    assert not look(p, state, row, 0, 9.0, 0.0)  # a threshold of nothing is none
    assert state.shares[row].tolist() == [0.0, 1.75]
    assert state.counts[row].tolist() == [0, 4]
    assert not any(look(p, state, rows.TRACKING, 0, 9.0, 1.0) for _ in range(99))  # it warns
    assert state.shares[rows.TRACKING, 0] == 9.0


def test_persistences_in_samples():
    p, _ = detectors(["oil_noise", "force_jump"], longest_hold=0.02)
    lasts = dict(zip((one.name for one in DETECTORS), p.persistence.tolist(), strict=True))
    assert lasts.pop("oil_balance") == lasts.pop("oil_noise") == 13
    assert lasts.pop("force_response") == lasts.pop("tracking") == 10
    assert [lasts.pop(name) for name in ("force_noise", "force_jump")] == [2, 2]
    assert [lasts.pop(f"{each}_frozen") for each in ("position", "velocity")] == [2, 2]
    assert [lasts.pop(f"{each}_frozen") for each in ("acceleration", "force")] == [2, 2]
    assert set(lasts.values()) == {3}
    rare, _ = detectors(dt=0.004)
    lasts = dict(zip((one.name for one in DETECTORS), rare.persistence.tolist(), strict=True))
    assert {lasts[name] for name in ALL[:7]} == {3}
    assert (lasts["tracking"], lasts["force_jump"], lasts["force_frozen"]) == (5, 2, 2)
    assert p.samples.tolist() == [5 if one.of_valve else 1 for one in DETECTORS]
    only_warn = [one.name for one, acts in zip(DETECTORS, p.acts, strict=True) if not acts]
    assert only_warn == ["oil_noise", "force_jump"]
    assert set(p.acts) == {0, 1}


@pytest.mark.parametrize("missing", [1, 2])
def test_where_a_sample_was_lost_nothing_is_compared(missing):
    p, state = detectors()
    samples, commands = noise_of_a_rig(40)
    whole = shares_of(p, state, samples, commands)
    begin_detectors(state)
    lost = shares_of(p, state, samples, commands, [*range(20), *range(20 + missing, 40 + missing)])
    np.testing.assert_array_equal(lost[:20], whole[:20])
    assert not lost[20].any()
    assert lost[21].any()


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


@pytest.mark.parametrize("row", range(4))
def test_a_channel_at_the_end_of_its_range_is_compared_with_nothing_until_it_is_back(row):
    ranges = np.zeros((4, N))
    ranges[row, 1] = 1e3
    p, state = detectors([one.name for one in DETECTORS], ranges=ranges)
    samples, commands = noise_of_a_rig(12)
    samples[5, row, 1] = -1e3
    seen = shares_of(p, state, samples, commands)
    watched = {0: (0, 3), 1: (0, 1, 2, 3, 4, 5), 2: (1, 4), 3: (2, 5)}[row]
    blind = np.array([not seen[k, watched].any() for k in range(1, 12)])
    assert blind.tolist() == [k in (5, 6) for k in range(1, 12)]
    silent = [not seen[k, rows.NO_RESPONSE].any() for k in (5, 6)]
    assert silent == [row > 1] * 2


@pytest.mark.parametrize("off", [1e-3, -1e-3])
def test_a_spike_makes_a_sample_suspect_and_a_jump_ends_the_test(off):
    for stays in (False, True):
        p, state = detectors()
        samples, commands = noise_of_a_rig(12, size=0.3)
        samples[5:, 0, 1] += off * (stays | (np.arange(5, 12) == 5))
        found = [detect(p, state, k, NO_TARGET, samples[k]) for k in range(8)]
        assert found[:5] == [SOUND] * 5
        assert found[5:7] == [SUSPECT] * 2
        assert found[7] == (rows.CHANGE * N + 1 if stays else SUSPECT)
    assert commands.any()


def test_a_detector_that_only_warns_puts_nothing_under_suspicion():
    p, state = detectors([one.name for one in DETECTORS])
    samples, _ = noise_of_a_rig(20, size=0.3)
    samples[5:, :, 1] += 100.0 * NOISE[:, 1]
    assert {detect(p, state, k, NO_TARGET, samples[k]) for k in range(20)} == {SOUND}
    assert state.shares.max() > 1.0


@pytest.mark.parametrize("row", range(4))
def test_a_channel_that_is_coarse_or_at_the_end_of_its_range_is_not_frozen(row):
    ranges = np.zeros((4, N))
    ranges[row, 0] = 1e3
    p, state = detectors(ALL, ranges=ranges)
    samples, commands = noise_of_a_rig(60, size=0.3)
    samples[20:, row, 0] = 1e3
    samples[:30, row, 1] = 2.7 * NOISE[row, 1] * (np.arange(30) % 2)  # 0.76: no small chance
    samples[30:, row, 1] = 0.0
    assert not shares_of(p, state, samples, commands)[:, rows.FROZEN + row].any()


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("row", range(4))
def test_a_channel_that_repeats_a_value_is_frozen_once_that_is_no_chance(row, axis):
    p, state = detectors([each for each in ALL if not each.endswith("_frozen")])
    samples, _ = noise_of_a_rig(60, size=0.3)
    step = 0.2 * NOISE[row, axis]
    samples[:, row, axis] = step * (np.arange(60) // 2 % 2)
    samples[30:, row, axis] = step
    most = math.log(1e-9) / math.log(0.2 / (2.0 * math.sqrt(math.pi)))
    frozen = rows.FROZEN + row
    for k in range(60):
        state.shares[:] = 0.0
        found = detect(p, state, k, NO_TARGET, samples[k])
        same = k - 30 if k > 30 else k % 2
        expected = same / most if k > 2 else 0.0
        assert state.shares[frozen, axis] == pytest.approx(expected, rel=1e-9)
        if found >= 0:
            assert found == frozen * N + axis
            assert k == 30 + math.floor(most) + 2
            break
        assert found == (SUSPECT if same > 2.0 * most / 3.0 else SOUND)
    assert found >= 0


def test_a_target_must_be_followed_but_not_while_the_valve_is_at_its_limit():
    p, state = detectors()
    samples, commands = noise_of_a_rig(200, size=0.0)
    samples[:, 0] = 1e-9 * np.arange(200)[:, np.newaxis] % 3e-9
    points = np.zeros((1, 3, N))
    points[0, 0] = 0.25, 0.0
    threshold = p.sums[0, 0] + p.bias[0, 0] / (1.0 - p.fade) + 0.5 * 0.25
    found = []
    for k in range(200):
        state.shares[:] = 0.0
        found.append(detect(p, state, k, points, samples[k]))
        share = state.shares[rows.TRACKING, 0]
        limited = 100 <= k - 1 <= 100 + 49
        expected = 0.0 if limited or not k else (0.25 - samples[k, 0, 0]) / threshold
        assert share == pytest.approx(expected, rel=1e-9)
        take_command(p, state, commands[k] * 0.0, k == 100)
        if k >= 99:
            state.counts[rows.TRACKING] = 0
    assert found[:11] == [SOUND] * 10 + [rows.TRACKING * N]


def test_the_targets_largest_motion_is_remembered():
    p, state = detectors(ALL)
    samples, commands = noise_of_a_rig(6, size=0.0)
    points = np.zeros((1, 3, N))
    for k, (target, there) in enumerate([(0.0, 0.0), (-0.25, -0.5), (0.0, -0.25), (0.0, 0.01)]):
        points[0, 0, 1], samples[k, 0, 1] = target, there
        state.shares[:] = 0.0
        detect(p, state, k, points, samples[k])
        take_command(p, state, commands[k] * 0.0, False)
        if k:
            largest = 0.5 * p.memory ** (k - 1)
            away = (0.25, 0.25, 0.01)[k - 1]
            bias = p.bias[0, 1] / (1.0 - p.fade)
            expected = away / (p.sums[0, 1] + bias + 0.5 * largest)
            assert state.shares[rows.TRACKING, 1] == pytest.approx(expected, rel=1e-9)


def test_a_whole_test_gives_the_shares_of_its_samples():
    p, state = detectors()
    samples, commands = noise_of_a_rig(50)
    commands[7, 1] = -0.5
    expected, steps = [], np.array([*range(30), *range(33, 53)])
    points = 0.1 * np.random.default_rng(5).normal(size=(50, 3, N))
    for k, step in enumerate(steps):
        detect(p, state, step, points[k : k + 1], samples[k])
        take_command(p, state, commands[k], bool(np.any(np.abs(commands[k]) >= 0.5)))
    expected = [values.copy() for values in state]
    begin_detectors(state)
    detect_all(p, state, steps, points, samples, commands, 0.5)
    for values, again in zip(expected, state, strict=True):
        np.testing.assert_array_equal(values, again)
    assert state.step[rows.LIMITED_AT] == 7


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
        np.testing.assert_allclose(p.steps[row], of_steps, rtol=1e-9)
    rough = 6.0 * rms([1.0, -2.0, 1.0]) * np.sqrt(f**2 + MASS**2 @ a**2)
    np.testing.assert_allclose(p.rough, rough, rtol=1e-9)
    assert (p.short, p.memory) == (math.exp(-DT / 0.015), math.exp(-DT / 0.3))
    assert detectors(dt=0.004)[0].short == math.exp(-1.0 / 7.0)


def test_a_valve_without_gain_or_oil_and_a_specimen_without_stiffness_are_not_known():
    actuator = ACTUATOR.copy()
    actuator[0, 0] = actuator[1, 1] = actuator[1, 3] = 0.0
    p, _ = detectors(actuator=actuator, ranges=np.full((4, N), 0.5))
    assert np.isinf(p.sums[rows.OIL]).all()
    np.testing.assert_array_equal(p.actuator[:, 3], [2e4, np.inf])
    np.testing.assert_array_equal(p.range, 0.5)
    for unknown in ("mass", "stiffness"):
        assert np.isinf(detectors(**{unknown: np.zeros((N, N))})[0].rough).all()


def test_what_is_not_known_of_the_hardware_is_not_watched():
    nothing, names = np.zeros((N, N)), [one.name for one in DETECTORS]
    unknown = {"noise": np.zeros((4, N)), "mass": nothing, "stiffness": nothing}
    p, state = detectors(actuator=np.zeros((N, 4)), computed_mass=nothing, **unknown)
    np.testing.assert_allclose(p.noise, 1e-3 * LIMITS[:, np.newaxis] * np.ones(N))
    samples, commands = noise_of_a_rig(50, size=0.1)
    seen = shares_of(p, state, samples, commands).max(axis=(0, 2))
    watched = {name for name, share in zip(names, seen, strict=True) if share > 0.0}
    assert watched == set(names[:2]) | set(names[3:5])
    derived, _ = detectors(velocity_is_derived=True)
    np.testing.assert_allclose(derived.noise[1], math.sqrt(2.0) * NOISE[0] / DT)


def test_a_detector_says_what_it_saw_and_where():
    found = np.array([0.01234, 0.005])
    assert describe(rows.CHANGE * N + 1, found, ("east", "north")) == (
        "measured displacement and velocity disagree on axis north: they differ by 0.0123 m over "
        "the last 50 ms (0.005 m allowed): displacement_velocity"
    )
    assert describe((rows.FROZEN + 3) * N, found, ("east", "north")).startswith(
        "measured force on axis east has repeated one value for 0.0123 samples"
    )


def test_the_last_turn_and_the_last_change_of_the_specimens_force_are_remembered():
    p, state = detectors(ALL)
    samples, _ = noise_of_a_rig(5)
    samples[:, 1] = np.transpose([[0.5, 0.25, -0.25, -0.5, 0.0], [0.5, 0.25, 0.5, 0.25, 0.5]])
    r = samples[:, 3] - samples[:, 2] @ MASS
    turns = []
    for k in range(5):
        detect(p, state, k, NO_TARGET, samples[k])
        turns.append(state.step[rows.TURN_AT] == k)
        np.testing.assert_allclose(state.restoring[1], r[k] - r[max(k - 1, 0)], atol=1e-9)
    assert turns == [False, False, True, False, True]
