"""The benchmark's plant in place of a laboratory's hardware, for `rig: hardware`.

As on any rig the command that answers a sample acts from the next one on: one period later than
with the controllers of the benchmark's own loop.
"""

from array import array
from collections.abc import Mapping
from typing import Any

import numpy as np
from rths_problem import FORCE, NOISE, POSITION, RATE, Plant, plant_step, quantised
from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import InputError
from seft_plant_sim.compiled import entry_point

BLOCK = 64
"""Samples whose noise is drawn at once: in less than a period."""


class BenchmarkRig:
    """A displacement servo with a load cell, and no other sensor.

    Parameters
    ----------
    plant : Plant
        What it truly is.
    seed : int
        Of the sensors' noise.

    Attributes
    ----------
    displacement : array
        True displacement at each sample, m.
    """

    can_wait = True

    def __init__(self, plant: Plant, seed: int) -> None:
        self._plant, self._z, self._work = plant, np.zeros(5), np.zeros((3, 5))
        self._rng = np.random.default_rng(seed)
        self._block = np.full((BLOCK, 4, 1), np.nan)  # samples to come: their noise
        self._acts = self._asked = 0.0  # commands: from this sample on, and from the next one on
        self._step = entry_point(plant_step, plant, self._z, 0.0, self._work)
        self.displacement = array("d")

    def read(self) -> Floats:
        """Move for a period, and give displacement and force; NaN for what is not measured."""
        place = len(self.displacement) % BLOCK
        if place == 0:
            noise = self._rng.standard_normal((BLOCK, 2)) * list(NOISE.values())
            self._block[:, ::3, 0] = noise
        if self.displacement:
            self._step(self._plant, self._z, self._acts, self._work)
        self._acts, sample = self._asked, self._block[place]
        x, limit = float(self._z[POSITION]), self._plant.capacity
        self.displacement.append(x)
        sample[0, 0] += x
        sample[3, 0] += min(max(float(self._z[FORCE]), -limit), limit)
        return sample

    def write(self, drive: Floats) -> None:
        """Command a displacement, m, shape (1,)."""
        self._asked = quantised(float(drive[0]))

    def safe(self) -> None:
        """Stand where it was last commanded to."""

    def close(self) -> None:
        """There is nothing to give back."""


def nominal_rig(parameters: Mapping[str, Any], axes: tuple[str, ...]) -> BenchmarkRig:
    """Make the nominal plant for ``rig: hardware``; an InputError says that the rate is wrong."""
    if parameters["rate"] != RATE:
        raise InputError(f"/**: rate is {parameters['rate']:g} Hz, but the plant has {RATE:g} Hz")
    return BenchmarkRig(Plant.nominal(), parameters["seed"])
