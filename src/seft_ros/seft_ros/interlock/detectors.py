"""Detectors of faulty sensors, valves and supplies, see `detector_step`."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from seft_plant_sim.sensors import CHANNELS

from seft_ros.interlock.detector_step import DetectorParameters, DetectorState

Floats = npt.NDArray[np.float64]

MEMORY = 0.05
"""Time constant of the sums of both sides of a relation, s."""
SHORT = 0.015
"""Time constant of the second-order work, s."""
LARGEST = 1.0
"""Time constant with which the largest motion is forgotten, s."""
SIGMAS = 6.0
"""Threshold over the RMS of the noise alone."""
TOLERANCE = 0.2
"""Part of the motion by which sensors may disagree: calibration, and channels 3 ms apart at 10 Hz."""
VALVE_TOLERANCE = 0.35
"""Part of the flow by which the valve may be off: the controller follows a gain error of 0.3."""
OFF_TARGET = 0.3
"""Part of the target's motion by which a test may be off it."""
LASTS, LONG_LASTS = 0.006, 0.02
"""Times for which a detector must be beyond its threshold, s: longer than a spike; and, where a
specimen that slips or bangs or a valve at its limit may be, longer than these."""


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
        Persistence, s.
    """

    name: str
    text: str
    unit: str
    lasts: float = LASTS


_SUMS = "disagree on axis {axis}: they differ by {seen} over the last 50 ms"
_STEP = "disagree on axis {axis} from sample to sample, as with noise: they differ by {seen}"
_OIL = "measured velocity and force, and the valve's flow by its commands,"
_SAME = "measured {} on axis {{axis}} has repeated one value for {{seen}}"
DETECTORS = (
    Detector("displacement_velocity", f"measured displacement and velocity {_SUMS}", "m"),
    Detector("velocity_acceleration", f"measured velocity and acceleration {_SUMS}", "m/s"),
    Detector("oil_balance", f"{_OIL} {_SUMS}", "m"),
    Detector("displacement_noise", f"measured displacement and velocity {_STEP}", "m"),
    Detector("velocity_noise", f"measured velocity and acceleration {_STEP}", "m/s"),
    Detector("oil_noise", f"{_OIL} {_STEP}", "m"),
    Detector(
        "force_noise",
        "measured force and acceleration disagree on axis {axis} from sample to sample, as with "
        "noise: the specimen's force jumps by {seen}",
        "N",
        LONG_LASTS,
    ),
    Detector(
        "second_order_work",
        "the measured force falls as the specimen is deformed further: work of {seen} against it",
        "N m",
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
"""In the order of the rows in `detector_step`."""


def detector_arrays(
    noise: Floats,
    velocity_is_derived: bool,
    actuator: Floats,
    past: Floats,
    mass: Floats,
    stiffness: Floats,
    computed_mass: Floats,
    warn_only: Sequence[str],
    dt: float,
) -> tuple[DetectorParameters, DetectorState]:
    """Put the detectors of n axes into arrays.

    Parameters
    ----------
    noise : ndarray
        RMS noise of displacement, velocity, acceleration and force, shape (4, n), positive.
    velocity_is_derived : bool
        Whether the velocity is that of the displacement.
    actuator, past : ndarray
        See `DetectorParameters`; a flow gain or an oil stiffness of 0 is not known.
    mass, stiffness, computed_mass : ndarray
        Shape (n, n), kg, N/m and kg.
    warn_only : sequence of str
        Names of the detectors that do not end a test.
    dt : float
        Sampling period, s.
    """
    n, fade, short = noise.shape[1], math.exp(-dt / MEMORY), math.exp(-dt / SHORT)
    x, v, a, f = noise
    if velocity_is_derived:
        v = math.sqrt(2.0) * x / dt
    known = (actuator[:, 0] > 0.0) & (actuator[:, 1] > 0.0)
    actuator = actuator.copy()
    actuator[~known, 1] = 1.0
    actuator[actuator[:, 3] <= 0.0, 3] = np.inf
    oil = np.where(known, f / actuator[:, 1], np.inf)
    jumps, rates = np.array([x, v, oil]), dt * np.array([v, a, v])
    sums = np.sqrt(jumps**2 * 2.0 / (1.0 + fade) + rates**2 / (2.0 * (1.0 - fade)))
    steps = np.sqrt(2.0 * jumps**2 + rates**2 / 2.0)
    rough = np.sqrt(6.0 * (f**2 + mass**2 @ a**2))
    unknown = 0.0 if mass.any() and stiffness.any() else math.inf
    lasts = [max(1, math.ceil(each.lasts / dt - 1e-9)) for each in DETECTORS]
    acts = [each.name not in warn_only for each in DETECTORS]
    parameters = DetectorParameters(
        dt=dt,
        fade=fade,
        short=short,
        memory=math.exp(-dt / LARGEST),
        actuator=actuator,
        past=past,
        mass=mass,
        stiffness=stiffness,
        computed_mass=computed_mass,
        noise=np.array([x, v, a, f]),
        sums=SIGMAS * sums,
        steps=SIGMAS * steps,
        rough=SIGMAS * rough + unknown,
        unknown=unknown,
        tolerance=np.array([TOLERANCE, TOLERANCE, VALVE_TOLERANCE]),
        off_target=OFF_TARGET,
        persistence=np.array(lasts),
        acts=np.array(acts, dtype=np.int64),
    )
    state = DetectorState(
        last=np.zeros((4, n)),
        flow=np.zeros(n),
        sent=np.zeros_like(past),
        sums=np.zeros((3, 2, n)),
        largest=np.zeros((7, n)),
        restoring=np.zeros((3, n)),
        work=np.zeros(3),
        response=np.zeros((2, n)),
        repeats=np.zeros((4, n), dtype=np.int64),
        resolution=np.zeros((4, n)),
        counts=np.zeros((len(DETECTORS), n), dtype=np.int64),
        shares=np.zeros((len(DETECTORS), n)),
        found=np.zeros(2),
        step=np.zeros(1, dtype=np.int64),
    )
    return parameters, state


def describe(place: int, found: Floats, axes: Sequence[str]) -> str:
    """Say in a sentence what a detector saw, of what `detect` gave and `DetectorState.found`."""
    row, axis = divmod(place, len(axes))
    one = DETECTORS[row]
    seen, threshold = (f"{value:.3g} {one.unit}" for value in found.tolist())
    return f"{one.text.format(axis=axes[axis], seen=seen)} ({threshold} allowed): {one.name}"
