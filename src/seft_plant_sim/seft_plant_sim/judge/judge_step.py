"""The judge: each sample is judged by likelihood, before anything uses it.

With displacement x, velocity v, acceleration a, actuator force f, the specimen's force r = f - M a
and the valve's flow w, four relations tie a sample of an axis to the ones before (indices 1, 2);
k_oil and lambda are those of the oil, and dt is h::

    x = x1 + h (v + v1) / 2 - h^2 (a - a1) / 12                                            (1)
    v = v1 + h (a + a1) / 2                                                                (2)
    f = f1 + k_oil (h w - h (v + v1) / 2 + h^2 (a - a1) / 12) - h lambda f1                (3)
        or 2 f1 - f2 if the oil is not known; nothing if a servo imposes the motion
    r = r1 + g (r1 - r2)                                                                   (4)

in short L y = D y1 + ... + u, where the covariance of u is the diagonal Q: what the relations leave
out. Of a measured sample z = y + noise + wrong, the residuals e = L z - D y1 - ... have the
covariance S = Q + L R L' + D P D', with the variances R of the noise and P of the last values. The
part g of the last change of r that goes on is its recent mean square over that with its noise (an
estimate of least squares). A velocity that is derived is one with its displacement.

The judge weighs `hypotheses`. Histories that remain likely live on in branches with states of their
own, and the next samples decide: what was wrongly accepted is repaired, `REVISED` samples later at
most. Before step 0 the rig is at rest.
"""

import math

import numpy as np
from seft_msgs_py.arrays import Floats, Record, clear

from seft_plant_sim.channels import derived
from seft_plant_sim.compiled import compiled, copy
from seft_plant_sim.judge import hypotheses
from seft_plant_sim.judge import judge as records
from seft_plant_sim.judge.hypotheses import ANY_CHANNEL, EVENT, FORCES, RARE, A, F, V, X, members
from seft_plant_sim.judge.judge import REVISED, UNKNOWN, JudgeParameters, JudgeState
from seft_plant_sim.judge.relation_following import MOTION_TO_NOISE
from seft_plant_sim.judge.valve_following import UNCERTAIN_OIL

OPPOSED, STIFFER, DAMPED = 0.5, 2.0, 0.5
"""Part of a spring's assumed stiffness by which it may soften, its largest stiffness over that, and
its largest damper over sqrt(k M): a quarter of critical damping."""
LIKE = 2.0
"""Size of an event over that of confirmed ones up to which it is like them: twice a friction's."""
SURE = math.log(1e-4)
"""Weight of all others below which an event is confirmed."""
PLAIN = 12.0
"""chi^2 of the four relations below which no hypothesis but the sound one can reach 1e-4 of the
weight: exp(PLAIN / 2) times `RARE`, with any amplitude."""
LEAST = RARE
"""Logarithm of the least weight of a branch: what is less likely is no alternative."""

LEAST_MISSED, ASSUMED_FOR = 0.002, 0.05
"""Least such part: a sensor's linearity; the assumed one counts like what a test shows within a
time, s, in which the motion is `MOTION_TO_NOISE` times the noise."""
CLIPPED = 4.0
"""Largest square of a residual that counts for what is left, over its variance."""

COARSEST = 1.0 / 128.0
"""Step of a converter of 8 bits, over its range."""
LONG_AGO = -(2**40)
ROUNDED = 1e-12
"""A smaller change, over the value, is none."""
NO_NUMBER = 1e9
"""A larger value is no value of a sensor, in any unit."""
Flow = tuple[float, float]
"""Of a valve, and its variance."""


def begin_judge(p: JudgeParameters, state: JudgeState) -> None:
    """Begin a test: the rig is at rest."""
    clear(each for name, each in zip(state._fields, state, strict=True) if name != "axes")
    state.step[0], state.place[0], state.axes[:] = -1, -1, p.rest
    state.raw[:], state.resolution[:] = p.rest.alive["value"][:, 0, 0].T, p.axes.step.T


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
        Mean flow of each valve since the last sample, and its variance, shape (2, n), m/s; not used
        without oil.
    judged : ndarray
        The result, shape (4, n).
    """
    n, is_next, c = raw.shape[1], step == state.step[0] + 1, state.room[0]
    state.step[0], state.place[0] = step, place_of_age(state, -1)
    for i in range(n):
        known, axis = p.axes[i], state.axes[i]
        take(p, state, i, raw)
        if not is_next:
            begin_anew(known, axis, c)
        else:
            mean = (flow[0, i], flow[1, i])
            count = 0
            if not is_plain(known, axis, c, mean):
                oppose(p, state, i, raw)
                count = weigh(known, axis, c, mean)
            decide(known, axis, count)
            note_motion(known, axis, flow[0, i])
        publish(state, i, judged)
    for i in range(n):
        restoring, axis = judged[F, i], state.axes[i]
        for k in range(n):
            restoring -= p.mass[i, k] * judged[A, k]
        state.restoring[i] = restoring
        if axis.alive[0].wrong[0] & ANY_CHANNEL == 0 and axis.alive[0].event[0] == 0.0:
            axis.strained = max(abs(restoring), p.axes[i].recent * axis.strained)


@compiled
def ask(known: Record, axis: Record, force: float) -> None:
    """Know what is asked of a rig that obeys forces, which it holds for a period."""
    last, before = axis.asked[0], axis.asked[1]
    turn = abs(force - 2.0 * last + before)
    axis.asked_turn = max(turn, known.brief * axis.asked_turn)
    axis.asked_jump = max(abs(force - last), known.brief * axis.asked_jump)
    axis.asked[0], axis.asked[1] = force, last


@compiled
def take(p: JudgeParameters, state: JudgeState, i: int, raw: Floats) -> None:
    """Take the values of an axis, the variances of their noise, and what is beside it."""
    c, known = state.room[0], p.axes[i]
    c.forced, c.beside, c.doubt = 0, 0.0, 0.0
    for row in range(4):
        value = raw[row, i]
        moved = abs(value - state.raw[row, i])
        if moved < ROUNDED * abs(value):  # of a filter, where its input stands still
            moved = 0.0
        state.moved[row, i], state.raw[row, i] = moved, value
        c.seen[row] = value
        if not abs(value) < NO_NUMBER:
            c.forced |= 1 << row
            c.seen[row] = state.axes[i].alive[0].value[0, row]
        elif abs(value) >= known.range[row]:
            c.forced |= 1 << row + 4
        resolution = state.resolution[row, i]
        if resolution == np.inf:  # it has not moved yet: by a step of its converter, if it does now
            coarsest = known.range[row] * COARSEST
            resolution = min(moved, coarsest) if coarsest < np.inf and moved < np.inf else 0.0
        c.noise[row] = known.noise[row] + resolution * resolution / 12.0
        if 0.0 < moved < state.resolution[row, i] and state.step[0] > 0:
            state.resolution[row, i] = moved
    unmeasured = known.never & ANY_CHANNEL
    c.forced &= ~(unmeasured | unmeasured << 4)
    for k in range(raw.shape[1]):  # the acceleration of others, to which the mass couples it
        if k != i and p.mass[i, k] != 0.0:
            last, a = state.axes[k].alive[0].value, raw[A, k]
            expected, surprise = 2.0 * last[0, A] - last[1, A], state.axes[k].turned
            if abs(a) < min(NO_NUMBER, p.axes[k].range[A]):
                expected, surprise = a, abs(a - expected)  # it may be wrong by that
            c.beside += p.mass[i, k] * expected
            c.doubt += (p.mass[i, k] * surprise) ** 2


def _oppose(p: JudgeParameters, state: JudgeState, i: int, raw: Floats) -> None:
    """Find how far r may change by the motion, with springs that soften and stops that close.

    Where a spring may turn since the last sample, its friction does, too: any change is possible.
    """
    most, known, on, back, damped = state.room[0].most, p.axes[i], 0.0, 0.0, 0.0
    most[:] = np.inf
    for k in range(len(p.springs)):
        spring, noise = p.springs[i, k], known.noise[V]
        last, now = state.axes[i].alive[0].value[0, V], raw[V, i]
        if k != i:
            last, now = last - state.axes[k].alive[0].value[0, V], now - raw[V, k]
            noise += p.axes[k].noise[V]
        if spring == 0.0:
            continue
        slow = hypotheses.SURE_SIGN * math.sqrt(noise)
        if not (min(last, now) > slow or max(last, now) < -slow):
            return
        strained = 0.5 * known.dt * spring * (last + now)
        on, back = on + max(strained, 0.0), back + max(-strained, 0.0)
        damped += DAMPED * math.sqrt(abs(spring) * known.mass) * abs(now - last)
    if back > 0.0:
        most[0] = STIFFER * on + OPPOSED * back + damped
    if on > 0.0:
        most[1] = STIFFER * back + OPPOSED * on + damped


oppose = compiled(_oppose, inline=False)


@compiled
def begin_anew(known: Record, axis: Record, c: Record) -> None:
    """Begin with one branch, of this sample."""
    axis.count, b = 1, axis.alive[0]
    b.weight, b.settling, b.event[:] = 0.0, axis.strained**2, 0.0
    for age in range(REVISED, 0, -1):
        b.wrong[age] = b.wrong[age - 1]
    b.wrong[0] = c.forced & ANY_CHANNEL
    for age in range(2):
        copy(4, c.seen, b.value[age])
        copy(4, c.noise, b.variance[age])
        b.restoring[age] = c.seen[F] - known.mass * c.seen[A] - c.beside
        b.blur[age] = c.noise[F] + known.mass**2 * c.noise[A]


@compiled
def rise_of(b: Record) -> float:
    """Give the square of the last change of r, less what its noise makes of it, N^2."""
    return (b.restoring[0] - b.restoring[1]) ** 2 - b.blur[0] - b.blur[1]


@compiled
def go_on(known: Record, axis: Record, b: Record) -> tuple[float, float]:
    """Give the r that (4) expects after a branch, N, and the variance of what it leaves, N^2."""
    change = b.restoring[0] - b.restoring[1]
    if known.mass == 0.0 and not known.imposed:
        return b.restoring[0] + change, UNKNOWN**2  # (3) tells f; without that r is f
    blur, before = b.blur[0], b.blur[1]
    rise = max(axis.rises, rise_of(b), 0.0)
    part = rise / (rise + blur + before)
    curved = known.stiffness * known.dt**2 * b.value[0, A]
    left = (1.0 + part) ** 2 * blur + part * part * before + (1.0 - part) ** 2 * rise
    return b.restoring[0] + part * change, left + b.settling + axis.scatter + curved * curved


def _find_blur(known: Record, axis: Record) -> None:
    """Covariance of the residuals by those of the last two samples, L R L' + D P D'."""
    noise, before = axis.usual[0], axis.usual[1]
    for row in range(4):
        for column in range(row + 1):
            value = 0.0
            for k in range(4):
                value += known.now[row, k] * noise[k] * known.now[column, k]
                value += known.before[row, k] * before[k] * known.before[column, k]
            axis.blur[row, column] = value
    hypotheses.factorise(axis.blur, axis.root, 4)


find_blur = compiled(_find_blur, inline=False)


def _compare(known: Record, axis: Record, c: Record, b: Record, flow: Flow) -> None:
    """Compare the sample with a branch: residuals, and their covariance (lower half)."""
    dt, z, last, left, held = known.dt, c.seen, b.value[0], c.left, 0.0
    half, bend = 0.5 * dt, dt * dt / 12.0
    if known.gain > 0.0:
        z[V] = derived(known.gain, known.pole, last[V], z[X] - last[X])
    moved = half * (z[V] + last[V]) - bend * (z[A] - last[A])
    c.off[0] = z[X] - last[X] - moved
    c.off[1] = z[V] - last[V] - half * (z[A] + last[A])
    expected, left_by_force = go_on(known, axis, b)
    c.off[3] = z[F] - known.mass * z[A] - c.beside - expected
    if known.mass > 0.0:  # a held force jumps at any time in a period
        held = half * axis.asked_jump / known.mass
    bent = abs(z[A] - 2.0 * last[A] + b.value[1, A])
    late, turned = known.late * axis.gained, dt / 12.0 * max(axis.turned, bent)
    left[0] = axis.part[0] * axis.travel**2 + late**2 + (dt / 6.0 * held) ** 2
    left[1] = axis.part[1] * axis.gained**2 + (late / dt) ** 2 + turned**2 + held**2
    if known.oil > 0.0:
        c.off[2] = z[F] - (1.0 - known.leak * dt) * last[F] + known.oil * (moved - dt * flow[0])
        left[2] = axis.part[2] * axis.pressed**2 + (known.oil * dt) ** 2 * flow[1]
        left[2] += (UNCERTAIN_OIL * known.oil * dt * (flow[0] - last[V])) ** 2
    else:
        c.off[2] = z[F] - 2.0 * last[F] + b.value[1, F]
        left[2] = b.variance[1, F] + axis.asked_turn**2 + axis.bent**2
        if known.imposed:
            left[2] = UNKNOWN**2
    left[3] = left_by_force + c.doubt
    is_usual = True
    for k in range(4):
        is_usual &= axis.usual[0, k] == c.noise[k]
        is_usual &= axis.usual[1, k] == b.variance[0, k]
    if not is_usual:
        copy(4, c.noise, axis.usual[0])
        copy(4, b.variance[0], axis.usual[1])
        find_blur(known, axis)
    for row in range(4):
        for column in range(row + 1):
            c.covariance[row, column] = axis.blur[row, column]
        c.covariance[row, row] += left[row]


compare_sample, compare_apart = compiled(_compare), compiled(_compare, inline=False)


@compiled
def is_plain(known: Record, axis: Record, c: Record, flow: Flow) -> bool:
    """Say whether the sample fits the only branch, and was added to it: so are nearly all."""
    b = axis.alive[0]
    if c.forced or axis.count > 1 or b.wrong[0] & ANY_CHANNEL:
        return False
    compare_sample(known, axis, c, b, flow)
    copy(4, c.off, c.solution)
    by_noise = hypotheses.substitute(axis.root, c.solution, 4)  # chi^2 by all of S is smaller
    if not by_noise < PLAIN:
        hypotheses.factorise(c.covariance, c.root, 4)
        copy(4, c.off, c.solution)
        if not hypotheses.substitute(c.root, c.solution, 4) < PLAIN:
            return False
    if b.wrong[0] == 0:
        learn(known, axis, c)
    c.which[0] = 0
    continue_branch(known, axis, c, b, b, 0)
    return True


@compiled
def learn(known: Record, axis: Record, c: Record) -> None:
    """Learn what the relations leave from a sample that is plainly sound, like the last one."""
    for relation in range(4):
        whole = c.covariance[relation, relation]
        beyond = min(c.off[relation] ** 2, CLIPPED * whole) - whole
        if relation == 3:
            axis.scatter = max(axis.scatter + (1.0 - known.recent) * beyond, 0.0)
            axis.rises += (1.0 - known.brief) * (rise_of(axis.alive[0]) - axis.rises)
            axis.rises = max(axis.rises, 0.0)
            break
        if relation == 2 and known.oil == 0.0:
            continue
        size = axis.travel if relation == 0 else axis.gained if relation == 1 else axis.pressed
        size = size * size
        described = axis.part[relation] * size
        if axis.motion[relation] == 0.0:
            first = ASSUMED_FOR / known.dt * MOTION_TO_NOISE**2 * (whole - described)
            axis.motion[relation], axis.missed[relation] = first, axis.part[relation] * first
        axis.motion[relation] = known.events * axis.motion[relation] + size
        missed = known.events * axis.missed[relation] + beyond + described
        axis.missed[relation] = max(missed, 0.0)
        part = axis.missed[relation] / axis.motion[relation]
        axis.part[relation] = max(part, LEAST_MISSED**2)


@compiled
def note_motion(known: Record, axis: Record, flow: float) -> None:
    """Note how far the last sample moves."""
    b, dt = axis.alive[0], known.dt
    rise, grown = b.value[0, A] - b.value[1, A], b.value[0, F] - b.value[1, F]
    axis.turned = max(abs(rise - axis.rise[0]), known.brief * axis.turned)
    axis.bent = max(abs(grown - axis.rise[1]), known.brief * axis.bent)
    axis.travel = max(dt * abs(b.value[0, V]), known.brief * axis.travel)
    axis.gained = max(dt * abs(b.value[0, A]), known.brief * axis.gained)
    pressed = known.oil * dt * max(abs(flow), abs(b.value[0, V]))
    axis.pressed = max(pressed, known.recent * axis.pressed)
    axis.rise[0], axis.rise[1] = rise, grown


def _weigh(known: Record, axis: Record, c: Record, flow: Flow) -> int:
    """Weigh all hypotheses after all branches; count the likeliest, the next branches."""
    count, forced = 0, (c.forced | c.forced >> 4) & ANY_CHANNEL
    for j in range(axis.count):
        b = axis.alive[j]
        before, is_sound = hypotheses.wrong_before(b), forced == 0
        compare_apart(known, axis, c, b, flow)
        for turns in (False, True):
            goes_on = hypotheses.allow_turn(known, axis, c, b) if turns else 0.0
            log_det = math.log(hypotheses.whiten(known, c))
            chi2 = hypotheses.fill_gram(known, c) + goes_on
            if is_sound:
                hypotheses.solve(c, 0, count)
                is_sound = chi2 < PLAIN and hypotheses.log_opposed(known, axis, c, b, count) == 0.0
            for which in records.SETS:
                turn = which & (EVENT | FORCES) == EVENT  # at an unknown time, by a known jump
                if forced & ~which or which & known.never or turn != turns:
                    continue
                if is_sound and which & ~before:
                    continue
                gain, log_det_b = hypotheses.solve(c, which, count)
                c.branch[count], c.which[count] = j, which
                weight = b.weight - 0.5 * (chi2 - gain + log_det + log_det_b)
                weight += hypotheses.log_prior(before, which, c.forced)
                c.likelihood[count] = weight + hypotheses.log_amplitudes(known, axis, c, count)
                count += 1
            if is_sound:
                break
    new, top = 0, c.likelihood[likeliest(c.likelihood, count)]
    for _ in range(records.ALIVE):
        at = likeliest(c.likelihood, count)
        if not c.likelihood[at] > top + LEAST:
            break
        b, to = axis.alive[c.branch[at]], axis.made[new]
        if new == 0 and (c.which[at] | b.wrong[0]) == 0:
            compare_apart(known, axis, c, b, flow)
            learn(known, axis, c)
        continue_branch(known, axis, c, b, to, at)
        c.likelihood[at] = -np.inf
        if not (new and joins(axis.made, new)):
            new += 1
    return new


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
def continue_branch(known: Record, axis: Record, c: Record, b: Record, to: Record, at: int) -> None:
    """Continue a branch by a candidate, as a new one; by none wrong, also in its own place."""
    which = c.which[at]
    for age in range(REVISED, 0, -1):
        to.wrong[age] = b.wrong[age - 1]
    to.event[2], to.event[1] = b.event[1], b.event[0]
    to.weight, to.wrong[0] = c.likelihood[at], which
    to.event[0] = c.amplitude[at, 5] if which & EVENT else 0.0
    for row in range(4):
        value, variance = c.seen[row], c.noise[row]
        if which >> row & 1:
            end, is_end = known.range[row], c.forced >> row + 4 & 1
            to.error[row] = c.amplitude[at, row]
            value -= to.error[row]
            variance = max(c.spread[at, row], variance)
            if is_end and hypotheses.weigh_end(known, c, b, row, at)[1]:
                value = max(value, end) if c.seen[row] > 0.0 else min(value, -end)
                to.wrong[0] &= ~(1 << row)
        to.value[0, row], to.value[1, row] = value, b.value[0, row]
        to.variance[0, row], to.variance[1, row] = variance, b.variance[0, row]
    if known.gain > 0.0:
        moved = to.value[0, X] - to.value[1, X]
        to.value[0, V] = derived(known.gain, known.pole, to.value[1, V], moved)
    force = to.value[0, F] - known.mass * to.value[0, A] - c.beside
    blur = to.variance[0, F] + known.mass**2 * to.variance[0, A]
    if which & FORCES and not which & EVENT:
        blur = min(blur, go_on(known, axis, b)[1])
    to.restoring[1], to.blur[1], to.settling = b.restoring[0], b.blur[0], 0.25 * b.settling
    to.restoring[0], to.blur[0] = force, blur
    if which & EVENT:  # a stop goes on to rise, friction stays: the mean of both
        half = 0.5 * to.event[0]
        to.restoring[1] = force - (b.restoring[0] - b.restoring[1]) - half
        to.blur[1], to.settling = b.blur[0] + b.blur[1], half * half


@compiled
def joins(made: Record, new: int) -> bool:
    """Say whether a new branch has come to the state of another, and was added to its weight."""
    b = made[new]
    if (b.wrong[0] | b.wrong[1]) & ANY_CHANNEL:
        return False
    size = 1e-9 * (abs(b.restoring[0]) + abs(b.restoring[1]))
    for k in range(new):
        other = made[k]
        is_near = abs(other.restoring[0] - b.restoring[0]) <= size
        is_near &= abs(other.restoring[1] - b.restoring[1]) <= size
        if is_near and not (other.wrong[0] | other.wrong[1]) & ANY_CHANNEL:
            other.weight += math.log1p(math.exp(b.weight - other.weight))
            return True
    return False


@compiled
def decide(known: Record, axis: Record, count: int) -> None:
    """Keep of new branches those that agree with the likeliest one on the oldest sample."""
    best, kept = likeliest(axis.made["weight"], count), 1
    if count:
        axis.alive[0] = axis.made[best]
    first = axis.alive[0]
    is_sure = first.event[2] != 0.0
    for j in range(count):
        b = axis.made[j]
        if j == best or (b.wrong[REVISED] ^ first.wrong[REVISED]) & ANY_CHANNEL:
            continue
        axis.alive[kept] = axis.made[j]
        axis.alive[kept].weight = b.weight - first.weight
        is_sure &= b.event[2] != 0.0 or b.weight - first.weight < SURE
        kept += 1
    axis.count, axis.alive[0].weight = kept, 0.0
    confirmed = abs(first.event[2]) if is_sure else 0.0
    axis.known = max(confirmed, known.events * axis.known)
    axis.lately = max(confirmed, known.brief * axis.lately)


@compiled
def publish(state: JudgeState, i: int, judged: Floats) -> None:
    """Give the likeliest values, and count those that were replaced, as is known by now."""
    b = state.axes[i].alive[0]
    for age in range(1 + REVISED):  # the present sample takes the place of the oldest one
        place, now = place_of_age(state, age), b.wrong[age]
        was = state.sets[place, i]
        if now == was:
            continue  # as nearly always
        for row in range(4):
            state.counts[row, i] += (now >> row & 1) - (was >> row & 1)
        state.counts[records.ANY_ROW, i] += int(members(now) > 0) - int(members(was) > 0)
        state.counts[records.SEVERAL_ROW, i] += int(members(now) > 1) - int(members(was) > 1)
        state.sets[place, i] = now
    for row in range(4):
        judged[row, i] = b.value[0, row]


@compiled
def is_replaced(state: JudgeState, age: int, row: int, i: int) -> bool:
    """Say whether a value of the last sample, or of one before, was replaced."""
    return state.sets[place_of_age(state, age), i] >> row & 1 != 0


@compiled
def place_of_age(state: JudgeState, age: int) -> int:
    """Place of a sample in ``sets``, by its age; -1: of the next one."""
    place, places = state.place[0] - age, len(state.sets)
    return place + places if place < 0 else place if place < places else 0
