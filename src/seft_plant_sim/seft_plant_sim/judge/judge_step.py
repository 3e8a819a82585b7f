"""The judge: each sample is compared with what the other channels expect, before anything uses it.

With displacement x, velocity v, acceleration a, actuator force f, the specimen's force r = f - M a
and the valve's flow w, the last sample (index 1) and the one before it (2), one expects

    x = x1 + dt (v + v1) / 2                                                               (1)
    v = v1 + dt (a + a1) / 2                                                               (2)
    f = f1 + dt k_oil (w - (v + v1) / 2) - dt lambda f1; 2 f1 - f2 if the oil is not known (3)
    r = 2 r1 - r2, so that a = M^-1 (f - r)                                                (4)

One wrong channel makes two of these fail, each another pair, and is replaced by its expected value:
the displacement (1) alone; the velocity (1), (2) and (3), but not (4); the force (3) and (4) by the
same amount; the acceleration (2) and (4). The specimen itself makes (4) fail when it sticks, slips,
yields or hits a stop: then the velocity follows the acceleration. If it does not do so yet, the
acceleration is replaced; in the next sample the velocity decides. Jumps that it has confirmed are
expected from then on.

A sample is compared with the judged one before, so that the second wrong sample in a row is found
like the first. More than a few in a short time end the test.
"""

import numpy as np
from seft_msgs_py.arrays import Floats

from seft_plant_sim.compiled import compiled
from seft_plant_sim.judge.judge import JudgeParameters, JudgeState

GATE = 0.15
"""Part of the largest recent force of the specimen by which r may jump without a confirmation: what
yielding does in a sample."""
USUAL = 1.5
"""Largest difference over the largest recent one that was accepted."""
SHOWN = 0.2
"""Part of a jump of the acceleration that the velocity must show at once: it shows the part of the
period after the jump."""
CALIBRATION_ERROR = 0.1
"""Part of the recent change in a sample by which (1) and (2) may fail: calibration, and channels
2 ms apart at 7 Hz."""
FLOW = 0.02
"""Likewise of the oil's change by the valve's flow in (3), beside the differences of before."""
BOTH = 2.0 / 3.0
"""Part of the largest noise that is beyond noise if (3) and (4) fail by the same amount."""

COARSEST = 1.0 / 128.0
"""Step of a converter of 8 bits, over its range."""

LONG_AGO = -(2**40)
NO_NUMBER = 1e9
"""A larger value is no value of a sensor, in any unit."""
X, V, A, F = range(4)
"""Rows of a sample."""


@compiled
def begin_judge(state: JudgeState) -> None:
    """Begin a test."""
    state.usual[:] = 0.0
    state.asked[:] = 0.0
    state.moves[:] = 0.0
    state.doubt[:] = 0.0
    state.jump[:] = 0.0
    state.off[:] = 0.0
    state.wrong[:] = LONG_AGO
    state.counts[:] = 0
    state.verdict[:] = 0
    state.resolution[:] = np.inf
    state.judged[:] = 0.0
    state.restoring[:] = 0.0
    state.raw[:] = 0.0
    state.taken[:] = -2


@compiled
def judge(
    p: JudgeParameters, state: JudgeState, step: int, raw: Floats, flow: Floats, judged: Floats
) -> None:
    """Judge a sample.

    Parameters
    ----------
    p, state
        The state is updated.
    step : int
        Of the sample. After a lost sample nothing can be compared; values that are no numbers
        are replaced in any case.
    raw : ndarray
        Displacement, velocity, acceleration and force, shape (4, n).
    flow : ndarray
        Mean flow of each valve since the last sample, shape (n,), m/s; not used without oil.
    judged : ndarray
        The result, shape (4, n).
    """
    n = raw.shape[1]
    is_next = step == state.taken[0] + 1
    state.taken[0] = step
    state.taken[1] = state.taken[1] + 1 if is_next else 0
    state.verdict[:] = 0
    for row in range(4):
        for i in range(n):
            state.moved[row, i] = abs(raw[row, i] - state.raw[row, i])
            state.raw[row, i] = raw[row, i]
            judged[row, i] = raw[row, i]
            if not abs(raw[row, i]) < NO_NUMBER:
                state.verdict[row, i] = 1
                judged[row, i] = state.judged[0, row, i]
            elif row == A and abs(raw[row, i]) >= p.range[row, i]:
                state.taken[2] = step
    if state.taken[1] > 0:
        for i in range(n):
            expect_missing(p, state, flow, judged, i)
        compare_accelerations(p, state, judged)
        for i in range(n):
            judge_motion(p, state, judged, i)
        is_replaced = False
        for i in range(n):
            is_replaced |= judge_force(p, state, flow, judged, i)
        if is_replaced:
            compare_accelerations(p, state, judged)
        for i in range(n):
            judge_acceleration(p, state, judged, i)
    keep(p, state, judged)
    for row in range(4):
        for i in range(n):
            moved = state.moved[row, i]
            if state.taken[1] > 0 and 0.0 < moved < state.resolution[row, i]:
                state.resolution[row, i] = moved
            is_at_range = (
                abs(judged[row, i]) >= p.range[row, i] and judged[row, i] * raw[row, i] > 0.0
            )
            if state.verdict[row, i] and not is_at_range:  # there the sensor can't do better
                state.wrong[row, i, state.counts[row, i] % state.wrong.shape[2]] = step
                state.counts[row, i] += 1


@compiled
def in_noise(p: JudgeParameters, state: JudgeState, relation: int, i: int, channel: int) -> float:
    """Difference of a relation by noise and by the resolution of its channel."""
    resolution = state.resolution[channel, i]
    if resolution == np.inf:  # it has not moved yet: by one step of its converter, if it does now
        coarsest = p.range[channel, i] * COARSEST
        resolution = min(state.moved[channel, i], coarsest) if coarsest < np.inf else 0.0
    return p.noise[relation, i] + 2.0 * resolution


@compiled
def accept(p: JudgeParameters, state: JudgeState, relation: int, i: int, off: float) -> None:
    """Remember an accepted difference."""
    state.usual[relation, i] = max(abs(off), p.recent * state.usual[relation, i])


@compiled
def ask(p: JudgeParameters, state: JudgeState, i: int, force: float) -> None:
    """Know what is asked of a rig that obeys forces: its force will differ as much from (3)."""
    last, before = state.asked[0, i], state.asked[1, i]
    turns = abs(force - 2.0 * last + before)
    state.asked[2, i] = max(turns, p.recent * state.asked[2, i])
    state.asked[0, i], state.asked[1, i] = force, last


@compiled
def expected_force(
    p: JudgeParameters, state: JudgeState, flow: Floats, judged: Floats, i: int
) -> float:
    """Relation (3)."""
    f1, f2, oil = state.judged[0, F, i], state.judged[1, F, i], p.oil[i, 0]
    if oil == 0.0:
        return 2.0 * f1 - f2
    moved = 0.5 * (judged[V, i] + state.judged[0, V, i])
    return f1 + p.dt * (oil * (flow[i] - moved) - p.oil[i, 1] * f1)


@compiled
def expect_missing(
    p: JudgeParameters, state: JudgeState, flow: Floats, judged: Floats, i: int
) -> None:
    """Expect values for those that are no numbers, before others are compared with them."""
    last = state.judged[0]
    if state.verdict[V, i]:
        a = last[A, i] if state.verdict[A, i] else judged[A, i]
        judged[V, i] = last[V, i] + 0.5 * p.dt * (a + last[A, i])
    if state.verdict[F, i]:
        judged[F, i] = expected_force(p, state, flow, judged, i)


@compiled
def compare_accelerations(p: JudgeParameters, state: JudgeState, judged: Floats) -> None:
    """Find the difference of (4), the expected accelerations, and what is beyond their gates."""
    n, off, r, a = judged.shape[1], state.off, state.restoring, state.judged
    knows = p.inverse[0, 0] != 0.0
    for i in range(n):
        off[0, i] = 0.0
        if knows:
            off[0, i] = judged[F, i] - 2.0 * r[0, i] + r[1, i]
            for k in range(n):
                off[0, i] -= p.mass[i, k] * judged[A, k]
    for i in range(n):
        jump, gate = judged[A, i] - 2.0 * a[0, A, i] + a[1, A, i], p.noise[1, i] / p.dt
        if knows:
            jump = gate = 0.0
            for k in range(n):
                curved = 0.0
                for m in range(n):
                    curved += abs(p.stiffness[k, m] * p.dt * p.dt * a[0, A, m])
                usual = max(GATE * state.moves[2, k], USUAL * state.usual[1, k])
                jump -= p.inverse[i, k] * off[0, k]
                rough = in_noise(p, state, 3, k, F) + curved + usual
                for m in range(n):
                    step = 2.0 * state.resolution[A, m]
                    rough += abs(p.mass[k, m]) * step if step < np.inf else 0.0
                gate += abs(p.inverse[i, k]) * rough
        off[1, i], off[2, i] = judged[A, i] - jump, jump if abs(jump) > gate else 0.0
    for i in range(n):
        if state.verdict[A, i]:
            judged[A, i], off[2, i] = off[1, i], 0.0


@compiled
def judge_motion(p: JudgeParameters, state: JudgeState, judged: Floats, i: int) -> None:
    """Judge velocity and displacement by (1) and (2); the acceleration may be wrong or jump."""
    last, dt = state.judged[0], p.dt
    x1, v1, a1 = last[X, i], last[V, i], last[A, i]
    bend = judged[A, i] - 2.0 * a1 + state.judged[1, A, i]
    jump = abs(state.off[2, i])
    a = state.off[1, i] if jump > 0.0 else judged[A, i]
    expected = v1 + 0.5 * dt * (a + a1)
    off = judged[V, i] - expected
    allowed = (
        in_noise(p, state, 1, i, V)
        + CALIBRATION_ERROR * state.moves[1, i]
        + (0.5 * dt + p.late) * abs(a - a1)
        + 0.125 * dt * abs(bend)  # the acceleration turns between the samples
        + max(dt * jump, 0.5 * dt * abs(judged[A, i] - state.off[1, i]))  # r turns at any time
    )
    if max(abs(judged[A, i]), abs(a1)) >= p.range[A, i]:
        allowed = np.inf  # it may be any larger one
    # if the displacement knows better, the acceleration misses what came between the samples
    by_expected = abs(judged[X, i] - x1 - 0.5 * dt * (expected + v1))
    by_measured = abs(judged[X, i] - x1 - 0.5 * dt * (judged[V, i] + v1))
    noise = in_noise(p, state, 0, i, X)
    knows = by_measured <= noise + CALIBRATION_ERROR * state.moves[0, i] and by_expected > noise
    is_wrong = abs(off) > allowed and not (knows and by_measured < by_expected)
    if is_wrong or state.verdict[V, i]:
        state.verdict[V, i] = 1
        judged[V, i] = expected
    v = judged[V, i]
    expected = x1 + 0.5 * dt * (v + v1)
    off = judged[X, i] - expected
    allowed = (
        in_noise(p, state, 0, i, X) + CALIBRATION_ERROR * state.moves[0, i] + p.late * abs(v - v1)
    )
    allowed += 0.125 * dt * dt * abs(a - a1) + 0.5 * dt * dt * jump
    if abs(off) > allowed or state.verdict[X, i]:
        state.verdict[X, i] = 1
        judged[X, i] = expected


@compiled
def judge_force(
    p: JudgeParameters, state: JudgeState, flow: Floats, judged: Floats, i: int
) -> bool:
    """Judge the force by (3) and (4); say whether it is replaced."""
    if state.verdict[F, i]:
        judged[F, i] = expected_force(p, state, flow, judged, i)
        return True
    knows_specimen = state.taken[0] - state.taken[2] > 2  # (4) needs the accelerations of three
    expected, r = expected_force(p, state, flow, judged, i), state.off[0, i]
    off, dt = judged[F, i] - expected, p.dt
    kink = 0.125 * dt * dt * abs(judged[A, i] - state.judged[0, A, i])
    usual = max(FLOW * abs(dt * flow[i]) * p.oil[i, 0], USUAL * state.usual[0, i])
    allowed = max(BOTH * in_noise(p, state, 2, i, F) + state.asked[2, i], usual)
    allowed += p.oil[i, 0] * kink
    allowed += state.doubt[i]  # what the last sample may be wrong by if it was replaced
    is_wrong = abs(off) > allowed and abs(r) > BOTH * in_noise(p, state, 3, i, F)
    is_wrong = is_wrong and knows_specimen and off * r > 0.5 * max(off * off, r * r)
    if is_wrong:
        state.verdict[F, i] = 1
        by_specimen = judged[F, i] - r  # unless it jumps in the same sample
        apart = abs(by_specimen - expected)
        state.doubt[i] = min(allowed, 0.5 * apart + BOTH * in_noise(p, state, 3, i, F))
        judged[F, i] = 0.5 * (expected + by_specimen) if apart < allowed else expected
    else:
        state.doubt[i] = 0.0
        accept(p, state, 0, i, off)
    return is_wrong


@compiled
def judge_acceleration(p: JudgeParameters, state: JudgeState, judged: Floats, i: int) -> None:
    """Judge the acceleration by (4), and by what the velocity shows of its jump."""
    jump, expected, before = state.off[2, i], state.off[1, i], state.off[3, i]
    state.jump[i] *= p.events
    state.off[3, i] = 0.0
    if state.verdict[A, i]:
        return
    if jump == 0.0:
        accept(p, state, 1, i, state.off[0, i])
        return
    last, dt, noise = state.judged[0], p.dt, p.noise[1, i]
    shown = judged[V, i] - last[V, i] - 0.5 * dt * (last[A, i] + expected)
    shown = shown if jump > 0.0 else -shown
    if dt * abs(jump) < noise:  # the velocity can't tell: what lasts for two samples is no spike
        is_shown = jump * before > 0.5 * before * before > 0.0
    else:
        is_shown = shown > max(0.5 * noise, SHOWN * dt * abs(jump))
    if is_shown:
        state.jump[i] = max(abs(jump), state.jump[i])
        place = (state.counts[A, i] - 1) % state.wrong.shape[2]
        if jump * before > 0.0 and state.wrong[A, i, place] == state.taken[0] - 1:
            state.counts[A, i] -= 1  # the sample before was not wrong
            state.wrong[A, i, place] = LONG_AGO
    elif abs(jump) >= USUAL * state.jump[i]:
        state.verdict[A, i] = 1
        state.off[3, i] = jump
        judged[A, i] = expected


@compiled
def keep(p: JudgeParameters, state: JudgeState, judged: Floats) -> None:
    """Keep a judged sample for the next one."""
    n = judged.shape[1]
    for i in range(n):
        for row in range(4):
            state.judged[1, row, i] = state.judged[0, row, i]
            state.judged[0, row, i] = judged[row, i]
        state.restoring[1, i] = state.restoring[0, i]
        r = judged[F, i]
        for k in range(n):
            r -= p.mass[i, k] * judged[A, k]
        state.restoring[0, i] = r
        state.moves[0, i] = max(p.dt * abs(judged[V, i]), p.brief * state.moves[0, i])
        state.moves[1, i] = max(p.dt * abs(judged[A, i]), p.brief * state.moves[1, i])
        state.moves[2, i] = max(abs(r), p.recent * state.moves[2, i])
        if state.taken[1] == 0:
            state.restoring[1, i] = r
            for row in range(4):
                state.judged[1, row, i] = judged[row, i]
