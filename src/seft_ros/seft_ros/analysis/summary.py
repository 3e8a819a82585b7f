"""What a test was worth, as a dict of JSON values: the ``--json`` of run, simulate, report."""

import math
from typing import Any

import numpy as np
from seft_msgs_py.wire.topics import LOOP_TOPICS, RIG_STATE
from seft_plant_sim.reference.whole_structure import ReferenceResponse
from seft_plant_sim.specimen.energy_balance import EnergyBalance

from seft_ros.analysis.energy import balance_of, energy_numbers
from seft_ros.analysis.estimates import summarise_estimates
from seft_ros.analysis.link import link_numbers
from seft_ros.analysis.metrics import Floats, agreement, peak
from seft_ros.analysis.motion_difference import MotionDifference, motion_difference
from seft_ros.analysis.reference import COMPARED, quantity, reference_of, reference_specimen
from seft_ros.analysis.timing import timing_of
from seft_ros.analysis.tracking import tracking_error_of, tracking_of
from seft_ros.recording.record import Record

__all__ = ["json_safe", "reference_of", "summarise", "summarise_briefly"]

_MEASURES = ("nrmse", "nrmse_aligned", "peak", "reference_peak", "delay_s")


def summarise(
    record: Record,
    reference: ReferenceResponse | None = None,
    balance: EnergyBalance | None = None,
    difference: MotionDifference | None = None,
) -> dict[str, Any]:
    """Summarise a test.

    Parameters
    ----------
    record : Record
        The test.
    reference : ReferenceResponse, optional
        As `reference_of` gives it; computed if not given.
    balance : EnergyBalance, optional
        As `balance_of` gives it; likewise.
    difference : MotionDifference, optional
        As `motion_difference` gives it; likewise.

    Returns
    -------
    dict
        ``steps`` (from 0 to the last that was recorded), ``first_step`` (the first that was; null
        if none), ``rate_hz``, ``duration_s``,
        ``wall_s``, ``realtime_factor``, ``complete``, ``stable`` (no trip, and all samples
        finite), ``trip`` (null or reason, step, time_s), ``missed`` (steps without a command
        in time), ``overruns`` (times the rig's own clock was held up), ``timing`` (round trips,
        gaps and the machine's own stalls, see `timing_of`; null offline), ``saturated`` (what
        was at the end of its range: stroke, force_capacity, valve, a sensor's range; with samples
        and first_step), ``link`` (how the reference force came over the link of a test on
        several hosts; null without one; see `link_numbers`), ``lost`` (samples that the record
        lacks, by topic), ``energy`` (of the
        specimen at the end, and how the balance closes; see `energy_numbers`), ``estimates`` (what
        the compensation identified on line: name -> axis -> first, last, least and largest, SI
        units), ``equivalent_motion`` (the ground motion that was tested against the one asked for,
        see `MotionDifference.numbers`), ``tracking_error`` (of displacement against a target: rms,
        peak, nrmse; null without one), ``reference_specimen`` (of the exact response:
        ``simulated``, or the ``model``; null if there is none), ``tracking`` (of the force that was
        meant by the measured force: axis -> frequency
        evaluation index, tracking indicator, energy error, J1-J9; see `tracking_of`), and for
        displacement (m), acceleration (m/s^2) and force (N) nrmse, nrmse_aligned, peak,
        reference_peak and delay_s over all axes; ``axes`` has the same
        three for each axis. What is unknown or makes no sense is null.
    """
    if reference is None:
        reference = reference_of(record)
    steps, recorded = _steps(record), record.series[RIG_STATE.name].steps
    duration = steps * record.experiment.timebase.dt
    timing = timing_of(record)
    axes = record.experiment.axes
    by_axis = {
        axis: _three(record, reference, slice(column, column + 1))
        for column, axis in enumerate(axes)
    }
    difference = difference or motion_difference(record)
    summary = {
        **_course(record),
        "first_step": int(recorded[0]) if len(recorded) else None,
        "rate_hz": record.experiment.timebase.rate,
        "duration_s": duration,
        "wall_s": record.wall_s,
        "realtime_factor": duration / record.wall_s if record.wall_s else None,
        "complete": record.complete,
        "missed": record.missed,
        "overruns": record.overruns,
        "timing": timing and timing.numbers(),
        "link": link_numbers(record),
        "lost": {topic.name: _lost(record, topic.name, steps) for topic in LOOP_TOPICS},
        "energy": energy_numbers(balance or balance_of(record)),
        "estimates": summarise_estimates(record.estimates, axes),
        "equivalent_motion": difference and difference.numbers(),
        "tracking_error": tracking_error_of(record),
        "reference_specimen": reference_specimen(record) if reference else None,
        "tracking": tracking_of(record, reference),
        **(by_axis[axes[0]] if len(axes) == 1 else _three(record, reference, slice(None))),
        "axes": by_axis,
    }
    return {key: json_safe(value) for key, value in summary.items()}


def summarise_briefly(record: Record, reference: ReferenceResponse) -> dict[str, Any]:
    """Of what `summarise` gives: steps, stable, trip, saturated, displacement, acceleration, force.

    For many tests of which no more is wanted: the rest takes most of the time.
    """
    summary = {**_course(record), **_three(record, reference, slice(None))}
    return {key: json_safe(value) for key, value in summary.items()}


def _course(record: Record) -> dict[str, Any]:
    """How far a test came, and how it ended."""
    trip = record.trip
    finite = all(np.isfinite(series.values).all() for series in record.series.values())
    return {
        "steps": _steps(record),
        "stable": trip is None and finite,
        "trip": trip and {"reason": trip.reason, "step": trip.step, "time_s": trip.time_s},
        "saturated": _saturated(record),
    }


def _steps(record: Record) -> int:
    steps = record.series[RIG_STATE.name].steps
    return int(steps[-1]) + 1 if len(steps) else 0


def json_safe(value: Any) -> Any:
    """Replace what JSON has no number for by None, in dicts and lists too."""
    if isinstance(value, dict):
        return {key: json_safe(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_safe(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def _three(
    record: Record, reference: ReferenceResponse | None, columns: slice
) -> dict[str, dict[str, Any]]:
    """Measures of displacement, acceleration and force on some axes."""
    states = record.series[RIG_STATE.name]
    dt = record.experiment.timebase.dt
    found: dict[str, dict[str, Any]] = {}
    for name, row in COMPARED:
        y: Floats = states.values[:, row, columns]
        if reference is None:
            found[name] = {**dict.fromkeys(_MEASURES), "peak": peak(y)}
        else:
            exact = quantity(reference, name)[:, columns]
            measured = agreement(y, exact, dt, states.steps)
            found[name] = {measure: getattr(measured, measure) for measure in _MEASURES}
    return found


def _saturated(record: Record) -> dict[str, dict[str, int]]:
    counts = record.saturation
    return {
        name: {"samples": samples, "first_step": counts.first_step[name]}
        for name, samples in sorted(counts.samples.items())
    }


def _lost(record: Record, topic: str, steps: int) -> int:
    series = record.series[topic]
    return steps - int(np.searchsorted(series.steps, steps))
