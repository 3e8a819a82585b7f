"""The step from which on a recorded reference force was brought down at the supervisor's word."""

import numpy as np
from seft_msgs_py.wire.topics import REFERENCE_FORCE, RIG_STATE

from seft_ros.interlock.protected_force import ProtectedForce
from seft_ros.replay.motion import Motion
from seft_ros.replay.recorded import Recorded


def ramp_step(recorded: Recorded) -> tuple[int | None, bool]:
    """Find the first step whose force was scaled down.

    No message says it: the supervisor's word came between two steps. Where the recorded forces
    are those of the block with the recorded parameters, the first that is not, but is the block's
    in the ramp, tells it exactly; else the times at which messages were recorded do, within some
    steps.

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
    first = _first_other(recorded)
    return first if first is not None and _first_other(recorded, first) is None else None


def _first_other(recorded: Recorded, ramp: int | None = None) -> int | None:
    """First step, up to that of the ramp, whose message is not the block's."""
    experiment = recorded.record.experiment
    section = experiment["reference_force"]
    block = ProtectedForce.from_parameters(section, experiment.axes, experiment.timebase)
    motion, states = Motion(recorded.chunks, len(experiment.axes)), recorded.series(RIG_STATE)
    for step, state in zip(states.steps.tolist(), states.values, strict=True):
        known, told = motion.window(step, 1 + block.preview), recorded.points.get(step)
        if known is None or told is None:
            return None
        if step == ramp:
            block.ramp_down()
        points = block.step(known, state)[: len(told)]
        if points.tobytes() != told.tobytes():
            return int(step)
        if block.ramping:
            return None  # by itself, before anybody said so
    return None


def _from_times(recorded: Recorded, ramped_ns: int) -> int | None:
    forces = recorded.series(REFERENCE_FORCE)
    if forces.received_ns is None:
        return None
    (after,) = np.nonzero(forces.received_ns > ramped_ns)
    return int(forces.steps[after[0]]) if len(after) else None
