"""A law with one corner, which foretells where a specimen will yield.

The identified model of `restoring_model` is a line near the specimen's state. It answers a corner
of the force when that has been measured, and the valve one delay later. But a specimen that has
yielded yields again at the same force. So beside that model stands

    s = p + K e + C e' + w z(e)

with one stop operator z of an unknown threshold y. Since the last slip, which ended at e_s in the
sense d = 1 or -1, it has w z = w (e - e_s) + c d with c = w y; while it slips, e = e_s. That is
linear in p, K, C, w and c, which a Kalman filter estimates, and with them y = c / w.

The law begins when the specimen yields: the filter of the model detects a change, the force rises
less than before while the specimen moves away from the middle, and no slip was foretold. What the
force lacks, over the stiffness, is how far the corner lies back. At the corner the force is known,
and a part of the stiffness, unknown by all of it, goes from K to w. At the first corner y is the
deformation itself; later it is half of the way from where it slipped to the other side. A law that
is refuted, because it was wrong where it began, begins again at the next corner.

The law takes the place of the assumed specimen when it has foretold a corner on the other side,
without which the force would have been missed by `STANDS_OUT` times its noise. Then it is as likely
as the identified model. From there on likelihoods decide, as for the assumed specimen. Like that
model it improves its estimate of earlier forces with every sample, see `restoring_model`.
"""

import math
from typing import Annotated, NamedTuple

from seft_msgs_py.arrays import Floats
from seft_plant_sim.compiled import compiled, copy, dot, multiply_sized

STANDS_OUT = 20.0
"""Least motion, or force, over its noise that is seen well: regression on a noisy motion
underestimates, by the square of the noise over the motion (0.25 %)."""
HOLDS = 1e3
"""Threshold of a stop operator that does not slip, m."""
_BEGUN, FORETELLS = 1.0, 2.0
_SENSE, _FORCE, _SUM, _VARIANCE, _SLID, _FROM, _END, STAGE, SHIFT, MENDED = range(10)
"""Columns of ``slider``: d; c, N; recent innovations, N, and their variance, N^2; motion of
foretold slips, m, or -1 before one on the other side; stage of the law, 0 before it begins; how far
the last sample has shifted z, m; and what it has mended of the past impulse, over a period, N."""


class CornerParameters(NamedTuple):
    """Parameters of the laws of n springs, see `seft_ros.reference_force.restoring_model`.

    Attributes
    ----------
    place : int
        Of w among the q parameters of the model.
    start, prior, drift : ndarray
        Of the model, shape (n, q).
    noise : ndarray
        Variance of the force with the effect of the motion's noise, N^2, shape (n,).
    recent, surprise : float
        Of the model.
    """

    place: int
    start: Floats
    prior: Floats
    drift: Floats
    noise: Floats
    recent: float
    surprise: float


class CornerState(NamedTuple):
    """State of the laws: arrays of zeros."""

    law: Annotated[Floats, "n", "q"]  # parameters, in the places of the model's
    covariance: Annotated[Floats, "n", 5, 5]  # of p, K, C, w and c
    past: Annotated[Floats, "n", 5]  # their covariance with the past impulse, over a period
    slider: Annotated[Floats, "n", 10]
    work: Annotated[Floats, 2, 5]


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
    damping, slips = 1 + len(p.start) + j, abs(z) == y
    if slips and z * slider[_SENSE] < 0.0:
        slider[_SENSE], slider[_SLID], slider[_FROM] = -slider[_SENSE], 0.0, slider[_END]
    if slips:
        slider[_END] = phi[1 + j]
    covariance[1, 1] += p.drift[j, 1 + j]
    covariance[2, 2] += p.drift[j, damping]
    variance = _variance(p, state, j, phi, y)
    missed = measured - _force(law, phi, p.place, state.work[0], slider)
    slider[_SUM] = p.recent * slider[_SUM] + missed
    slider[_VARIANCE] = p.recent * p.recent * slider[_VARIANCE] + variance
    if is_refuted(p, slider):
        slider[_SLID] = -1.0
    if slips and slider[_SLID] >= 0.0:
        slider[_SLID] += abs(moved)
        saved = law[p.place] * slider[_SLID]
        if saved > STANDS_OUT * math.sqrt(p.noise[j]) and _yields(p, law, j):
            slider[STAGE] = FORETELLS
    return variance


@compiled
def _variance(p: CornerParameters, state: CornerState, j: int, phi: Floats, y: float) -> float:
    """Variance of a force about its law, N^2; ``work`` is then the factors and their gains."""
    factors, gain, sense = state.work[0], state.work[1], state.slider[j, _SENSE]
    factors[0], factors[1], factors[2] = 1.0, phi[1 + j], phi[1 + len(p.start) + j]
    factors[3], factors[4] = phi[p.place] - sense * y, sense
    multiply_sized(5, 5, state.covariance[j], factors, gain)
    return p.noise[j] + dot(5, factors, gain)


@compiled
def _force(law: Floats, phi: Floats, place: int, factors: Floats, slider: Floats) -> float:
    """Force by a law, N: with c, which is not w y before w is known."""
    beside = law[place] * (factors[3] - phi[place]) + slider[_FORCE] * factors[4]
    return dot(len(law), law, phi) + beside


@compiled
def may_begin(p: CornerParameters, state: CornerState, j: int) -> bool:
    """Say whether there is no law, or one that is refuted, or of no yielding."""
    slider = state.slider[j]
    return slider[STAGE] == 0.0 or not _yields(p, state.law[j], j) or is_refuted(p, slider)


@compiled
def _yields(p: CornerParameters, law: Floats, j: int) -> bool:
    """Say whether a law has a slider, and falls no faster behind its corner than it rises before.

    Small motions of a slider that sticks far from 0 may tell K and w only by their sum.
    """
    return law[p.place] > 0.0 and 2.0 * law[1 + j] + law[p.place] >= 0.0


@compiled
def is_refuted(p: CornerParameters, slider: Floats) -> bool:
    """Say whether recent innovations of a law are larger than chance makes them."""
    return slider[_SUM] * slider[_SUM] > p.surprise * slider[_VARIANCE]


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
) -> float:
    """Let the law of spring j begin; give y.

    Parameters
    ----------
    p, state, j, phi, moved
        See `expect_corner`; z in ``phi`` is changed to that of the corner.
    lacks, slope : float
        What the force lacks, N, and the stiffness before, N/m.
    found : ndarray
        The model's parameters before, shape (q,).
    """
    law, slider, covariance, e = state.law[j], state.slider[j], state.covariance[j], phi[1 + j]
    along, damping, sense = state.work[1], 1 + len(p.start) + j, 1.0 if moved > 0.0 else -1.0
    start = HOLDS if slider[_SENSE] == 0.0 else slider[_FROM]
    if slider[_SENSE] * sense < 0.0:
        start = slider[_END]
    way = abs(e) if start == HOLDS else 0.5 * abs(e - start)
    over = min(lacks / max(slope, 1e-3 * abs(p.start[j, 1 + j])), way)
    y = way - over if start == HOLDS else way - 0.5 * over
    copy(len(law), p.start[j], law)
    law[0], law[1 + j], law[damping] = found[0], slope, found[damping]
    along[0], along[1], along[2] = e - sense * (over + y), -1.0, 0.0
    along[3], along[4] = 1.0, y
    for i in range(5):
        for k in range(5):
            covariance[i, k] = slope * slope * along[i] * along[k]
    covariance[0, 0] += p.prior[j, 0]
    covariance[1, 1] += p.prior[j, 1 + j]
    covariance[2, 2] += p.prior[j, damping]
    covariance[4, 4] += slope * slope * moved * moved  # the corner may lie a sample away
    slider[:] = 0.0
    state.past[j] = 0.0
    slider[_SENSE], slider[_SLID], slider[STAGE] = sense, -1.0, _BEGUN
    slider[_FROM], slider[_END] = start, e
    phi[p.place] = sense * y
    _variance(p, state, j, phi, y)
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
) -> float:
    """Update the law of spring j with its force; give y, and change z in ``phi`` accordingly.

    ``work`` is as `expect_corner` or `begin_corner` has left it. The structure has ``remembered``
    such a part of an impulse for a step.
    """
    law, slider, covariance = state.law[j], state.slider[j], state.covariance[j]
    factors, gain, damping = state.work[0], state.work[1], 1 + len(p.start) + j
    past, per_variance = state.past[j], 1.0 / (p.noise[j] + dot(5, factors, gain))
    share = per_variance * (measured - _force(law, phi, p.place, factors, slider))
    of_past = dot(5, past, factors)
    slider[MENDED] = of_past * share
    for i in range(5):
        before = past[i] - of_past * gain[i] * per_variance
        past[i] = remembered * before + gain[i] * p.noise[j] * per_variance
    law[0] += gain[0] * share
    law[1 + j] += gain[1] * share
    law[damping] += gain[2] * share
    law[p.place] += gain[3] * share
    slider[_FORCE] += gain[4] * share
    for i in range(5):
        for k in range(5):
            covariance[i, k] -= gain[i] * gain[k] * per_variance
    if not _yields(p, law, j) or slider[_FORCE] <= 0.0:
        slider[STAGE] = _BEGUN
        return y
    y = slider[_FORCE] / law[p.place]
    phi[p.place] = factors[3] + slider[_SENSE] * y
    return y
