"""The judge: each sample is judged by likelihood, before anything uses it.

With displacement x, velocity v, acceleration a, actuator force f, the specimen's force r = f - M a
and the valve's flow w, four relations tie a sample of an axis to the ones before (indices 1, 2);
k_oil and lambda are those of the oil, and dt is h::

    x = x1 + h (v + v1) / 2 - h^2 (a - a1) / 12                                            (1)
    v = v1 + h (a + a1) / 2                                                                (2)
    f = f1 + k_oil (h w - h (v + v1) / 2 + h^2 (a - a1) / 12) - h lambda f1                (3)
        or 2 f1 - f2 if the oil is not known
    r = 2 r1 - r2                                                                          (4)

in short L y = D y1 + ... + u, where the covariance of u is the diagonal Q: what the relations leave
out. Of a measured sample z = y + noise + wrong, the residuals e = L z - D y1 - ... have the
covariance S = Q + L R L' + D P D', with the variances R of the noise and P of the last values.

A hypothesis is a set of unknown amplitudes b: of wrong channels, which add L b to e, of an event of
the specimen (it sticks, slips, yields, hits a stop), which adds to (4), and of the oil, to (3). Its
weight is its prior times the likelihood of e, b integrated out by Laplace's method. Histories that
remain likely live on in branches with states of their own, and the next samples decide: what was
wrongly accepted is repaired, `REVISED` samples later at most.

A value at the end of its sensor's range is unknown, but beyond that: its hypothesis is weighted by
the chance of this. Before step 0 the rig is at rest.
"""

import math

import numpy as np
from seft_msgs_py.arrays import Floats, Ints

from seft_plant_sim.compiled import compiled, copy
from seft_plant_sim.judge.judge import (
    ALIVE,
    REVISED,
    SETS,
    UNKNOWN,
    Branches,
    Comparison,
    JudgeParameters,
    JudgeState,
)

RARE = math.log(1e-6)
"""Chance that a sample has a wrong channel, or that an event begins: of a false alarm."""
ANOTHER = math.log(1e-2)
"""Part of the wrong samples in which one more channel is wrong, or all are (a common cause)."""
LASTS_ON, ENDS = math.log(0.1), math.log(0.9)
"""Chance that a wrong channel is wrong in the next sample, and that it is not."""
KNOWN, GOES_ON = 1e-4, 0.1
"""Chance of an event like those of the last seconds, which later samples have confirmed, and of one
like that of the last three samples."""
SURE = math.log(1e-4)
"""Weight of all others below which an event is confirmed."""
PLAIN = 12.0
"""chi^2 of the four relations below which no hypothesis but the sound one can reach 1e-4 of the
weight: exp(PLAIN / 2) times `RARE`, with any amplitude."""
LEAST = -20.0
"""Logarithm of the least weight of a branch."""

ASSUMED = np.array([0.1 / 3.0, 0.1 / 3.0, 0.1])
"""Part of the motion that (1) to (3) leave, RMS, before the test has shown it: a calibration error
of 10 % as three standard deviations; a valve whose flow is followed."""
LEAST_MISSED, ASSUMED_FOR, MOTION_TO_NOISE = 0.002, 0.05, 20.0
"""Least such part: a sensor's linearity; the assumed one counts like what a test shows within a
time, s, in which the motion is so many times the noise."""
CLIPPED = 4.0
"""Largest square of a residual that counts for what is left, over its variance."""

COARSEST = 1.0 / 128.0
"""Step of a converter of 8 bits, over its range."""
LONG_AGO = -(2**40)
NO_NUMBER = 1e9
"""A larger value is no value of a sensor, in any unit."""
X, V, A, F = range(4)
"""Rows of a sample, and relations (1) to (4)."""
CHANNELS, FORCES, OIL_EVENT, EVENT = 0b001111, 0b001100, 0b010000, 0b100000
"""Bits of a set: of its channels, of those of which r is made, and of events."""
HALF_LOG_TURN = 0.5 * math.log(2.0 * math.pi)


@compiled
def begin_judge(p: JudgeParameters, state: JudgeState) -> None:
    """Begin a test: the rig is at rest."""
    state.step[0] = -1
    state.raw[:] = 0.0
    state.moved[:] = 0.0
    state.resolution[:] = np.inf
    state.restoring[:] = 0.0
    state.verdict[:] = 0
    state.wrong[:] = LONG_AGO
    state.counts[:] = 0
    state.told[:] = 0
    state.travel[:] = 0.0
    state.gained[:] = 0.0
    state.rise[:] = 0.0
    state.turned[:] = 0.0
    state.pressed[:] = 0.0
    state.strained[:] = 0.0
    state.scatter[:] = 0.0
    state.asked[:] = 0.0
    state.asked_jump[:] = 0.0
    state.asked_turn[:] = 0.0
    state.known[:] = 0.0
    state.missed[:] = 0.0
    state.motion[:] = 0.0
    for i in range(state.raw.shape[1]):
        for row in range(4):
            state.raw[row, i] = p.rest[0, row, i]
            state.compared.seen[row] = p.rest[0, row, i]
            state.compared.noise[row] = p.rest[1, row, i] ** 2
        settle(p, state, i, 0)


@compiled
def settle(p: JudgeParameters, state: JudgeState, i: int, wrong: int) -> None:
    """Begin with one branch, from the sample in `Comparison.seen`, with `Comparison.noise`."""
    b, seen, noise = state.alive, state.compared.seen, state.compared.noise
    state.count[i] = 1
    b.weight[i, 0] = 0.0
    b.settling[i, 0] = state.strained[i] ** 2
    b.event[i, 0, :] = 0.0
    b.wrong[i, 0, :] = 0
    b.wrong[i, 0, 0] = wrong
    mass = p.mass[i, i]
    for age in range(2):
        copy(4, seen, b.value[i, 0, age])
        copy(4, noise, b.variance[i, 0, age])
        b.restoring[i, 0, age] = seen[F] - mass * seen[A]
        b.blur[i, 0, age] = noise[F] + mass * mass * noise[A]


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
    n, is_next = raw.shape[1], step == state.step[0] + 1
    state.step[0] = step
    for i in range(n):
        forced = take(p, state, i, raw)
        if not is_next:
            settle(p, state, i, forced & CHANNELS)
        elif not (forced == 0 and is_plain(p, state, i, raw, flow[i])):
            weigh(p, state, i, raw, flow[i], forced)
        publish(p, state, step, i, judged)
    for i in range(n):
        restoring = judged[F, i]
        for k in range(n):
            restoring -= p.mass[i, k] * judged[A, k]
        state.restoring[i] = restoring
        if state.told[i, 0] == 0 and state.alive.event[i, 0, 0] == 0.0:
            state.strained[i] = max(abs(restoring), p.recent * state.strained[i])


@compiled
def ask(p: JudgeParameters, state: JudgeState, i: int, force: float) -> None:
    """Know what is asked of a rig that obeys forces, which it holds for a period."""
    last, before = state.asked[0, i], state.asked[1, i]
    state.asked_turn[i] = max(
        abs(force - 2.0 * last + before), p.recent * state.asked_turn[i]
    )
    state.asked_jump[i] = max(abs(force - last), p.recent * state.asked_jump[i])
    state.asked[0, i], state.asked[1, i] = force, last


@compiled
def take(p: JudgeParameters, state: JudgeState, i: int, raw: Floats) -> int:
    """Take the values of an axis and the variances of their noise.

    Give the set of those that are no numbers, and that of those at the end of their ranges, as the
    bits after it.
    """
    c, forced = state.compared, 0
    for row in range(4):
        value = raw[row, i]
        moved = abs(value - state.raw[row, i])
        state.moved[row, i], state.raw[row, i] = moved, value
        c.seen[row] = value
        if not abs(value) < NO_NUMBER:
            forced |= 1 << row
            c.seen[row] = state.alive.value[i, 0, 0, row]
        elif abs(value) >= p.range[row, i]:
            forced |= 1 << row + 4
        resolution = state.resolution[row, i]
        if resolution == np.inf:  # it has not moved yet: by a step of its converter, if it does now
            coarsest = p.range[row, i] * COARSEST
            resolution = min(moved, coarsest) if coarsest < np.inf and moved < np.inf else 0.0
        c.noise[row] = p.noise[row, i] ** 2 + resolution * resolution / 12.0
        if 0.0 < moved < state.resolution[row, i] and state.step[0] > 0:
            state.resolution[row, i] = moved
    return forced


@compiled
def beside(p: JudgeParameters, state: JudgeState, i: int, raw: Floats) -> float:
    """Force on an axis by the acceleration of the others, to which the mass couples it, N."""
    force = 0.0
    for k in range(raw.shape[1]):
        if k != i and p.mass[i, k] != 0.0:
            is_known = abs(raw[A, k]) < min(NO_NUMBER, p.range[A, k])
            force += p.mass[i, k] * (raw[A, k] if is_known else state.alive.value[k, 0, 0, A])
    return force


@compiled
def left_by_force(p: JudgeParameters, state: JudgeState, i: int, j: int) -> float:
    """Variance of what (4) leaves after a branch, N^2."""
    b = state.alive
    if p.mass[i, i] == 0.0:
        return UNKNOWN**2
    curved = p.stiffness[i, i] * p.dt * p.dt * b.value[i, j, 0, A]
    known = 4.0 * b.blur[i, j, 0] + b.blur[i, j, 1] + b.settling[i, j]
    return known + state.scatter[1, i] + curved * curved


def _compare(
    p: JudgeParameters, state: JudgeState, i: int, j: int, flow: float, other: float
) -> None:
    """Compare the sample with a branch: residuals, and their covariance (lower half)."""
    c, b, h = state.compared, state.alive, p.dt
    seen, noise, off, left, covariance = c.seen, c.noise, c.off, c.left, c.covariance
    last, variance = b.value[i, j, 0], b.variance[i, j, 0]
    now, before, oil = p.now[i], p.before[i], p.oil[i, 0]
    for row in range(4):
        value = 0.0
        for channel in range(4):
            value += now[row, channel] * seen[channel] - before[row, channel] * last[channel]
        off[row] = value
    travel, gained, mass = state.travel[i], state.gained[i], p.mass[i, i]
    held = 0.5 * h * state.asked_jump[i] / mass if mass > 0.0 else 0.0  # at any time in a period
    bend = h / 12.0 * state.turned[i]
    left[X] = part_of(state.missed, state.motion, 0, i) * travel * travel + (p.late * gained) ** 2 + (h / 6.0 * held) ** 2
    left[V] = part_of(state.missed, state.motion, 1, i) * gained * gained + bend * bend + (p.late / h * gained) ** 2
    left[V] += held * held
    if oil > 0.0:
        off[2] -= oil * h * flow
        left[2] = part_of(state.missed, state.motion, 2, i) * state.pressed[i] ** 2
    else:
        off[2] += b.value[i, j, 1, F]
        left[2] = b.variance[i, j, 1, F] + state.asked_turn[i] ** 2 + state.scatter[0, i]
    off[3] += b.restoring[i, j, 1] - 2.0 * b.restoring[i, j, 0] - other
    left[3] = left_by_force(p, state, i, j)
    for row in range(4):
        for column in range(row + 1):
            value = left[row] if row == column else 0.0
            for channel in range(4):
                value += now[row, channel] * noise[channel] * now[column, channel]
                value += before[row, channel] * variance[channel] * before[column, channel]
            covariance[row, column] = value


compare, compare_apart = compiled(_compare), compiled(_compare, inline=False)


@compiled
def part_of(missed: Floats, motion: Floats, relation: int, i: int) -> float:
    """Mean square of what (1) to (3) leave of the motion."""
    size = motion[relation, i]
    part = missed[relation, i] / size if size > 0.0 else ASSUMED[relation] ** 2
    return max(part, LEAST_MISSED**2)


@compiled
def misfit(s: Floats, e: Floats) -> float:
    """chi^2 of residuals e of a covariance S, shape (4, 4), of which the lower half is read."""
    one, two, three = s[1, 0] / s[0, 0], s[2, 0] / s[0, 0], s[3, 0] / s[0, 0]
    s11, s21, s31 = s[1, 1] - one * s[1, 0], s[2, 1] - two * s[1, 0], s[3, 1] - three * s[1, 0]
    s22, s32 = s[2, 2] - two * s[2, 0], s[3, 2] - three * s[2, 0]
    e1, e2, e3 = e[1] - one * e[0], e[2] - two * e[0], e[3] - three * e[0]
    two, three = s21 / s11, s31 / s11
    s22, s32 = s22 - two * s21, s32 - three * s21
    e2, e3 = e2 - two * e1, e3 - three * e1
    last = s32 / s22
    s33 = s[3, 3] - s[3, 0] * s[3, 0] / s[0, 0] - three * s31 - last * s32
    e3 -= last * e2
    return e[0] * e[0] / s[0, 0] + e1 * e1 / s11 + e2 * e2 / s22 + e3 * e3 / s33


@compiled
def is_plain(p: JudgeParameters, state: JudgeState, i: int, raw: Floats, flow: float) -> bool:
    """Say whether the sample fits the only branch, and was added to it: so are nearly all."""
    b, c = state.alive, state.compared
    if state.count[i] > 1 or b.wrong[i, 0, 0] & CHANNELS:
        return False
    other = beside(p, state, i, raw)
    compare(p, state, i, 0, flow, other)
    if not misfit(c.covariance, c.off) < PLAIN:
        return False
    if b.wrong[i, 0, 0] == 0:
        learn(p, state, i)
    state.known[i] = max(abs(b.event[i, 0, 0]), p.events * state.known[i])
    for age in (2, 1):
        b.event[i, 0, age] = b.event[i, 0, age - 1]
    b.event[i, 0, 0] = 0.0
    for age in range(REVISED, 0, -1):
        b.wrong[i, 0, age] = b.wrong[i, 0, age - 1]
    b.wrong[i, 0, 0] = 0
    copy(4, b.value[i, 0, 0], b.value[i, 0, 1])
    copy(4, c.seen, b.value[i, 0, 0])
    copy(4, b.variance[i, 0, 0], b.variance[i, 0, 1])
    copy(4, c.noise, b.variance[i, 0, 0])
    b.settling[i, 0] *= 0.25
    mass = p.mass[i, i]
    b.restoring[i, 0, 1], b.blur[i, 0, 1] = b.restoring[i, 0, 0], b.blur[i, 0, 0]
    b.restoring[i, 0, 0] = c.seen[F] - mass * c.seen[A] - other
    b.blur[i, 0, 0] = c.noise[F] + mass * mass * c.noise[A]
    note_motion(p, state, i, flow)
    return True


@compiled
def learn(p: JudgeParameters, state: JudgeState, i: int) -> None:
    """Learn what the relations leave from a sample that is plainly sound, like the last one."""
    off, covariance = state.compared.off, state.compared.covariance
    left = state.compared.left
    for relation in range(3):
        whole = covariance[relation, relation]
        square = min(off[relation] * off[relation], CLIPPED * whole)
        if relation == 2 and p.oil[i, 0] == 0.0:
            drift(state.scatter, 0, i, 1.0 - p.recent, square - whole)
            continue
        size = state.travel[i] if relation == 0 else state.gained[i]
        size = state.pressed[i] if relation == 2 else size
        size *= size
        described = part_of(state.missed, state.motion, relation, i) * size
        noise = whole - described
        if state.motion[relation, i] == 0.0:
            first = ASSUMED_FOR / p.dt * MOTION_TO_NOISE**2 * noise
            state.motion[relation, i] = first
            state.missed[relation, i] = ASSUMED[relation] ** 2 * first
        state.motion[relation, i] = p.events * state.motion[relation, i] + size
        state.missed[relation, i] = p.events * state.missed[relation, i] + square - noise
    whole = covariance[3, 3]
    beyond = min(off[3] * off[3], CLIPPED * whole) - whole
    drift(state.scatter, 1, i, 1.0 - p.recent, beyond)


def _learn_apart(
    p: JudgeParameters, state: JudgeState, i: int, j: int, flow: float, other: float
) -> None:
    """Learn from a sample after a branch, see `learn`."""
    compare(p, state, i, j, flow, other)
    learn(p, state, i)


learn_apart = compiled(_learn_apart, inline=False)


@compiled
def drift(scatter: Floats, row: int, i: int, share: float, beyond: float) -> None:
    """Let a variance follow what the square of a residual is beyond its variance."""
    scatter[row, i] = max(scatter[row, i] + share * beyond, 0.0)


@compiled
def note_motion(p: JudgeParameters, state: JudgeState, i: int, flow: float) -> None:
    """Note how far the last sample moves."""
    last, before = state.alive.value[i, 0]
    bend, state.rise[i] = abs(last[A] - before[A] - state.rise[i]), last[A] - before[A]
    state.travel[i] = max(p.dt * abs(last[V]), p.brief * state.travel[i])
    state.gained[i] = max(p.dt * abs(last[A]), p.brief * state.gained[i])
    state.turned[i] = max(bend, p.brief * state.turned[i])
    pressed = p.oil[i, 0] * p.dt * max(abs(flow), abs(last[V]))
    state.pressed[i] = max(pressed, p.recent * state.pressed[i])


def _weigh(
    p: JudgeParameters, state: JudgeState, i: int, raw: Floats, flow: float, forced: int
) -> None:
    """Weigh all hypotheses after all branches; the likeliest become the next branches."""
    c, b = state.compared, state.alive
    other, count = beside(p, state, i, raw), 0
    for j in range(state.count[i]):
        compare_apart(p, state, i, j, flow, other)
        is_sound = forced == 0 and b.wrong[i, j, 0] & CHANNELS == 0
        for turns in (False, True):
            if turns:
                allow_turn(p, state, i)
            chi2, log_det = whiten(c, p.now[i])
            is_sound = is_sound and chi2 < PLAIN
            for which in SETS:
                if (forced | forced >> 4) & CHANNELS & ~which or is_turn(which) != turns:
                    continue
                if is_sound and which:
                    continue
                gain, log_det_b, unknowns = solve(c, which, count)
                c.candidate[count, 0], c.candidate[count, 1] = j, which
                c.likelihood[count] = (
                    b.weight[i, j]
                    - 0.5 * (chi2 - gain + log_det + log_det_b)
                    + HALF_LOG_TURN * unknowns
                    + log_prior(b.wrong[i, j, 0], which, forced)
                    + log_amplitudes(p, state, i, count, forced)
                )
                count += 1
            if is_sound:
                break
    new, top = 0, c.likelihood[likeliest(c.likelihood, count)]
    for _ in range(ALIVE):
        at = likeliest(c.likelihood, count)
        if not c.likelihood[at] > top + LEAST:
            break
        if new == 0 and c.candidate[at, 1] == 0 and b.wrong[i, c.candidate[at, 0], 0] == 0:
            learn_apart(p, state, i, c.candidate[at, 0], flow, other)
        continue_branch(p, state, i, new, at, other, forced)
        c.likelihood[at] = -np.inf
        if not (new and joins(state.made, i, new)):
            new += 1
    decide(p, state, i, new, flow)


weigh = compiled(_weigh, inline=False)


@compiled
def likeliest(likelihood: Floats, count: int) -> int:
    """Find the place of the largest of the first values."""
    best = 0
    for k in range(1, count):
        if likelihood[k] > likelihood[best]:
            best = k
    return best


@compiled
def is_turn(which: int) -> bool:
    """Say whether in a set an event turns the acceleration at an unknown time, by a known jump."""
    return which & EVENT != 0 and which & FORCES == 0


@compiled
def allow_turn(p: JudgeParameters, state: JudgeState, i: int) -> None:
    """Add to the covariance that the jump of (4) comes at any time since the last sample."""
    s, mass, h, oil = state.compared.covariance, p.mass[i, i], p.dt, p.oil[i, 0]
    jump = abs(state.compared.off[3]) / mass if mass > 0.0 else 0.0
    kink = (h * h * jump) ** 2 / 720.0
    s[V, V] += (h * jump) ** 2 / 12.0
    s[X, X] += kink
    s[2, 2] += oil * oil * kink


@compiled
def factorise(matrix: Floats, root: Floats, size: int) -> float:
    """Cholesky factor of a matrix, of which the lower half is read; give its log det."""
    log_det = 0.0
    for row in range(size):
        for column in range(row + 1):
            value = matrix[row, column]
            for k in range(column):
                value -= root[row, k] * root[column, k]
            if row == column:
                root[row, row] = math.sqrt(max(value, 1e-300))
                log_det += 2.0 * math.log(root[row, row])
            else:
                root[row, column] = value / root[column, column]
    return log_det


@compiled
def whiten(c: Comparison, now: Floats) -> tuple[float, float]:
    """Give chi^2 of the residuals and log det S; fill `whitened` and `gram`."""
    root, w = c.root, c.whitened
    log_det = factorise(c.covariance, root, 4)
    for row in range(4):
        for column in range(7):
            value = c.off[row] if column == 6 else 0.0
            if column < 4:
                value = now[row, column]
            elif row == column - 2:  # events add to the last two relations
                value = 1.0
            for k in range(row):
                value -= root[row, k] * w[k, column]
            w[row, column] = value / root[row, row]
    for j in range(7):
        for k in range(j + 1):
            c.gram[j, k] = 0.0
            for row in range(4):
                c.gram[j, k] += w[row, j] * w[row, k]
    return c.gram[6, 6], log_det


@compiled
def solve(c: Comparison, which: int, at: int) -> tuple[float, float, int]:
    """Find the amplitudes of a set and their variances, of a candidate.

    Give by how much they lower chi^2, the log det of their information, and their number.
    """
    count = 0
    chosen, factor, solution = c.chosen, c.factor, c.solution
    for j in range(6):
        c.amplitude[at, j] = c.spread[at, j] = 0.0
        if which >> j & 1:
            chosen[count] = j
            count += 1
    for a in range(count):
        for k in range(a + 1):
            factor[a, k] = c.gram[chosen[a], chosen[k]]
    log_det, gain = factorise(factor, factor, count), 0.0
    for a in range(count):
        value = c.gram[6, chosen[a]]
        for k in range(a):
            value -= factor[a, k] * solution[k]
        solution[a] = value / factor[a, a]
        gain += solution[a] * solution[a]
    for a in range(count - 1, -1, -1):
        value = solution[a]
        for k in range(a + 1, count):
            value -= factor[k, a] * c.amplitude[at, chosen[k]]
        c.amplitude[at, chosen[a]] = value / factor[a, a]
    for j in range(count):  # the diagonal of the inverse: squares of the columns of the factor's
        for a in range(j, count):
            value = 1.0 if a == j else 0.0
            for k in range(j, a):
                value -= factor[a, k] * solution[k]
            solution[a] = value / factor[a, a]
            c.spread[at, chosen[j]] += solution[a] * solution[a]
    return gain, log_det, count


@compiled
def members(which: int) -> int:
    """Count the channels of a set."""
    return (which & 1) + (which >> 1 & 1) + (which >> 2 & 1) + (which >> 3 & 1)


@compiled
def log_prior(before: int, which: int, forced: int) -> float:
    """Prior of a set after another; of those that are no numbers, or at their ends, none."""
    fresh, value = which & ~before & ~(forced | forced >> 4) & CHANNELS, 0.0
    if fresh:
        others = 1 if fresh == CHANNELS else members(fresh) - 1
        value = RARE + others * ANOTHER
    return value + LASTS_ON * members(before & which) + ENDS * members(before & ~which)


@compiled
def log_below(margin: float) -> float:
    """Logarithm of the chance that a standard normal value is below a margin."""
    if margin > -5.0:
        return math.log(0.5 * math.erfc(-margin / math.sqrt(2.0)))
    return -0.5 * margin * margin - math.log(-margin) - HALF_LOG_TURN


@compiled
def log_beyond(c: Comparison, row: int, end: float, at: int) -> float:
    """Logarithm of the chance that a value at its range's end is beyond it, by the others."""
    value = c.seen[row] - c.amplitude[at, row]
    outside = (value if c.seen[row] > 0.0 else -value) - end
    return log_below(outside / math.sqrt(c.spread[at, row]))


@compiled
def log_amplitudes(
    p: JudgeParameters, state: JudgeState, i: int, at: int, forced: int
) -> float:
    """Prior of the amplitudes of a set: a wrong value may be any that the sensor can show."""
    c, value = state.compared, 0.0
    j, which = c.candidate[at]
    for row in range(4):
        if not which >> row & 1 or forced >> row & 1:
            continue
        if forced >> row + 4 & 1:
            value += max(log_beyond(c, row, p.range[row, i], at), RARE + math.log(0.5))
        else:
            value -= math.log(min(2.0 * p.range[row, i], NO_NUMBER))
    if which & EVENT:
        jumps, recent = state.alive.event[i, j], 0.0
        for age in range(3):
            recent = max(recent, abs(jumps[age]))
        size, rate = c.amplitude[at, 5], math.exp(RARE)
        if state.known[i] > 0.0:
            rate += KNOWN * math.exp(-0.5 * (size / state.known[i]) ** 2)
        if recent > 0.0:
            rate += GOES_ON * math.exp(-0.5 * (size / recent) ** 2)
        value += math.log(rate) + log_size(size, c.covariance[3, 3], p.spread[i])
    if which & OIL_EVENT:
        value += RARE + log_size(c.amplitude[at, 4], c.covariance[2, 2], p.spread[i])
    return value


@compiled
def log_size(size: float, variance: float, spread: float) -> float:
    """Prior of the size of an event: of any order of magnitude."""
    return -math.log(2.0 * (abs(size) + math.sqrt(variance))) - spread


@compiled
def continue_branch(
    p: JudgeParameters, state: JudgeState, i: int, new: int, at: int, other: float, forced: int
) -> None:
    """Continue a branch by a candidate, as a new one."""
    c, b, made = state.compared, state.alive, state.made
    j, which = c.candidate[at]
    made.weight[i, new] = c.likelihood[at]
    told = which
    for row in range(4):
        value, variance = c.seen[row], c.noise[row]
        if which >> row & 1:
            value -= c.amplitude[at, row]
            variance = max(c.spread[at, row], variance)
            is_end = forced >> row + 4 & 1
            if is_end and log_beyond(c, row, p.range[row, i], at) > RARE + math.log(0.5):
                end = p.range[row, i]
                value = max(value, end) if c.seen[row] > 0.0 else min(value, -end)
                told &= ~(1 << row)
        made.value[i, new, 0, row], made.variance[i, new, 0, row] = value, variance
    copy(4, b.value[i, j, 0], made.value[i, new, 1])
    copy(4, b.variance[i, j, 0], made.variance[i, new, 1])
    for age in range(REVISED):
        made.wrong[i, new, 1 + age] = b.wrong[i, j, age]
    made.wrong[i, new, 0] = told
    made.event[i, new, 0] = c.amplitude[at, 5]
    for age in range(2):
        made.event[i, new, 1 + age] = b.event[i, j, age]
    continue_force(p, state, i, new, j, which, other)


@compiled
def continue_force(
    p: JudgeParameters, state: JudgeState, i: int, new: int, j: int, which: int, other: float
) -> None:
    """Continue the specimen's force of a branch: after an event it goes on to rise, or stays."""
    b, made, mass = state.alive, state.made, p.mass[i, i]
    value, variance = made.value[i, new, 0], made.variance[i, new, 0]
    force = value[F] - mass * value[A] - other
    blur = variance[F] + mass * mass * variance[A]
    if which & FORCES and not which & EVENT:
        blur = min(blur, left_by_force(p, state, i, j))
    before, before_blur = b.restoring[i, j, 0], b.blur[i, j, 0]
    settling = 0.25 * b.settling[i, j]
    if which & EVENT:
        half = 0.5 * made.event[i, new, 0]
        before = force - (before - b.restoring[i, j, 1]) - half
        before_blur, settling = before_blur + b.blur[i, j, 1], half * half
    made.restoring[i, new, 0], made.blur[i, new, 0] = force, blur
    made.restoring[i, new, 1], made.blur[i, new, 1] = before, before_blur
    made.settling[i, new] = settling


@compiled
def joins(made: Branches, i: int, new: int) -> bool:
    """Say whether a new branch has come to the state of another, and was added to its weight."""
    if (made.wrong[i, new, 0] | made.wrong[i, new, 1]) & CHANNELS:
        return False
    last, before = made.restoring[i, new]
    for k in range(new):
        size = 1e-9 * (abs(last) + abs(before))
        is_near = abs(made.restoring[i, k, 0] - last) <= size
        is_near &= abs(made.restoring[i, k, 1] - before) <= size
        if is_near and not (made.wrong[i, k, 0] | made.wrong[i, k, 1]) & CHANNELS:
            made.weight[i, k] += math.log1p(math.exp(made.weight[i, new] - made.weight[i, k]))
            return True
    return False


@compiled
def decide(p: JudgeParameters, state: JudgeState, i: int, count: int, flow: float) -> None:
    """Keep the branches that agree with the likeliest one on the oldest sample."""
    b, made, best, kept = state.alive, state.made, 0, 0
    for j in range(1, count):
        if made.weight[i, j] > made.weight[i, best]:
            best = j
    is_sure = made.event[i, best, 1] != 0.0
    for turn in range(count):
        j = best if turn == 0 else (turn - 1 if turn <= best else turn)
        if (made.wrong[i, j, REVISED] ^ made.wrong[i, best, REVISED]) & CHANNELS:
            continue
        weight = made.weight[i, j] - made.weight[i, best]
        is_sure &= made.event[i, j, 1] != 0.0 or weight < SURE
        b.weight[i, kept], b.settling[i, kept] = weight, made.settling[i, j]
        for age in range(2):
            copy(4, made.value[i, j, age], b.value[i, kept, age])
            copy(4, made.variance[i, j, age], b.variance[i, kept, age])
            b.restoring[i, kept, age] = made.restoring[i, j, age]
            b.blur[i, kept, age] = made.blur[i, j, age]
        copy(3, made.event[i, j], b.event[i, kept])
        for age in range(1 + REVISED):
            b.wrong[i, kept, age] = made.wrong[i, j, age]
        kept += 1
    state.count[i] = kept
    known = abs(b.event[i, 0, 1]) if is_sure else 0.0
    state.known[i] = max(known, p.events * state.known[i])
    note_motion(p, state, i, flow)


@compiled
def publish(p: JudgeParameters, state: JudgeState, step: int, i: int, judged: Floats) -> None:
    """Give the likeliest values, and count those that were replaced, as is known by now."""
    b = state.alive
    for age in range(REVISED, 0, -1):
        was, now = state.told[i, age - 1], b.wrong[i, 0, age] & CHANNELS
        state.told[i, age] = now
        for row in range(4):
            if (was & ~now) >> row & 1:  # what is found wrong later was used: it is not counted
                take_back(state.wrong[row, i], state.counts[row], i, step - age)
    state.told[i, 0] = b.wrong[i, 0, 0] & CHANNELS
    for row in range(4):
        judged[row, i] = b.value[i, 0, 0, row]
        is_wrong = state.told[i, 0] >> row & 1
        state.verdict[row, i] = is_wrong
        if is_wrong:
            steps = state.wrong[row, i]
            steps[state.counts[row, i] % len(steps)] = step
            state.counts[row, i] += 1


@compiled
def take_back(steps: Ints, counts: Ints, i: int, step: int) -> None:
    """Count a value that was replaced at a step no longer."""
    last = counts[i] - 1
    for back in range(min(last + 1, len(steps))):
        if steps[(last - back) % len(steps)] == step:
            for place in range(last - back, last):
                steps[place % len(steps)] = steps[(place + 1) % len(steps)]
            steps[last % len(steps)] = LONG_AGO
            counts[i] = last
            return
