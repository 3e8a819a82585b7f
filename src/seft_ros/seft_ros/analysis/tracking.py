"""How well the actuators followed in a test: the intended force, and a target's motion."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.wire.topics import GROUND_MOTION, REFERENCE_FORCE, RIG_STATE, TARGET
from seft_plant_sim.whole_structure import ReferenceResponse, whole_structure

from seft_ros.analysis.alignment import common_steps, every_step
from seft_ros.analysis.equivalent_motion import EquivalentMotion, assumed_structure
from seft_ros.analysis.metrics import nrmse, paired, peak
from seft_ros.analysis.tracking_metrics import (
    benchmark_criteria,
    energy_error,
    frequency_evaluation_index,
    relative_energy_error,
    relative_tracking_indicator,
)
from seft_ros.bags.record import Record

Floats = npt.NDArray[np.float64]
Steps = npt.NDArray[np.int64]

SENT_AS_MEANT = ("none", "restoring", "target_motion")
"""Compensation methods whose reference force is that of its own step; others send it ahead."""

_DISPLACEMENT, _VELOCITY, _FORCE = (
    RIG_STATE.quantities.index(name) for name in ("positions", "velocities", "effort")
)


@dataclass(frozen=True)
class Tracked:
    """Signals at every step from the first to the last that both topics have.

    Attributes
    ----------
    steps : ndarray of int64
        Shape (N,), consecutive.
    command, force, velocity : ndarray
        Intended and measured force (N), velocity (m/s), shape (N, n); lost samples are
        interpolated.
    derived : bool
        Whether the intended force is derived from measurements, and not the one sent.
    """

    steps: Steps
    command: Floats
    force: Floats
    velocity: Floats
    derived: bool


def tracked_of(record: Record) -> Tracked:
    """Pair the intended with the measured force.

    The intended force is the reference force of the same step; where the compensation method
    sends that ahead of time, it is f* = -M_e a_g + S r, from measurements (docs/theory.md, "The
    algebraic loop solved"). With the test's own ground motion a_eq this is
    f* = f + M_e (a_eq - a_g), whatever is computed.
    """
    commands, states, motion = (
        record.series[topic.name] for topic in (REFERENCE_FORCE, RIG_STATE, GROUND_MOTION)
    )
    steps, _, _ = common_steps(commands.steps, states.steps)
    every = np.arange(steps[0], steps[-1] + 1) if len(steps) else steps
    measured = every_step(states, every)
    force, velocity = measured[:, _FORCE], measured[:, _VELOCITY]
    section = record.experiment.sections.get("reference_force", {})
    assumed = assumed_structure(record.experiment)
    ahead = section.get("compensation.method", "none") not in SENT_AS_MEANT
    derived = ahead and len(motion.steps) > 0 and len(every) > 0
    if not derived or assumed is None:
        command = every_step(commands, every)[:, -1]  # the effort, with a target's motion or not
        return Tracked(every, command, force, velocity, derived=False)
    equivalent = EquivalentMotion(whole_structure(assumed), record.experiment.timebase.dt)
    with np.errstate(over="ignore", invalid="ignore"):  # of a test that went unstable
        difference = equivalent.advance(measured) - every_step(motion, every)[:, 0]
        command = force + difference @ equivalent.mass.T
    return Tracked(every, command, force, velocity, derived=True)


def tracking_of(record: Record, reference: ReferenceResponse | None) -> dict[str, dict[str, Any]]:
    """Measure the tracking of each axis.

    The intended force is that of `tracked_of`. Where it is the reference force of the same step,
    even an ideal actuator is one period late: the rig measures at step k what commands before it
    did. Samples between the first and the last step that both topics have count; lost ones are
    left out of errors, and interpolated for spectra, areas, integrals and J1.

    Returns
    -------
    dict
        Axis -> ``fei_amplitude``, ``fei_delay_s``, ``fei_frequency_hz``,
        ``tracking_indicator_end`` (over the square of the largest intended force),
        ``energy_error`` (over the largest input energy), ``energy_error_j`` (J), and ``J``: J1
        (ms), J2, J3 and the axis's displacement criteria (%), NaN without a reference response.
    """
    commands, states = record.series[REFERENCE_FORCE.name], record.series[RIG_STATE.name]
    dt = record.experiment.timebase.dt
    steps, _, _ = common_steps(commands.steps, states.steps)
    signals = tracked_of(record)
    counted = steps - steps[0] if len(steps) else steps
    command, force, velocity = signals.command, signals.force, signals.velocity
    displacement = states.values[:, _DISPLACEMENT]
    exact = np.full_like(displacement, np.nan)
    if reference is not None:
        exact = reference.displacement
        if len(states.steps) != len(exact):
            exact = exact[states.steps]
    criteria = benchmark_criteria(command[counted], force[counted], exact, displacement, dt, steps)
    fei = frequency_evaluation_index(command, force, dt)
    with np.errstate(invalid="ignore", over="ignore"):
        work = energy_error(force - command, velocity, dt)
    by_axis = {
        "fei_amplitude": fei.amplitude,
        "fei_delay_s": fei.delay_s,
        "fei_frequency_hz": fei.frequency_hz,
        "tracking_indicator_end": relative_tracking_indicator(command, force),
        "energy_error": relative_energy_error(command, force, velocity, dt),
        "energy_error_j": work[-1] if len(work) > 1 else np.full(work.shape[1:], np.nan),
    }
    return {
        axis: {name: float(values[column]) for name, values in by_axis.items()}
        | {"J": criteria[column]}
        for column, axis in enumerate(record.experiment.axes)
    }


def tracking_error_of(record: Record) -> dict[str, float] | None:
    """Tracking error of a test whose reference force has a target's motion before it, else None."""
    targets, states = record.series[REFERENCE_FORCE.name], record.series[RIG_STATE.name]
    if targets.values.shape[1] < len(TARGET.quantities):
        return None
    _, at_targets, at_states = common_steps(targets.steps, states.steps)
    return tracking_error(states.values[at_states, _DISPLACEMENT], targets.values[at_targets, 0])


def tracking_error(displacement: Floats, target: Floats) -> dict[str, float]:
    """Compare a displacement with its target, m.

    Returns
    -------
    dict
        ``rms`` and ``peak`` of x - x_target, m, over all axes, and ``nrmse``, that RMS over the
        RMS of x.
    """
    wanted, x = paired(target, displacement)
    with np.errstate(invalid="ignore", over="ignore"):
        error = wanted - x
        rms = float(np.sqrt(np.mean(np.square(error)))) if error.size else np.nan
    return {"rms": rms, "peak": peak(error), "nrmse": nrmse(wanted, x)}
