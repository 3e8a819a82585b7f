"""The restoring force near the specimen's state: a line, a damper and sliders, identified on line.

In coordinates of the specimen's springs, with deformations e = D x and forces s = D^-T r, each
spring j is

    s_j = p_j + sum_l K_jl e_l + sum_l C_jl e_l' + sum_i w_ji z_i(e_j)

p is an offset, K and C are stiffness and damping. z_i is the stop operator with threshold y_i: it
moves with the deformation, and stays between -y_i and y_i. Sums of stop operators are the
hysteresis of Prandtl and Ishlinskii (Visintin, Differential Models of Hysteresis, 1994, ch. III),
which describes friction, yielding and unloading. The model is linear in p, K, C and w, so a Kalman
filter estimates them.

The model is only used near the sample: the offset p contains the part of the measured force that
the other parts of the model does not explain. The model serves for the step from the specimen's
state to the target's, and for the prediction a few steps ahead.

While the innovations are noise, the filter averages. If their recent sum is so large that chance
makes it once in `ONCE_IN` s, the specimen has changed: the covariance is increased by the prior's,
scaled to explain the sum (Zhou & Frank 1996), in directions that keep the force of the last sample,
because a force does not jump when a stiffness does.

The assumed specimen is a model without unknowns. If it is right, it predicts better than a model
that still learns. The two are weighted by their likelihoods (Magill 1965), whose ratio is bounded
so that each can overtake the other. When a specimen has yielded, a law that foretells its corners
takes the place of the assumed specimen, see `yield_corner`.

The structure remembers the restoring force as an impulse, and every sample also improves the
estimate of earlier forces. With the covariance c of the parameters and that impulse, the Kalman
filter estimates the impulse, too (a fixed-lag smoother: Anderson & Moore, Optimal Filtering, 1979,
ch. 7). The change of its estimate acts now::

    change of the impulse = c . phi / variance * innovation
    c <- c - P phi (c . phi) / variance, then c <- fade c + P phi with the P after the update

Without it the impulse would be the sum of the estimates over time, with twice the variance of the
sum of the measured force.

The innovations before a change was detected were taken for noise. Their impulse is applied, too.
The structure forgets an impulse in a quarter of its period, which is short where the specimen
sticks: fade follows from the tangent stiffness.

The error b of the observed deformation moves the stop operators, too, while they stick. It is one
more unknown, a Gauss-Markov process with the variance and memory of the observer's noise, that acts
through the tangent stiffness. So the force of a stiff slider that sticks tells b, and is taken
neither for an offset nor for a change.

A spring does not give energy: an estimated damping below 0 is 0, and the offset takes its force.
Otherwise the target of a specimen that sticks could swing on, with the damping of small sliders,
which noise moves, balanced by one that is not there.
"""

import math
from statistics import NormalDist
from typing import Annotated, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints, Record, zeros
from seft_plant_sim.compiled import bounded, compiled, copy, dot, multiply_sized

from seft_ros.reference_force.yield_corner import (
    FORETELLS,
    HOLDS,
    CornerParameters,
    CornerState,
    begin_corner,
    expect_corner,
    fade,
    follow_corner,
    forget,
    may_begin,
    sharpen,
)

THRESHOLDS = 12
"""Number of stop operators of a spring; each has twice the threshold of the one before: from the
noise to 2000 times it, and a corner has a slider within a factor of 1.4. The last is that of
`yield_corner`."""
CORNER = THRESHOLDS - 1
SMALLEST_SLIDER = 2.0
"""Least threshold over the noise of the deformation: smaller ones can't be told from noise."""
ONCE_IN = 2.0
"""Mean time between two sums of innovations that chance makes and the filter takes for a change, s:
3.3 standard deviations at 500 Hz. A false change costs noise, a missed one a corner."""
_RECENT = 0.008
"""Time constant of that sum, s: changes that last longer than a valve's answer matter."""
UNCERTAIN_STIFFNESS, UNCERTAIN_DAMPING = 0.3, 0.3
"""Standard deviation of the assumed values, relative to them: that of a drawing."""
CHANGING_STIFFNESS, CHANGING_DAMPING, CHANGING_SLIDER = 1.0, 0.5, 1.5
"""Standard deviation of a change: of K and C relative to them, of w to its prior. Yielding takes
all stiffness."""
SLIDER_TO_NOISE, OFFSET_TO_NOISE = 0.5, 7.0
"""Prior of a slider's force and of the offset, over the noise of the restoring force, chosen so
that sliders appear when something slips, and the offset takes the remainder."""
MAX_EVIDENCE = math.log(1e4)
"""Largest magnitude of the logarithm of the likelihoods' ratio: a few samples overturn it."""
CONFIRMED_IN = 0.05
"""Time for which the assumed model must be right before it is accepted again, s: with any specimen
an oscillating force crosses the assumed line now and then."""
MOVING_STOP, MOVING_RATE = 3, 8.0
"""A spring moves while the stop operator of 16 times the noise slides, or its rate is 8 times its
noise (0.4 and 1.6 % by the same rule)."""
STUCK_ERROR = 4.0
"""Variance of the error of stop operators that stick over that of the deformation: the noise now,
that at which they began to stick, and as much again, because a stop operator that slides follows
the largest of the noisy deformations (1.3 standard deviations, of six)."""
MODEL_DRIFT = 0.003
"""Undetected slow change in a second, relative to the prior or the assumed value."""
MIN_DAMPING = 0.02
"""Least damping ratio of a spring, also if none is assumed."""


class ModelParameters(NamedTuple):
    """Parameters of the models of n springs with q parameters and m thresholds each.

    Attributes
    ----------
    springs : tuple of int or ndarray
        0 to n - 1, see `places`.
    thresholds : ndarray
        y, shape (n, m), m, at the beginning.
    start : ndarray
        Parameters (p, K, C, w, b) of each spring at the beginning, shape (n, q): 2 + 2n + m, and
        up to three zeros, so that q is a multiple of four.
    prior, drift, change : ndarray
        Their variance at the beginning, per step, and of a change; shape (n, q).
    noise : ndarray
        Variance of the restoring force from the sensors of force and acceleration, and with the
        effect of the motion's noise on the assumed specimen; shape (n, 2), N^2.
    observed : ndarray
        Variance of the deformations (m^2) and their rates (m^2/s^2), shape (n, 2).
    kept : float
        Factor per step with which the error b fades.
    stuck : ndarray
        Variance that it gains per step, shape (n,), m^2.
    least : ndarray
        Least rate above the noise, see `MOVING_RATE`; shape (n,), m/s.
    recent : float
        Factor per step with which sums of innovations fade.
    forgotten : ndarray
        Rate per step at which the structure forgets an impulse on each spring, over the root of its
        stiffness; shape (n,), (m/N)^1/2.
    surprise : float
        Square of the normalised sum at which a change is detected.
    confirming : float
        Largest growth of the evidence for the assumed model while it is not accepted, per step.
    corner : CornerParameters
        Of the laws that foretell yielding.
    """

    springs: tuple[int, ...] | Ints
    thresholds: Floats
    start: Floats
    prior: Floats
    drift: Floats
    change: Floats
    noise: Floats
    observed: Floats
    kept: float
    stuck: Floats
    least: Floats
    recent: float
    forgotten: Floats
    surprise: float
    confirming: float
    corner: CornerParameters


SUMS = np.dtype(
    [
        ("innovation", "f8"),  # recent innovations, N
        ("variance", "f8"),  # of these, N^2
        ("evidence", "f8"),  # logarithm of the likelihoods' ratio, assumed model over identified
        ("impulse", "f8"),  # unexplained, over a period, N
        ("correction", "f8"),  # force that corrects impulses, N
    ]
)
"""What the samples of a spring add up to."""


LINE = np.dtype(
    [
        ("force", "f8"),  # so far, N
        ("slope", "f8"),  # N/m
        ("moved", "f8"),  # so far, m
        ("room", "f8"),  # motion to its end, m
        ("sense", "f8"),  # of the motion
    ]
)
"""Force of a spring's sliders in a motion ahead."""


class RestoringState(NamedTuple):
    """State of the models: arrays of zeros before `begin_model`."""

    values: Annotated[Floats, "n", "q"]  # used parameters
    before: Annotated[Floats, "n", "q"]  # those at the last sample
    found: Annotated[Floats, "n", "q"]  # parameters of the filter
    covariance: Annotated[Floats, "n", "q", "q"]
    past: Annotated[Floats, "n", "q"]  # their covariance with the past impulse, over a period
    regressors: Annotated[Floats, "n", "q"]  # factors of the parameters
    last: Annotated[Floats, "n", "q"]  # those at the last sample
    stops: Annotated[Floats, "n", THRESHOLDS]  # z of the specimen, m
    sums: Annotated[Record, SUMS, "n"]
    work: Annotated[Floats, 3, "q"]
    thresholds: Annotated[Floats, "n", THRESHOLDS]  # y, m
    corner: CornerState


def model_arrays(
    springs: tuple[int, ...] | Ints,
    mass: Floats,
    damping: Floats,
    stiffness: Floats,
    noise: Floats,
    observed: Floats,
    alike: float,
    frequency: Floats,
    dt: float,
) -> tuple[ModelParameters, RestoringState]:
    """Make models of an assumed specimen, all in coordinates of its springs.

    Parameters
    ----------
    springs : tuple or ndarray
        0 to n - 1, see `places`.
    mass, damping, stiffness : ndarray
        Shape (n, n), kg, N s/m and N/m.
    noise : ndarray
        RMS noise of the restoring force from the sensors of force and acceleration, shape (n,), N.
    observed : ndarray
        RMS noise of deformations (m) and their rates (m/s), shape (n, 2).
    alike : float
        So many samples of these count as one, because the observer filters them.
    frequency : ndarray
        Frequency of the whole structure at each spring, shape (n,), rad/s: after a quarter of the
        period an impulse has become a displacement.
    dt : float
        Sampling period, s.
    """
    n, observed = len(mass), np.ascontiguousarray(observed)
    thresholds = SMALLEST_SLIDER * observed[:, :1] * 2.0 ** np.arange(THRESHOLDS)
    thresholds[:, CORNER] = HOLDS
    white = noise**2
    assumed = white + np.hstack([stiffness, damping]) ** 2 @ observed.T.ravel() ** 2
    least_seen = np.sqrt(assumed)[:, np.newaxis]
    force = SLIDER_TO_NOISE * least_seen / thresholds * (thresholds < HOLDS)
    least = 2.0 * MIN_DAMPING * np.sqrt(np.abs(np.diag(mass) * np.diag(stiffness)))
    damps = np.abs(damping) + np.diag(least / UNCERTAIN_DAMPING)
    offset = OFFSET_TO_NOISE * least_seen
    stiff, kept = np.abs(stiffness), 1.0 - 2.0 / (alike + 1.0)
    root = np.sqrt(np.diag(stiff))
    rates = np.divide(2.0 / math.pi * dt * frequency, root, out=np.zeros(n), where=root > 0.0)

    def padded(*columns: Floats) -> Floats:
        values = np.hstack(columns)
        return np.pad(values, [(0, 0), (0, 1 + -(values.shape[1] + 1) % 4)])

    def variance(p: float, k: float, c: float, w: float) -> Floats:
        return padded(p * offset, k * stiff, c * damps, w * force) ** 2

    start = padded(np.zeros((n, 1)), stiffness, damping, np.zeros_like(thresholds))
    prior = variance(1.0, UNCERTAIN_STIFFNESS, UNCERTAIN_DAMPING, 1.0)
    drift = variance(0.0, MODEL_DRIFT, MODEL_DRIFT, MODEL_DRIFT) * dt
    change = variance(1.0, CHANGING_STIFFNESS, CHANGING_DAMPING, CHANGING_SLIDER)
    recent = math.exp(-dt / _RECENT)
    surprise = NormalDist().inv_cdf(1.0 - 0.5 * min(dt / ONCE_IN, 0.5)) ** 2
    place, seen = 1 + 2 * n + CORNER, (observed**2, kept, recent, surprise)
    corner = CornerParameters(place, start, prior, drift, assumed, white, *seen)
    parameters = ModelParameters(
        springs=springs,
        thresholds=thresholds,
        start=start,
        prior=prior,
        drift=drift,
        change=change,
        noise=np.column_stack([white, assumed]),
        observed=observed**2,
        kept=kept,
        stuck=STUCK_ERROR * (1.0 - kept**2) * observed[:, 0] ** 2,
        least=MOVING_RATE * observed[:, 1],
        recent=recent,
        forgotten=rates,
        surprise=surprise,
        confirming=MAX_EVIDENCE * dt / CONFIRMED_IN,
        corner=corner,
    )
    sizes = {"n": n, "q": start.shape[1]}
    return parameters, zeros(RestoringState, sizes, corner=zeros(CornerState, sizes))


@compiled
def begin_model(parameters: ModelParameters, state: RestoringState) -> None:
    """Begin a test with the assumed model."""
    n, q = parameters.start.shape
    state.covariance[:] = 0.0
    state.past[:] = 0.0
    state.stops[:] = 0.0
    state.last[:] = 0.0
    for j in range(n):
        sums = state.sums[j]
        sums.innovation = sums.variance = sums.impulse = sums.correction = 0.0
        sums.evidence = MAX_EVIDENCE
        forget(state.corner.slider[j])
        for i in range(q):
            start = parameters.start[j, i]
            state.values[j, i] = state.before[j, i] = state.found[j, i] = start
            state.covariance[j, i, i] = parameters.prior[j, i]
        copy(THRESHOLDS, parameters.thresholds[j], state.thresholds[j])


@compiled
def move_stops(
    parameters: ModelParameters, thresholds: Floats, change: Floats, stops: Floats
) -> None:
    """Move stop operators by a change of each deformation, shape (n,), m."""
    for j in range(len(parameters.springs)):
        moved = change[j]
        for i in range(0, THRESHOLDS, 4):  # the processor has instructions for four at a time
            one = bounded(stops[j, i] + moved, thresholds[j, i])
            two = bounded(stops[j, i + 1] + moved, thresholds[j, i + 1])
            three = bounded(stops[j, i + 2] + moved, thresholds[j, i + 2])
            four = bounded(stops[j, i + 3] + moved, thresholds[j, i + 3])
            stops[j, i], stops[j, i + 1], stops[j, i + 2], stops[j, i + 3] = one, two, three, four


@compiled
def slider_forces(
    parameters: ModelParameters, values: Floats, stops: Floats, forces: Floats
) -> None:
    """Force of the sliders of each spring with these values, shape (n,), N: the result."""
    n = len(parameters.springs)
    first = 1 + 2 * n
    for j in range(n):
        one = two = three = four = 0.0
        for i in range(0, THRESHOLDS, 4):
            one += values[j, first + i] * stops[j, i]
            two += values[j, first + i + 1] * stops[j, i + 1]
            three += values[j, first + i + 2] * stops[j, i + 2]
            four += values[j, first + i + 3] * stops[j, i + 3]
        forces[j] = (one + two) + (three + four)


@compiled
def slide_on(
    parameters: ModelParameters,
    thresholds: Floats,
    values: Floats,
    change: Floats,
    stops: Floats,
    ahead: Record,
    forces: Floats,
) -> None:
    """Give the force of the sliders of each spring, (n,), N, after a change of its deformation, m.

    It is a line, ``ahead``, as long as the motion goes on and no more sliders slide; the stop
    operators are those of its beginning.
    """
    first = 1 + 2 * len(parameters.springs)
    for j in range(len(parameters.springs)):
        line, further = ahead[j], change[j]
        forces[j] = line.force + line.slope * further
        moved = line.moved + further
        if line.sense * further < 0.0 or abs(moved) > line.room:
            force, slope, room = 0.0, 0.0, math.inf
            sense = 1.0 if further >= 0.0 else -1.0
            for i in range(THRESHOLDS):
                w, y = values[j, first + i], thresholds[j, i]
                z = bounded(bounded(stops[j, i] + line.moved, y) + further, y)
                stops[j, i], left = z, y - sense * z
                force += w * z
                slope += w if left > 0.0 else 0.0
                room = min(room, left if left > 0.0 else math.inf)
            line.slope, line.room, line.sense = slope, room, sense
            forces[j], moved = force, 0.0
        line.force, line.moved = forces[j], moved


@compiled
def tangent(parameters: ModelParameters, state: RestoringState, j: int) -> float:
    """Find the identified stiffness of spring j with the sliders that stick, N/m."""
    n = len(parameters.springs)
    slope = state.found[j, 1 + j]
    for i in range(THRESHOLDS):
        if abs(state.stops[j, i]) < state.thresholds[j, i]:
            slope += state.found[j, 1 + 2 * n + i]
    return slope


@compiled
def motion_noise(parameters: ModelParameters, state: RestoringState, j: int) -> float:
    """Variance of the force of spring j from noise that b does not explain, N^2."""
    found, observed, n = state.found[j], parameters.observed, len(parameters.springs)
    variance = parameters.noise[j, 0]
    for i in range(n):
        if i != j:
            variance += found[1 + i] * found[1 + i] * observed[i, 0]
        variance += found[1 + n + i] * found[1 + n + i] * observed[i, 1]
    return variance


@compiled
def hold_against_law(
    parameters: ModelParameters, state: RestoringState, j: int, moved: float, measured: float
) -> float:
    """Hold a force, N, against the law with a corner; give the variance of what is missed, N^2.

    It is that of the assumed specimen until the law takes its place.
    """
    stage, y, phi = state.corner.slider[j].stage, state.thresholds[j, CORNER], state.regressors[j]
    if stage == 0.0:
        return parameters.noise[j, 1]
    variance = expect_corner(parameters.corner, state.corner, j, phi, moved, measured, y)
    if state.corner.slider[j].stage != FORETELLS:
        return parameters.noise[j, 1]
    if stage != FORETELLS:
        state.sums[j].evidence = max(state.sums[j].evidence, 0.0)
    return variance


@compiled
def follow_law(
    parameters: ModelParameters,
    state: RestoringState,
    j: int,
    moved: float,
    measured: float,
    lacks: float,
    remembered: float,
    moves: bool,
) -> float:
    """Let the law with a corner learn, or begin where the force lacks something, N.

    The result is the change of the past impulse by a law that foretells, over a period, N.
    """
    laws, corner, phi, y = parameters.corner, state.corner, state.regressors[j], state.thresholds[j]
    if lacks > 0.0 and phi[laws.place] * moved > 0.0 and may_begin(laws, corner, j):
        slope, found = tangent(parameters, state, j), state.found[j]
        y[CORNER] = begin_corner(
            laws, corner, j, phi, moved, lacks, slope, found, measured, y[CORNER]
        )
    if corner.slider[j].stage:
        y[CORNER] = follow_corner(laws, corner, j, phi, measured, y[CORNER], remembered, moves)
        state.stops[j, CORNER] = phi[laws.place]
    return corner.slider[j].mended if corner.slider[j].stage == FORETELLS else 0.0


@compiled
def follow_specimen(
    parameters: ModelParameters, state: RestoringState, e: Floats, rate: Floats, measured: Floats
) -> None:
    """Update the models with the measured restoring force of each spring, shape (n,), N.

    The stops have moved to the deformations e before. The result, each spring's ``correction``, is
    the force that acts on the structure over this step in addition to the model's.
    """
    n = len(parameters.springs)
    q = (2 + 2 * n + THRESHOLDS + 3) // 4 * 4  # the processor has instructions for four at a time
    for j in range(n):
        phi, sums, p, gain = state.regressors[j], state.sums[j], state.covariance[j], state.work[0]
        moved, was_right = e[j] - state.last[j, 1 + j], sums.evidence > 0.0
        slope = find_regressors(parameters, state, j, e, rate)
        remembered = math.exp(-parameters.forgotten[j] * math.sqrt(max(slope, 0.0)))
        variance = motion_noise(parameters, state, j)
        innovation = measured[j] - dot(q, state.found[j], phi)
        doubt = hold_against_law(parameters, state, j, moved, measured[j])
        foretells = state.corner.slider[j].stage == FORETELLS
        assumed = state.corner.law[j] if foretells else parameters.start[j]
        surplus = measured[j] - dot(q, assumed, phi)
        for i in range(q):
            p[i, i] += parameters.drift[j, i]
        multiply_sized(q, q, p, phi, gain)  # p is symmetric
        variance += dot(q, phi, gain)
        of_past = dot(q, state.past[j], phi)
        slides = abs(state.stops[j, MOVING_STOP]) == state.thresholds[j, MOVING_STOP]
        moves = slides or abs(rate[j]) > parameters.least[j]
        surprise = weigh_models(parameters, sums, innovation, variance, surplus, doubt)
        is_change = surprise > parameters.surprise
        if is_change:
            change, unexplained = parameters.change[j], (surprise - 1.0) * variance
            learned = q if moves else 1
            variance += widen(phi, state.last[j], change, learned, unexplained, p, gain)
        yields = is_change and sums.evidence <= 0.0 and innovation * moved < 0.0
        lacks = abs(innovation) if yields else 0.0
        by_law = follow_law(parameters, state, j, moved, measured[j], lacks, remembered, moves)
        of_past *= 1.0 / variance
        update_filter(parameters, state, j, innovation, variance, moves, remembered, of_past)
        foretells = state.corner.slider[j].stage == FORETELLS
        assumed, found = state.corner.law[j] if foretells else parameters.start[j], state.found[j]
        weight = 1.0 / (1.0 + math.exp(-sums.evidence))
        copy(q, state.values[j], state.before[j])
        for i in range(q):
            state.values[j, i] = found[i] + weight * (assumed[i] - found[i])
        used = measured[j] - dot(q, state.values[j], phi)
        late = (1.0 - weight) * of_past * innovation + weight * by_law
        impulse = remembered * sums.impulse + used - late
        acts = sums.evidence <= 0.0 and (is_change or was_right)
        sums.impulse = 0.0 if acts else impulse
        sums.correction = late + (impulse if acts else 0.0)
        copy(q, phi, state.last[j])


@compiled
def find_regressors(
    parameters: ModelParameters, state: RestoringState, j: int, e: Floats, rate: Floats
) -> float:
    """Find the factors of the parameters of spring j; give its tangent stiffness, that of b, N/m.

    The error b fades meanwhile.
    """
    n, phi = len(parameters.springs), state.regressors[j]
    error = 1 + 2 * n + THRESHOLDS
    phi[0] = 1.0
    copy(n, e, phi[1:])
    copy(n, rate, phi[1 + n :])
    copy(THRESHOLDS, state.stops[j], phi[1 + 2 * n :])
    state.found[j, error] *= parameters.kept
    fade(state.covariance[j], error, parameters.kept, parameters.stuck[j])
    phi[error] = tangent(parameters, state, j)
    return phi[error]


@compiled
def weigh_models(
    parameters: ModelParameters,
    sums: Record,
    innovation: float,
    variance: float,
    surplus: float,
    doubt: float,
) -> float:
    """Weigh what both models left of a force, N, with their variances, N^2; give the surprise.

    The surprise is the square of the normalised sum of the identified model's innovations;
    ``surplus`` and ``doubt`` are those of the assumed model.
    """
    is_right = sums.evidence > 0.0
    gained = innovation**2 / variance + math.log(variance / doubt)
    gained -= surplus**2 / doubt
    gained = min(0.5 * gained, MAX_EVIDENCE if is_right else parameters.confirming)
    sums.evidence = min(max(sums.evidence + gained, -MAX_EVIDENCE), MAX_EVIDENCE)
    sums.innovation = parameters.recent * sums.innovation + innovation
    sums.variance = parameters.recent**2 * sums.variance + variance
    return sums.innovation * sums.innovation / sums.variance


@compiled
def update_filter(
    parameters: ModelParameters,
    state: RestoringState,
    j: int,
    innovation: float,
    variance: float,
    moves: bool,
    remembered: float,
    of_past: float,
) -> None:
    """Update the identified model of spring j, whose gain P phi is in ``work``.

    Also its covariance c with the past impulse, where ``of_past`` is c . phi over the variance.
    """
    n, p, found = len(parameters.springs), state.covariance[j], state.found[j]
    phi, past, gain = state.regressors[j], state.past[j], state.work[0]
    damper, error, per_variance = 1 + n + j, 1 + 2 * n + THRESHOLDS, 1.0 / variance
    q = (error + 4) // 4 * 4
    taken, left, slope, offset = state.work[1], state.work[2], phi[error], gain[0]
    if not moves:  # the sum may be far more certain than its offset: that gains no more
        most = max(dot(q, phi, gain) - slope * gain[error], 0.0)
        offset = min(max(offset, -most), most)
    for i in range(q):
        # a spring that does not move changes offset and error only (Schmidt-Kalman)
        own = offset if i == 0 else gain[i]
        taken[i] = own * per_variance if moves or i == 0 or i == error else 0.0
        left[i] = taken[i] * variance - gain[i]
        found[i] += taken[i] * innovation
    sharpen(q, taken, left, gain, p)
    negative = min(found[damper], 0.0)
    found[damper] -= negative
    found[0] += negative * phi[damper]
    by_taken, by_left = dot(q, taken, phi), dot(q, left, phi)
    for i in range(q):  # an error of the motion is none of the force
        after = gain[i] + taken[i] * by_left - gain[i] * by_taken - p[i, error] * slope
        past[i] = remembered * (past[i] - of_past * gain[i]) + after


@compiled
def widen(
    phi: Floats,
    last: Floats,
    change: Floats,
    learned: int,
    unexplained: float,
    p: Floats,
    gain: Floats,
) -> float:
    """Let parameters have changed, with the force of the last sample kept; give what that explains.

    P += g T diag(change) T', where T keeps that force; ``gain`` is P phi. Variances are in N^2.
    """
    explained = change[0]
    for i in range(1, learned):
        explained += change[i] * (phi[i] - last[i]) ** 2
    grown = min(unexplained / explained, 1.0)
    p[0, 0] += grown * change[0]
    gain[0] += grown * change[0]
    for i in range(1, learned):
        added = grown * change[i]
        if added > 0.0:
            p[i, i] += added
            p[0, i] -= added * last[i]
            p[i, 0] -= added * last[i]
            p[0, 0] += added * last[i] ** 2
            gain[i] += added * (phi[i] - last[i])
            gain[0] -= added * last[i] * (phi[i] - last[i])
    return grown * explained
