"""The step from which on a recorded reference force was brought down at the supervisor's word."""

import numpy as np
from seft_msgs_py.topics import REFERENCE_FORCE, RIG_STATE

from seft_ros.interlock.protected_force import ProtectedForce
from seft_ros.interlock.ramp_down import ramp_factor
from seft_ros.replay.motion import Motion
from seft_ros.replay.recorded import Recorded


def ramp_step(recorded: Recorded) -> tuple[int | None, bool]:
    """Find the first step whose force was scaled down.

    No message says it: the supervisor's word came between two steps. Where the recorded forces
    are those of the block with the recorded parameters, the first that is not, but is the block's
    times the ramp's first factor, tells it exactly; else the times at which messages were
    recorded do, within some steps.

    Returns
    -------
    step : int or None
        None where the supervisor never said so.
    exact : bool
        Whether the forces themselves tell.
    """
    if recorded.ramped_ns is None:
        return None, True
    found = _from_forces(recorded)
    return (
        (found, True) if found is not None else (_from_times(recorded, recorded.ramped_ns), False)
    )


def _from_forces(recorded: Recorded) -> int | None:
    experiment = recorded.record.experiment
    section = experiment["reference_force"]
    block = ProtectedForce.from_parameters(section, experiment.axes, experiment.timebase)
    factor = ramp_factor(1, block.ramp.steps)
    motion, ahead = Motion(recorded.chunks, len(experiment.axes)), max(section["loop_delay"], 0)
    states, forces = recorded.series(RIG_STATE), recorded.series(REFERENCE_FORCE)
    values = dict(zip(forces.steps.tolist(), forces.values[:, 0], strict=True))
    for step, state in zip(states.steps.tolist(), states.values, strict=True):
        known = motion.window(step, 1 + block.preview)
        if known is None or step + ahead not in values:
            return None
        force = block.step(known, state)
        if block.ramping:
            return None  # by itself, before anybody said so
        told = values[step + ahead]
        if force.tobytes() != told.tobytes():
            scaled = np.array(block.plausible.last) * factor
            return int(step) if scaled.tobytes() == told.tobytes() else None
    return None


def _from_times(recorded: Recorded, ramped_ns: int) -> int | None:
    forces = recorded.series(REFERENCE_FORCE)
    if forces.received_ns is None:
        return None
    (after,) = np.nonzero(forces.received_ns > ramped_ns)
    return int(forces.steps[after[0]]) if len(after) else None
