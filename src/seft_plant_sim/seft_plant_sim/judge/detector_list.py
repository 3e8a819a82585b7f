"""The detectors: their names, what they say when they find a fault, and how long they wait."""

from dataclasses import dataclass

from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.facts import CHANNELS

from seft_plant_sim.judge.judge import LASTS

LONG_LASTS = 0.02
"""Time for which the tracking error must be beyond its threshold, s: longer than the effects of a
specimen that slips or hits a stop, or of a valve at its limit. For the others it is `LASTS`."""

WARNING = 0.8
"""Part of its threshold at which a detector warns: noise alone reaches 0.75 in a test."""


@dataclass(frozen=True)
class Detector:
    """One of the detectors.

    Attributes
    ----------
    name : str
        Name in parameters and reports.
    text : str
        Its finding in a sentence, with the measured value and the threshold.
    unit : str
        Of both.
    lasts : float, optional
        Persistence, s; three samples at least, because an event between two samples shows in both;
        0: two samples; None: one, of what counts samples.
    """

    name: str
    text: str
    unit: str
    lasts: float | None = LASTS


_SUMS = "disagree on axis {axis}: they differ by {seen} over the last"
_OIL = "measured displacement and force, and the actuator's motion by its commands,"
_SAME = "measured {} on axis {{axis}} has repeated one value for {{seen}}"
_WORK = "the measured force falls as the specimen is deformed further: work of {seen} against it"
_LESS = "the specimen carries less where it is deformed farther: work of {seen} is lost"
_JUMPS = "the specimen's force by measured force and acceleration on axis {axis} jumps by {seen}"
_WRONG = "measured {} on axis {{axis}} contradicts the other channels: {{seen}} within 50 ms"
DETECTORS = (
    Detector("displacement_velocity", f"measured displacement and velocity {_SUMS} 50 ms", "m"),
    Detector("velocity_acceleration", f"measured velocity and acceleration {_SUMS} 50 ms", "m/s"),
    Detector("oil_balance", f"{_OIL} {_SUMS} 0.2 s", "m"),
    Detector("second_order_work", _WORK, "N m"),
    Detector("strength", _LESS, "N m"),
    Detector("force_jump", _JUMPS, "N", 0.0),
    *(Detector(f"{name}_frozen", _SAME.format(name), "samples", None) for name in CHANNELS),
    *(Detector(f"{name}_wrong", _WRONG.format(name), "samples", None) for name in CHANNELS),
)
"""Those of a rig, in the order of the rows of their arrays."""
_AWAY = "measured displacement on axis {axis} is {seen} away from its target"
TRACKING = Detector("tracking", _AWAY, "m", LONG_LASTS)
"""That of a force controller, which knows the target."""

MODEL_BASED = ("oil_balance", "second_order_work", "strength", "force_jump")
"""Detectors that need actuators or specimen: they only warn while these are being identified."""
NOISE_BASED = tuple(f"{name}_frozen" for name in CHANNELS)
"""Detectors that need the noise of the channels: a value with noise does not repeat."""
ALL = "all"


def describe(detector: Detector, found: Floats, axis: str) -> str:
    """Describe a detector's finding in a sentence: its value and its threshold, shape (2,)."""
    seen, threshold = (f"{value:.3g} {detector.unit}" for value in found.tolist())
    text = detector.text.format(axis=axis, seen=seen)
    return f"{text} ({threshold} allowed): {detector.name}"
