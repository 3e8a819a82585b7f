"""The inverse of a specimen of several axes, as one transfer function for each of its modes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import mass_matrix, symmetric_matrix
from seft_msgs_py.errors import InputError

Floats = npt.NDArray[np.float64]

_ROUNDING = 1e-9


@dataclass(frozen=True)
class SpecimenModes:
    """Controllers of a specimen's modes.

    Attributes
    ----------
    controllers : list of (list of float, list of float)
        Numerator and denominator of each mode, in s, highest power first.
    shapes : ndarray
        The modes' shapes P, a column each, of unit mass: P^T M P = 1; shape (n, n), kg^-1/2.
    """

    controllers: list[tuple[list[float], list[float]]]
    shapes: Floats


def specimen_modes(
    section: dict[str, Any], axes: Sequence[str], own: Sequence[int], dt: float
) -> SpecimenModes:
    """Make a controller that inverts a specimen: u = g (M s^2 + C s + K)^-1 (f_r - f).

    The valves open as far as the specimen would move under the force error, times g. A valve's
    oil column sees the specimen's modes as zeros of its force (control-structure interaction,
    Dyke et al. 1995); the paper's Eq. 3.1 has the one mode of its specimen for poles, which
    cancel them. This does so for every mode of a specimen of several axes, and all modes have
    one force loop, which then is that of Eq. 3.1. With controllers of the axes, each made for one
    frequency, the modes far above it are unstable, whatever the gain.

    What damping couples modes is left out: P^T C P has its diagonal only. Poles are those of the
    specimen as it is sampled; the bilinear transform would move those of high frequency off the
    zeros that they are to cancel.

    Parameters
    ----------
    section : dict
        Parameters ``specimen.*`` of the force controller, for all axes.
    axes : sequence of str
        Names of all axes.
    own : sequence of int
        Places of those that this controller drives.
    dt : float
        Sampling period, s.

    Raises
    ------
    InputError
        If the specimen is not known, is none, or couples axes of several rigs.
    """
    where = "force_controller: specimen"
    if not np.any(section["specimen.mass"]):
        raise InputError(
            f"{where}.mass is 0, but method decoupling inverts the specimen: give its mass, "
            "damping and stiffness"
        )
    matrices = {"mass": mass_matrix(section["specimen.mass"], axes, f"{where}.mass")}
    for name in ("damping", "stiffness"):
        matrices[name] = symmetric_matrix(section[f"specimen.{name}"], axes, f"{where}.{name}")
    mass, damping, stiffness = (
        own_part(matrix, own, f"{where}.{name} {matrix.tolist()} couples")
        for name, matrix in matrices.items()
    )
    root = np.linalg.cholesky(mass)  # of M: P = root^-T Q, Q of root^-1 K root^-T
    inverse = np.linalg.inv(root)
    squares, turned = np.linalg.eigh(inverse @ stiffness @ inverse.T)
    shapes = inverse.T @ turned
    losses = np.einsum("im,ij,jm->m", shapes, damping, shapes)
    for name, of_modes in (("stiffness", squares), ("damping", losses)):
        if of_modes.min() < -_ROUNDING * np.abs(of_modes).max():
            raise InputError(
                f"{where}.{name} {matrices[name].tolist()} is negative for some deformation: the "
                "controller that inverts it would be unstable"
            )
    gain = float(section["specimen.gain"])
    controllers = [
        _as_sampled(gain, loss, square, dt) for loss, square in np.maximum([losses, squares], 0.0).T
    ]
    return SpecimenModes(controllers, shapes)


def own_part(matrix: Floats, own: Sequence[int], doing: str) -> Floats:
    """Take one rig's part of a matrix over all axes; InputError if it is tied to another's."""
    if np.delete(matrix[list(own)], own, axis=1).any():
        raise InputError(
            f"{doing} axes of different rigs, whose force controllers do not know each other's "
            "forces"
        )
    part: Floats = matrix[np.ix_(own, own)]
    return part


def _as_sampled(
    gain: float, loss: float, square: float, dt: float
) -> tuple[list[float], list[float]]:
    """Make gain / (s^2 + loss s + square), bent so that its bilinear transform has its poles."""
    poles = np.exp(np.roots([1.0, loss, square]) * dt)
    warped = np.poly(2.0 / dt * (poles - 1.0) / (poles + 1.0)).real
    same_when_slow = warped[2] / square if square > 0.0 else 1.0
    return [gain * same_when_slow], warped.tolist()
