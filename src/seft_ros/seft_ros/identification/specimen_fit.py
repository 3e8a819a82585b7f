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
    row, column = np.triu_indices(n)

    def matrices(p: Floats) -> Floats:
        """M, C and K, shape (3, n, n), of their upper triangles."""
        upper = np.zeros((3, n, n))
        upper[:, row, column] = p.reshape(3, -1)
        return upper + np.triu(upper, 1).swapaxes(1, 2)

    def residuals(p: Floats) -> Floats:
        errors = np.concatenate([_weighed(part, *matrices(p * scale)).ravel() for part in measured])
        return np.concatenate([errors.real, errors.imag])

    start = _rough(measured[-1])[:, row, column]
    size = np.abs(start).max(axis=1, keepdims=True)
    scale = np.repeat(np.where(size > 0, size, 1.0), start.shape[1], axis=1).ravel()
    found = least_squares(residuals, start.ravel() / scale, loss="soft_l1", f_scale=3.0)
    mass, damping, stiffness = matrices(found.x * scale)
    values, vectors = np.linalg.eigh(damping)
    damping = (vectors * np.maximum(values, 0.0)) @ vectors.T  # no specimen feeds energy in
    damping = (damping + damping.T) / 2
    unexplained = [
        np.linalg.norm(_error(part, mass, damping, stiffness)) / np.linalg.norm(_parts(part)[2])
        for part in measured
    ]
    return SpecimenFit(mass, damping, stiffness, float(np.mean(unexplained)))


def _parts(measured: Response) -> list[Complexes]:
    """Displacement, acceleration and force, shape (F, n, n) each."""
    return np.split(measured.response, 3, axis=1)


def _motion(measured: Response, damping: Floats, stiffness: Floats) -> Complexes:
    s = 2j * np.pi * measured.frequencies_hz[:, np.newaxis, np.newaxis]
    return np.asarray(s * damping + stiffness, dtype=np.complex128)


def _error(measured: Response, mass: Floats, damping: Floats, stiffness: Floats) -> Complexes:
    """Error of the equation of motion M A + (jw C + K) X = F at every frequency."""
    x, a, f = _parts(measured)
    error: Complexes = f - mass @ a - _motion(measured, damping, stiffness) @ x
    return error


def _weighed(measured: Response, mass: Floats, damping: Floats, stiffness: Floats) -> Complexes:
    """Error over its standard deviation, shape (F, n, n): equations, inputs."""
    x, a, f = (np.abs(part) for part in _parts(measured))
    one = np.broadcast_to(np.eye(len(mass)), f.shape)
    rows = [-_motion(measured, damping, stiffness), -mass * one, one]
    by_noise = np.concatenate(rows, axis=2)
    power = np.einsum("fij,fjk,fik->fi", by_noise, measured.noise, by_noise.conj()).real
    variance = power[:, :, np.newaxis] * measured.input_gain[:, np.newaxis, :]
    terms = f + np.abs(mass) @ a + np.abs(stiffness) @ x
    deviation = np.sqrt(np.maximum(variance, 0.0) + (_FLOOR * terms) ** 2)
    return _error(measured, mass, damping, stiffness) / deviation


def _rough(measured: Response) -> Floats:
    """First guess, each axis by itself: linear least squares on relative errors; (3, n, n)."""
    n = measured.response.shape[2]
    found, s = np.zeros((3, n, n)), 2j * np.pi * measured.frequencies_hz
    for axis in range(n):
        x, a, f = (part[:, axis, axis] for part in _parts(measured))
        columns = np.stack([a, s * x, x], axis=1) / np.abs(f)[:, np.newaxis]
        target = f / np.abs(f)
        scale = np.linalg.norm(columns, axis=0)
        split = np.concatenate([columns.real, columns.imag]) / scale
        wanted = np.concatenate([target.real, target.imag])
        found[:, axis, axis] = np.abs(np.linalg.lstsq(split, wanted, rcond=None)[0] / scale)
    return found
