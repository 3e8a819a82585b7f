"""Detectors for tests of something else."""

import numpy as np
from seft_plant_sim.judge.detector_list import DETECTORS
from seft_plant_sim.judge.detectors import detector_arrays


def warning_detectors(axes, dt=0.002, has_valve=True):
    """Detectors that end no test, of axes whose hardware is not known."""
    names = [one.name for one in DETECTORS]
    nothing, none = np.zeros((axes, axes)), np.zeros((4, axes))
    actuator, past = np.zeros((axes, 4)), np.zeros((axes, 2, 1))
    limits = np.ones(4)
    return detector_arrays(
        *(none, limits, none, False, actuator, past, has_valve),
        *[nothing] * 3,
        *(names, 10.0, dt),
    )
