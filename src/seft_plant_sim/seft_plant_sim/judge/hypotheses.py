"""Hypotheses on a sample after a branch of the judge, and their weights.

A hypothesis is a set of unknown amplitudes b: of wrong channels, which add L b to the residuals e
of `judge_step`, of an event of the specimen (it sticks, slips, yields, hits a stop), which adds to
(4), and of the oil, to (3). Its weight is its prior times the likelihood of e, b integrated out: a
wrong value is normal, as wide as all that its sensor can show; an event is of any order of
magnitude (Laplace's method), and the rarer the farther it is beyond what the test has shown.

A value at the end of its sensor's range is unknown, but beyond that: its hypothesis is weighted by
the chance of this.
"""

import math

import numpy as np
from seft_msgs_py.arrays import Floats, Record

from seft_plant_sim.compiled import compiled
from seft_plant_sim.judge.judge import OIL_EVENT

RARE = math.log(1e-6)
"""Chance that a sample has a wrong channel: of a false alarm."""

ANOTHER = math.log(1e-2)
"""Part of the wrong samples in which one more channel is wrong, or all are (a common cause)."""

LASTS_ON, ENDS, STAYS = math.log(0.1), math.log(0.9), math.log(0.5)
"""Chance that a channel that was wrong in the last samples is wrong in the next, or is not, after a
spark; and either of these of several channels, whose amplifier may fail."""

NEW, KNOWN, GOES_ON = 1e-6, 1e-4, 0.1
"""Chance of an event of a kind that the test has not shown, as of a wrong channel: both look the
same until the velocity shows it. Chance of one like those that later samples have confirmed in the
last seconds, and of one like these or a possible one of the last samples."""

X, V, A, F = range(4)
"""Rows of a sample, and relations (1) to (4)."""

ANY_CHANNEL, FORCES, EVENT = 0b001111, 0b001100, 0b100000
"""Bits of a set: of its channels, of those of which r is made, and of the specimen's event."""

TINY = 1e-60
"""Least variance, or information: four of them are still numbers."""

ROUNDING = 1e-14
"""Least part of a variance that the others may leave: less is rounding. All channels wrong, without
a known range of any, leave none."""

BREAKS, SURE_SIGN = math.log(1e-5), 3.0
"""Chance that a specimen breaks where its force changes against the motion, and a velocity over its
deviation from which on its sign is known."""

HALF_LOG_TURN = 0.5 * math.log(2.0 * math.pi)


@compiled
def allow_turn(known: Record, axis: Record, c: Record, b: Record) -> float:
    """Add to the covariance that the jump of (4) comes at any time since the last sample.

    The force goes on then, also behind a servo, whose motion goes on in all other events: give by
    how much that raises chi^2.
    """
    s, h, oil, off = c.covariance, known.dt, known.oil, 0.0
    if known.imposed:
        off = c.off[2] * c.off[2] / (axis.blur[2, 2] + b.variance[1, F] + axis.bent**2)
    jump = abs(c.off[3]) / known.mass if known.mass > 0.0 else 0.0
    kink = (h * h * jump) ** 2 / 720.0
    s[V, V] += (h * jump) ** 2 / 12.0
    s[X, X] += kink
    s[2, 2] += oil * oil * kink
    return off


@compiled
def factorise(matrix: Floats, root: Floats, size: int) -> float:
    """Cholesky factor of a matrix, of which the lower half is read, its diagonal inverted; det."""
    det = 1.0
    for row in range(size):
        for column in range(row):
            value = matrix[row, column]
            for k in range(column):
                value -= root[row, k] * root[column, k]
            root[row, column] = value * root[column, column]
        value = matrix[row, row]
        for k in range(row):
            value -= root[row, k] * root[row, k]
        value = max(value, TINY, ROUNDING * matrix[row, row])
        root[row, row], det = 1.0 / math.sqrt(value), det * value
    return det


@compiled
def substitute(root: Floats, rest: Floats, size: int) -> float:
    """Divide residuals by a factor of `factorise`, and give the square of what that gives."""
    square = 0.0
    for row in range(size):
        value = rest[row]
        for k in range(row):
            value -= root[row, k] * rest[k]
        rest[row] = value * root[row, row]
        square += rest[row] * rest[row]
    return square


@compiled
def whiten(known: Record, c: Record) -> float:
    """Fill `whitened`, and give det S."""
    det, w = factorise(c.covariance, c.root, 4), c.whitened
    for row in range(4):
        for column in range(6):  # events add to the last two relations
            w[column, row] = known.now[row, column] if column < 4 else 1.0 * (row == column - 2)
        w[6, row] = c.off[row]
    for column in range(7):
        substitute(c.root, w[column], 4)
    return det


@compiled
def product(c: Record, j: int, k: int) -> float:
    """Product of two rows of `whitened`."""
    one, other = c.whitened[j], c.whitened[k]
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2] + one[3] * other[3]


@compiled
def fill_gram(known: Record, c: Record) -> float:
    """Fill `gram`, and give chi^2 of the residuals."""
    for j in range(7):
        for k in range(j + 1):
            c.gram[j, k] = product(c, j, k)
        if j < 6:
            c.gram[j, j] += known.precision[min(j, F)]
    return c.gram[6, 6]


@compiled
def solve(c: Record, which: int, at: int) -> tuple[float, float]:
    """Find the amplitudes of a set and their variances, of a candidate.

    Give by how much they lower chi^2, and the log det of their information.
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
        solution[a] = c.gram[6, chosen[a]]
    det = factorise(factor, factor, count)
    gain = substitute(factor, solution, count)
    for j in range(count):  # the factor's inverse, transposed, in place of what is above it
        for a in range(j, count):
            value = 1.0 if a == j else 0.0
            for k in range(j, a):
                value -= factor[a, k] * factor[j, k]
            factor[j, a] = value * factor[a, a]
            c.amplitude[at, chosen[j]] += factor[j, a] * solution[a]
            c.spread[at, chosen[j]] += factor[j, a] * factor[j, a]
    return gain, math.log(det)


@compiled
def members(which: int) -> int:
    """Count the channels of a set."""
    return (which & 1) + (which >> 1 & 1) + (which >> 2 & 1) + (which >> 3 & 1)


@compiled
def wrong_before(b: Record) -> int:
    """Give the channels that were wrong in the last samples of a branch."""
    return (b.wrong[0] | b.wrong[1] | b.wrong[2]) & ANY_CHANNEL


@compiled
def log_prior(before: int, which: int, forced: int) -> float:
    """Prior of a set after others; of values that are no numbers, or at their ends, none."""
    asked = ANY_CHANNEL & ~(forced | forced >> 4)
    fresh, before, value = which & ~before & asked, before & asked, 0.0
    if fresh:
        others = 1 if fresh == ANY_CHANNEL else members(fresh) - 1
        value = RARE + others * ANOTHER
    if members(before) > 1:
        return value + STAYS
    return value + (LASTS_ON if before & which else ENDS if before else 0.0)


@compiled
def log_below(margin: float) -> float:
    """Logarithm of the chance that a standard normal value is below a margin."""
    if margin > -5.0:
        return math.log(0.5 * math.erfc(-margin / math.sqrt(2.0)))
    return -0.5 * margin * margin - math.log(-margin) - HALF_LOG_TURN


@compiled
def weigh_end(known: Record, c: Record, b: Record, row: int, at: int) -> tuple[float, bool]:
    """Weigh a value at its range's end: it is beyond that, by the others, or it is wrong.

    Give the logarithm of the larger chance, and whether it is beyond.
    """
    value, before, which = c.seen[row] - c.amplitude[at, row], wrong_before(b), c.which[at]
    outside = (value if c.seen[row] > 0.0 else -value) - known.range[row]
    beyond = log_below(outside / math.sqrt(c.spread[at, row]))
    wrong = ANOTHER if which & ~before & ANY_CHANNEL & ~(1 << row) else RARE
    if before >> row & 1:
        beyond, wrong = beyond + ENDS, LASTS_ON
    wrong += math.log(0.5)
    return max(beyond, wrong), beyond > wrong


@compiled
def log_amplitudes(known: Record, axis: Record, c: Record, at: int) -> float:
    """Prior of the amplitudes of a set: a wrong value may be any that the sensor can show.

    Where several channels of an axis fail together, as by their amplifier, errors go on.
    """
    which, b = c.which[at], axis.alive[c.branch[at]]
    value = log_opposed(known, axis, c, b, at)
    together = b.wrong[0] & which & ANY_CHANNEL
    for row in range(4):
        if not which >> row & 1:
            continue
        density = 0.5 * math.log(known.precision[row])
        if c.forced >> row + 4 & 1:
            density = HALF_LOG_TURN + weigh_end(known, c, b, row, at)[0]
        elif together >> row & 1 and members(together) > 1 and axis.asked_jump == 0.0:
            change, noise = c.amplitude[at, row] - b.error[row], c.noise[row] + b.variance[0, row]
            like_last = HALF_LOG_TURN + log_size(change, noise, known.orders, math.inf)
            density = max(density, like_last)
        value += density
    if which & EVENT:
        jumps, size = b.event, c.amplitude[at, 5]
        recent = max(axis.lately, abs(jumps[0]), abs(jumps[1]), abs(jumps[2]))
        rate = NEW
        if axis.known > 0.0:
            rate += KNOWN * math.exp(-0.5 * (size / axis.known) ** 2)
        if recent > 0.0:
            rate += GOES_ON * math.exp(-0.5 * (size / recent) ** 2)
        value += HALF_LOG_TURN + math.log(rate)
        value += log_size(size, c.covariance[3, 3], known.orders, axis.strained)
        value += ANOTHER if known.mass == 0.0 else 0.0  # only the next sample can confirm it
        value += RARE if c.forced >> F + 4 & 1 else 0.0  # no specimen jumps beyond a range
    if which & OIL_EVENT:
        size, variance = c.amplitude[at, 4], c.covariance[2, 2]
        value += HALF_LOG_TURN + math.log(NEW) + log_size(size, variance, known.orders, math.inf)
        if known.oil > 0.0:  # no flow makes more
            value -= 0.5 * size * size / (axis.pressed**2 + variance)
    return value


@compiled
def log_opposed(known: Record, axis: Record, c: Record, b: Record, at: int) -> float:
    """Logarithm of the chance that r changes as it does: not against a motion that goes on.

    A specimen gives no work (Hill 1958): while it moves on its force falls by no more than `oppose`
    allows, and while it moves back it rises by no more.
    """
    if min(c.most[0], c.most[1]) == np.inf:
        return 0.0
    force, a = c.seen[F] - c.amplitude[at, F], c.seen[A] - c.amplitude[at, A]
    change = force - known.mass * a - c.beside - b.restoring[0]
    variance = b.blur[0] + c.noise[F] + known.mass**2 * c.noise[A] + axis.scatter + c.doubt
    margin = min(c.most[0] - change, c.most[1] + change) / math.sqrt(variance)
    return max(log_below(margin), BREAKS) if margin < 5.0 else 0.0


@compiled
def log_size(size: float, variance: float, orders: float, usual: float) -> float:
    """Prior of the size of an event: of any order of magnitude, rare beyond what is usual."""
    deviation = math.sqrt(variance)
    whole = abs(size) + deviation
    return -math.log(2.0 * whole) - orders - math.log(max(whole / (usual + deviation), 1.0))
