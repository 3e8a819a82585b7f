"""The numbers of a test as a dict of JSON values, but for those that only a verdict needs."""

from dataclasses import asdict, replace
from typing import Any

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS, FORCE_DRIVEN
from seft_msgs_py.config.parameter_table import group
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire import topics
from seft_msgs_py.wire.outcome import RIG, ZEROED
from seft_plant_sim import whole_structure
from seft_plant_sim.calibration import biases_of_all, check_biases
from seft_plant_sim.channels import ACCELERATION, DISPLACEMENT, FORCE
from seft_plant_sim.computed.computed_model import ModelError
from seft_plant_sim.judge.detector_list import DETECTORS, TRACKING
from seft_plant_sim.judge.detector_step import begin_detectors, detect_all
from seft_plant_sim.judge.detectors import detectors_of
from seft_plant_sim.judge.guard import DRIVE_ROW
from seft_plant_sim.lti import split_dead_time
from seft_plant_sim.simulated.specimen import EnergyBalance, energy_balance
from seft_plant_sim.whole_structure import ReferenceResponse

from seft_ros.analysis import equivalent_motion
from seft_ros.analysis.calibration_check import calibration_check
from seft_ros.analysis.metrics import Agreement, agreement, common_steps, peak
from seft_ros.analysis.timing import link_numbers, timing_of
from seft_ros.bags.recording import Estimates, Recording, every_step
from seft_ros.drawing.style import json_safe
from seft_ros.force_controller.target_distance import begin_tracking, track_all, tracking_detector
from seft_ros.ground_motion.ground_motion_block import MOTION
from seft_ros.ground_motion.response_spectrum import significant_parts

COMPARED = {"displacement": DISPLACEMENT, "acceleration": ACCELERATION, "force": FORCE}
"""Quantity, by its name in a summary and in `ReferenceResponse` -> its row in rig/state."""
BEFORE, AFTER = 1.0, 2.0  # s that are drawn beside the strong part
ENERGIES = ("input", "kinetic", "strain", "damped", "hysteretic")
"""Parts of an energy balance."""


def summarise(
    recording: Recording,
    reference: ReferenceResponse | None = None,
    balance: EnergyBalance | None = None,
    difference: equivalent_motion.MotionDifference | None = None,
) -> dict[str, Any]:
    """Summarise a test.

    What `reference_of` gives of the recording, and `balance_of` and `motion_difference` of its
    `assessed_part`, is computed if not given.

    Returns
    -------
    dict
        ``steps`` (from 0 to the last recorded), ``judged_steps`` (of which errors and energies are,
        see `assessed_part`), ``first_step`` (the first recorded), ``rate_hz``, ``duration_s``,
        ``wall_s``, ``realtime_factor``, ``complete``, ``damage`` (what is wrong with its bag, and
        missing), ``checked`` (changed samples would have been noticed), ``stable`` (no trip, and
        all samples finite), ``trip`` (reason, step, time_s), ``stopped`` (by the operator, which is
        no trip), ``missed`` (steps that missed the command deadline), ``overruns`` (of the rig's
        sampling), ``timing`` (see `timing_of`),
        ``simulated`` (largest true motion of a simulated rig, see `Simulated`),
        ``saturated`` (stroke, force_capacity, valve, a sensor's range -> samples and first_step),
        ``link`` (see `link_numbers`), ``lost`` (samples missing from the recording, by topic),
        ``ground_motion`` (see `seft_ros.ground_motion.ground_motion_block.motion_facts`),
        ``energy`` (see `energy_numbers`), ``estimates`` (identified on line by the compensation:
        name -> axis -> first, last, least and largest, SI units), ``equivalent_motion`` (see
        `MotionDifference.numbers`), ``calibration`` (of mass and channels, see
        `calibration_check`), ``tracking_error`` (see `tracking_error`), ``detectors`` (of
        faults, see `detector_shares`), ``replaced`` (values of each channel that were wrong, and
        were replaced), ``reference_specimen`` (of the reference response: ``simulated``,
        or the ``model``, by which no test can be assessed), ``tracking`` (see `tracking_of`), and
        for displacement (m), acceleration (m/s^2) and force (N) the fields of `Agreement`, over all
        axes; ``axes`` has the same three for each axis.
        Null: unknown, undefined or not there.
    """
    if reference is None:
        reference = reference_of(recording)
    steps, recorded, series = _steps(recording), recording.states.steps, recording.series
    assessed, reference = assessed_part(recording, reference)
    duration = steps * recording.experiment.timebase.dt
    timing = timing_of(recording)
    axes = recording.experiment.axes
    by_axis = {
        axis: _responses(assessed, reference, slice(column, column + 1))
        for column, axis in enumerate(axes)
    }
    difference = difference or equivalent_motion.motion_difference(assessed)
    simulated = whole_structure.is_simulated(recording.experiment)
    found = {
        **_outcome(recording),
        "judged_steps": _steps(assessed),
        "first_step": int(recorded[0]) if len(recorded) else None,
        "rate_hz": recording.experiment.timebase.rate,
        "duration_s": duration,
        "wall_s": recording.wall_s,
        "realtime_factor": duration / recording.wall_s if recording.wall_s else None,
        "complete": recording.complete,
        "damage": recording.damage,
        "checked": recording.checked,
        "missed": recording.missed,
        "overruns": recording.overruns,
        "timing": timing and timing.numbers,
        "link": link_numbers(recording),
        "lost": {
            topic.name: steps - int(np.searchsorted(series[topic.name].steps, steps))
            for topic in topics.LOOP_TOPICS
            if topic is not topics.MEASURED
            or (topics.MEASURED.name in series and len(series[topics.MEASURED.name].steps))
        },
        "ground_motion": recording.facts.get(topics.GROUND_MOTION.name, {}).get(MOTION),
        "zeroed": zeroed_in(recording),
        "energy": energy_numbers(balance or balance_of(assessed)),
        "estimates": _estimates(assessed.estimates, axes),
        "equivalent_motion": difference and difference.numbers(),
        "calibration": calibration_check(assessed),
        "tracking_error": equivalent_motion.tracking_error_of(assessed),
        "detectors": detector_shares(assessed),
        "replaced": replaced_in(recording),
        "reference_specimen": ("simulated" if simulated else "model") if reference else None,
        "tracking": equivalent_motion.tracking_of(assessed),
        **(by_axis[axes[0]] if len(axes) == 1 else _responses(assessed, reference, slice(None))),
        "axes": by_axis,
    }
    return json_safe(found)


def zeroed_in(recording: Recording) -> dict[str, Any] | None:
    """Give what the rigs measured at rest: None if nothing, or nothing that can be read.

    ``subtracted`` and ``left`` as of `seft_plant_sim.calibration.zeroed_at_rest`, over the test's
    axes; ``warning`` as of `check_biases`.
    """
    experiment, axes = recording.experiment, len(recording.experiment.axes)
    nodes = [(rig.places, rig.node(RIG)) for rig in experiment.rigs]
    if not any(node in recording.facts for _, node in nodes):  # an offline test has one for all
        nodes = [(tuple(range(axes)), RIG)]
    try:
        parts = [(places, recording.facts[node][ZEROED]) for places, node in nodes]
        whole = biases_of_all(axes, parts)
    except (KeyError, TypeError, ValueError, IndexError):
        return None
    sections = experiment.sections
    limits = group(sections.get("rig", sections.get("supervisor", {})), "limits")
    known = set(CHANNELS) <= set(limits)
    return whole | {"warning": check_biases(whole, limits).warning if known else ""}


def summarise_briefly(recording: Recording, reference: ReferenceResponse) -> dict[str, Any]:
    """Of what `summarise` gives: how a test ended, and displacement, acceleration and force.

    For many tests of which no more is wanted: the other numbers take most of the time.
    """
    assessed, known = assessed_part(recording, reference)
    return json_safe({**_outcome(recording), **_responses(assessed, known, slice(None))})


def assessed_part(
    recording: Recording, reference: ReferenceResponse | None = None
) -> tuple[Recording, ReferenceResponse | None]:
    """Cut a test that tripped or was stopped, and its reference response, where the ramp began.

    The ramp-down is no part of the planned test: no reference response holds for it.
    """
    last = recording.last_step
    if last is None or last + 1 >= _steps(recording):
        return recording, reference
    series = {name: one.until(last) for name, one in recording.series.items()}
    estimates = recording.estimates and recording.estimates.until(last)
    if estimates is not None and not len(estimates.steps):
        estimates = None
    if reference is not None:
        reference = reference.first(last + 1)
    return replace(recording, series=series, estimates=estimates), reference


def reference_of(recording: Recording) -> ReferenceResponse | None:
    """Exact response of the whole structure at every step from 0 to the recording's last.

    Returns
    -------
    ReferenceResponse or None
        Arrays of shape (N, n); None if the recording holds no rig state, not the ground motion
        of all N steps, or nothing of the reference-force node's parameters.

    Raises
    ------
    InputError
        If parameters are missing that describe the structure, or make none.
    """
    motion, count = recording.series[topics.GROUND_MOTION.name], _steps(recording)
    whole = count > 0 and np.array_equal(motion.steps[:count], np.arange(count))
    if not whole or "reference_force" not in recording.experiment.sections:
        return None
    try:
        return whole_structure.reference_response(recording.experiment, motion.values[:count, 0, :])
    except ModelError:
        if recording.trip is None:
            raise
        return None  # the test has failed of the same
    except KeyError as error:
        lacks = f"its description lacks {error.args[0]}; was it recorded with another version?"
        raise InputError(f"the structure is not known: {lacks}") from None


def balance_of(recording: Recording) -> EnergyBalance | None:
    """Energies of the specimen at each step, as measured, from step 0.

    None if the specimen is not known, or samples are missing or not finite.
    """
    states = recording.states
    count = len(states.steps)
    whole = count > 1 and np.array_equal(states.steps, np.arange(count))
    if not whole or not np.isfinite(states.values).all():
        return None
    try:
        specimen = whole_structure.tested_specimen(recording.experiment)
    except KeyError:
        return None
    displacement, velocity, _, force = np.moveaxis(states.values, 1, 0)
    dt, held = recording.experiment.timebase.dt, _held(recording.experiment)
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


def _outcome(recording: Recording) -> dict[str, Any]:
    """How far a test came, and how it ended."""
    trip = recording.trip
    finite = all(np.isfinite(series.values).all() for series in recording.series.values())
    return {
        "steps": _steps(recording),
        "stable": trip is None and finite,
        "trip": trip and {"reason": trip.reason, "step": trip.step, "time_s": trip.time_s},
        "stopped": recording.stopped,
        "saturated": dict(sorted(recording.saturation.items())),
        "simulated": recording.simulated and asdict(recording.simulated),
    }


def _responses(
    recording: Recording, reference: ReferenceResponse | None, columns: slice
) -> dict[str, dict[str, Any]]:
    """Measures of displacement, acceleration and force on some axes."""
    states, dt = recording.states, recording.experiment.timebase.dt
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


def replaced_in(recording: Recording) -> dict[str, int]:
    """Count the values that were wrong and replaced, by channel."""
    count = np.count_nonzero(recording.measured.values != recording.states.values, axis=(0, 2))
    return dict(zip(CHANNELS, count.tolist(), strict=True))


def strong_part(recording: Recording) -> tuple[float, float]:
    """Choose the times between which a test is drawn at first, s.

    From a second before 5 % of the ground motion's Arias intensity to two after 95 %, on any axis,
    and up to a trip or stop at least. All of the test where the ground motion is not known.
    """
    dt, motion = recording.experiment.timebase.dt, recording.series[topics.GROUND_MOTION.name]
    end = max(_steps(recording) - 1, 1) * dt
    if len(motion.steps) < 2 or motion.steps[0] != 0 or not np.any(motion.values):
        return 0.0, end
    every = np.arange(motion.steps[-1] + 1)
    starts, ends = zip(*significant_parts(every_step(motion, every)[:, 0], dt), strict=True)
    last = max(ends) + AFTER
    if recording.last_step is not None:
        last = max(last, recording.last_step * dt + AFTER)
    return max(min(starts) - BEFORE, 0.0), min(last, end)


def _steps(recording: Recording) -> int:
    steps = recording.states.steps
    return int(steps[-1]) + 1 if len(steps) else 0


def detector_shares(recording: Recording) -> dict[str, float] | None:
    """Give the largest value of each detector in a test on any axis, over its threshold, by name.

    None where it is not known: the configuration is not recorded, or no sample.
    """
    experiment, states = recording.experiment, recording.series[topics.RIG_STATE.name]
    rig, controller = (experiment.sections.get(n, {}) for n in ("rig", "force_controller"))
    if "specimen.mass" not in rig or not len(states.steps):
        return None
    axes, dt = experiment.axes, experiment.timebase.dt
    shares = np.zeros(len(DETECTORS))
    measured, drives = recording.measured.values, states.values[:, DRIVE_ROW]
    for one in experiment.rigs:
        parameters, state = detectors_of(rig, axes, dt, one.places)
        own = list(one.places)
        begin_detectors(parameters, state)
        shown, drive = (np.ascontiguousarray(each[..., own]) for each in (measured, drives))
        judged = np.empty_like(parameters.noise)
        detect_all(parameters, state, states.steps, shown, drive, judged)
        shares = np.maximum(shares, state.shares.max(axis=1))
    found = {one.name: share for one, share in zip(DETECTORS, shares.tolist(), strict=True)}
    forces = recording.series[topics.REFERENCE_FORCE.name]
    if controller and forces.values.shape[1] == len(topics.TARGET.quantities):
        steps, at_states, at_forces = common_steps(states.steps, forces.steps)
        watched = tracking_detector(controller, axes, range(len(axes)), dt)
        begin_tracking(watched[1])
        targets = np.ascontiguousarray(forces.values[at_forces, 0])
        track_all(*watched, steps, targets, states.values[at_states])
        found[TRACKING.name] = float(watched[1].shares.max())
    return found
