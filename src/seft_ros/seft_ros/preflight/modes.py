"""The whole structure's modes as a test will show them: false damping, shifted frequency."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigh
from scipy.optimize import linear_sum_assignment
from seft_plant_sim.whole_structure import WholeStructure

from seft_ros.preflight.plan import Plan

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

NEAR = 2.0
"""A mode of the loop stands for one of the structure within this factor in frequency."""
_UNFIT = 1e6


@dataclass(frozen=True)
class Mode:
    """Natural frequency in Hz and damping ratio of the whole structure, and of the test."""

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
    circle; none stands for two. Overdamped modes, and those that the loop does not show, are
    left out. Of a method that follows the specimen it is the loop with the force as measured.
    """
    whole = WholeStructure.of_test(plan.rig.specimen, plan.section, plan.axes).structure
    n = len(plan.axes)
    _, shapes = eigh(whole.stiffness, whole.mass)
    exact = _upper(np.linalg.eigvals(whole.state_matrices()[0]).astype(np.complex128))
    if len(exact) < whole.axes:  # then shapes can't be matched by order
        return []
    z, residues = plan.loops()[-1].modes()
    upper = (z.imag > 0) & (np.abs(z) > 0.1)
    z, residues = z[upper], residues[upper]
    s = np.log(z) / plan.dt
    distance = np.abs(np.log(np.abs(s) / np.abs(exact)[:, np.newaxis]))
    weights = shapes[:n].T @ whole.mass[:n, :n]  # as far as a test measures a shape
    moved = np.linalg.norm(np.einsum("mi,pij->mpj", weights, residues), axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        fitness = np.log(moved / np.maximum(np.abs(1 - np.abs(z)), 1e-12)) - distance
    fits = (distance < np.log(NEAR)) & np.isfinite(fitness)
    pairs = zip(*linear_sum_assignment(np.where(fits, -fitness, _UNFIT)), strict=True)
    return [Mode(*_natural(exact[m]), *_natural(s[p])) for m, p in pairs if fits[m, p]]


def _upper(poles: Complexes) -> Complexes:
    upper = poles[poles.imag > 0]
    return upper[np.abs(upper).argsort()]


def _natural(pole: complex) -> tuple[float, float]:
    return abs(pole) / (2 * np.pi), -pole.real / abs(pole)
