"""What the reference-force node gathers for a step: states of several rigs, and ground motion."""

import math
from collections.abc import Sequence

import numpy as np
from seft_msgs_py.config.parameter_table import Floats
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.topics import RigAxes


class StateGathering:
    """Keeps the states of several rigs until all have sent the same step.

    Parameters
    ----------
    rigs : sequence of RigAxes
        The rigs of the test, with n axes together.
    patience : float
        Time for which the state of a rig may lack when another's is there, s.
    """

    def __init__(self, rigs: Sequence[RigAxes], patience: float) -> None:
        self._rigs = tuple(rigs)
        self._places = [list(rig.places) for rig in rigs]
        self._axes = sum(len(rig.axes) for rig in rigs)
        self._patience = patience
        self.reset()

    def reset(self) -> None:
        """Begin a new test."""
        self._newest = [-1] * len(self._rigs)
        self._parts: dict[int, dict[int, Floats]] = {}
        self._since = math.inf  # when the first state came that waits for another

    def take(self, rig: int, step: int, state: Floats, now: float) -> Floats | None:
        """Take the state of a rig.

        Parameters
        ----------
        rig : int
            Its number.
        step : int
            Step of the sample.
        state : ndarray
            Of its axes, shape (4, its number of axes).
        now : float
            The time, s, monotonic.

        Returns
        -------
        ndarray or None
            State of all axes at that step, shape (4, n), once all rigs have sent theirs; steps
            before it are given up then.

        Raises
        ------
        WireError
            If the rig has sent a state of this step before.
        """
        parts = self._parts.setdefault(step, {})
        if rig in parts:
            raise WireError(f"state of step {step} of {self._rigs[rig].name} a second time")
        parts[rig] = state
        self._newest[rig] = max(self._newest[rig], step)
        if len(parts) < len(self._rigs):
            self._since = min(self._since, now)
            return None
        self._since = math.inf
        for passed in [other for other in self._parts if other <= step]:
            del self._parts[passed]
        whole = np.empty((len(state), self._axes))
        for number, part in parts.items():
            whole[:, self._places[number]] = part
        return whole

    @property
    def is_waiting(self) -> bool:
        """Whether the state of a rig is there and that of another is not."""
        return self._since < math.inf

    def lost(self, now: float) -> str:
        """Name the rig whose states are late at a time in s, monotonic; empty if none is."""
        if now - self._since <= self._patience:
            return ""
        first, last = max(self._newest), min(self._newest)
        name, ahead = (self._rigs[self._newest.index(step)].name for step in (last, first))
        known = f"the last is of step {last}" if last >= 0 else "none has come"
        return (
            f"no rig/state of {name} for {self._patience:g} s ({known}; {ahead} is at step {first})"
        )


class MotionBuffer:
    """Ground accelerations of n axes by step, from the first that is still wanted on.

    Parameters
    ----------
    axes : int
        n.
    """

    def __init__(self, axes: int) -> None:
        self._values = np.empty((0, axes))
        self._first = 0

    def add(self, first: int, values: Floats) -> bool:
        """Append a piece of the motion; a piece that begins at step 0 begins a new motion.

        Parameters
        ----------
        first : int
            Step of its first sample.
        values : ndarray
            Shape (p, n), m/s^2.

        Returns
        -------
        bool
            False where steps before it are missing; then it is left out.
        """
        if first == 0 or not len(self._values):
            self._first, self._values = first, values.copy()
            return True
        known = self._first + len(self._values) - first
        if known < 0:
            return False
        self._values = np.concatenate([self._values, values[known:]])
        return True

    def window(self, step: int, count: int) -> Floats | None:
        """Accelerations of ``count`` steps from ``step`` on, shape (count, n), if all are there."""
        start = step - self._first
        if start < 0 or start + count > len(self._values):
            return None
        return self._values[start : start + count]

    def drop_before(self, step: int) -> None:
        """Forget the steps before one."""
        passed = min(max(step - self._first, 0), len(self._values))
        self._values = self._values[passed:]
        self._first += passed
