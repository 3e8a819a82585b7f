"""Detectors of faulty sensors, valves and supplies, by name: what they say, and for how long."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from seft_plant_sim.sensors import CHANNELS

Floats = npt.NDArray[np.float64]

LASTS, LONG_LASTS = 0.006, 0.02
"""Times for which a detector must be beyond its threshold, s: longer than a spike; and, where a
specimen that slips or bangs or a valve at its limit may be, longer than these."""

WARNING = 0.8
"""Part of its threshold from which on a detector warns: noise alone reaches 0.75 in a test."""


@dataclass(frozen=True)
class Detector:
    """One of the detectors.

    Attributes
    ----------
    name : str
        By which parameters and reports call it.
    text : str
        What it says: a sentence of what it saw and its threshold.
    unit : str
        Of these.
    lasts : float
        Persistence, s; two samples at least.
    of_valve : bool
        Whether it knows the flow by the commands, of which a rig may have missed some.
    """

    name: str
    text: str
    unit: str
    lasts: float = LASTS
    of_valve: bool = False


_SUMS = "disagree on axis {axis}: they differ by {seen} over the last 50 ms"
_STEP = "disagree on axis {axis} from sample to sample, as with noise: they differ by {seen}"
_OIL = "measured velocity and force, and the valve's flow by its commands,"
_SAME = "measured {} on axis {{axis}} has repeated one value for {{seen}}"
DETECTORS = (
    Detector("displacement_velocity", f"measured displacement and velocity {_SUMS}", "m"),
    Detector("velocity_acceleration", f"measured velocity and acceleration {_SUMS}", "m/s"),
    Detector("oil_balance", f"{_OIL} {_SUMS}", "m", of_valve=True),
    Detector("displacement_noise", f"measured displacement and velocity {_STEP}", "m"),
    Detector("velocity_noise", f"measured velocity and acceleration {_STEP}", "m/s"),
    Detector("oil_noise", f"{_OIL} {_STEP}", "m", of_valve=True),
    Detector(
        "second_order_work",
        "the measured force falls as the specimen is deformed further: work of {seen} against it",
        "N m",
    ),
    Detector(
        "force_noise",
        "measured force and acceleration disagree on axis {axis} from sample to sample, as with "
        "noise: the specimen's force jumps to and fro in {seen} of late",
        "samples",
        0.0,
    ),
    Detector(
        "force_jump",
        "the specimen's force by measured force and acceleration on axis {axis} jumps by {seen}",
        "N",
        0.0,
    ),
    Detector(
        "force_response",
        "measured force on axis {axis} does not answer the motion: sum of squares {seen}",
        "N^2",
        LONG_LASTS,
    ),
    Detector(
        "tracking",
        "measured displacement on axis {axis} is {seen} away from its target",
        "m",
        LONG_LASTS,
    ),
    *(Detector(f"{name}_frozen", _SAME.format(name), "samples", 0.0) for name in CHANNELS),
)
"""In the order of the rows in `detector_look`."""

MODEL_BASED = (
    *("oil_balance", "oil_noise", "second_order_work"),
    *("force_noise", "force_jump", "force_response"),
)
"""Those which need to know actuators or specimen: they only warn where these are to be found."""
ALL = "all"


def describe(place: int, found: Floats, axes: Sequence[str]) -> str:
    """Say in a sentence what a detector saw, of what `detect` gave and `DetectorState.found`."""
    row, axis = divmod(place, len(axes))
    one = DETECTORS[row]
    seen, threshold = (f"{value:.3g} {one.unit}" for value in found.tolist())
    return f"{one.text.format(axis=axes[axis], seen=seen)} ({threshold} allowed): {one.name}"
