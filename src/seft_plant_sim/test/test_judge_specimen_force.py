"""The specimen's force, sample by sample: its jumps and its work."""

import math

import numpy as np
import pytest
from detector_samples import (
    ALL,
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
from seft_plant_sim.judge.specimen_force import (
    is_elastic,
    look_at_restoring_force,
    look_at_strength,
)

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
    ("way", "r", "fastest", "turned", "part", "stiff"),
    [  # of the specimen: its way on both axes; r before, and now
        ((1e-3, 2e-3), (100.0, 400.0), FAST, 4, 0.35, 6 * 200.0),  # rises with the motion
        ((1e-3, 2e-3), (-100.0, -400.0), FAST, 4, 0.35, 6 * 30.0),  # falls with the other's
        ((0.0, 2e-3), (-900.0, -1200.0), 8e-3, 4, 0.25, 0.0),
        ((-1e-3, -2e-3), (-100.0, -400.0), FAST, 4, 0.35, 6 * 200.0),
        ((0.0, 2e-3), (100.0, -400.0), FAST, 4, 0.25, 0.0),  # breaks
        ((0.0, -2e-3), (100.0, 400.0), FAST, 4, 0.25, 0.0),
        ((0.0, -2e-3), (-100.0, 400.0), FAST, 3, 2.0, 0.0),  # the motion has turned
        ((1e-3, -2e-3), (900.0, 400.0), SLOW, 9, 2.0, 6 * 230.0),  # or sticks
    ],
)
@pytest.mark.parametrize("before", [0.0, 70.0])
def test_how_far_the_force_of_a_specimen_may_jump(way, r, fastest, turned, part, stiff, before):
    p, state = detectors(ALL)
    state.last[0], measured = [0.25, -0.5], np.zeros((4, N))
    measured[0] = state.last[0] + way
    state.restoring[:, 1], state.changes[1, :, 0] = r, (before, 1.0)
    axis = state.judge.axes[1]
    axis.travel, state.largest[3, 1], state.step[rows.TURN_AT] = fastest, 300.0, 50 - turned
    assert look_at_restoring_force(p, state, 50, measured, 1) == -1
    assert not state.shares.any()  # no event
    axis.alive[0].event[:2] = 1.0, before
    assert state.largest[3, 1] == max(abs(r[0]), p.memory * 300.0)
    jump = r[1] - r[0] + before
    axis.known = 0.49 * abs(jump)
    assert look_at_restoring_force(p, state, 50, measured, 1) == -1
    is_stop = before and stiff  # the change before it is as stiff: 70 N within 1 m
    threshold = part * state.largest[3, 1] + p.rough[1] + stiff
    expected = 0.0 if is_stop else abs(jump) / threshold
    assert state.shares[rows.JUMP, 1] == pytest.approx(expected, rel=1e-9)
    assert not state.shares[:, 0].any()


def test_a_confirmed_event_is_a_stop_or_like_those_before():
    p, state = detectors()
    measured, axis, shares = np.zeros((4, N)), state.judge.axes[1], []
    measured[0, 1], axis.alive[0].event[1] = 1e-3, 1.0
    state.changes[1] = [[9e9, 0.0], [1e-3, 1e-3]]
    for known, turned, now in ((0.49, 3, 0.0), (0.51, 3, 0.0), (0.51, 4, 0.0), (0.0, 4, 4.6e9)):
        state.step[rows.TURN_AT], axis.known, state.shares[:] = 50 - turned, known * 9e9, 0.0
        state.restoring[1, 1] = now
        look_at_restoring_force(p, state, 50, measured, 1)
        shares.append(state.shares[rows.JUMP, 1] > 1.0)
    assert shares == [True, False, True, False]


def test_a_stop_presses_on_or_has_pressed_and_what_slips_does_so_once():
    slip, stop, left = np.array(
        [[[800.0, before], [1e-3, 2e-3]] for before in (70.0, 70.0, 1700.0)]
    )
    assert not is_elastic(slip, 70.0, 1e-3, 10.0)
    assert is_elastic(stop, 390.0, 1e-3, 10.0)
    assert not is_elastic(stop, 390.0, 2e-3, 10.0)  # it should have pressed twice as much
    assert is_elastic(left, 70.0, 1e-3, 10.0)
    assert is_elastic(slip, 0.0, 1e-6, 10.0)  # it hardly moves: nobody knows


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


def test_the_last_turn_and_the_last_change_of_the_specimens_force_are_remembered():
    p, state = detectors(ALL)
    samples, _ = noise_of_a_rig(5)
    samples[:, 1] = np.transpose([[2.0, 1.0, -1.0, -2.0, 0.0], [2.0, 1.0, 2.0, 1.0, 2.0]]) * 1e-3
    r = samples[:, 3] - samples[:, 2] @ MASS
    turns = []
    for k in range(5):
        detect(p, state, k, samples[k])
        turns.append(state.step[rows.TURN_AT] == k)
        np.testing.assert_allclose(state.changes[:, 0, 0], r[k] - r[max(k - 1, 0)], atol=1e-9)
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
        state.restoring[1], state.shares[:] = left * STIFFNESS @ x, 0.0
        carried = state.carried[int(x @ way < 0.0), 1]
        ends.append(look_at_strength(p, state, measured))
        energy = x @ STIFFNESS @ x
        expected = carried * math.sqrt(energy)
        lost = (expected - left * energy) / (0.5 * expected + math.sqrt(x**2 @ p.rough**2))
        share = max(lost, 0.0) if is_compared else 0.0
        assert state.shares[rows.WEAKENS].tolist() == pytest.approx([share, 0.0])
    assert ends == [-1] * 7 + [rows.WEAKENS * N]
