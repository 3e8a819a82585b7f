"""How well the actuators followed in a test: the force that was meant, and a target's motion."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.wire.topics import GROUND_MOTION, REFERENCE_FORCE, RIG_STATE
from seft_plant_sim.reference.whole_structure import ReferenceResponse, whole_structure

from seft_ros.analysis.alignment import common_steps, every_step
from seft_ros.analysis.equivalent_motion import EquivalentMotion, assumed_structure
from seft_ros.analysis.metrics import nrmse, paired_columns, peak
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
_TARGET = ("positions", "velocities", "effort")  # of a reference force with a target


@dataclass(frozen=True)
class Tracked:
    """Signals at every step from the first to the last that both topics have.

    Attributes
    ----------
    steps : ndarray of int64
        Shape (N,), consecutive.
    command, force, velocity : ndarray
        Force that was meant and measured force (N), velocity (m/s), shape (N, n); lost samples
        are interpolated.
    derived : bool
        Whether the force that was meant is derived from what was measured, and not the one sent.
    """

    steps: Steps
    command: Floats
    force: Floats
    velocity: Floats
    derived: bool


def tracked_of(record: Record) -> Tracked:
    """Pair what a record meant and measured.

    The force that was meant is the reference force of the same step; where the compensation
    method sends that ahead of time, it is f* = -M_e a_g + S r, from what was measured
    (docs/theory.md, "The algebraic loop solved"). With the test's own ground motion a_eq this is
    f* = f + M_e (a_eq - a_g), whatever is computed.
    """
    commands, states = record.series[REFERENCE_FORCE.name], record.series[RIG_STATE.name]
    steps, _, _ = common_steps(commands.steps, states.steps)
    every = np.arange(steps[0], steps[-1] + 1) if len(steps) else steps
    measured = every_step(states, every)
    command = _derived(record, measured, every)
    derived = command is not None
    if command is None:
        command = every_step(commands, every)[:, -1]  # the effort, with a target's motion or not
    return Tracked(every, command, measured[:, _FORCE], measured[:, _VELOCITY], derived)


def _derived(record: Record, measured: Floats, every: Steps) -> Floats | None:
    """Force that was meant by a method that sends it ahead, shape (N, n)."""
    section = record.experiment.sections.get("reference_force", {})
    motion, assumed = record.series[GROUND_MOTION.name], assumed_structure(record.experiment)
    ahead = section.get("compensation.method", "none") not in SENT_AS_MEANT
    if not (ahead and len(motion.steps) and len(every)) or assumed is None:
        return None
    equivalent = EquivalentMotion(whole_structure(assumed), record.experiment.timebase.dt)
    with np.errstate(over="ignore", invalid="ignore"):  # of a test that went unstable
        difference = equivalent.advance(measured) - every_step(motion, every)[:, 0]
        command: Floats = measured[:, _FORCE] + difference @ equivalent.mass.T
    return command


def tracking_of(record: Record, reference: ReferenceResponse | None) -> dict[str, dict[str, Any]]:
    """Tracking of each axis; formulas and signs are in docs/metrics.md.

    The force that was meant is that of `tracked_of`. Where it is the reference force of the same
    step, even an ideal actuator is one period late: the rig measures at step k what commands
    before it did. Samples between the first and the last step that both topics have count; of the
    lost ones errors are left out, and what needs every sample (spectra, areas, integrals, J1)
    interpolates them.

    Without an exact response J4 to J9 are NaN.

    Returns
    -------
    dict
        Axis -> ``fei_amplitude``, ``fei_delay_s``, ``fei_frequency_hz``,
        ``tracking_indicator_end`` (over the square of the largest force that was meant),
        ``energy_error`` (over the largest input energy), ``energy_error_j`` (J), and ``J``: J1
        (ms), J2, J3 and the axis's displacement criteria (%).
    """
    commands, states = record.series[REFERENCE_FORCE.name], record.series[RIG_STATE.name]
    dt = record.experiment.timebase.dt
    steps, _, _ = common_steps(commands.steps, states.steps)
    signals = tracked_of(record)
    counted = steps - steps[0] if len(steps) else steps
    command, force, velocity = signals.command, signals.force, signals.velocity
    displacement = states.values[:, _DISPLACEMENT]
    if reference is None:
        exact = np.full_like(displacement, np.nan)
    else:
        exact = reference.displacement
        if len(states.steps) != len(exact):
            exact = exact[states.steps]
    criteria = benchmark_criteria(command[counted], force[counted], exact, displacement, dt, steps)
    fei = frequency_evaluation_index(command, force, dt)
    indicator = relative_tracking_indicator(command, force)
    with np.errstate(invalid="ignore", over="ignore"):
        work = energy_error(force - command, velocity, dt)
        end_j = work[-1] if len(work) > 1 else np.full(work.shape[1:], np.nan)
        del work
    relative = relative_energy_error(command, force, velocity, dt)
    return {
        axis: {
            "fei_amplitude": float(fei.amplitude[column]),
            "fei_delay_s": float(fei.delay_s[column]),
            "fei_frequency_hz": float(fei.frequency_hz[column]),
            "tracking_indicator_end": float(indicator[column]),
            "energy_error": float(relative[column]),
            "energy_error_j": float(end_j[column]),
            "J": criteria[column],
        }
        for column, axis in enumerate(record.experiment.axes)
    }


def tracking_error_of(record: Record) -> dict[str, float] | None:
    """Tracking error of a test whose reference force carries a target's motion, else None.

    Such a topic has three quantities: the target's displacement, velocity and force.
    """
    targets, states = record.series[REFERENCE_FORCE.name], record.series[RIG_STATE.name]
    if targets.values.shape[1] < len(_TARGET):
        return None
    _, at_targets, at_states = common_steps(targets.steps, states.steps)
    return tracking_error(states.values[at_states, _DISPLACEMENT], targets.values[at_targets, 0])


def tracking_error(displacement: Floats, target: Floats) -> dict[str, float]:
    """Tell how far a specimen was from its target, both of shape (N, n), m, else a ValueError.

    Returns
    -------
    dict
        ``rms`` and ``peak`` of x - x_target, m, over all axes, and ``nrmse``, that RMS over the
        RMS of x.
    """
    wanted, x = paired_columns(target, displacement)
    with np.errstate(invalid="ignore", over="ignore"):
        error = wanted - x
        rms = float(np.sqrt(np.mean(np.square(error)))) if error.size else np.nan
    return {"rms": rms, "peak": peak(error), "nrmse": nrmse(wanted, x)}
