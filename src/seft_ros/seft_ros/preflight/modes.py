"""The whole structure's modes as a test will show them: false damping, shifted frequency."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigh
from seft_msgs_py.arrays import mass_matrix

from seft_ros.preflight.plan import Plan

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

NEAR = 2.0
"""A mode of the loop stands for one of the structure within this factor in frequency."""


@dataclass(frozen=True)
class Mode:
    """A mode of the whole structure, and of the test in its place.

    Attributes
    ----------
    exact_hz, exact_damping : float
        Natural frequency in Hz and damping ratio of the whole structure (paper Eq. 2.1).
    hz, damping : float
        Of the test.
    """

    exact_hz: float
    exact_damping: float
    hz: float
    damping: float

    @property
    def false_damping(self) -> float:
        """What the test adds to the damping ratio."""
        return self.damping - self.exact_damping

    @property
    def frequency_error(self) -> float:
        """Relative error of the natural frequency."""
        return self.hz / self.exact_hz - 1


def predicted_modes(plan: Plan) -> list[Mode]:
    """Modes of the whole structure beside those of the loop, lowest first.

    In place of a mode stands the eigenvalue of the loop, near it in frequency, through which
    the ground motion moves the mode's shape most: the residue over the distance from the unit
    circle. Overdamped modes, and those that the loop does not show, are left out.
    """
    specimen = plan.rig.specimen
    mass = whole_mass(plan)
    n = len(mass)
    _, shapes = eigh(specimen.stiffness, mass)
    exact = _upper(
        np.linalg.eigvals(
            np.block(
                [
                    [np.zeros((n, n)), np.eye(n)],
                    [
                        -np.linalg.solve(mass, specimen.stiffness),
                        -np.linalg.solve(mass, specimen.damping),
                    ],
                ]
            )
        )
    )
    if len(exact) < n:  # then shapes can't be matched by order
        return []
    z, residues = plan.loop().modes()
    upper = (z.imag > 0) & (np.abs(z) > 0.1)
    z, residues = z[upper], residues[upper]
    s = np.log(z) / plan.dt
    modes = []
    for pole, shape in zip(exact, shapes.T, strict=True):
        moved = np.linalg.norm(np.einsum("p,pq,iqn->in", shape, mass, residues), axis=1)
        peak = moved / np.maximum(np.abs(1 - np.abs(z)), 1e-12)
        near = (np.abs(s) > abs(pole) / NEAR) & (np.abs(s) < abs(pole) * NEAR)
        peak = np.where(near & np.isfinite(peak), peak, 0.0)
        if peak.any():
            found = s[int(peak.argmax())]
            modes.append(Mode(*_natural(pole), *_natural(found)))
    return modes


def whole_mass(plan: Plan) -> Floats:
    """Mass of the whole structure, shape (n, n), kg, as for the reference of a test."""
    mass = mass_matrix(plan.section["model.mass"], plan.axes, "reference_force: model.mass")
    if plan.section["method"] == "eft":
        return (1.0 + plan.mass_ratio) * mass
    return plan.rig.specimen.mass + plan.mass_ratio * mass


def _upper(poles: Complexes) -> Complexes:
    upper = poles[poles.imag > 0]
    return upper[np.abs(upper).argsort()]


def _natural(pole: complex) -> tuple[float, float]:
    return abs(pole) / (2 * np.pi), -pole.real / abs(pole)
