"""A step of the rig, for the compiler: `seft_plant_sim.rig.Rig` over its own arrays.

What the blocks multiply by matrices is multiplied by the very same matrices here; the laws that
are not linear are the blocks' own functions, compiled.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit
from numba.extending import register_jitable
from seft_plant_sim import nonlinearity, restoring_force

Floats = npt.NDArray[np.float64]

OPTIONS: dict[str, Any] = {"fastmath": {"reassoc", "contract"}, "error_model": "numpy"}
"""Sums may be taken in any order: that is what makes them fast, and all that differs."""

lost_opening = register_jitable(nonlinearity.lost_opening)
holding_force = register_jitable(nonlinearity.holding_force)
bounded = register_jitable(restoring_force.bounded)
spring_force = register_jitable(restoring_force.spring_force)
work_rate = register_jitable(restoring_force.hysteretic_work_rate)
bouc_wen_rate = register_jitable(restoring_force.bouc_wen_rate)

LIMIT, BOUC_WEN = 3, 4
"""Columns of `PlantArrays.springs`."""


class PlantArrays(NamedTuple):
    """A plant of n axes, s states, r residuals.

    Attributes
    ----------
    linear : ndarray
        `LinearPlant.matrix`; shape (0, 0): the plant is not linear.
    predict, correct : tuple of ndarray
        Of the two stretches of `NonlinearPlant`.
    steps : tuple of int
        Likewise.
    output : ndarray
        Its `output`.
    drive_limit : ndarray
        Shape (n,).
    whole, part : int
        Whole periods of the dead time, and whether a part remains.
    piston : ndarray
        `PistonAndValve.rows`; shape (0, 6): there is none.
    springs : ndarray
        Shape (p, 11): stiffness, hardening ratio, yield displacement, largest hysteretic
        displacement; then 1 and the six parameters of a Bouc-Wen law, or 0.
    deformation : ndarray
        Of the springs, shape (p, n).
    first : int
        State with which the springs' begin.
    """

    linear: Floats
    predict: tuple[Floats, Floats]
    correct: tuple[Floats, Floats]
    steps: tuple[int, int]
    output: Floats
    drive_limit: Floats
    whole: int
    part: int
    piston: Floats
    springs: Floats
    deformation: Floats
    first: int


def _multiply(matrix: Floats, vector: Floats, result: Floats) -> None:
    for row in range(matrix.shape[0]):
        total = 0.0
        for column in range(matrix.shape[1]):
            total += matrix[row, column] * vector[column]
        result[row] = total


def _find_residuals(plant: PlantArrays, n: int, z: Floats, result: Floats) -> None:
    for i in range(len(plant.piston)):
        own = plant.piston
        result[i] = lost_opening(z[3 * n + i], z[2 * n + i], own[i, 0], own[i, 1])
        result[n + i] = holding_force(z[i], z[n + i], own[i, 2], own[i, 3], own[i, 4], own[i, 5])
    count, start = len(plant.springs), 2 * len(plant.piston)
    for j in range(count):
        e = v = 0.0
        for i in range(n):
            e += plant.deformation[j, i] * z[i]
            v += plant.deformation[j, i] * z[n + i]
        own = plant.springs
        stiffness, hardening, z_y, limit = own[j, 0], own[j, 1], own[j, 2], own[j, LIMIT]
        hysteretic, work = z[plant.first + j], z[plant.first + count + j]
        force = spring_force(e, bounded(hysteretic, limit), stiffness, hardening)
        rate = v
        if own[j, BOUC_WEN]:
            rate = bouc_wen_rate(
                hysteretic, v, work, z_y, limit,
                own[j, 5], own[j, 6], own[j, 7], own[j, 8], own[j, 9], own[j, 10],
            )  # fmt: skip
        result[start + j] = force - stiffness * e
        result[start + count + j] = rate - v
        result[start + 2 * count + j] = work_rate(hysteretic, v, hardening, z_y)


def _integrate(
    plant: PlantArrays, n: int, drives: Floats, step: int, work: Floats, z: Floats, change: Floats
) -> None:
    """Go from one sample to the next as `NonlinearPlant` does, under two drives in turn.

    ``drives`` holds them from ``step`` on, shape (..., n); ``work`` is as the plant's own, with
    state, drive and residuals; ``z`` and ``change`` are room for a state and residuals.
    """
    size = len(z)
    start = size + n  # of the residuals
    for stretch in range(2):
        predict, correct = plant.predict[stretch], plant.correct[stretch]
        for i in range(n):
            work[size + i] = drives[step + stretch, i]
        for half in range(2 * plant.steps[stretch]):
            if half % 2 == 0:  # what the residuals would be at the end, were they to stay
                multiply(predict, work, z)
            else:
                for i in range(size):
                    total = 0.0
                    for j in range(len(change)):
                        total += correct[i, j] * (change[j] - work[start + j])
                    z[i] += total
                for j in range(len(plant.springs)):
                    place = plant.first + j
                    z[place] = bounded(z[place], plant.springs[j, LIMIT])
            find_residuals(plant, n, z, change)
            if half % 2:
                for i in range(size):
                    work[i] = z[i]
                for j in range(len(change)):
                    work[start + j] = change[j]


multiply = njit(forceinline=True, **OPTIONS)(_multiply)
find_residuals = njit(forceinline=True, **OPTIONS)(_find_residuals)
integrate = njit(forceinline=True, **OPTIONS)(_integrate)
