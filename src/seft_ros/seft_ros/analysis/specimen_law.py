"""How a specimen would have answered another ground motion, by the law of its recording.

The restoring force that was measured is fitted by stop operators, a rising curve and a
damper of each spring's deformation e = D x. None of them gives energy: a law that did would let
every small difference grow. What they do not describe stays as it was measured, so that for the
test's own motion the structure does what it did. For a motion that is different by g its
displacement differs by d::

    M d'' + C d' + K d + D^T (s(e + D d) - s(e)) = -M g

with the mass M of the whole structure, C and K of its computed part and the dampers, and s of stop
operators and curve. Unlike a linear structure it yields, slips and closes gaps where the specimen
did, and a small difference grows where that of the specimen would.

Of stop operators with round corners (`seft_ros.reference_force.stop_operators`) the law of Bouc and
Wen is made, too.

The deformation is that of displacement and acceleration together, which has a quarter of the noise
(`seft_ros.analysis.channel_estimates`).

The zero of the force may move while a test runs. It is in the restoring force r = f - M a::

    r = law(x) + m a + b g(t)                                                              (1)

with m for a mass that is wrong. Where the law leaves little but noise, g is a step or a ramp that
begins at a sample: what explains most. The standard error is that of correlated residuals (Newey &
West 1987), times what makes `SIGNIFICANT` of them as unlikely as they are of one estimate with a
known error: of so many steps and ramps one is large by chance, and the residuals' few independent
parts make their errors a Student's (Kiefer & Vogelsang 2005). Any other law leaves slow residuals.
With g = (1 - cos(pi t / T)) / 2 in the time T of the test, they are fitted by cosines of k = 1 to
`MODES` half periods. Those of a random walk, which has no drift, are independent with standard
deviations that fall as 1/k: the standard error is k times the amplitude of the faster ones (RMS).
To both comes by how much a law without round corners differs.
"""

import math

import numpy as np
from scipy.special import erfc, stdtrit
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_plant_sim.calibration import SIGNIFICANT
from seft_plant_sim.channels import DISPLACEMENT
from seft_plant_sim.compiled import compiled
from seft_plant_sim.simulated.specimen import deformations
from seft_plant_sim.whole_structure import WholeStructure

from seft_ros.analysis.channel_estimates import noise_of, summed_covariance, with_motion
from seft_ros.analysis.metrics import ratio
from seft_ros.reference_force.stop_operators import move_stop, stop_operators

SHARP, ROUND, CORNERS = 24, 12, 40
"""Stop operators with a corner, those of each roundness, and corners of the curve of a
spring: from noise to most of its deformation, and so close that a corner of the law is within a
hundredth of it."""
STOP_OPERATORS = SHARP + 3 * ROUND
_POWERS = np.repeat([0.0, 1.0, 2.0, 4.0], [SHARP, ROUND, ROUND, ROUND])  # n of each; 0: a corner
_NEXT = 1.4  # threshold of a round one over that of the next, up to the largest deformation
_COUPLED = 1e-6  # of the largest stiffness: less is rounding
_ROWS = 1 << 14  # of samples that are fitted, of longer tests at equal distances
_BLOCK = 1 << 10  # of them at a time
_SMOOTH = 0.1  # weight of a bend of the curve, over a sample's force: few samples make no corner
_RIDGE = 1e-3  # of all parameters, over a sample's force: stop operators may be alike

_PARTS = 16  # of a test, in the first and last of which no step begins
MODES = 10
"""Cosines of Eq. (1)."""
_SLOW = 3  # of them, in which a drift may be
_STOPS, _EVEN, _CORNERS = 24, 96, 30  # beside a drift: the corner of a law is within its noise
_DRIFT_ROWS, _DRIFT_SMOOTH = 1 << 13, 1e-2
_DESCRIBED = 1.2  # what the law leaves, over the noise
_MEMORY = 8  # parts of a test over which residuals may be correlated
_ROUNDING = 1e-10  # of a law's regressors, which may be alike
_FREEDOM = 1.5 * _MEMORY  # degrees, of the error of so few


def springs_of(assumed: Experiment, whole: WholeStructure) -> Floats:
    """Deformations of the specimen's springs per displacement, shape (p, n).

    Those that are known; without, springs between the axes that its stiffness couples, and to the
    ground where the stiffness does not add up to 0: of a shear frame its storeys. One without
    stiffness has those to the ground.
    """
    section, axes = assumed["reference_force"], assumed.axes
    n = len(axes)
    if np.any(section["specimen.springs"]):
        return deformations(section["specimen.springs"], axes, "/**: specimen")
    stiffness = whole.structure.stiffness[:n, :n] - whole.computed.stiffness[:n, :n]
    least, one = _COUPLED * np.abs(stiffness).max(), np.eye(n)
    grounded = [one[i] for i in range(n) if abs(stiffness[i].sum()) > least]
    pairs = zip(*np.nonzero(np.abs(np.triu(stiffness, 1)) > least), strict=True)
    return np.array([*grounded, *(one[j] - one[i] for i, j in pairs)] or one)


class SpecimenLaw:
    """Restoring law of a specimen, from the samples of a test.

    Parameters
    ----------
    whole : WholeStructure
        Its structure, of whose specimen the mass alone counts.
    mass : ndarray
        Of the specimen, shape (n, n), kg.
    samples : ndarray
        Displacement, velocity, acceleration and force as measured, shape (N, 4, n), every step.
    deformation : ndarray
        Of each spring per displacement of each axis, shape (p, n).
    dt : float
        Sampling period, s.

    Attributes
    ----------
    deformation : ndarray
        Of each spring, shape (N, p), m.
    noise : ndarray
        RMS of that of the displacement alone, shape (p,), m.
    """

    def __init__(
        self, whole: WholeStructure, mass: Floats, samples: Floats, deformation: Floats, dt: float
    ) -> None:
        self.noise = noise_of(samples[:, DISPLACEMENT] @ deformation.T)
        _, v, a, f = np.moveaxis(samples, 1, 0)
        x = with_motion(samples, noise_of(samples), dt)[:, DISPLACEMENT]
        self._whole, self._dt, self._x = whole, dt, x
        self._springs = np.ascontiguousarray(deformation)
        self.deformation, rates = np.ascontiguousarray(x @ deformation.T), v @ deformation.T
        low, high = self.deformation.min(axis=0), self.deformation.max(axis=0)
        self._thresholds = _thresholds(self.deformation, self.noise, SHARP, 0.7)
        self._step = np.maximum(high - low, 1e-300) / (CORNERS - 1)
        self._low = low - self._step  # of the first corner: a further one on either side, see below
        values = self._fitted(rates, (f - a @ mass.T) @ deformation.T)
        self._slopes = values[:, :STOP_OPERATORS] / self._thresholds
        curve = values[:, STOP_OPERATORS : STOP_OPERATORS + CORNERS]
        # beyond the motion of the test it goes on with its mean slope, which pulls back
        rise = (curve[:, -1:] - curve[:, :1]) / (CORNERS - 1)
        self._curve = np.hstack([curve[:, :1] - rise, curve, curve[:, -1:] + rise])
        self._damping = deformation.T * values[:, -1] @ deformation

    def _fitted(self, rates: Floats, force: Floats) -> Floats:
        """Fit stop operators, curve and damper to the springs' forces times D, shape (N, p)."""
        from scipy.optimize import nnls  # takes longer to import than all else of a report

        p, columns = len(self._springs), STOP_OPERATORS + CORNERS + 1
        size = np.maximum(np.sqrt(np.mean(rates**2, axis=0)), 1e-300)
        normal, right = self._equations(rates, size, force)
        rises = np.eye(columns)  # of a curve, from corner to corner
        rises[STOP_OPERATORS:-1, STOP_OPERATORS:-1] = np.tri(CORNERS)
        sums = np.kron(np.eye(p), rises)
        lower = np.linalg.cholesky(sums.T @ normal @ sums)
        target = np.linalg.solve(lower, sums.T @ right.ravel())
        # the force at a curve's first corner may be negative: a difference of two that are not
        first = np.arange(p) * columns + STOP_OPERATORS
        signed = np.hstack([lower.T, -lower.T[:, first]])
        both, _ = nnls(signed, target, maxiter=30 * p * columns)
        found = both[: p * columns]
        found[first] -= both[p * columns :]
        values = (sums @ found).reshape(p, columns)
        values[:, -1] /= size
        return values

    def _equations(self, rates: Floats, size: Floats, force: Floats) -> tuple[Floats, Floats]:
        """Sum up the normal equations of the fit, with rates over their size, and its prior."""
        every, p = 1 + len(rates) // _ROWS, len(self._springs)
        columns = STOP_OPERATORS + CORNERS + 1
        normal, right = np.zeros((p * columns, p * columns)), np.zeros((p, columns))
        z, block = np.zeros((p, STOP_OPERATORS)), every * _BLOCK
        for first in range(0, len(rates), block):  # not all at once: that takes much memory
            begin = min(first, 1)  # stop operators need the sample before
            before, here = slice(first - begin, first + block), slice(first, first + block, every)
            parts = []
            for j, e in enumerate(self.deformation[before].T):
                stops = stop_operators(e, self._thresholds[j], _POWERS, z[j])
                z[j] = stops[-1]
                place = (self.deformation[here, j] - self._low[j]) / self._step[j] - 1.0
                stops, rate = stops[begin::every] / self._thresholds[j], rates[here, j] / size[j]
                parts.append(_regressors(stops, place, CORNERS, rate))
                right[j] += parts[j].T @ force[here, j]
            regressors = np.hstack(parts)
            normal += regressors.T @ regressors
        prior = _prior(len(rates[::every]), columns, STOP_OPERATORS, CORNERS, _SMOOTH)
        normal *= np.kron(self._springs @ self._springs.T, np.ones((columns, columns)))
        normal += np.kron(np.eye(p), prior)
        return normal, right

    def difference(self, change: Floats) -> float:
        """RMS of the displacement's difference, over that of the answer to the other motion.

        ``change`` is that of the ground motion, shape (N, n), m/s^2.
        """
        structure, computed, dt = self._whole.structure, self._whole.computed, self._dt
        inside = [(0, structure.axes - change.shape[1])] * 2
        mass, damping = structure.mass, computed.damping + np.pad(self._damping, inside)
        stiff = 0.25 * dt**2 * computed.stiffness
        inverse = np.linalg.inv(mass + 0.5 * dt * damping + stiff)
        keeps = inverse @ (mass - 0.5 * dt * damping + stiff)
        push = -dt * self._whole.motion(change) @ (inverse @ mass).T
        moved, p = np.zeros((len(change), structure.axes)), len(self._springs)
        springs = np.pad(self._springs, [(0, 0), inside[0]])
        law = self._thresholds, _POWERS, self._slopes, self._curve, self._low, self._step
        linear = keeps, dt * inverse @ computed.stiffness, dt * inverse
        work = np.zeros((2, p, STOP_OPERATORS)), np.zeros((2, p)), np.zeros((2, structure.axes))
        _differ(self.deformation, springs, law, linear, push, dt, moved, work)
        moved = moved[:, : change.shape[1]]
        moved_rms, whole_rms = (float(np.sqrt(np.mean(y**2))) for y in (moved, self._x + moved))
        return ratio(moved_rms, whole_rms)


def _thresholds(e: Floats, noise: Floats, sharp: int, highest: float) -> Floats:
    """Thresholds of stop operators, of the sharp ones from noise to a share of each deformation.

    Shape (p, sharp + 3 ROUND).
    """
    largest = np.maximum(np.abs(e).max(axis=0), 1e-300)
    least = np.maximum(noise, largest / 1000)
    each = np.geomspace(least, highest * largest, sharp).T
    rounded = largest[:, np.newaxis] * _NEXT ** np.arange(1.0 - ROUND, 1.0)
    return np.hstack([each, rounded, rounded, rounded])


def _regressors(stops: Floats, place: Floats, corners: int, *linear: Floats) -> Floats:
    """Stop operators, hats at the corners of a curve for places counted in these, and others."""
    hats = np.maximum(0.0, 1.0 - np.abs(place[:, np.newaxis] - np.arange(corners)))
    return np.column_stack([stops, hats, *linear])


def _prior(rows: int, columns: int, stops: int, corners: int, smooth: float) -> Floats:
    """Keep a curve smooth and all parameters small, beside so many samples: a normal matrix."""
    bends = np.zeros((corners - 2, columns))
    bends[:, stops : stops + corners] = np.diff(np.eye(corners), 2, axis=0)
    return rows * (smooth**2 * bends.T @ bends + _RIDGE**2 * np.eye(columns))


def fine_law(deformation: Floats, noise: float) -> Floats:
    """Regressors of the force of a spring whose law is known to its noise; shape (N, q).

    Parameters
    ----------
    deformation : ndarray
        Shape (N,).
    noise : float
        RMS, m.
    """
    (thresholds,) = _thresholds(deformation[:, np.newaxis], np.array([noise]), _STOPS, 1.0)
    thresholds = np.append(thresholds[_STOPS - 1] * np.arange(1, _EVEN) / _EVEN, thresholds)
    powers = np.append(np.zeros(len(thresholds) - 3 * ROUND), _POWERS[SHARP:])
    stops = stop_operators(deformation, thresholds, powers) / thresholds
    place = (deformation - deformation.min()) / max(np.ptp(deformation), 1e-300) * (_CORNERS - 1)
    size = np.sqrt(np.mean(deformation**2)) + 1e-300
    return _regressors(stops, place, _CORNERS, deformation / size)


def force_drift(law: Floats, others: Floats, force: Floats) -> tuple[float, float, Floats]:
    """Fit the zero of a spring's force, Eq. (1); give b, N, its standard error, and g, (N,).

    Parameters
    ----------
    law : ndarray
        See `fine_law`; shape (N, q).
    others : ndarray
        What else the force may follow, shape (N, k): the rate and the inertia.
    force : ndarray
        Of the spring, shape (N,).
    """
    count, here = len(force), slice(None, None, 1 + len(force) // _DRIFT_ROWS)
    others = others[here] / (np.sqrt(np.mean(others**2, axis=0)) + 1e-300)
    y, law = force[here], np.hstack([others, law[here]])
    stops = law.shape[1] - _CORNERS - 1
    prior = _prior(len(y), law.shape[1], stops, _CORNERS, _DRIFT_SMOOTH)
    squares = law.T @ law
    sharp = np.delete(np.arange(len(squares)), np.s_[stops - 3 * ROUND : stops])
    normal = squares + prior
    laws = (law, normal), (law[:, sharp], normal[np.ix_(sharp, sharp)])
    power, begin = _best_onset(law, squares + _ROUNDING * len(y) * np.eye(len(squares)), y)
    time, at = np.arange(count), here.step * begin
    shape = (time >= at) * (np.maximum(time - at, 0) / (count - at)) ** power
    (b, error, left), (other, *_) = (_beside_law(shape[here, np.newaxis], *one, y) for one in laws)
    if np.sqrt(np.mean(left**2)) <= _DESCRIBED * noise_of(force[:, np.newaxis])[0]:
        most = -stdtrit(_FREEDOM, erfc(SIGNIFICANT / math.sqrt(2.0)) / (4.0 * len(y)))
        return float(b[0]), float(np.hypot(most / SIGNIFICANT * error, b - other)[0]), shape
    modes = np.arange(1, MODES + 1)
    cosines = np.cos(np.pi * np.outer(time[here] / count, modes))
    b, other = (_beside_law(cosines, *one, y)[0] for one in laws)
    unsure = np.hypot(np.sqrt(np.mean((modes * b)[_SLOW:] ** 2)), b[0] - other[0])
    return float(-2.0 * b[0]), float(2.0 * unsure), 0.5 - 0.5 * np.cos(np.pi * time / count)


def _best_onset(law: Floats, normal: Floats, y: Floats) -> tuple[int, int]:
    """Find what explains most beside a law: a step (0) or a ramp (1), and the row where it begins.

    Sums from each row on give the products of all steps; sums of these, those of all ramps.
    """
    q = law @ np.linalg.inv(np.linalg.cholesky(normal)).T
    products = np.column_stack([y - q @ (q.T @ y), q])
    rows, part = np.arange(len(y), 0.0, -1.0), len(y) // _PARTS
    squares, best = rows, (0.0, 0, 0)
    for power, begin in ((0, part), (1, 0)):
        if power:
            products = np.vstack([products[1:], np.zeros_like(products[:1])])
            squares = (rows - 1.0) * rows * (2.0 * rows - 1.0) / 6.0
        products = np.cumsum(products[::-1], axis=0)[::-1]
        beside = squares - (products[:, 1:] ** 2).sum(axis=1)
        gained = products[:, 0] ** 2 / np.maximum(beside, 1e-9 * squares + 1e-9)
        at = begin + int(np.argmax(gained[begin : len(y) - part]))
        best = max(best, (float(gained[at]), power, at))
    return best[1:]


def _beside_law(
    drift: Floats, law: Floats, normal: Floats, y: Floats
) -> tuple[Floats, Floats, Floats]:
    """Fit Eq. (1); give the q values of the drift, their standard errors, and what is left."""
    both = np.column_stack([drift, y])
    both -= law @ np.linalg.solve(normal, law.T @ both)
    own, left = both[:, :-1], both[:, -1]
    inverse = np.linalg.inv(drift.T @ own)
    values = inverse @ (drift.T @ left)
    left = left - own @ values
    spread = summed_covariance(own * left[:, np.newaxis], max(2, len(y) // _MEMORY))
    return values, np.sqrt((inverse @ spread @ inverse).diagonal()), left


@compiled
def _curve_at(curve: Floats, place: float) -> float:
    """Force of a curve at a place over its corners; it goes on straight beyond the ends."""
    j = int(min(max(place, 0.0), len(curve) - 2.0))
    force: float = curve[j] + (place - j) * (curve[j + 1] - curve[j])
    return force


@compiled
def _differ(
    e: Floats,
    springs: Floats,
    law: tuple[Floats, Floats, Floats, Floats, Floats, Floats],
    linear: tuple[Floats, Floats, Floats],
    push: Floats,
    dt: float,
    moved: Floats,
    work: tuple[Floats, Floats, Floats],
) -> None:
    """Integrate the difference; springs by central differences, the others by average acceleration.

    ``work`` are stop operators of both motions, last deformations and velocities.
    """
    thresholds, powers, slopes, curve, low, step = law
    keeps, pulls, inverse = linear
    z, last, velocity = work
    n, (p, m) = len(keeps), thresholds.shape
    for j in range(p):
        last[0, j] = last[1, j] = e[0, j]
    for k in range(len(e) - 1):
        for i in range(n):
            velocity[1, i] = push[k, i]
            for h in range(n):
                velocity[1, i] += keeps[i, h] * velocity[0, h] - pulls[i, h] * moved[k, h]
        for j in range(p):
            both, force = e[k, j], 0.0
            for h in range(n):
                both += springs[j, h] * moved[k, h]
            for i in range(m):
                if slopes[j, i] > 0.0:
                    y, power = thresholds[j, i], powers[i]
                    z[0, j, i] = move_stop(z[0, j, i], e[k, j] - last[0, j], y, power)
                    z[1, j, i] = move_stop(z[1, j, i], both - last[1, j], y, power)
                    force += slopes[j, i] * (z[1, j, i] - z[0, j, i])
            last[0, j], last[1, j] = e[k, j], both
            force += _curve_at(curve[j], (both - low[j]) / step[j])
            force -= _curve_at(curve[j], (e[k, j] - low[j]) / step[j])
            for i in range(n):
                for h in range(n):
                    velocity[1, i] -= inverse[i, h] * springs[j, h] * force
        for i in range(n):
            velocity[0, i] = velocity[1, i]
            moved[k + 1, i] = moved[k, i] + dt * velocity[0, i]
