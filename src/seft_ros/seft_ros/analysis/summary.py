"""The numbers of a test as a dict of JSON values: the ``--json`` of run, simulate, report."""

from dataclasses import asdict, fields, replace
from typing import Any

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS, FORCE_DRIVEN
from seft_msgs_py.config.parameter_table import group
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.outcome import RIG, ZEROED
from seft_msgs_py.wire.topics import (
    GROUND_MOTION,
    JUDGED,
    LOOP_TOPICS,
    REFERENCE_FORCE,
    RIG_STATE,
)
from seft_plant_sim.calibration import zeros_of_all
from seft_plant_sim.computed_model import ModelError
from seft_plant_sim.lti import split_dead_time
from seft_plant_sim.specimen import EnergyBalance, energy_balance
from seft_plant_sim.whole_structure import (
    ReferenceResponse,
    is_simulated,
    reference_response,
    tested_specimen,
)

from seft_ros.analysis.calibration_check import calibration_check
from seft_ros.analysis.equivalent_motion import MotionDifference, motion_difference
from seft_ros.analysis.metrics import Agreement, agreement, common_steps, peak
from seft_ros.analysis.timing import link_numbers, timing_of
from seft_ros.analysis.tracking import tracking_error_of, tracking_of
from seft_ros.bags.record import Estimates, Record, every_step
from seft_ros.drawing.style import json_safe
from seft_ros.force_controller.detection import detector_shares
from seft_ros.ground_motion.ground_motion_block import MOTION
from seft_ros.ground_motion.response_spectrum import significant_parts
from seft_ros.protection.zeros import judge_zeros

COMPARED = {
    "displacement": RIG_STATE.quantities.index("positions"),
    "acceleration": RIG_STATE.quantities.index("accelerations"),
    "force": RIG_STATE.quantities.index("effort"),
}
"""Quantity, by its name in a summary and in `ReferenceResponse` -> its row in rig/state."""
BEFORE, AFTER = 1.0, 2.0  # s that are drawn beside the strong part
ENERGIES = ("input", "kinetic", "strain", "damped", "hysteretic")
"""Parts of an energy balance."""


def summarise(
    record: Record,
    reference: ReferenceResponse | None = None,
    balance: EnergyBalance | None = None,
    difference: MotionDifference | None = None,
) -> dict[str, Any]:
    """Summarise a test.

    What `reference_of` gives of the record, and `balance_of` and `motion_difference` of its
    `judged_part`, is computed if not given.

    Returns
    -------
    dict
        ``steps`` (from 0 to the last recorded), ``judged_steps`` (of which errors and energies are,
        see `judged_part`), ``first_step`` (the first recorded), ``rate_hz``, ``duration_s``,
        ``wall_s``, ``realtime_factor``, ``complete``, ``damage`` (what is wrong with its bag, and
        missing), ``checked`` (changed samples would have been noticed), ``stable`` (no trip, and
        all samples finite), ``trip`` (reason, step, time_s), ``missed`` (steps that missed the
        command deadline), ``overruns`` (of the rig's sampling), ``timing`` (see `timing_of`),
        ``simulated`` (largest true motion of a simulated rig, see `Simulated`),
        ``saturated`` (stroke, force_capacity, valve, a sensor's range -> samples and first_step),
        ``link`` (see `link_numbers`), ``lost`` (samples missing from the record, by topic),
        ``ground_motion`` (see `seft_ros.ground_motion.ground_motion_block.motion_facts`),
        ``energy`` (see `energy_numbers`), ``estimates`` (identified on line by the compensation:
        name -> axis -> first, last, least and largest, SI units), ``equivalent_motion`` (see
        `MotionDifference.numbers`), ``calibration`` (of mass and channels, see
        `CalibrationCheck.numbers`), ``tracking_error`` (see `tracking_error`), ``detectors`` (of
        faults, see `shares_of`), ``replaced`` (values of each channel that were wrong, and were
        replaced), ``reference_specimen`` (of the reference response: ``simulated``,
        or the ``model``, by which no test can be judged), ``tracking`` (see `tracking_of`), and for
        displacement (m), acceleration (m/s^2) and force (N) the fields of `Agreement`, over all
        axes; ``axes`` has the same three for each axis.
        Null: unknown, undefined or not there.
    """
    if reference is None:
        reference = reference_of(record)
    steps, recorded = _steps(record), record.states.steps
    judged, reference = judged_part(record, reference)
    duration = steps * record.experiment.timebase.dt
    timing = timing_of(record)
    axes = record.experiment.axes
    by_axis = {
        axis: _responses(judged, reference, slice(column, column + 1))
        for column, axis in enumerate(axes)
    }
    difference = difference or motion_difference(judged)
    check = calibration_check(judged)
    simulated = is_simulated(record.experiment)
    found = {
        **_outcome(record),
        "judged_steps": _steps(judged),
        "first_step": int(recorded[0]) if len(recorded) else None,
        "rate_hz": record.experiment.timebase.rate,
        "duration_s": duration,
        "wall_s": record.wall_s,
        "realtime_factor": duration / record.wall_s if record.wall_s else None,
        "complete": record.complete,
        "damage": record.damage,
        "checked": record.checked,
        "missed": record.missed,
        "overruns": record.overruns,
        "timing": timing and timing.numbers,
        "link": link_numbers(record),
        "lost": {
            topic.name: steps - int(np.searchsorted(record.series[topic.name].steps, steps))
            for topic in LOOP_TOPICS
            if topic is not JUDGED or _has_judged(record)
        },
        "ground_motion": record.facts.get(GROUND_MOTION.name, {}).get(MOTION),
        "zeroed": zeroed_in(record),
        "energy": energy_numbers(balance or balance_of(judged)),
        "estimates": _estimates(judged.estimates, axes),
        "equivalent_motion": difference and difference.numbers(),
        "calibration": check and check.numbers(),
        "tracking_error": tracking_error_of(judged),
        "detectors": shares_of(judged),
        "replaced": replaced_in(record),
        "reference_specimen": ("simulated" if simulated else "model") if reference else None,
        "tracking": tracking_of(judged),
        **(by_axis[axes[0]] if len(axes) == 1 else _responses(judged, reference, slice(None))),
        "axes": by_axis,
    }
    return json_safe(found)


def zeroed_in(record: Record) -> dict[str, Any] | None:
    """Give what the rigs measured at rest: None if nothing, or nothing that can be read.

    ``subtracted`` and ``left`` as of `seft_plant_sim.calibration.zeroed_at_rest`, over the test's
    axes; ``warning`` as of `judge_zeros`.
    """
    experiment, axes = record.experiment, len(record.experiment.axes)
    nodes = [(rig.places, rig.node(RIG)) for rig in experiment.rigs]
    if not any(node in record.facts for _, node in nodes):  # an offline test has one for all
        nodes = [(tuple(range(axes)), RIG)]
    try:
        parts = [(places, record.facts[node][ZEROED]) for places, node in nodes]
        whole = zeros_of_all(axes, parts)
    except (KeyError, TypeError, ValueError, IndexError):
        return None
    sections = experiment.sections
    limits = group(sections.get("rig", sections.get("supervisor", {})), "limits")
    known = set(CHANNELS) <= set(limits)
    return whole | {"warning": judge_zeros(whole, limits).warning if known else ""}


def summarise_briefly(record: Record, reference: ReferenceResponse) -> dict[str, Any]:
    """Of what `summarise` gives: steps, stable, trip, saturated, displacement, acceleration, force.

    For many tests of which no more is wanted: the rest takes most of the time.
    """
    judged, known = judged_part(record, reference)
    return json_safe({**_outcome(record), **_responses(judged, known, slice(None))})


def judged_part(
    record: Record, reference: ReferenceResponse | None = None
) -> tuple[Record, ReferenceResponse | None]:
    """Cut a tripped test, and its reference response, where the force began to come down.

    The ramp-down is no part of the planned test: no reference response holds for it.
    """
    if record.trip is None or record.trip.step + 1 >= _steps(record):
        return record, reference
    last = record.trip.step
    series = {name: one.until(last) for name, one in record.series.items()}
    estimates = record.estimates and record.estimates.until(last)
    if estimates is not None and not len(estimates.steps):
        estimates = None
    if reference is not None:
        parts = {part.name: getattr(reference, part.name)[: last + 1] for part in fields(reference)}
        reference = ReferenceResponse(**parts)
    return replace(record, series=series, estimates=estimates), reference


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
    except ModelError:
        if record.trip is None:
            raise
        return None  # the test has failed of the same
    except KeyError as error:
        raise InputError(
            f"the structure is not known: its description lacks {error.args[0]}; was it "
            "recorded with another version?"
        ) from None


def balance_of(record: Record) -> EnergyBalance | None:
    """Energies of the specimen at each step, as measured, from step 0.

    None if the specimen is not known, or samples are missing or not finite.
    """
    states = record.states
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
    kind, dt = rig.get("actuator.kind"), experiment.timebase.dt
    names = [f"simulated.sensors.{c}_{what}" for c in CHANNELS for what in ("lag", "filter")]
    if kind not in FORCE_DRIVEN or any(np.any(rig.get(name)) for name in names):
        return None
    delay = rig["simulated.actuator.delay"] if kind == "delay" else 0.0
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
    trip = record.trip
    finite = all(np.isfinite(series.values).all() for series in record.series.values())
    return {
        "steps": _steps(record),
        "stable": trip is None and finite,
        "trip": trip and {"reason": trip.reason, "step": trip.step, "time_s": trip.time_s},
        "saturated": dict(sorted(record.saturation.items())),
        "simulated": record.simulated and asdict(record.simulated),
    }


def _responses(
    record: Record, reference: ReferenceResponse | None, columns: slice
) -> dict[str, dict[str, Any]]:
    """Measures of displacement, acceleration and force on some axes."""
    states, dt = record.states, record.experiment.timebase.dt
    found = {}
    for name, row in COMPARED.items():
        y = states.values[:, row, columns]
        measures = Agreement(peak=peak(y))
        if reference is not None:
            measures = agreement(y, getattr(reference, name)[:, columns], dt, states.steps)
        found[name] = asdict(measures)
    return found


def _estimates(
    estimates: Estimates | None, axes: tuple[str, ...]
) -> dict[str, dict[str, dict[str, float]]]:
    """How each estimate changed on each axis; empty if nothing was identified."""
    if estimates is None:
        return {}
    y = estimates.values
    parts = {"first": y[0], "last": y[-1], "least": y.min(axis=0), "largest": y.max(axis=0)}
    return {
        name: {
            axis: {part: float(values[row, column]) for part, values in parts.items()}
            for column, axis in enumerate(axes)
        }
        for row, name in enumerate(estimates.names)
    }


def shares_of(record: Record) -> dict[str, float] | None:
    """Say how near each detector of faults came to its threshold, see `detector_shares`.

    None where it is not known: the configuration is not recorded, or no sample was answered.
    """
    section = record.experiment.sections.get("force_controller", {})
    states, forces = (record.series[topic.name] for topic in (RIG_STATE, REFERENCE_FORCE))
    steps, at_states, at_forces = common_steps(states.steps, forces.steps)
    if "specimen.mass" not in section or not len(steps):
        return None
    measured, forces_there = states.values[at_states], forces.values[at_forces]
    with np.errstate(over="ignore", invalid="ignore"):
        return detector_shares(record.experiment, steps, forces_there, measured)


def _has_judged(record: Record) -> bool:
    """Say whether judged samples were recorded: others record none."""
    return JUDGED.name in record.series and len(record.series[JUDGED.name].steps) > 0


def replaced_in(record: Record) -> dict[str, int]:
    """Count the values that were wrong and replaced, by channel."""
    measured, judged = record.series[RIG_STATE.name].values, record.states.values
    count = np.count_nonzero(measured[:, :4] != judged, axis=(0, 2))
    return dict(zip(CHANNELS, count.tolist(), strict=True))


def strong_part(record: Record) -> tuple[float, float]:
    """Choose the times between which a test is drawn at first, s.

    From a second before 5 % of the ground motion's Arias intensity to two after 95 %, on any axis,
    and up to a trip at least. All of the test where the ground motion is not known.
    """
    dt, motion = record.experiment.timebase.dt, record.series[GROUND_MOTION.name]
    end = max(_steps(record) - 1, 1) * dt
    if len(motion.steps) < 2 or motion.steps[0] != 0 or not np.any(motion.values):
        return 0.0, end
    every = np.arange(motion.steps[-1] + 1)
    starts, ends = zip(*significant_parts(every_step(motion, every)[:, 0], dt), strict=True)
    last = max(ends) + AFTER
    if record.trip is not None:
        last = max(last, record.trip.time_s + AFTER)
    return max(min(starts) - BEFORE, 0.0), min(last, end)


def _steps(record: Record) -> int:
    steps = record.states.steps
    return int(steps[-1]) + 1 if len(steps) else 0
