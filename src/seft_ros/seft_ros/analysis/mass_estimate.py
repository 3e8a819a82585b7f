"""What a test's own samples say of the specimen's mass, whatever its law is.

The mass is in the measured force::

    f_i = m_i (M a)_i - m_i tau_i (M a)_i' + r_i                                           (1)

with the known mass matrix M, a factor m_i on it and the lag tau_i of the force
behind the acceleration. The restoring force r of any specimen is, in a short window, a constant and
a line in x; what that leaves is taken by stop operators, a curve and dampers of the springs'
deformations (see `seft_ros.analysis.specimen_law`). Noise of the acceleration would make the
estimate too small; the derivative of the velocity, which has other noise, serves as an instrument
(Reiersol 1945). So do the velocities for the dampers' rates, which are derived from the
displacement: noise of one channel in both would be taken for mass, 3 % on three storeys. Windows in
which the specimen is not described so well weigh less. Standard errors are those of correlated
residuals (Newey & West 1987), which a law of many parameters makes smaller than the noise: over the
degrees of freedom that it leaves (MacKinnon & White 1985).
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import Floats

from seft_ros.analysis import channel_estimates
from seft_ros.reference_force.yield_corner import STANDS_OUT

INERTIA_BAND = 8.0
"""Highest frequency of Eq. (1) over that of the motion: there a stiffness is 2 % of the inertia."""
WINDOWS = (0.7, 1.4, 2.8)
"""Lengths of the windows of Eq. (1), over the period of the motion: a line in x describes a part of
a cycle, and a short window has little but noise beside it. The median of the three counts, and
their scatter is part of the standard error."""
FEWEST_WINDOWS = 20
"""Windows without which a length does not count; no mass is given of one length alone."""
MAX_WINDOWS = 1500
"""Of a long test, those that move most: the error is below a part in a thousand then."""
WEIGHT_POWER = 1.5
"""Power of 1/variance that is a window's weight: more than the 1 of equal laws with other noise,
because a large residual means a law that is not described, which is a bias and not a noise."""
MEMORY = 12
"""Windows, half of each overlapping the next, over which residuals may be correlated."""
WIDEN = 1.5
"""Factor on the standard error of Eq. (1), because no law is described exactly: with it nine kinds
of specimen are within two standard errors in 93 of 100 tests (docs/metrics.md)."""
MIN_ERROR = 1.5e-3
"""Least standard error of a mass, relative: the samples' timing and the converter's steps."""
ALIKE_SPRINGS = 1e6
"""Condition number of deformations that do not determine the displacements."""
_ROUNDS = 5  # of weighting; then weights change by less than a percent
_RIDGE = 1e-6  # of the law's regressors, which may be alike


def inertia(
    states: Floats,
    mass: Floats,
    deformation: Floats,
    laws: list[Floats],
    dt: float,
    frequency: float,
    parts: Sequence[slice] = (),
) -> list[channel_estimates.Relation | None]:
    """Estimate the mass from a test's own samples, and from parts of it, Eq. (1).

    Parameters
    ----------
    states : ndarray
        Displacement, velocity, acceleration and force as measured, shape (N, 4, n).
    mass : ndarray
        M, shape (n, n), kg.
    deformation : ndarray
        Of each spring per displacement of each axis, shape (p, n).
    laws : list of ndarray
        Regressors of the force of each spring, see `fine_law`.
    frequency : float
        Of the motion, Hz.
    parts : sequence of slice
        The parts.

    Returns
    -------
    list of Relation or None
        None if too few windows move by more than the noise, or the regressors are alike.
    """
    x, v, a, f = np.moveaxis(states, 1, 0)
    top = min(INERTIA_BAND * frequency, channel_estimates.OF_SAMPLING / dt)
    half = 3.5 / top
    if len(x) < 6 * half / dt:
        return [None] * (1 + len(parts))
    every = max(1, int(0.4 / (top * dt)))  # no higher frequency is left
    band, noise = (0.0, top), channel_estimates.noise_of(x)
    by_spring, n = x @ deformation.T, x.shape[1]
    share = np.eye(n)
    if len(deformation) == n and np.linalg.cond(deformation) < ALIKE_SPRINGS:
        share = np.linalg.inv(deformation).T  # the equation of a spring, of its own law alone
    else:
        laws = [np.hstack(laws)] * n

    def filtered(y: Floats, *orders: int) -> list[Floats]:
        return [one[::every] for one in channel_estimates.derivatives(y, orders, band, dt, half)]

    own = [*filtered(f, 0), *filtered(a @ mass.T, 0, 1), *filtered(v @ mass.T, 1, 2)]
    (travel,) = filtered(x, 0)
    (rates,), (seen,) = filtered(by_spring, 1), filtered(v @ deformation.T, 0)
    laws = [np.hstack([*filtered(law, 0), rates]) for law in laws]
    lost, found = round(half / dt), list[list[tuple[Floats, Floats]]]()
    for part in (slice(0, len(x)), *parts):
        within = slice(*(max(0, -(-(end - lost) // every)) for end in (part.start, part.stop)))
        found.append([])
        for length in WINDOWS:
            size = max(n + 3, round(length / (frequency * dt * every)))
            take = moving_windows(travel[within], size, STANDS_OUT * noise) + within.start
            if len(take) >= FEWEST_WINDOWS:
                projected = without_line([*own, seen, *laws], travel, take)
                found[-1].append(_fit(projected[: len(own)], *projected[len(own) :], share=share))
    return [_relation(of_part, n) for of_part in found]


def _relation(found: list[tuple[Floats, Floats]], n: int) -> channel_estimates.Relation | None:
    """Give the median of what windows of each length have found."""
    if len(found) < 2:
        return None
    each = np.array(found).reshape(-1, 2, 2, n)  # length, (value, error), (m, -m tau), axis
    value = np.median(each[:, 0], axis=0)
    scatter = each[:, 0].var(axis=0, ddof=1)
    error = WIDEN * np.sqrt(np.median(each[:, 1], axis=0) ** 2 + scatter)
    factor = value[0]
    if not np.isfinite(each).all() or (factor <= 0).any():
        return None
    masses = factor, np.maximum(error[0], MIN_ERROR * factor)
    return channel_estimates.Relation(*masses, -value[1] / factor, error[1] / factor)


def moving_windows(travel: Floats, size: int, least: Floats) -> npt.NDArray[np.intp]:
    """Choose windows in which some axis moves by more than the least RMS.

    ``travel`` has shape (N, n), ``least`` (n,); the result are indices, shape (w, size). Each
    window overlaps the next by half.
    """
    starts = np.arange(0, len(travel) - size + 1, max(1, size // 2))
    take = starts[:, np.newaxis] + np.arange(size)
    if not len(starts):
        return take
    moved = travel[take].std(axis=1)
    ratio = (moved / np.maximum(least, 1e-3 * moved.max())).max(axis=1)
    chosen = np.flatnonzero(ratio > 1.0)
    if len(chosen) > MAX_WINDOWS:
        chosen = np.sort(chosen[np.argsort(ratio[chosen])[-MAX_WINDOWS:]])
    return take[chosen]


def without_line(signals: list[Floats], travel: Floats, take: npt.NDArray[np.intp]) -> list[Floats]:
    """Take a constant and a line in the displacements out of signals, of each window its own.

    Signals and displacements have shape (N, c) and (N, n), windows (w, size); the results
    (w, size, c).
    """
    moved = travel[take]
    moved = moved - moved.mean(axis=1, keepdims=True)
    one = np.ones((*take.shape, 1))
    basis = np.concatenate([one, moved], axis=2)
    basis /= np.sqrt((basis**2).sum(axis=1, keepdims=True)) + 1e-300
    q, _ = np.linalg.qr(basis)
    across = q.transpose(0, 2, 1)
    return [(y := signal[take]) - q @ (across @ y) for signal in signals]


def _fit(own: list[Floats], seen: Floats, *laws: Floats, share: Floats) -> tuple[Floats, Floats]:
    """Fit Eq. (1) of all springs together; give (m, -m tau) and standard errors, shape (2n,).

    Parameters
    ----------
    own : list of ndarray
        Force, inertial force and its rate of each axis, and the instruments of these two; shape
        (w, size, n), in windows.
    seen : ndarray
        Rates of the deformations as the velocity shows them, shape (w, size, p).
    *laws : ndarray
        Regressors of the force of each spring, shape (w, size, q); the last are the rates as the
        displacement shows them, and ``seen`` are their instruments.
    share : ndarray
        Of each axis' forces in the equation of each spring, shape (n, n).
    """
    (windows, size, n), (*_, p), (*_, q) = own[0].shape, seen.shape, laws[0].shape
    equations, weights = [], []
    for spring, law in zip(share, laws, strict=True):
        size_of = np.sqrt((law**2).mean(axis=(0, 1))) + 1e-300
        target, *y = (own[0] @ spring)[..., np.newaxis], *(one * spring for one in own[1:])
        parts = law / size_of, *y[:2], target, seen / size_of[-p:], *y[2:]
        equations.append(np.concatenate(parts, axis=2))
        weights.append(np.full(windows, 1.0 / np.mean(target**2)))
    # the law's regressors, those of the axes, and the force; instruments of the axes, of the law
    its, forces, axes = np.s_[:q], np.s_[q : q + 2 * n + 1], np.s_[q + 2 * n + 1 + p :]
    of_law = np.append(np.arange(q - p), q + 2 * n + 1 + np.arange(p))
    try:
        for _ in range(_ROUNDS):
            total, solved, before = np.zeros((2 * n, 2 * n + 1)), [], weights
            for columns, weight in zip(equations, weights, strict=True):
                rooted = columns * np.sqrt(weight)[:, np.newaxis, np.newaxis]
                rooted = rooted.reshape(-1, columns.shape[2])
                sums, ridge = rooted.T @ rooted, _RIDGE * size * weight.sum()
                inverse = np.linalg.inv(sums[of_law, its] + ridge * np.eye(q))
                used = q - ridge * np.trace(inverse)
                # eliminate the law, which no other equation has
                onto = sums[axes, its] @ inverse
                total += sums[axes, forces] - onto @ sums[of_law, forces]
                beside = columns[..., forces] - columns[..., its] @ (inverse @ sums[of_law, forces])
                solved.append((onto, beside))
            found = np.linalg.solve(total[:, :-1], total[:, -1])
            lefts = [beside @ np.append(-found, 1.0) for _, beside in solved]
            variance = np.stack([(left**2).mean(axis=1) for left in lefts])
            least = np.maximum(np.quantile(variance, 0.1, axis=1, keepdims=True), 1e-300)
            weights = [*(np.maximum(variance, least) / least) ** -WEIGHT_POWER / least]
        scores = np.zeros((windows, 2 * n))
        for columns, (onto, _), left, weight in zip(equations, solved, lefts, before, strict=True):
            z = columns[..., axes] - columns[..., of_law] @ onto.T
            scores += (z * (left * weight[:, np.newaxis])[..., np.newaxis]).sum(axis=1)
        scores = np.linalg.solve(total[:, :-1], scores.T).T
    except np.linalg.LinAlgError:
        return np.full(2 * n, np.nan), np.full(2 * n, np.nan)
    # windows overlap by half, and each has its line
    spare = max(0.1, 1.0 - (n + 1) / size - used / (0.5 * windows * size))
    return found, np.sqrt(np.diag(channel_estimates.summed_covariance(scores, MEMORY)) / spare)
