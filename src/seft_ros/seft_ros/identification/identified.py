"""What tests say of a rig: its actuators, its specimen, the force loop, and how it follows."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import ExperimentError
from seft_plant_sim.specimen import Specimen

from seft_ros.identification.actuator_fit import ActuatorFit, fit_actuator
from seft_ros.identification.measured_test import (
    FORCE,
    MOTION,
    MOTION_TO,
    REFERENCE,
    VALVE,
    MeasuredTest,
)
from seft_ros.identification.specimen_fit import SpecimenFit, fit_specimen
from seft_ros.identification.spectral import Measurement
from seft_ros.identification.tracking_fit import TrackingFit, fit_tracking
from seft_ros.loop_shaping.controller import Controller
from seft_ros.loop_shaping.design import LoopDesign, shape_loop
from seft_ros.loop_shaping.margins import Tracking, tracking_measures
from seft_ros.loop_shaping.plant import Plant, small_signal
from seft_ros.loop_shaping.sampling import SampledPlant
from seft_ros.recording.record import Record

Floats = npt.NDArray[np.float64]

_COHERENT = 0.8  # up to there the closed loop is fitted
_FLOOR = 0.01  # of a response: what a model is asked to explain
_OPEN_LOOP, _CLOSED_LOOP = "open loop", "closed loop"


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
    """Closed loop of one axis: reference force to measured force of the same step."""

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
    tests: dict[str, MeasuredTest] = {}
    unusable: list[str] = []
    faults: list[str] = []
    for what, record, option in (
        (_OPEN_LOOP, open_loop, "--amplitude"),
        (_CLOSED_LOOP, closed_loop, "--force"),
    ):
        if record is None:
            continue
        test = MeasuredTest(record, band)
        if test.at_limit():
            faults.append(
                f"{what}: a valve command was at its limit in {test.at_limit()} of {test.steps} "
                f"steps, which bends what is linear; lower {option}, or mend an unstable loop"
            )
        if incoherent := test.incoherent():
            unusable.append(f"{what}: {incoherent}; raise {option} or --duration")
        else:
            tests[what] = test
    actuators: list[ActuatorFit] = []
    if opened := tests.get(_OPEN_LOOP):
        each = range(len(opened.axes))
        actuators = [fit_actuator(*opened.of_actuator(axis), opened.dt, band) for axis in each]
        named = zip(opened.axes, actuators, strict=True)
        bad = [f"{_OPEN_LOOP}: axis {axis}: {fit.fault()}" for axis, fit in named if fit.fault()]
        if bad:
            unusable += bad
            del tests[_OPEN_LOOP]
    if not tests:
        raise ExperimentError(unusable[0])
    specimen = fit_specimen(
        [test.response(REFERENCE, MOTION, MOTION_TO) for test in tests.values()]
    )
    valves, loops = [], []
    if opened := tests.get(_OPEN_LOOP):
        valves = _valves(opened, specimen, actuators, controller)
    if closed := tests.get(_CLOSED_LOOP):
        each = range(len(closed.axes))
        loops = [_closed_loop(closed.of(REFERENCE, FORCE, axis), closed.dt) for axis in each]
    axes = next(iter(tests.values())).axes
    return Identified(
        axes, band, specimen, tuple(valves), tuple(loops), tuple(unusable), tuple(faults)
    )


def _valves(
    test: MeasuredTest,
    specimen: SpecimenFit,
    actuators: list[ActuatorFit],
    controller: Controller | None,
) -> list[ValveResponse]:
    """Let the fitted actuators act on the fitted specimen, the valves of other axes closed."""
    names = ("oil_stiffness", "leakage", "flow_gain", "valve_frequency", "valve_damping")
    known = {name: np.array([getattr(fit, name) for fit in actuators]) for name in names}
    model = small_signal(
        Specimen(specimen.mass, specimen.damping, specimen.stiffness),
        viscous_friction=np.array([fit.drag for fit in actuators]),
        dead_time=0.0,
        **known,
    )
    whole, dt, valves = Plant.of_model("identified", model), test.dt, []
    for axis, actuator in enumerate(actuators):
        plant = replace(whole.axis(axis), delay=actuator.dead_time)
        measured = test.of(VALVE, FORCE, axis)
        loop = shape_loop(plant, controller or Controller((1.0,), (1.0,)), dt)
        wrong = SampledPlant.of(plant, dt).response(measured.frequencies_hz) - measured.response
        size = np.abs(measured.response)
        deviation = np.hypot(measured.deviation, _FLOOR * size)
        error = float(np.linalg.norm(wrong / deviation) / np.linalg.norm(size / deviation))
        valves.append(ValveResponse(actuator, measured, error, loop, controller is not None))
    return valves


def _closed_loop(measured: Measurement, dt: float) -> ClosedLoop:
    f, tracking = measured.frequencies_hz, measured.response
    # to the end of what is known: a pole beyond would be made up
    coherent = np.flatnonzero(measured.coherence >= _COHERENT)
    known = slice(0, int(coherent[-1]) + 1)
    weight = 1.0 / np.hypot(measured.deviation, _FLOOR)[known]
    fit = fit_tracking(f[known], tracking[known], weight, least_dead_time=dt)  # the loop's latency
    return ClosedLoop(measured, tracking_measures(f, tracking), fit)
