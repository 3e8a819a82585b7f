"""What tests say of a rig: its actuators, its specimen, the force loop, and how it follows."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import ExperimentError

from seft_ros.identification.actuator_fit import ActuatorFit, fit_actuator
from seft_ros.identification.measured_test import (
    FORCE,
    MOTION,
    MOTION_TO,
    REFERENCE,
    VALVE,
    MeasuredTest,
)
from seft_ros.identification.measurement import Measurement
from seft_ros.identification.plant_model import plants
from seft_ros.identification.specimen_fit import SpecimenFit, fit_specimen
from seft_ros.identification.tracking_fit import TrackingFit, fit_tracking
from seft_ros.loop_shaping.controller import Controller
from seft_ros.loop_shaping.design import LoopDesign, shape_loop
from seft_ros.loop_shaping.margins import Tracking, tracking_measures
from seft_ros.loop_shaping.plant import Plant
from seft_ros.loop_shaping.sampling import SampledPlant
from seft_ros.recording.record import Record

Floats = npt.NDArray[np.float64]

_COHERENT = 0.8  # up to there the closed loop is fitted
_FLOOR = 0.01  # of a response: what a model is asked to explain


@dataclass(frozen=True)
class ValveResponse:
    """Open loop of one axis: the actuator, and the loop that it makes with the specimen.

    Attributes
    ----------
    actuator : ActuatorFit
        The actuator, whatever the specimen is.
    measured : Measurement
        Valve command u_k to force f_k, N/V.
    error : float
        RMS of what actuator and specimen, as fitted, leave of it, relative, 0 to 1.
    loop : LoopDesign
        Their plant, sampled, with the experiment's controller.
    controller_known : bool
        Whether that is a transfer function; else the loop is of the plant alone.
    """

    actuator: ActuatorFit
    measured: Measurement
    error: float
    loop: LoopDesign
    controller_known: bool


@dataclass(frozen=True)
class ClosedLoop:
    """Closed loop of one axis.

    Attributes
    ----------
    measured : Measurement
        Reference force to measured force of the same step.
    tracking : Tracking
        How it follows.
    fit : TrackingFit
        Low-order model.
    """

    measured: Measurement
    tracking: Tracking
    fit: TrackingFit


@dataclass(frozen=True)
class Identified:
    """Everything that was identified.

    Attributes
    ----------
    axes : tuple of str
        Names of the n axes.
    band : tuple of float
        Lowest and highest frequency excited, Hz.
    specimen : SpecimenFit
        The specimen.
    valves : tuple of ValveResponse
        One for each axis; empty where no valve was driven.
    closed_loops : tuple of ClosedLoop
        One for each axis; empty where the closed loop did not run to its end.
    unusable : tuple of str
        Why a test could not be used, one line each.
    faults : tuple of str
        What else was wrong, likewise.
    """

    axes: tuple[str, ...]
    band: tuple[float, float]
    specimen: SpecimenFit
    valves: tuple[ValveResponse, ...]
    closed_loops: tuple[ClosedLoop, ...]
    unusable: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()


def identify(
    open_loop: Record | None,
    closed_loop: Record | None,
    band: tuple[float, float],
    controller: Controller | None,
) -> Identified:
    """Identify a rig from the records of its tests.

    Parameters
    ----------
    open_loop, closed_loop : Record or None
        One may be missing.
    band : tuple of float
        Lowest and highest frequency of the excitation, Hz.
    controller : Controller or None
        Of the force loop whose margins are wanted; None: not known as a transfer function.

    Raises
    ------
    ExperimentError
        If no test says anything.
    """
    unusable: list[str] = []
    faults: list[str] = []
    opened = _usable(open_loop, band, "open loop", "--amplitude", unusable, faults)
    closed = _usable(closed_loop, band, "closed loop", "--force", unusable, faults)
    actuators: list[ActuatorFit] = []
    if opened:
        actuators = [
            fit_actuator(*opened.of_actuator(axis), opened.dt, band)
            for axis in range(len(opened.axes))
        ]
        bad = [
            f"open loop: axis {axis}: {actuator.fault()}"
            for axis, actuator in zip(opened.axes, actuators, strict=True)
            if actuator.fault()
        ]
        unusable += bad
        opened, actuators = (None, []) if bad else (opened, actuators)
    tests = [test for test in (opened, closed) if test]
    if not tests:
        raise ExperimentError(unusable[0])
    specimen = fit_specimen([test.response(REFERENCE, MOTION, MOTION_TO) for test in tests])
    valves: list[ValveResponse] = []
    if opened:
        for axis, plant in enumerate(plants(specimen, actuators)):
            measured = opened.of(VALVE, FORCE, axis)
            loop = shape_loop(plant, controller or _ALONE, opened.dt)
            error = _relative_error(plant, measured, opened.dt)
            valves.append(
                ValveResponse(actuators[axis], measured, error, loop, controller is not None)
            )
    loops: list[ClosedLoop] = []
    if closed:
        each = range(len(closed.axes))
        loops = [_closed_loop(closed.of(REFERENCE, FORCE, axis), closed.dt) for axis in each]
    axes = tests[0].axes
    return Identified(
        axes, band, specimen, tuple(valves), tuple(loops), tuple(unusable), tuple(faults)
    )


_ALONE = Controller.from_coefficients(1.0, 1.0)


def _usable(
    record: Record | None,
    band: tuple[float, float],
    what: str,
    option: str,
    unusable: list[str],
    faults: list[str],
) -> MeasuredTest | None:
    """Take a test unless it is mostly noise; say what is wrong with it."""
    if record is None:
        return None
    test = MeasuredTest(record, band)
    if test.at_limit():
        faults.append(
            f"{what}: a valve command was at its limit in {test.at_limit()} of {test.steps} "
            f"steps, which bends what is linear; lower {option}, or mend an unstable loop"
        )
    incoherent = test.incoherent()
    if incoherent:
        unusable.append(f"{what}: {incoherent}; raise {option} or --duration")
        return None
    return test


def _relative_error(plant: Plant, measured: Measurement, dt: float) -> float:
    error = SampledPlant.of(plant, dt).response(measured.frequencies_hz) - measured.response
    size = np.abs(measured.response)
    deviation = np.hypot(measured.deviation, _FLOOR * size)
    return float(np.linalg.norm(error / deviation) / np.linalg.norm(size / deviation))


def _closed_loop(measured: Measurement, dt: float) -> ClosedLoop:
    f, tracking = measured.frequencies_hz, measured.response
    # to the end of what is known: a pole beyond would be made up
    coherent = np.flatnonzero(measured.coherence >= _COHERENT)
    known = slice(0, int(coherent[-1]) + 1)
    weight = 1.0 / np.hypot(measured.deviation, _FLOOR)[known]
    fit = fit_tracking(f[known], tracking[known], weight, least_dead_time=dt)  # the loop's latency
    return ClosedLoop(measured, tracking_measures(f, tracking), fit)
