"""Restoring-force laws of a specimen's springs, in one place.

A spring of elastic stiffness k and hardening ratio a carries

    s = a k e + (1 - a) k z

where e is its deformation and z its hysteretic displacement, which follows e as long as the
spring is elastic. What it stores is (a k e^2 + (1 - a) k z^2) / 2; the rest of the work done on
it is dissipated. All laws are independent of the rate of loading.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

PATH_STEP = 0.02  # of the yield displacement: longest step of a law along a given path
MOST_STEPS = 20_000  # from one point of a path to the next: a jump beyond is followed roughly


def bounded(z: float, limit: float) -> float:
    """Bring ``z`` back between -limit and limit."""
    return limit if z > limit else -limit if z < -limit else z


def spring_force(e: float, z: float, stiffness: float, hardening_ratio: float) -> float:
    """Force s of a spring, N, at a deformation e and a hysteretic displacement z, both in m."""
    return stiffness * (hardening_ratio * e + (1.0 - hardening_ratio) * z)


def hysteretic_work_rate(z: float, velocity: float, hardening_ratio: float, z_y: float) -> float:
    """Rate of the work on the hysteretic part in units of k z_y^2, see `HystereticSpring`."""
    return (1.0 - hardening_ratio) * z * velocity / z_y**2


def bouc_wen_rate(
    z: float,
    velocity: float,
    work: float,
    z_y: float,
    limit: float,
    exponent: float,
    beta: float,
    gamma: float,
    amplitude_loss: float,
    strength_loss: float,
    stiffness_loss: float,
) -> float:
    """Rate of the hysteretic displacement, m/s, by the law of `BoucWenSpring`."""
    amplitude = max(0.0, 1.0 - amplitude_loss * work)
    strength = 1.0 + strength_loss * work
    stiffness = 1.0 + stiffness_loss * work
    power = abs(bounded(z, limit) / z_y) ** exponent
    shape = gamma + (beta if z * velocity >= 0.0 else -beta)
    return velocity * (amplitude - strength * power * shape) / stiffness


@dataclass(frozen=True)
class HystereticSpring(ABC):
    """One spring with hysteresis.

    Attributes
    ----------
    stiffness : float
        k, elastic, N/m.
    yield_displacement : float
        z_y, m; the yield force is k z_y.
    hardening_ratio : float
        a, stiffness after yielding over k; at least 0 and below 1.
    """

    stiffness: float
    yield_displacement: float
    hardening_ratio: float

    @abstractmethod
    def rate(self, z: float, velocity: float, work: float) -> float:
        """Rate of the hysteretic displacement, m/s.

        Parameters
        ----------
        z : float
            Hysteretic displacement, m.
        velocity : float
            Rate of deformation, m/s.
        work : float
            Work done on the hysteretic part so far, in units of k z_y^2, see `work_rate`.
        """

    def trial_rate(self, z: float, velocity: float, work: float) -> float:
        """Rate for an integrator that settles z after each step, see `rate`."""
        return self.rate(z, velocity, work)

    def settle(self, z: float) -> float:
        """Bring z back to where the law allows it to be, after a step of an integrator."""
        return z

    def force(self, deformation: float, z: float) -> float:
        """Force, N, at a deformation and a hysteretic displacement, both in m."""
        return spring_force(deformation, self.settle(z), self.stiffness, self.hardening_ratio)

    def work_rate(self, z: float, velocity: float) -> float:
        """Rate of the work on the hysteretic part, 1/s: (1 - a) z v / z_y^2 (Baber & Wen 1981)."""
        return hysteretic_work_rate(z, velocity, self.hardening_ratio, self.yield_displacement)

    def strain_energy(self, deformation: Floats, z: Floats) -> Floats:
        """Energy that can be had back, J; arrays of m."""
        a = self.hardening_ratio
        return 0.5 * self.stiffness * (a * deformation**2 + (1.0 - a) * z**2)

    def follow(self, deformation: npt.ArrayLike) -> Floats:
        """Hysteretic displacement along a path of deformation, straight between its points.

        Parameters
        ----------
        deformation : array_like
            Shape (N,), m. The spring has not been loaded before the first point.

        Returns
        -------
        ndarray
            z, shape (N,), m.
        """
        path = np.asarray(deformation, dtype=np.float64).tolist()
        found, z, work, last = [], 0.0, 0.0, 0.0
        for point in path:
            z, work = self._advance(z, work, point - last)
            last = point
            found.append(z)
        return np.array(found)

    def _advance(self, z: float, work: float, change: float) -> tuple[float, float]:
        """Hysteretic displacement and work after a change of deformation (Runge-Kutta)."""
        wanted = abs(change) / (PATH_STEP * self.yield_displacement)
        steps = 1 + int(min(wanted, MOST_STEPS))
        h = change / steps
        sign = 1.0 if change > 0 else -1.0

        def slopes(z: float, work: float) -> tuple[float, float]:
            return sign * self.rate(z, sign, work), sign * self.work_rate(z, sign)

        for _ in range(steps):
            z1, w1 = slopes(z, work)
            z2, w2 = slopes(z + 0.5 * h * z1, work + 0.5 * h * w1)
            z3, w3 = slopes(z + 0.5 * h * z2, work + 0.5 * h * w2)
            z4, w4 = slopes(z + h * z3, work + h * w3)
            z = self.settle(z + h / 6.0 * (z1 + 2.0 * z2 + 2.0 * z3 + z4))
            work += h / 6.0 * (w1 + 2.0 * w2 + 2.0 * w3 + w4)
        return z, work


@dataclass(frozen=True)
class BilinearSpring(HystereticSpring):
    """Bilinear law with kinematic hardening: the hysteretic part is elastic, perfectly plastic."""

    def rate(self, z: float, velocity: float, work: float) -> float:
        """Rate of the hysteretic displacement, m/s; see `HystereticSpring.rate`."""
        del work
        limit = self.yield_displacement
        yielding = (z >= limit and velocity > 0.0) or (z <= -limit and velocity < 0.0)
        return 0.0 if yielding else velocity

    def trial_rate(self, z: float, velocity: float, work: float) -> float:
        """As if it did not yield: a step that ends beyond is brought back to the knee itself."""
        del z, work
        return velocity

    def settle(self, z: float) -> float:
        """Bring z back between the yield displacements."""
        return bounded(z, self.yield_displacement)

    def _advance(self, z: float, work: float, change: float) -> tuple[float, float]:
        """Exactly: the law is elastic, then perfectly plastic."""
        return self.settle(z + change), work  # the law does not depend on the work


@dataclass(frozen=True)
class BoucWenSpring(HystereticSpring):
    """Bouc-Wen law (Wen 1976), with the degradation of Baber & Wen (1981) where wished for.

    With v the rate of deformation and E the work on the hysteretic part::

        z' = [A v - nu (beta |v| |z/z_y|^(n-1) z/z_y + gamma v |z/z_y|^n)] / eta
        A = 1 - d_A E,  nu = 1 + d_nu E,  eta = 1 + d_eta E

    beta + gamma = 1 makes z_y the largest hysteretic displacement of the spring as new.

    Attributes
    ----------
    exponent : float
        n, sharpness of yielding; at least 1.
    beta, gamma : float
        Shape of unloading.
    amplitude_loss, strength_loss, stiffness_loss : float
        d_A, d_nu, d_eta, for E in units of k z_y^2.
    """

    exponent: float = 1.0
    beta: float = 0.5
    gamma: float = 0.5
    amplitude_loss: float = 0.0
    strength_loss: float = 0.0
    stiffness_loss: float = 0.0

    @cached_property
    def limit(self) -> float:
        """Largest hysteretic displacement that the law leads to, m."""
        shape = self.beta + self.gamma
        return self.yield_displacement * shape ** (-1.0 / self.exponent) if shape > 0 else math.inf

    def settle(self, z: float) -> float:
        """Bring z back to the law's limit, where a step of an integrator was too long for it."""
        return bounded(z, self.limit)

    def rate(self, z: float, velocity: float, work: float) -> float:
        """Rate of the hysteretic displacement, m/s; see `HystereticSpring.rate`."""
        return bouc_wen_rate(
            z,
            velocity,
            work,
            self.yield_displacement,
            self.limit,
            self.exponent,
            self.beta,
            self.gamma,
            self.amplitude_loss,
            self.strength_loss,
            self.stiffness_loss,
        )
