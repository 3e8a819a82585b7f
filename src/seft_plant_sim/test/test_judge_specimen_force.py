"""The specimen's force, sample by sample: its jumps, its noise, and its work."""

import math

import numpy as np
import pytest
from detector_samples import (
    ALL,
    COMPUTED,
    DT,
    MASS,
    NOISE,
    STIFFNESS,
    N,
    detect,
    detectors,
    faded,
    noise_of_a_rig,
    shares_of,
)
from seft_plant_sim.judge import detectors as rows
from seft_plant_sim.judge.specimen_force import look_at_restoring_force, look_at_strength

SLOW, FAST = 0.1, 1e-3
"""Fastest recent motion, m in a sample, against which 2 mm are little and much."""


@pytest.mark.parametrize("axis", [0, 1])
def test_work_against_the_specimen_is_reported_of_all_axes_at_once(axis):
    p, state = detectors(["force_jump"])
    samples, _ = noise_of_a_rig(90, size=0.3)
    t = DT * np.maximum(np.arange(90) - 59, 0)
    samples[:, :3, axis] += np.transpose([15.0 * t**2, 30.0 * t, 30.0 * (t > 0.0)])
    samples[:, 1, axis] -= 15.0 * DT * (t > 0.0)
    samples[:, 3, axis] -= 3e5 * 15.0 * t**2
    p.acts[:] = np.arange(len(ALL)) == rows.SECOND_ORDER_WORK
    found = [detect(p, state, k, samples[k]) for k in range(90)]
    assert max(found) == rows.SECOND_ORDER_WORK * N
    assert found.index(max(found)) == 66


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
    state.judge.axes[1].travel, state.largest[3, 1] = fastest, 300.0
    state.step[rows.TURN_AT], state.counts[rows.JUMP, 1] = 50 - turned, counted
    largest = 300.0 if counted else max(abs(r[0]), p.memory * 300.0)
    jump = r[2] - r[0] + counted * r[1]
    assert look_at_restoring_force(p, state, 50, measured, 1) == -1
    expected = abs(jump) / (part * largest + p.rough[1] + stiff)
    assert state.shares[rows.JUMP, 1] == pytest.approx(expected, rel=1e-9)
    assert state.largest[3, 1] == largest
    assert not state.shares[:, 0].any()


def test_a_force_that_jumps_back_and_forth_is_counted_as_noise():
    p, state = detectors(ALL)
    measured, now = np.zeros((4, N)), np.array([3000.0, -3000.0])
    measured[2], state.last[2] = now, [4000.0, 5000.0]
    curved = abs(DT**2 * STIFFNESS[1] @ (now + state.last[2]))
    measured[0, 1] = 0.01  # it moves, and bends by a part of that
    part = 0.5 * DT**2 * abs(now[1] + state.last[2, 1]) / 0.01
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
        state.step[rows.TURN_AT], state.largest[3, 1] = 50 - turned, 0.0
        limit = p.rough[1] + curved + (800.0 if turned < 4 else 0.0)
        if turned > 3:  # of the change, 70 N and the bend
            limit = (limit + math.copysign(70.0 * part, excess)) / (1.0 - part)
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


def test_the_last_turn_and_the_last_change_of_the_specimens_force_are_remembered():
    p, state = detectors(ALL)
    samples, _ = noise_of_a_rig(5)
    samples[:, 1] = np.transpose([[2.0, 1.0, -1.0, -2.0, 0.0], [2.0, 1.0, 2.0, 1.0, 2.0]]) * 1e-3
    r = samples[:, 3] - samples[:, 2] @ MASS
    turns = []
    for k in range(5):
        detect(p, state, k, samples[k])
        turns.append(state.step[rows.TURN_AT] == k)
        np.testing.assert_allclose(state.restoring[1], r[k] - r[max(k - 1, 0)], atol=1e-9)
    assert turns == [False, False, True, False, True]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_specimen_carries_less_where_it_is_deformed_farther(sign):
    p, state = detectors()
    way = sign * np.linalg.eigh(STIFFNESS)[1][0]
    steps = (  # displacement, part of the force that is left, and whether it is compared
        (0.01 * way, 1.0, True),
        (-0.02 * way, 0.6, True),  # the other direction has a memory of its own
        (-0.03 * way, 0.5, True),
        (0.02 * way, 0.6, True),
        (0.01 * way, 0.0, False),  # where it was before, it may have a gap
        *[(0.03 * way, 0.1, True)] * 3,
    )
    ends = []
    for x, left, is_compared in steps:
        measured = np.zeros((4, N))
        measured[0] = x
        state.restoring[2], state.shares[:] = left * STIFFNESS @ x, 0.0
        carried = state.carried[int(x @ way < 0.0), 1]
        ends.append(look_at_strength(p, state, measured))
        energy = x @ STIFFNESS @ x
        expected = carried * math.sqrt(energy)
        lost = (expected - left * energy) / (0.5 * expected + math.sqrt(x**2 @ p.rough**2))
        share = max(lost, 0.0) if is_compared else 0.0
        assert state.shares[rows.WEAKENS].tolist() == pytest.approx([share, 0.0])
    assert ends == [-1] * 7 + [rows.WEAKENS * N]
