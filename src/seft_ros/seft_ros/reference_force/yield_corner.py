"""A law with one corner, which foretells where a specimen will yield.

The identified model of `restoring_model` is a line near the specimen's state. It answers a corner
of the force when that has been measured, and the valve one delay later. But a specimen that has
yielded yields again at the same force. So beside that model stands

    s = p + K e + C e' + w z(e)

with one stop operator z of an unknown threshold y. Since the last slip, which ended at e_s in the
sense d = 1 or -1, it has w z = w (e - e_s) + c d with c = w y; while it slips, e = e_s. That is
linear in p, K, C, w and c, which a Kalman filter estimates, and with them y = c / w.

An error b of the observed deformation e acts through K and, while it sticks, through w together
with that of e_s, b_s: with friction 1 um is 10 N. So the law has K (e + b) and w (e + b - e_s -
b_s) + c d, and both errors are estimated, too: b is a Gauss-Markov process with the variance and
memory of the observer's noise, and b_s is b of the sample at which it stopped slipping. The law
slips where this z does; near y a part of the force is uncertain, because the slider may stick. A
spring that does not move tells nothing of K, C, w and c: regression on a motion that is noise takes
w for smaller than it is.

The law begins when the specimen yields: the filter of the model detects a change, the force rises
less than before while the specimen moves away from the middle, and no slip was foretold. What the
force lacks, over the stiffness, is how far the corner lies back. The stiffness is the model's, or
that from where the motion began to here, if it is larger: the model may not have learned yet how
stiff a specimen sticks. At the corner the force is known, and a part of the stiffness, unknown by
all of it, goes from K to w. At the first corner y is the deformation itself; later it is half of
the way from where it slipped to the other side. A law that is refuted, because it was wrong where
it began, begins again at the next corner that it has not foretold. Until it foretells at all, what
refutes it makes w uncertain.

The law takes the place of the assumed specimen when it has foretold a corner on the other side,
without which the force would have been missed by `STANDS_OUT` times its noise and the error of w:
on a linear specimen a small w is chance. Then it is as likely as the identified model. From there
on likelihoods decide, as for the assumed specimen. Like that model it improves its estimate of
earlier forces with every sample, see `restoring_model`.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Record
from seft_plant_sim.compiled import compiled, copy, dot, multiply_sized

STANDS_OUT = 20.0
"""Least motion, or force, over its noise that is seen well: regression on a noisy motion
underestimates, by the square of the noise over the motion (0.25 %)."""
_P, _K, _C, _W, _FORCE, _ERROR, _END_ERROR = range(7)
"""Places of the unknowns p, K, C, w, c, b and b_s."""
HOLDS = 1e3
"""Threshold of a stop operator that does not slip, m."""
_BEGUN, FORETELLS = 1.0, 2.0
CORNER_STATE = np.dtype(
    [
        ("stage", "f8"),  # of the law: 0 before it begins, `_BEGUN` or `FORETELLS`
        ("sense", "f8"),  # d
        ("force", "f8"),  # c, N
        ("sticks", "f8"),  # 1 while it sticks, or 0
        ("missed", "f8"),  # recent innovations, N
        ("chance", "f8"),  # their variance, N^2
        ("variance", "f8"),  # of the last one, N^2
        ("foretold", "f8"),  # motion of foretold slips, m; -1 before one on the other side
        ("begun", "f8"),  # deformation at which the slips before began, m
        ("ended", "f8"),  # e_s, m
        ("held", "f8"),  # force at e_s, without damping, N
        ("error", "f8"),  # b, m
        ("end_error", "f8"),  # b_s, m
        ("shift", "f8"),  # by which the last sample has moved z with y, m
        ("mended", "f8"),  # by it of the past impulse, over a period, N
    ]
)
"""State of a law's slider; zeros before it begins."""


class CornerParameters(NamedTuple):
    """Parameters of the laws of n springs, see `seft_ros.reference_force.restoring_model`.

    Attributes
    ----------
    place : int
        Of w among the q parameters of the model.
    start, prior, drift : ndarray
        Of the model, shape (n, q).
    noise, white : ndarray
        Variance of the force with the effect of the motion's noise, and without; N^2, shape (n,).
    observed, kept
        Of the model: variances of the motion, and memory of its error.
    recent, surprise : float
        Of the model.
    """

    place: int
    start: Floats
    prior: Floats
    drift: Floats
    noise: Floats
    white: Floats
    observed: Floats
    kept: float
    recent: float
    surprise: float


class CornerState(NamedTuple):
    """State of the laws: arrays of zeros."""

    law: Annotated[Floats, "n", "q"]  # parameters, in the places of the model's
    covariance: Annotated[Floats, "n", 8, 8]  # of the unknowns, and a zero
    past: Annotated[Floats, "n", 8]  # their covariance with the past impulse, over a period
    slider: Annotated[Record, CORNER_STATE, "n"]
    work: Annotated[Floats, 4, 8]


@compiled
def forget(slider: Record) -> None:
    """Set the state of a slider to zeros."""
    slider.stage = slider.sense = slider.force = slider.sticks = slider.foretold = 0.0
    slider.missed = slider.chance = slider.variance = slider.shift = slider.mended = 0.0
    slider.begun = slider.ended = slider.held = slider.error = slider.end_error = 0.0


@compiled
def expect_corner(
    p: CornerParameters,
    state: CornerState,
    j: int,
    phi: Floats,
    moved: float,
    measured: float,
    y: float,
) -> float:
    """Hold the force of spring j, N, against its law; give the innovation's variance, N^2.

    Parameters
    ----------
    p, state
        The state is updated.
    j : int
        The spring.
    phi : ndarray
        Factors of the parameters, shape (q,); z is that of the law.
    moved, measured, y : float
        Change of the deformation, m; the force; and the threshold, m.
    """
    z, law, slider, covariance = phi[p.place], state.law[j], state.slider[j], state.covariance[j]
    damping, e, unsure = 1 + len(p.start) + j, phi[1 + j], 0.0
    if slider.sticks == 0.0:  # it slips on from here, or sticks
        slider.end_error, state.past[j, _END_ERROR] = slider.error, state.past[j, _ERROR]
        for i in range(8):
            covariance[i, _END_ERROR] = covariance[i, _ERROR]
        copy(8, covariance[_ERROR], covariance[_END_ERROR])
        if abs(z) < y:  # it turned
            slider.ended = e - (z - slider.sense * y)
    slider.error *= p.kept
    fade(covariance, _ERROR, p.kept, (1.0 - p.kept * p.kept) * p.observed[j, 0])
    z = slider.sense * y + e - slider.ended + slider.error - slider.end_error
    over = abs(z) - y
    slips = over >= 0.0
    slider.sticks = 0.0 if slips else 1.0
    if slips:
        z = y if z > 0.0 else -y
        of_z = (
            covariance[_ERROR, _ERROR]
            + covariance[_END_ERROR, _END_ERROR]
            - 2.0 * covariance[_ERROR, _END_ERROR]
        )
        unsure = 0.5 * law[p.place] ** 2 * of_z * math.exp(-0.5 * over * over / of_z)
        if z * slider.sense < 0.0:
            slider.sense, slider.foretold, slider.begun = -slider.sense, 0.0, slider.ended
        slider.ended, slider.held = e, measured - law[damping] * phi[damping]
    phi[p.place] = z
    covariance[_K, _K] += p.drift[j, 1 + j]
    covariance[_C, _C] += p.drift[j, damping]
    variance = unsure + _variance(p, state, j, phi, y)
    missed = measured - _force(p, state, j, phi)
    slider.missed = p.recent * slider.missed + missed
    slider.chance = p.recent * p.recent * slider.chance + variance
    if is_refuted(p, slider):
        slider.foretold = -1.0
        if slider.stage == _BEGUN and not slips and missed * missed > variance:
            by_w = (missed * missed - variance) / state.work[0, _W] ** 2
            covariance[_W, _W] += min(by_w, law[p.place] ** 2)
            variance = _variance(p, state, j, phi, y)
    if slips and slider.foretold >= 0.0:
        slider.foretold += abs(moved)
        saved = law[p.place] * slider.foretold
        of_saved = p.noise[j] + covariance[_W, _W] * slider.foretold**2
        if saved > STANDS_OUT * math.sqrt(of_saved) and _yields(p, law, j):
            slider.stage = FORETELLS
    slider.variance = variance
    return variance


@compiled
def fade(covariance: Floats, place: int, kept: float, gained: float) -> None:
    """Predict the covariance of an error with a memory, which is in a place."""
    for i in range(len(covariance)):
        covariance[i, place] *= kept
        covariance[place, i] *= kept
    covariance[place, place] += gained


@compiled
def _variance(p: CornerParameters, state: CornerState, j: int, phi: Floats, y: float) -> float:
    """Variance of a force about its law, N^2; ``work`` is then the factors and their gains."""
    factors, gain, law, slider = state.work[0], state.work[1], state.law[j], state.slider[j]
    sense, damping, by_slider = slider.sense, 1 + len(p.start) + j, law[p.place] * slider.sticks
    factors[_P], factors[_K], factors[_C] = 1.0, phi[1 + j], phi[damping]
    factors[_W], factors[_FORCE] = phi[p.place] - sense * y, sense
    factors[_ERROR], factors[_END_ERROR] = law[1 + j] + by_slider, -by_slider
    multiply_sized(8, 8, state.covariance[j], factors, gain)
    return p.white[j] + law[damping] ** 2 * p.observed[j, 1] + dot(8, factors, gain)


@compiled
def _force(p: CornerParameters, state: CornerState, j: int, phi: Floats) -> float:
    """Force by a law, N: with b, and with c, which is not w y before w is known."""
    law, slider, factors = state.law[j], state.slider[j], state.work[0]
    beside = law[1 + j] * slider.error + slider.force * factors[_FORCE]
    return dot(len(law), law, phi) + law[p.place] * (factors[_W] - phi[p.place]) + beside


@compiled
def may_begin(p: CornerParameters, state: CornerState, j: int) -> bool:
    """Say whether there is no law, or one of no yielding, or refuted where it foretold no slip."""
    slider = state.slider[j]
    foretold = slider.stage == FORETELLS and slider.sticks == 0.0
    fails = not _yields(p, state.law[j], j) or (is_refuted(p, slider) and not foretold)
    return slider.stage == 0.0 or fails


@compiled
def _yields(p: CornerParameters, law: Floats, j: int) -> bool:
    """Say whether a law has a slider, and falls no faster behind its corner than it rises before.

    Small motions of a slider that sticks far from 0 may tell K and w only by their sum.
    """
    return law[p.place] > 0.0 and 2.0 * law[1 + j] + law[p.place] >= 0.0


@compiled
def is_refuted(p: CornerParameters, slider: Record) -> bool:
    """Say whether recent innovations of a law are larger than chance makes them."""
    return slider.missed * slider.missed > p.surprise * slider.chance


@compiled
def begin_corner(
    p: CornerParameters,
    state: CornerState,
    j: int,
    phi: Floats,
    moved: float,
    lacks: float,
    slope: float,
    found: Floats,
    measured: float,
    y: float,
) -> float:
    """Let the law of spring j begin; give y.

    Parameters
    ----------
    p, state, j, phi, moved, measured, y
        See `expect_corner`; z in ``phi`` is changed to that of the corner.
    lacks, slope : float
        What the force lacks, N, and the stiffness before, N/m.
    found : ndarray
        The model's parameters before, shape (q,).
    """
    law, slider, covariance, e = state.law[j], state.slider[j], state.covariance[j], phi[1 + j]
    along, damping, sense = state.work[1], 1 + len(p.start) + j, 1.0 if moved > 0.0 else -1.0
    now, back = measured - found[damping] * phi[damping], slider.sense * sense
    start = HOLDS if slider.sense == 0.0 else slider.ended if back < 0.0 else slider.begun
    part, way = (1.0, abs(e)) if start == HOLDS else (0.5, abs(e - start))
    way = max(way, abs(moved))
    rise = abs(now - slider.held) if back <= 0.0 else 0.0
    slope = max(slope, (rise + lacks) / way)
    over = lacks / slope
    if over >= part * way:  # it did not begin before the motion
        return y
    y = part * (way - over)
    copy(len(law), p.start[j], law)
    law[0], law[1 + j], law[damping] = 0.0, slope, found[damping]
    law[0] = measured + sense * lacks - dot(len(law), law, phi)
    along[:] = 0.0
    along[_P], along[_K], along[_W], along[_FORCE] = e - sense * (over + y), -1.0, 1.0, y
    for i in range(8):
        for k in range(8):
            covariance[i, k] = slope * slope * along[i] * along[k]
    covariance[_P, _P] += p.prior[j, 0]
    covariance[_K, _K] += p.prior[j, 1 + j]
    covariance[_C, _C] += p.prior[j, damping]
    covariance[_W, _W] += 2.0 * p.observed[j, 0] * (slope / way) ** 2  # of the ends of the way
    covariance[_FORCE, _FORCE] += slope * slope * moved * moved  # the corner may lie a sample away
    covariance[_ERROR, _ERROR] = p.observed[j, 0]
    forget(slider)
    state.past[j] = 0.0
    slider.sense, slider.foretold, slider.stage = sense, -1.0, _BEGUN
    slider.begun, slider.ended, slider.held = start, e, now
    phi[p.place] = sense * y
    slider.variance = _variance(p, state, j, phi, y)
    return y


@compiled
def follow_corner(
    p: CornerParameters,
    state: CornerState,
    j: int,
    phi: Floats,
    measured: float,
    y: float,
    remembered: float,
    moves: bool,
) -> float:
    """Update the law of spring j with its force; give y, and change z in ``phi`` accordingly.

    ``work`` is as `expect_corner` or `begin_corner` has left it. The structure has ``remembered``
    such a part of an impulse for a step. Where the spring does not move, p and errors change only.
    """
    law, slider, covariance = state.law[j], state.slider[j], state.covariance[j]
    factors, gain, taken, left = state.work[0], state.work[1], state.work[2], state.work[3]
    damping, past, variance = 1 + len(p.start) + j, state.past[j], slider.variance
    missed = measured - _force(p, state, j, phi)
    of_past = dot(8, past, factors) / variance
    for i in range(8):
        taken[i] = gain[i] / variance if moves or i == _P or i >= _ERROR else 0.0
        left[i] = taken[i] * variance - gain[i]
    sharpen(8, taken, left, gain, covariance)
    for i in range(8):  # an error of the motion is none of the force
        past[i] = remembered * (past[i] - of_past * gain[i]) + dot(_ERROR, covariance[i], factors)
    slider.mended, slider.shift = of_past * missed, 0.0
    law[0] += taken[_P] * missed
    law[1 + j] += taken[_K] * missed
    law[damping] += taken[_C] * missed
    law[p.place] += taken[_W] * missed
    slider.force += taken[_FORCE] * missed
    slider.error += taken[_ERROR] * missed
    slider.end_error += taken[_END_ERROR] * missed
    if not _yields(p, law, j) or slider.force <= 0.0:
        slider.stage = _BEGUN
        return y
    slider.shift = slider.sense * (slider.force / law[p.place] - y)
    phi[p.place] += slider.shift + slider.sticks * (taken[_ERROR] - taken[_END_ERROR]) * missed
    return slider.force / law[p.place]


@compiled
def sharpen(q: int, taken: Floats, left: Floats, gain: Floats, p: Floats) -> None:
    """Take what a sample tells out of a covariance, P += taken left' - gain taken'."""
    for i in range(q):
        own, row = taken[i], gain[i]
        for k in range(0, q, 4):  # all four before the first is stored: it might be one of these
            one = p[i, k] + (own * left[k] - row * taken[k])
            two = p[i, k + 1] + (own * left[k + 1] - row * taken[k + 1])
            three = p[i, k + 2] + (own * left[k + 2] - row * taken[k + 2])
            four = p[i, k + 3] + (own * left[k + 3] - row * taken[k + 3])
            p[i, k], p[i, k + 1], p[i, k + 2], p[i, k + 3] = one, two, three, four
