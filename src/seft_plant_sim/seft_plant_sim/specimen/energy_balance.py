"""Energy balance of a specimen under test: a check of its samples that needs no reference.

M a + C v + r(x) = f (Eq. 2.4), each term times the velocity and integrated, says that the work
of the actuators' force is kinetic energy, strain energy, and what dampers and springs dissipate
(Uang & Bertero 1990, relative energy; the force does the work of the ground motion here). It
closes if samples, mass, damping and restoring force fit each other.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from seft_plant_sim.specimen.specimen import Specimen

Floats = npt.NDArray[np.float64]

PATH_POINTS = 4
"""Points of the springs' path in a sample: knees and turning points lie between samples."""

_PIECE = 1 << 16  # samples whose splines are in memory at a time
_OVERLAP = 128  # samples beyond either end: each takes a quarter of what the end is wrong by
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)  # exact for the product of two splines


@dataclass(frozen=True)
class EnergyBalance:
    """Energies at each of N samples, each of shape (N,), in J.

    Attributes
    ----------
    input : ndarray
        Work of the actuators' force so far.
    kinetic, strain : ndarray
        What the specimen holds at the sample.
    damped, hysteretic : ndarray
        What its viscous damping, and the hysteresis of its springs, have dissipated so far.
    """

    input: Floats
    kinetic: Floats
    strain: Floats
    damped: Floats
    hysteretic: Floats

    @property
    def error(self) -> Floats:
        """What is left unexplained, shape (N,), relative to the largest input; NaN if that is 0."""
        left = self.input - self.kinetic - self.strain - self.damped - self.hysteretic
        largest = np.abs(self.input).max()
        return left / largest if largest else np.full_like(left, np.nan)


def energy_balance(
    specimen: Specimen,
    displacement: Floats,
    velocity: Floats,
    force: Floats,
    dt: float,
    *,
    held: float | None = None,
) -> EnergyBalance:
    """Energies of a specimen from rest.

    Work is that of the force over the displacement, whose splines are integrated exactly: the
    trapezoidal rule would lose (w dt)^2 / 6 of it, 1.6 % at 25 Hz and 500 Hz. Displacement and
    not velocity stands for the motion in it and in the damping, as noise of two sensors has no
    mean product, where that of one with itself would be counted as energy.

    Parameters
    ----------
    specimen : Specimen
        n axes.
    displacement, velocity, force : ndarray
        Of the actuators, shape (N, n), m, m/s and N; relative to the ground, N at least 2.
    dt : float
        Sampling period, s.
    held : float, optional
        For a force that is constant in between, and changes after this part of each period: 1
        for a zero-order hold. Default: the force is continuous.

    Returns
    -------
    EnergyBalance
        At each sample.
    """
    from scipy.interpolate import CubicSpline  # 20 MB that no node needs

    count = len(displacement)
    time = dt * np.arange(count)
    viscous = velocity @ specimen.damping.T
    work, damped = np.empty((2, count - 1))
    per_sample = PATH_POINTS if specimen.springs else 1
    path = np.empty((per_sample * (count - 1) + 1, displacement.shape[1]))
    for first, last in _pieces(count):
        known = slice(max(0, first - _OVERLAP), last + 1 + _OVERLAP)
        within = slice(first, last)
        motion, damping = (CubicSpline(time[known], y[known]) for y in (displacement, viscous))
        inside = (time[within, np.newaxis] + dt / 2 * (1 + _NODES)).ravel()
        rate = motion(inside, 1)
        damped[within] = _integral(damping(inside) * rate, dt)
        if held is None:
            work[within] = _integral(CubicSpline(time[known], force[known])(inside) * rate, dt)
        else:
            change, after = motion(time[within] + held * dt), slice(first + 1, last + 1)
            parts = change - displacement[within], displacement[after] - change
            work[within] = (force[within] * parts[0] + force[after] * parts[1]).sum(axis=1)
        points = np.arange(per_sample * first, per_sample * last + 1)
        path[points[0] : points[-1] + 1] = motion(dt / per_sample * points)
    strain, hysteretic = _springs(specimen, path, per_sample)
    return EnergyBalance(
        input=_so_far(work),
        kinetic=_quadratic(specimen.mass, velocity),
        strain=strain,
        damped=_so_far(damped),
        hysteretic=hysteretic,
    )


def _pieces(count: int) -> Iterator[tuple[int, int]]:
    """Cut a record into pieces, from sample to sample: splines are many times its size."""
    for first in range(0, count - 1, _PIECE):
        yield first, min(first + _PIECE, count - 1)


def _integral(power: Floats, dt: float) -> Floats:
    """Integrate over each period what all axes have at its nodes."""
    return (power.sum(axis=1).reshape(-1, len(_NODES)) * _WEIGHTS).sum(axis=1) * dt / 2


def _springs(specimen: Specimen, path: Floats, per_sample: int) -> tuple[Floats, Floats]:
    """Strain energy and dissipation of the springs at each sample of a path."""
    elastic, samples = specimen.stiffness.copy(), path[::per_sample]
    strain, hysteretic = np.zeros((2, len(samples)))
    for spring, row in zip(specimen.springs, specimen.deformation, strict=True):
        elastic -= spring.stiffness * np.outer(row, row)
        _, stored, dissipated = spring.follow(path @ row)[:, ::per_sample]
        strain += stored
        hysteretic += dissipated
    return strain + _quadratic(elastic, samples), hysteretic


def _quadratic(matrix: Floats, vectors: Floats) -> Floats:
    return 0.5 * ((vectors @ matrix) * vectors).sum(axis=1)


def _so_far(increments: Floats) -> Floats:
    return np.concatenate([[0.0], np.cumsum(increments)])
