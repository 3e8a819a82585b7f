"""Mass, damping and stiffness of the specimen, from measured force and motion."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from seft_plant_sim.specimen import Specimen

from seft_ros.identification.spectral import Response
from seft_ros.loop_shaping.roots import Root, roots_of

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

_FLOOR = 0.003  # of each term: what a calibrated sensor is good for


@dataclass(frozen=True)
class SpecimenFit:
    """Identified specimen: M a + C v + K x = f.

    Attributes
    ----------
    mass, damping, stiffness : ndarray
        Shape (n, n), symmetric, in kg, N s/m and N/m.
    error : float
        RMS of the force that they leave unexplained, over that of the force, 0 to 1.
    """

    mass: Floats
    damping: Floats
    stiffness: Floats
    error: float

    def roots(self) -> list[Root]:
        """Natural frequencies and dampings, lowest first."""
        moving, _ = Specimen(self.mass, self.damping, self.stiffness).state_matrices()
        return roots_of(np.linalg.eigvals(moving))

    def axis_root(self, axis: int) -> Root:
        """Natural frequency and damping of one axis, the others held."""
        m, c, k = (part[axis, axis] for part in (self.mass, self.damping, self.stiffness))
        w = float(np.sqrt(k / m))
        return Root(w / (2 * np.pi), float(c / (2 * m * w)))


def fit_specimen(measured: Sequence[Response]) -> SpecimenFit:
    """Fit mass, damping and stiffness to responses of force and motion.

    The responses to the excitation are its cross spectra with the sensors, so that noise of
    the sensors averages out of them (the excitation is the instrument). What is left of it is
    weighed out: the equation error of every frequency counts by the inverse of the variance that
    noise of force, acceleration and displacement gives it, at the parameters sought. That is
    the maximum-likelihood estimator of errors in variables, and consistent (Pintelon &
    Schoukens, System Identification, 2nd ed., sec. 9.11). The mass is seen through the
    acceleration, damping and stiffness through the displacement, each where it is strong.

    Parameters
    ----------
    measured : sequence of Response
        Of displacement, acceleration and force over n axes, stacked, to the excitation.
    """
    n = measured[0].response.shape[2]
    upper = np.triu_indices(n)
    parts = [_Equation(part, n) for part in measured]

    def matrices(p: Floats) -> list[Floats]:
        found = []
        for values in p.reshape(3, -1):
            matrix = np.zeros((n, n))
            matrix[upper] = values
            found.append(matrix + np.triu(matrix, 1).T)
        return found

    def residuals(p: Floats) -> Floats:
        errors = np.concatenate([part.weighed(*matrices(p * scale)).ravel() for part in parts])
        return np.concatenate([errors.real, errors.imag])

    start = np.stack([matrix[upper] for matrix in parts[-1].rough()])
    size = np.abs(start).max(axis=1, keepdims=True)
    scale = np.repeat(np.where(size > 0, size, 1.0), start.shape[1], axis=1).ravel()
    found = least_squares(residuals, start.ravel() / scale, loss="soft_l1", f_scale=3.0)
    mass, damping, stiffness = matrices(found.x * scale)
    values, vectors = np.linalg.eigh(damping)
    damping = (vectors * np.maximum(values, 0.0)) @ vectors.T  # no specimen feeds energy in
    damping = (damping + damping.T) / 2
    error = np.mean([part.unexplained(mass, damping, stiffness) for part in parts])
    return SpecimenFit(mass, damping, stiffness, float(error))


class _Equation:
    """Equation of motion at every frequency: M A + (jw C + K) X = F, and its noise."""

    def __init__(self, measured: Response, n: int) -> None:
        self._x, self._a, self._f = (
            measured.response[:, part * n : (part + 1) * n] for part in range(3)
        )
        self._s = 2j * np.pi * measured.frequencies_hz[:, np.newaxis, np.newaxis]
        self._noise = measured.noise
        self._gain = measured.input_gain
        self._one = np.broadcast_to(np.eye(n), (len(self._s), n, n))

    def _error(self, mass: Floats, damping: Floats, stiffness: Floats) -> Complexes:
        error: Complexes = self._f - mass @ self._a - (self._s * damping + stiffness) @ self._x
        return error

    def weighed(self, mass: Floats, damping: Floats, stiffness: Floats) -> Complexes:
        """Error over its standard deviation, shape (F, n, n): equations, inputs."""
        motion = self._s * damping + stiffness
        rows = np.concatenate([-motion, -mass * self._one, self._one], axis=2)
        power = np.einsum("fij,fjk,fik->fi", rows, self._noise, rows.conj()).real
        variance = power[:, :, np.newaxis] * self._gain[:, np.newaxis, :]
        terms = np.abs(self._f) + np.abs(mass) @ np.abs(self._a)
        terms = terms + np.abs(stiffness) @ np.abs(self._x)
        return self._error(mass, damping, stiffness) / np.sqrt(
            np.maximum(variance, 0.0) + (_FLOOR * terms) ** 2
        )

    def rough(self) -> list[Floats]:
        """First guess, each axis by itself: linear least squares on relative errors."""
        n = self._one.shape[1]
        found = np.zeros((3, n))
        for axis in range(n):
            x, a, f = (part[:, axis, axis] for part in (self._x, self._a, self._f))
            columns = np.stack([a, self._s[:, 0, 0] * x, x], axis=1) / np.abs(f)[:, np.newaxis]
            target = f / np.abs(f)
            scale = np.linalg.norm(columns, axis=0)
            split = np.concatenate([columns.real, columns.imag]) / scale
            wanted = np.concatenate([target.real, target.imag])
            solution = np.linalg.lstsq(split, wanted, rcond=None)[0]
            found[:, axis] = solution / scale
        return [np.diag(np.abs(values)) for values in found]

    def unexplained(self, mass: Floats, damping: Floats, stiffness: Floats) -> float:
        error = self._error(mass, damping, stiffness)
        return float(np.linalg.norm(error) / np.linalg.norm(self._f))
