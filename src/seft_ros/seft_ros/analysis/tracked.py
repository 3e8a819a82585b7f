"""The force that was meant, measured force and velocity of a test, at the same steps."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from seft_msgs_py.wire.topics import GROUND_MOTION, REFERENCE_FORCE, RIG_STATE
from seft_plant_sim.reference.whole_structure import whole_structure

from seft_ros.analysis.common_steps import common_steps
from seft_ros.analysis.equivalent_motion import EquivalentMotion, told_structure
from seft_ros.recording.record import Record, Series

Floats = npt.NDArray[np.float64]
Steps = npt.NDArray[np.int64]

VELOCITY, FORCE = (RIG_STATE.quantities.index(name) for name in ("velocities", "effort"))
SENT_AS_MEANT = ("none", "restoring", "target_motion")
"""Compensation methods whose reference force is that of its own step; others send it ahead."""


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
    return Tracked(every, command, measured[:, FORCE], measured[:, VELOCITY], derived)


def _derived(record: Record, measured: Floats, every: Steps) -> Floats | None:
    """Force that was meant by a method that sends it ahead, shape (N, n)."""
    section = record.experiment.sections.get("reference_force", {})
    motion, told = record.series[GROUND_MOTION.name], told_structure(record.experiment)
    ahead = section.get("compensation.method", "none") not in SENT_AS_MEANT
    if not (ahead and len(motion.steps) and len(every)) or told is None:
        return None
    equivalent = EquivalentMotion(whole_structure(told), record.experiment.timebase.dt)
    with np.errstate(over="ignore", invalid="ignore"):  # of a test that went unstable
        difference = equivalent.advance(measured) - every_step(motion, every)[:, 0]
        command: Floats = measured[:, FORCE] + difference @ equivalent.mass.T
    return command


def every_step(series: Series, every: Steps) -> Floats:
    """Values at every one of these consecutive steps, shape (N, q, n); lost ones interpolated."""
    if len(every) == 0 or np.array_equal(series.steps[: len(every)], every):
        return series.values[: len(every)]
    flat = series.values.reshape(len(series.steps), -1)
    columns = [np.interp(every, series.steps, column) for column in flat.T]
    return np.stack(columns, axis=1).reshape(len(every), *series.values.shape[1:])
