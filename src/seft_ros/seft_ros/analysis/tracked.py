"""Reference force, measured force and velocity of a test, at the same steps."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from seft_msgs_py.topics import REFERENCE_FORCE, RIG_STATE

from seft_ros.analysis.common_steps import common_steps
from seft_ros.recording.record import Record, Series

Floats = npt.NDArray[np.float64]
Steps = npt.NDArray[np.int64]

VELOCITY, FORCE = (RIG_STATE.quantities.index(name) for name in ("velocities", "effort"))


@dataclass(frozen=True)
class Tracked:
    """Signals at every step from the first to the last that both topics have.

    Attributes
    ----------
    steps : ndarray of int64
        Shape (N,), consecutive.
    command, force, velocity : ndarray
        Reference force and measured force (N), velocity (m/s), shape (N, n); lost samples are
        interpolated.
    """

    steps: Steps
    command: Floats
    force: Floats
    velocity: Floats


def tracked_of(record: Record) -> Tracked:
    """Pair what a record commanded and measured.

    The rig measures at step k what commands before it did, so even an ideal actuator is one
    period late.
    """
    commands, states = record.series[REFERENCE_FORCE.name], record.series[RIG_STATE.name]
    steps, _, _ = common_steps(commands.steps, states.steps)
    every = np.arange(steps[0], steps[-1] + 1) if len(steps) else steps
    return Tracked(
        every,
        _filled(commands, 0, every),
        _filled(states, FORCE, every),
        _filled(states, VELOCITY, every),
    )


def _filled(series: Series, row: int, every: Steps) -> Floats:
    """Values of a quantity at every one of these steps, shape (N, n)."""
    values = series.values[:, row]
    if len(every) == 0 or np.array_equal(series.steps, every):
        return values[: len(every)]
    columns = [np.interp(every, series.steps, column) for column in values.T]
    return np.stack(columns, axis=1)
