"""What two tests say of a rig: specimen, valve-to-force response, force loop, closed loop."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import ExperimentError

from seft_ros.identification.blocked_compliance import BlockedCompliance
from seft_ros.identification.blocked_error import blocked_error
from seft_ros.identification.measured_test import (
    FORCE,
    MOTION,
    MOTION_TO,
    REFERENCE,
    VALVE,
    MeasuredTest,
)
from seft_ros.identification.measurement import Measurement
from seft_ros.identification.nominal_axis import NominalAxis
from seft_ros.identification.plant_fit import PlantFit, fit_plant
from seft_ros.identification.specimen_fit import SpecimenFit, fit_specimen
from seft_ros.identification.tracking_fit import TrackingFit, fit_tracking
from seft_ros.loop_shaping.controller import Controller
from seft_ros.loop_shaping.design import LoopDesign, shape_loop
from seft_ros.loop_shaping.margins import Tracking, tracking_measures
from seft_ros.loop_shaping.plant import identified_plant
from seft_ros.recording.record import Record

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

_COHERENT = 0.8  # up to there the closed loop is fitted
_TRACKING_FLOOR = 0.01


@dataclass(frozen=True)
class ValveResponse:
    """Open loop of one axis: what was measured, the model, and the loop that it makes.

    Attributes
    ----------
    measured : Measurement
        Valve command u_k to force f_k, N/V.
    fit : PlantFit
        The continuous plant.
    loop : LoopDesign
        That plant, sampled, with the experiment's controller.
    controller_known : bool
        Whether that is a transfer function; else the loop is of the plant alone.
    blocked_error : tuple of float
        Error over force of the loop where the piston is held still, in s, highest power first;
        empty where the controller is not known.
    """

    measured: Measurement
    fit: PlantFit
    loop: LoopDesign
    controller_known: bool
    blocked_error: tuple[float, ...] = ()


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
    nominal : NominalAxis or None
        Of several axes: the uncoupled specimen of `tracking`. None where the force controller
        inverts the specimen: all axes have one force loop then, with the specimen as it is.
    tracking : ClosedLoop or None
        Of several axes, or where the force controller inverts the specimen: the force loop of all
        of them, as it would be with that specimen, or without the compliance.
    compliance : BlockedCompliance or None
        Where the force controller inverts the specimen, and valves were driven.
    """

    axes: tuple[str, ...]
    band: tuple[float, float]
    specimen: SpecimenFit
    valves: tuple[ValveResponse, ...]
    closed_loops: tuple[ClosedLoop, ...]
    unusable: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    nominal: NominalAxis | None = None
    tracking: ClosedLoop | None = None
    compliance: BlockedCompliance | None = None


def identify(
    open_loop: Record | None,
    closed_loop: Record | None,
    band: tuple[float, float],
    controller: Controller | None,
) -> Identified:
    """Identify a rig from the records of its two tests.

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
        If the coherence is too low to say anything.
    """
    named = ((open_loop, "open loop", "--amplitude"), (closed_loop, "closed loop", "--force"))
    tests, unusable, faults = [], [], []
    for record, what, option in named:
        if record is None:
            continue
        test = MeasuredTest(record, band)
        incoherent = test.incoherent()
        if incoherent:
            unusable.append(f"{what}: {incoherent}; raise {option} or --duration")
        else:
            tests.append(test)
        if test.at_limit():
            faults.append(
                f"{what}: a valve command was at its limit in {test.at_limit()} of {test.steps} "
                f"steps, which bends what is linear; lower {option}, or mend an unstable loop"
            )
    if not tests:
        raise ExperimentError(unusable[0])
    axes, dt = tests[0].axes, tests[0].dt
    specimen = fit_specimen([test.response(REFERENCE, MOTION, MOTION_TO) for test in tests])
    several = len(axes) > 1
    nominal = NominalAxis.of(specimen) if several else None
    tracking: ClosedLoop | None = None
    compliance: BlockedCompliance | None = None
    valves: list[ValveResponse] = []
    closed_loops: list[ClosedLoop] = []
    for test in tests:
        if test.record is closed_loop and nominal is not None:
            tracking = _closed_loop(test.as_of(nominal.on_each(len(axes)), compliance), dt)
        for axis in range(len(axes)):
            if test.record is closed_loop:
                closed_loops.append(_closed_loop(test.of(REFERENCE, FORCE, axis), dt))
            else:
                measured = test.of(VALVE, FORCE, axis)
                valves.append(_valve(measured, dt, specimen, axis, controller))
    return Identified(
        axes,
        band,
        specimen,
        tuple(valves),
        tuple(closed_loops),
        tuple(unusable),
        tuple(faults),
        nominal,
        tracking,
        compliance,
    )


def _valve(
    measured: Measurement,
    dt: float,
    specimen: SpecimenFit,
    axis: int,
    controller: Controller | None,
) -> ValveResponse:
    fit = fit_plant(measured, dt, specimen.axis_root(axis), len(specimen.mass))
    model = fit.model.rational()
    section = {
        "plant.numerator": model.numerator,
        "plant.denominator": model.denominator,
        "plant.dead_time": model.dead_time,
    }
    alone = Controller.from_coefficients(1.0, 1.0)
    loop = shape_loop(identified_plant(section, 1), controller or alone, dt)
    blocked = blocked_error(fit, controller, dt) if controller else ()
    return ValveResponse(measured, fit, loop, controller is not None, blocked)


def _closed_loop(measured: Measurement, dt: float) -> ClosedLoop:
    f, tracking = measured.frequencies_hz, measured.response
    # to the end of what is known: a pole beyond would be made up
    coherent = np.flatnonzero(measured.coherence >= _COHERENT)
    known = slice(0, int(coherent[-1]) + 1)
    weight = 1.0 / np.hypot(measured.deviation, _TRACKING_FLOOR)[known]
    fit = fit_tracking(f[known], tracking[known], weight, least_dead_time=dt)  # the loop's latency
    return ClosedLoop(measured, tracking_measures(f, tracking), fit)
