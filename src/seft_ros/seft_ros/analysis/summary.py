"""What a test was worth, as a dict of JSON values: the ``--json`` of run, simulate, report."""

import math
from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import GROUND_MOTION, LOOP_TOPICS, RIG_STATE
from seft_plant_sim.lti import split_dead_time
from seft_plant_sim.reference.whole_structure import (
    ReferenceResponse,
    reference_response,
    tested_specimen,
)
from seft_plant_sim.specimen.energy_balance import EnergyBalance, energy_balance

from seft_ros.analysis.equivalent_motion import MotionDifference, motion_difference
from seft_ros.analysis.fault_detection import shares_of
from seft_ros.analysis.metrics import Agreement, agreement, peak
from seft_ros.analysis.timing import link_numbers, timing_of
from seft_ros.analysis.tracking import tracking_error_of, tracking_of
from seft_ros.bags.record import Estimates, Record

Floats = npt.NDArray[np.float64]

COMPARED = {
    "displacement": RIG_STATE.quantities.index("positions"),
    "acceleration": RIG_STATE.quantities.index("accelerations"),
    "force": RIG_STATE.quantities.index("effort"),
}
"""Quantity, by its name in a summary and in `ReferenceResponse` -> its row in rig/state."""
ENERGIES = ("input", "kinetic", "strain", "damped", "hysteretic")
"""Parts of an energy balance."""


def summarise(
    record: Record,
    reference: ReferenceResponse | None = None,
    balance: EnergyBalance | None = None,
    difference: MotionDifference | None = None,
) -> dict[str, Any]:
    """Summarise a test.

    What `reference_of`, `balance_of` and `motion_difference` give is computed if not given.

    Returns
    -------
    dict
        ``steps`` (from 0 to the last that was recorded), ``first_step`` (the first that was),
        ``rate_hz``, ``duration_s``, ``wall_s``, ``realtime_factor``, ``complete``, ``stable`` (no
        trip, and all samples finite), ``trip`` (reason, step, time_s), ``missed`` (steps without a
        command in time), ``overruns`` (times the rig's own clock was held up), ``timing`` (see
        `timing_of`), ``saturated`` (what was at the end of its range: stroke, force_capacity,
        valve, a sensor's range; with samples and first_step), ``link`` (see `link_numbers`),
        ``lost`` (samples that the record lacks, by topic), ``energy`` (see `energy_numbers`),
        ``estimates`` (what the compensation identified on line: name -> axis -> first, last, least
        and largest, SI units), ``equivalent_motion`` (see `MotionDifference.numbers`),
        ``tracking_error`` (see `tracking_error`), ``detectors`` (of faults, see `shares_of`),
        ``reference_specimen`` (of the exact response: ``simulated``, or the ``model``, which is no
        truth to judge a test by), ``tracking`` (see
        `tracking_of`), and for displacement (m), acceleration (m/s^2) and force (N) what
        `Agreement` has, over all axes; ``axes`` has the same three for each axis. What is unknown,
        makes no sense or does not exist is null.
    """
    if reference is None:
        reference = reference_of(record)
    steps, recorded = _steps(record), record.series[RIG_STATE.name].steps
    duration = steps * record.experiment.timebase.dt
    timing = timing_of(record)
    axes = record.experiment.axes
    by_axis = {
        axis: _responses(record, reference, slice(column, column + 1))
        for column, axis in enumerate(axes)
    }
    difference = difference or motion_difference(record)
    simulated = "specimen.mass" in record.experiment.sections.get("rig", {})
    summary = {
        **_outcome(record),
        "first_step": int(recorded[0]) if len(recorded) else None,
        "rate_hz": record.experiment.timebase.rate,
        "duration_s": duration,
        "wall_s": record.wall_s,
        "realtime_factor": duration / record.wall_s if record.wall_s else None,
        "complete": record.complete,
        "missed": record.missed,
        "overruns": record.overruns,
        "timing": timing and timing.numbers,
        "link": link_numbers(record),
        "lost": {topic.name: _lost(record, topic.name, steps) for topic in LOOP_TOPICS},
        "energy": energy_numbers(balance or balance_of(record)),
        "estimates": _estimates(record.estimates, axes),
        "equivalent_motion": difference and difference.numbers(),
        "tracking_error": tracking_error_of(record),
        "detectors": shares_of(record),
        "reference_specimen": ("simulated" if simulated else "model") if reference else None,
        "tracking": tracking_of(record, reference),
        **(by_axis[axes[0]] if len(axes) == 1 else _responses(record, reference, slice(None))),
        "axes": by_axis,
    }
    return {key: json_safe(value) for key, value in summary.items()}


def summarise_briefly(record: Record, reference: ReferenceResponse) -> dict[str, Any]:
    """Of what `summarise` gives: steps, stable, trip, saturated, displacement, acceleration, force.

    For many tests of which no more is wanted: the rest takes most of the time.
    """
    summary = {**_outcome(record), **_responses(record, reference, slice(None))}
    return {key: json_safe(value) for key, value in summary.items()}


def json_safe(value: Any) -> Any:
    """Replace what JSON has no number for by None, in dicts and lists too."""
    if isinstance(value, dict):
        return {key: json_safe(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_safe(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def reference_of(record: Record) -> ReferenceResponse | None:
    """Exact response of the whole structure at every step from 0 to the record's last.

    Returns
    -------
    ReferenceResponse or None
        Arrays of shape (N, n); None if the record holds no rig state, not the ground motion
        of all N steps, or nothing of the reference-force node's parameters.

    Raises
    ------
    InputError
        If parameters are missing that describe the structure, or make none.
    """
    motion, count = record.series[GROUND_MOTION.name], _steps(record)
    whole = count > 0 and np.array_equal(motion.steps[:count], np.arange(count))
    if not whole or "reference_force" not in record.experiment.sections:
        return None
    try:
        return reference_response(record.experiment, motion.values[:count, 0, :])
    except KeyError as error:
        raise InputError(
            f"the structure is not known: its description lacks {error.args[0]}; was it "
            "recorded with another version?"
        ) from None


def balance_of(record: Record) -> EnergyBalance | None:
    """Energies of the specimen at each step, as measured, from step 0.

    None if the specimen is not known, or samples are missing or not finite.
    """
    states = record.series[RIG_STATE.name]
    count = len(states.steps)
    whole = count > 1 and np.array_equal(states.steps, np.arange(count))
    if not whole or not np.isfinite(states.values).all():
        return None
    try:
        specimen = tested_specimen(record.experiment)
    except KeyError:
        return None
    displacement, velocity, _, force = np.moveaxis(states.values, 1, 0)
    dt, held = record.experiment.timebase.dt, _held(record.experiment)
    with np.errstate(over="ignore", invalid="ignore"):  # of a test that went unstable
        return energy_balance(specimen, displacement, velocity, force, dt, held=held)


def _held(experiment: Experiment) -> float | None:
    """Part of a period after which an idealised actuator's force changes; None: it has none."""
    rig = experiment.sections.get("rig", {})
    if rig.get("actuator.kind") not in ("ideal", "delay") or rig.get("sensors.anti_alias"):
        return None
    delay = rig["actuator.delay"] if rig["actuator.kind"] == "delay" else 0.0
    dt = experiment.timebase.dt
    _, part = split_dead_time(delay, dt)
    return part / dt if part else 1.0


def energy_numbers(balance: EnergyBalance | None) -> dict[str, float] | None:
    """Give the `ENERGIES` of the specimen at the end of a test, J, as ``input_j`` and so on.

    ``closure`` is the largest of the balance's error over the test, over the largest input.
    """
    if balance is None:
        return None
    energies = {f"{name}_j": float(getattr(balance, name)[-1]) for name in ENERGIES}
    with np.errstate(over="ignore", invalid="ignore"):
        return {**energies, "closure": float(np.abs(balance.error).max())}


def _outcome(record: Record) -> dict[str, Any]:
    """How far a test came, and how it ended."""
    trip, counts = record.trip, record.saturation
    finite = all(np.isfinite(series.values).all() for series in record.series.values())
    return {
        "steps": _steps(record),
        "stable": trip is None and finite,
        "trip": trip and {"reason": trip.reason, "step": trip.step, "time_s": trip.time_s},
        "saturated": {
            name: {"samples": samples, "first_step": counts.first_step[name]}
            for name, samples in sorted(counts.samples.items())
        },
    }


def _responses(
    record: Record, reference: ReferenceResponse | None, columns: slice
) -> dict[str, dict[str, Any]]:
    """Measures of displacement, acceleration and force on some axes."""
    states, dt = record.series[RIG_STATE.name], record.experiment.timebase.dt
    found = {}
    for name, row in COMPARED.items():
        y: Floats = states.values[:, row, columns]
        if reference is None:
            found[name] = asdict(Agreement(peak=peak(y)))
        else:
            exact = getattr(reference, name)[:, columns]
            found[name] = asdict(agreement(y, exact, dt, states.steps))
    return found


def _estimates(
    estimates: Estimates | None, axes: tuple[str, ...]
) -> dict[str, dict[str, dict[str, float]]]:
    """How each estimate went on each axis; empty if nothing was identified."""
    if estimates is None:
        return {}
    return {
        name: {
            axis: {
                "first": float(values[0]),
                "last": float(values[-1]),
                "least": float(np.min(values)),
                "largest": float(np.max(values)),
            }
            for axis, values in zip(axes, estimates.values[:, row].T, strict=True)
        }
        for row, name in enumerate(estimates.names)
    }


def _steps(record: Record) -> int:
    steps = record.series[RIG_STATE.name].steps
    return int(steps[-1]) + 1 if len(steps) else 0


def _lost(record: Record, topic: str, steps: int) -> int:
    series = record.series[topic]
    return steps - int(np.searchsorted(series.steps, steps))
