"""The specimen, and the energy balance of a test.

The balance checks the samples of a test without a reference. M a + C v + r(x) = f (Eq. 2.4),
multiplied by the velocity and integrated, states that the work of the actuators' force is the sum
of kinetic energy, strain energy, and the dissipation of dampers and springs (Uang & Bertero 1990,
relative energy; here the force does the work of the ground motion). The balance closes if samples,
mass, damping and restoring force are consistent.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.linalg import eigh
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.parameter_table import mass_matrix, symmetric_matrix
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RigAxes

from seft_plant_sim.simulated.springs import Spring, make_springs


@dataclass(frozen=True)
class Specimen:
    """Mass, damping and restoring force of a specimen: M a + C v + r(x) = f (Eq. 2.4).

    A linear specimen has r = K x. With nonlinear springs, r = D^T s for the deformations e = D x;
    while the springs are elastic this is K x again (friction acts in parallel).

    Attributes
    ----------
    mass, damping, stiffness : ndarray
        M, C and K, shape (n, n), in kg, N s/m and N/m.
    springs : tuple of Spring
        p of them; none: the specimen is linear.
    deformation : ndarray
        D, shape (p, n): deformation of each spring per displacement of each axis.
    """

    mass: Floats
    damping: Floats
    stiffness: Floats
    springs: tuple[Spring, ...] = ()
    deformation: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    @classmethod
    def from_parameters(
        cls, section: dict[str, Any], axes: Sequence[str], where: str
    ) -> "Specimen":
        """Make it from parameters ``mass``, ``damping``, ``stiffness``, and ``kind`` if given.

        Raises
        ------
        InputError
            If a matrix does not fit the axes or is not symmetric, mass is not positive, or the
            stiffness is not the sum of such springs.
        """
        linear = cls(
            mass=mass_matrix(section["mass"], axes, f"{where}.mass"),
            damping=symmetric_matrix(section["damping"], axes, f"{where}.damping"),
            stiffness=symmetric_matrix(section["stiffness"], axes, f"{where}.stiffness"),
        )
        kind = section.get("kind", "linear")
        if kind == "linear":
            return linear
        deformation = deformations(section["springs"], axes, where)
        stiffness = _spring_stiffness(linear.stiffness, deformation, where)
        springs = make_springs(kind, section, stiffness, where)
        return replace(linear, springs=springs, deformation=deformation)

    @property
    def axes(self) -> int:
        """Number of axes n."""
        return len(self.mass)

    def modes(self) -> tuple[Floats, Floats]:
        """Natural frequencies, Hz, lowest first, and damping ratios of its modes, if elastic.

        Of those that have stiffness, both of shape (m,).
        """
        squares, shapes = eigh(self.stiffness, self.mass)
        held = squares > 1e-12 * max(squares[-1], 1e-300)
        w, shapes = np.sqrt(squares[held]), shapes[:, held]
        damping = np.einsum("ij,ik,kj->j", shapes, self.damping, shapes) / (2 * w)
        return w / (2 * np.pi), damping

    def part(self, rig: RigAxes, where: str) -> "Specimen":
        """Take the part of one of several rigs.

        Raises
        ------
        InputError
            If a matrix or a spring couples axes of different rigs.
        """
        own = list(rig.places)
        if len(own) == self.axes:
            return self
        others = [place for place in range(self.axes) if place not in own]
        for name in ("mass", "damping", "stiffness"):
            if getattr(self, name)[np.ix_(own, others)].any():
                raise InputError(
                    f"{where}.{name} couples axes of {rig.name} with those of another rig; such "
                    "a coupling can only be computed: give it as reference_force: computed.*"
                )
        touching = self.deformation[:, own].any(axis=1) if self.springs else np.zeros(0, bool)
        if self.springs and self.deformation[np.ix_(touching, others)].any():
            raise InputError(f"{where}.springs: a spring connects {rig.name} with another rig")
        square = np.ix_(own, own)
        return Specimen(
            self.mass[square],
            self.damping[square],
            self.stiffness[square],
            tuple(itertools.compress(self.springs, touching)),
            self.deformation[touching][:, own] if self.springs else self.deformation,
        )

    def state_matrices(self) -> tuple[Floats, Floats]:
        """State-space form over (x, v), driven by the force f, of the elastic specimen.

        Returns
        -------
        a, b : ndarray
            Shapes (2n, 2n) and (2n, n): d/dt (x, v) = a (x, v) + b f.
        """
        n = self.axes
        a = np.zeros((2 * n, 2 * n))
        a[:n, n:] = np.eye(n)
        a[n:, :n] = -np.linalg.solve(self.mass, self.stiffness)
        a[n:, n:] = -np.linalg.solve(self.mass, self.damping)
        b = np.zeros((2 * n, n))
        b[n:] = np.linalg.inv(self.mass)
        return a, b


def deformations(value: float | Sequence[float], axes: Sequence[str], where: str) -> Floats:
    """Matrix D over n axes, shape (p, n): deformation of each spring per displacement.

    A single 0 means one spring between each axis and the ground.

    Raises
    ------
    InputError
        If there are not n values for each spring; ``where`` names the parameters' group.
    """
    numbers = np.atleast_1d(np.asarray(value, dtype=np.float64))
    n = len(axes)
    if numbers.size == 1 and numbers[0] == 0.0:
        return np.eye(n)
    if numbers.size % n:
        raise InputError(
            f"{where}.springs: {numbers.size} values for {n} axes [{', '.join(axes)}]; give {n} "
            "for each spring (its deformation per displacement of each axis), spring by spring"
        )
    return numbers.reshape(-1, n)


def _spring_stiffness(stiffness: Floats, deformation: Floats, where: str) -> list[float]:
    """Stiffnesses k of springs with deformations D that add up to K = D^T diag(k) D."""
    each = np.array([np.outer(row, row).ravel() for row in deformation]).T
    found = np.linalg.lstsq(each, stiffness.ravel(), rcond=None)[0]
    if not np.allclose(each @ found, stiffness.ravel(), rtol=0.0, atol=1e-6 * stiffness.max()):
        raise InputError(
            f"{where}.stiffness {stiffness.tolist()} is not what springs with the deformations "
            f"{deformation.tolist()} add up to; name the springs in {where}.springs"
        )
    if found.min() <= 0.0:
        raise InputError(
            f"{where}.stiffness gives springs of {np.round(found, 6).tolist()} N/m, but they must "
            f"be positive; correct {where}.springs or the stiffness"
        )
    return found.tolist()


PATH_POINTS = 4
"""Points of the springs' path in a sample: knees and turning points lie between samples."""
_PIECE = 1 << 16  # samples of which splines are in memory at a time
_OVERLAP = 128  # samples beyond each end: each reduces the error of the end to a quarter
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)  # exact for the product of two splines


@dataclass(frozen=True)
class EnergyBalance:
    """Energies at each of N samples, each of shape (N,), in J.

    Attributes
    ----------
    input : ndarray
        Work of the actuators' force so far.
    kinetic, strain : ndarray
        Energy of the specimen at the sample.
    damped, hysteretic : ndarray
        Energy dissipated so far by viscous damping, and by the hysteresis of the springs.
    """

    input: Floats
    kinetic: Floats
    strain: Floats
    damped: Floats
    hysteretic: Floats

    @property
    def error(self) -> Floats:
        """The unbalanced remainder, shape (N,), relative to the largest input; NaN if that is 0."""
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

    The work of the force over the displacement is integrated exactly, with splines of both: the
    trapezoidal rule would lose (w dt)^2 / 6 of it, 1.6 % at 25 Hz and 500 Hz. Work and damping use
    the displacement and not the velocity: the noise of two sensors has no mean product, but the
    noise of one sensor times itself would count as energy.

    Parameters
    ----------
    displacement, velocity, force : ndarray
        Of the actuators, shape (N, n), m, m/s and N; relative to the ground, N at least 2.
    dt : float
        Sampling period, s.
    held : float, optional
        For a force that is constant in between, and changes after this part of each period: 1
        for a zero-order hold. Default: the force is continuous.
    """
    from scipy.interpolate import CubicSpline  # 20 MB that no node needs

    count = len(displacement)
    time = dt * np.arange(count)
    viscous = velocity @ specimen.damping.T
    work, damped = np.empty((2, count - 1))
    per_sample = PATH_POINTS if specimen.springs else 1
    path = np.empty((per_sample * (count - 1) + 1, displacement.shape[1]))
    for first in range(0, count - 1, _PIECE):  # splines need many times the memory of a recording
        last = min(first + _PIECE, count - 1)
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


def _integral(power: Floats, dt: float) -> Floats:
    """Integrate over each period the power at its nodes, of all axes."""
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
