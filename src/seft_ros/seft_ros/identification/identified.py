"""An identified rig: actuators, specimen, closed loop; its parameter file, table and numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from seft_msgs_py.config.experiment import write_parameter_file
from seft_msgs_py.config.facts import EVERY_NODE
from seft_msgs_py.config.parameter_table import Section
from seft_msgs_py.errors import ExperimentError
from seft_plant_sim.lti import TransferFunction
from seft_plant_sim.simulated.specimen import Specimen

from seft_ros.bags.recording import Recording
from seft_ros.design.plant import Plant, small_signal
from seft_ros.drawing.style import Number, TextTable, json_safe, look_up, rows_of
from seft_ros.identification import response_fits
from seft_ros.identification.actuator_fit import ActuatorFit, OilBalance, fit_actuator
from seft_ros.identification.measured_test import MeasuredTest, Measurement
from seft_ros.identification.rig_tests import obeys_displacement
from seft_ros.reference_force.compensator import OF_THE_LOOP

_COHERENT = 0.8  # up to there the closed loop is fitted
_FLOOR = 0.01  # of a response: required accuracy of a model
_SERVO_FLOOR = 0.002  # of a servo's, whose errors are those of the displacement
_OPEN_LOOP, _CLOSED_LOOP = "open loop", "closed loop"


@dataclass(frozen=True)
class ValveResponse:
    """Open loop of one axis: the actuator, and the plant that it makes with the specimen.

    Attributes
    ----------
    actuator : ActuatorFit
        The actuator, whatever the specimen is.
    measured : Measurement
        Valve command u_k to force f_k, N/V.
    error : float
        RMS of the error of the fitted actuator and specimen, relative, 0 to 1.
    plant : Plant
        Both of them, the valves of other axes closed.
    """

    actuator: ActuatorFit
    measured: Measurement
    error: float
    plant: Plant


@dataclass(frozen=True)
class ClosedLoop:
    """Closed loop of one axis: reference force to measured force of the same step.

    Of a displacement servo command to displacement, without the loop's step and hold.
    """

    measured: Measurement
    tracking: response_fits.Tracking
    fit: response_fits.TrackingFit


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
    valves : list of ValveResponse
        One for each axis; empty if no valve was driven.
    closed_loops : list of ClosedLoop
        One for each axis; empty if the closed loop did not run to its end.
    unusable : list of str
        Why a test could not be used, one line each.
    faults : list of str
        Other faults, likewise.
    has_servos : bool
        Whether displacement servos were driven: the closed loops are theirs, from command to
        displacement.
    """

    axes: tuple[str, ...]
    band: tuple[float, float]
    specimen: response_fits.SpecimenFit
    valves: list[ValveResponse]
    closed_loops: list[ClosedLoop]
    unusable: list[str]
    faults: list[str]
    has_servos: bool = False


def identify_from_recordings(
    open_loop: Recording | None, closed_loop: Recording | None, band: tuple[float, float]
) -> Identified:
    """Identify a rig from the recordings of its tests.

    Parameters
    ----------
    open_loop, closed_loop : Recording or None
        One may be missing.
    band : tuple of float
        Lowest and highest frequency of the excitation, Hz.

    Raises
    ------
    ExperimentError
        If no test is usable.
    """
    tests, unusable, faults = dict[str, MeasuredTest](), list[str](), list[str]()
    given = (_OPEN_LOOP, open_loop, "--amplitude"), (_CLOSED_LOOP, closed_loop, "--force")
    for what, recording, option in given:
        if recording is None:
            continue
        test = MeasuredTest(recording, band)
        if at_limit := test.at_limit():
            text = f"a valve command was at its limit in {at_limit} of {test.steps} steps"
            mend = f"lower {option}, or stabilise the loop"
            faults.append(f"{what}: {text}, which is not linear; {mend}")
        if incoherent := test.incoherent():
            unusable.append(f"{what}: {incoherent}; raise {option} or --duration")
        else:
            tests[what] = test
    actuators: list[ActuatorFit] = []
    servo = any(obeys_displacement(test.recording.experiment) for test in tests.values())
    if (opened := tests.get(_OPEN_LOOP)) and not servo:
        for index, axis in enumerate(opened.axes):
            fit = fit_actuator(OilBalance(opened.of_actuator(index), opened.dt, band))
            actuators.append(fit)
            if fit.fault():
                unusable.append(f"{_OPEN_LOOP}: axis {axis}: {fit.fault()}")
                tests.pop(_OPEN_LOOP, None)
    if not tests:
        raise ExperimentError(unusable[0])
    specimen = response_fits.fit_specimen([test.motion() for test in tests.values()])
    opened, closed = tests.get(_OPEN_LOOP), tests.get(_CLOSED_LOOP)
    valves = _valves(opened, specimen, actuators) if opened and not servo else []
    followed = opened if servo and opened else closed
    loops = _loops(followed, followed is opened) if followed else []
    axes = next(iter(tests.values())).axes
    return Identified(axes, band, specimen, valves, loops, unusable, faults, servo)


def _valves(
    test: MeasuredTest, specimen: response_fits.SpecimenFit, actuators: list[ActuatorFit]
) -> list[ValveResponse]:
    """Combine the fitted actuators with the fitted specimen, the valves of other axes closed."""
    whole, dt, valves = fitted_plant(specimen, actuators), test.dt, []
    for axis, actuator in enumerate(actuators):
        plant = replace(whole.axis(axis), delay=actuator.dead_time)
        measured = test.plant(axis)
        wrong = plant.sampled_response(measured.frequencies_hz, dt) - measured.response
        size = np.abs(measured.response)
        deviation = np.hypot(measured.deviation, _FLOOR * size)
        error = float(np.linalg.norm(wrong / deviation) / np.linalg.norm(size / deviation))
        valves.append(ValveResponse(actuator, measured, error, plant))
    return valves


def fitted_plant(
    specimen: response_fits.SpecimenFit, actuators: Sequence[ActuatorFit], motion: bool = False
) -> Plant:
    """Give the plant of all axes, without dead time; to the forces or to the motion, too."""
    names = ("oil_stiffness", "leakage", "flow_gain", "valve_frequency", "valve_damping")
    known = {name: np.array([getattr(fit, name) for fit in actuators]) for name in names}
    known["viscous_friction"] = np.array([fit.drag for fit in actuators])
    moved = Specimen(specimen.mass, specimen.damping, specimen.stiffness)
    model = small_signal(moved, dead_time=0.0, **known)
    return Plant.of_model("identified", model, motion)


def _loops(test: MeasuredTest, servo: bool) -> list[ClosedLoop]:
    """Measure the closed loop, or the displacement servo, of every axis, and fit it."""
    # a force's dead time has the loop's latency in it
    floor, least, good = _FLOOR, test.dt, response_fits.GOOD
    if servo:
        floor, least, good = _SERVO_FLOOR, 0.0, _SERVO_FLOOR
    loops = []
    for axis in range(len(test.axes)):
        measured = test.servo(axis) if servo else test.tracking(axis)
        f, response = measured.frequencies_hz, measured.response
        # a pole beyond the coherent frequencies would be arbitrary
        known = slice(0, int(np.flatnonzero(measured.coherence >= _COHERENT)[-1]) + 1)
        weight = 1.0 / np.hypot(measured.deviation, floor)[known]
        fit = response_fits.fit_tracking(f[known], response[known], weight, least, good)
        loops.append(ClosedLoop(measured, response_fits.tracking_measures(f, response), fit))
    return loops


_ACTUATOR = {  # parameter -> its key in the result
    "flow_gain": "flow_gain_m_per_s_per_v",
    "oil_stiffness": "oil_stiffness_n_per_m",
    "leakage": "leakage_per_s",
    "force_capacity": "force_capacity_n",
    "valve_frequency": "valve_frequency_hz",
    "valve_damping": "valve_damping",
    "dead_time": "dead_time_s",
    "friction": "friction_n",
    "friction_velocity": "friction_velocity_m_per_s",
}
_MATRICES = ("mass", "damping", "stiffness")
_LONGEST_DELAY = 1.0  # s, as in the parameter table


def facts_of(
    identified: Identified, specimen: bool, dt: float, sensor_lag: float, obeys_force: bool
) -> Section:
    """Give what was identified, with a period of ``dt`` s, as facts.

    The actuators are those of all axes; a force capacity that was not identified on every axis is
    left out, so that the configured one counts. The closed loop, which has one set of parameters,
    is that of the first axis. The specimen's matrices are included if ``specimen`` is true. Dead
    times have the ``sensor_lag`` (s) of the tests in them, and the closed loop of a rig that obeys
    forces, too; it is taken off, because the loop adds it.
    """
    closed_lag, found = sensor_lag if obeys_force else 0.0, dict[str, Any]()
    if specimen:
        for name in _MATRICES:
            found[f"specimen.{name}"] = getattr(identified.specimen, name).ravel().tolist()
    if identified.has_servos:
        found |= _servo_facts([loop.fit.model for loop in identified.closed_loops], sensor_lag)
    elif identified.closed_loops:
        closed = identified.closed_loops[0]
        if closed.tracking.delay_s is not None:
            delay = closed.tracking.delay_s - OF_THE_LOOP * dt - closed_lag
            found["actuator.delay"] = float(min(max(delay, 0.0), _LONGEST_DELAY))
        model = closed.fit.model
        found["actuator.response.numerator"] = list(model.numerator)
        found["actuator.response.denominator"] = list(model.denominator)
        dead_time = max(float(model.dead_time) - closed_lag, 0.0)
        found["actuator.response.dead_time"] = dead_time
    if identified.valves:
        for name in _ACTUATOR:
            values = [float(getattr(valve.actuator, name)) for valve in identified.valves]
            if name == "dead_time":
                values = [max(value - sensor_lag, 0.0) for value in values]
            if name != "force_capacity" or all(values):
                found[f"actuator.{name}"] = values
    return found


def _servo_facts(models: Sequence[TransferFunction], sensor_lag: float) -> Section:
    """Give the responses of servos, one polynomial after the other, with equal lengths."""
    found: Section = {}
    for name in ("numerator", "denominator"):
        parts = [getattr(model, name) for model in models]
        longest = max(map(len, parts))
        padded = [[0.0] * (longest - len(part)) + list(part) for part in parts]
        found[f"actuator.response.{name}"] = [value for part in padded for value in part]
    late = [max(model.dead_time - sensor_lag, 0.0) for model in models]
    return found | {"actuator.response.dead_time": late}


def write_model(identified: Identified, path: Path, source: str, known: Section) -> None:
    """Write facts to a file, to be read after the experiment's own, by every command and node.

    ``source`` goes into a comment. An InputError says if the file can't be written.
    """
    comments = [f"Identified by seft identify from {source}", f"Axes: {identified.axes}"]
    if identified.valves:
        comments.append("actuator: of the actuators, for any specimen")
    if identified.has_servos:
        comments.append("actuator.response: of the displacement servos, with this specimen")
    elif identified.closed_loops:
        of = f"with this specimen, of axis {identified.axes[0]}"
        comments.append(f"actuator.delay and .response: {of}")
    write_parameter_file(path, {EVERY_NODE: known}, comments, replace=True)


def _number(label: str, key: str, unit: str, at: str = "", scale: float = 1.0) -> Number:
    return Number(label, key, unit, scale, ".3g", "none", at)


_TABLE = (  # of an axis, by section
    (
        Number("actuator: flow gain", "actuator.flow_gain_m_per_s_per_v", "mm/s/V", 1e3),
        Number("  oil stiffness", "actuator.oil_stiffness_n_per_m", "kN/m", 1e-3),
        Number("  leakage", "actuator.leakage_per_s", "1/s"),
        Number("  friction", "actuator.friction_n", "N"),
        Number("  force capacity", "actuator.force_capacity_n", "kN", 1e-3),
        Number("  valve", "actuator.valve_frequency_hz", "Hz"),
        Number("    damping", "actuator.valve_damping", "%", 100.0),
        Number("  dead time", "actuator.dead_time_s", "ms", 1e3),
        Number("  flow explained", "actuator.flow_explained", "% of its variance", 100.0),
        Number("    that is", "actuator.verdict"),
    ),
    (
        Number("zero (specimen)", "plant_zero_hz", "Hz"),
        Number("  damping", "plant_zero_damping", "%", 100.0),
        Number("oil column", "plant_pole_hz", "Hz"),
        Number("  damping", "plant_pole_damping", "%", 100.0),
        Number("model's error", "fit_error", "%", 100.0),
    ),
    (
        _number("flat within 1 dB to", "closed_loop_flat_to_hz", "Hz"),
        _number("bandwidth (-3 dB)", "bandwidth_hz", "Hz"),
        _number("delay", "delay_s", "ms", scale=1e3),
        _number("dip within 25 Hz", "dip_db", "dB", "dip_hz"),
    ),
    (
        Number("specimen's mass", "specimen.mass", "kg"),
        Number("specimen's damping", "specimen.damping", "N s/m"),
        Number("specimen's stiffness", "specimen.stiffness", "N/m"),
    ),
    (
        Number("coherence, open loop", "coherence.open_loop.mean", "mean"),
        Number("coherence, closed loop", "coherence.closed_loop.mean", "mean"),
    ),
)


def identified_table(summary: Mapping[str, Any]) -> TextTable:
    """Tabulate the result of `summarise_identified`, one column for each axis."""
    matrices = {name: np.atleast_2d(summary["specimen"][name]) for name in _MATRICES}
    by_axis = [
        {**axis, "specimen": {name: matrix[index, index] for name, matrix in matrices.items()}}
        for index, axis in enumerate(summary["axes"])
    ]
    rows: list[list[str] | None] = []
    for section in _TABLE:
        known = [n for n in section if any(look_up(axis, n.key) is not None for axis in by_axis)]
        rows += [*rows_of(known, *by_axis), None]
    return TextTable(["", *(axis["axis"] for axis in by_axis)], rows)


def summarise_identified(identified: Identified) -> dict[str, Any]:
    """Summarise what was identified: ``seft identify --json``.

    Returns
    -------
    dict
        Of the first axis ``actuator``, the plant that it makes with the specimen, the measured
        closed loop, and ``coherence`` of both tests; ``axes`` has these for each axis.
        ``specimen`` has mass, damping and stiffness (numbers, of several axes matrices), natural
        frequencies and dampings; ``notes`` says what could not be identified. What was not
        measured is null.
    """
    by_axis = [
        {"axis": axis, **_of_axis(identified, index)} for index, axis in enumerate(identified.axes)
    ]
    specimen, roots = identified.specimen, identified.specimen.roots()
    matrices = {name: getattr(specimen, name).squeeze().tolist() for name in _MATRICES}
    summary: dict[str, Any] = {
        **by_axis[0],
        "specimen": {
            **matrices,
            "frequencies_hz": [root.hz for root in roots],
            "dampings": [root.damping for root in roots],
            "fit_error": specimen.error,
        },
        "axes": by_axis,
        "notes": notes(identified),
    }
    return {key: json_safe(value) for key, value in summary.items()}


def notes(identified: Identified) -> list[str]:
    """List what a reader must know about the numbers, one line each."""
    found = [*identified.unusable, *identified.faults]
    if identified.valves:
        others = "actuator.delay and actuator.response.* hold for this specimen"
        found.append(f"actuator.* describes the actuators and holds for any specimen ({others})")
    elif not identified.has_servos:
        found.append("no good test of a valve, so actuators are not known")
    for axis, valve in zip(identified.axes, identified.valves, strict=False):
        actuator = valve.actuator
        if actuator.unsure:
            found.append(f"axis {axis}: the test shows poorly: {', '.join(actuator.unsure)}")
        if not actuator.force_capacity:
            small = f"forces to {actuator.largest_force:.3g} N are too small"
            stays = "which stays as configured (0: no effect); raise --amplitude for it"
            found.append(f"axis {axis}: {small} to show the force capacity, {stays}")
    if not identified.closed_loops:
        lacks = "actuator.response.*, which other methods need, is not known"
        found.append(f"no good closed-loop test: {lacks}")
    return found


def _of_axis(identified: Identified, index: int) -> dict[str, Any]:
    valve = identified.valves[index] if identified.valves else None
    closed = identified.closed_loops[index] if identified.closed_loops else None
    return {
        "actuator": valve and _of_actuator(valve.actuator),
        **_of_plant(valve.plant if valve else None),
        "fit_error": valve and valve.error,
        **asdict(closed.tracking if closed else response_fits.Tracking()),
        "tracking_fit_error": closed and closed.fit.error,
        "coherence": {
            "open_loop": valve and _coherence(valve.measured),
            "closed_loop": closed and _coherence(closed.measured),
        },
    }


def _of_plant(plant: Plant | None) -> dict[str, float | None]:
    """Zero (of the specimen) and pole (the oil column); None where there is none."""
    zero, pole = (plant.antiresonance(), plant.oil_column()) if plant else (None, None)
    return {
        f"plant_{name}_{key}": getattr(root, key) if root else None
        for name, root in (("zero", zero), ("pole", pole))
        for key in ("hz", "damping")
    }


def _of_actuator(actuator: ActuatorFit) -> dict[str, Any]:
    return {
        **{key: getattr(actuator, name) for name, key in _ACTUATOR.items()},
        "force_capacity_n": actuator.force_capacity or None,
        "flow_explained": actuator.explained,
        "verdict": actuator.verdict,
        "largest_force_n": actuator.largest_force,
    }


def _coherence(measured: Measurement) -> dict[str, float]:
    lowest = int(measured.coherence.argmin())
    return {
        "mean": float(measured.coherence.mean()),
        "lowest": float(measured.coherence[lowest]),
        "lowest_hz": float(measured.frequencies_hz[lowest]),
    }
