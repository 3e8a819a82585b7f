"""What the force controllers that follow a target share: points, estimates, and the stop."""

from collections.abc import Callable
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import InputError
from seft_plant_sim.compiled import entry_point
from seft_plant_sim.rig_parameters import common_lag

from seft_ros.force_controller.force_control import LinearControl
from seft_ros.protection.protection_step import stop_steps
from seft_ros.reference_force.compensator import NotLinearError
from seft_ros.reference_force.reference_force_parameters import HORIZON_PER_LAG, horizon_steps


def horizon_of(section: dict[str, Any], dt: float, needed: int, driven: str) -> int:
    """Count the future steps; an InputError says how many what is driven needs, if too few."""
    horizon = horizon_steps(section, dt)
    if horizon < needed:
        needs = needed * dt - HORIZON_PER_LAG * common_lag(section)
        raise InputError(
            f"reference_force: compensation.horizon is {section['compensation.horizon']:g} s, "
            f"but the {driven} need {needs:.3g} s of the future motion; make it longer"
        )
    return horizon


class TargetFollower:
    """Force controller of n axes that follows a target by its future motion.

    A subclass has ``method``, its name, and ``names``, those of its errors.

    Parameters
    ----------
    parameters, state : NamedTuple
        The state has ``errors`` of shape (n, number of errors).
    functions : tuple of callable
        Compiled: begin(state), step(parameters, state, points, measured, command), and
        stop(parameters, state, plan, slowed, commands).
    horizon, needed : int
        Future steps that are known, and those that a step needs.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    limited, shape
        See `ForceControl`.
    parameters, state
        As given; arguments of the step, here and in a compiled loop.
    """

    method: str
    names: tuple[str, ...]

    def __init__(
        self,
        parameters: Any,
        state: Any,
        functions: tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any]],
        horizon: int,
        needed: int,
        dt: float,
    ) -> None:
        self.parameters, self.state = parameters, state
        n, steps, (begin, step, stop) = len(state.errors), stop_steps(1 + horizon, dt), functions
        self.shape = 1 + horizon, 3
        self._points, self._measured = np.zeros((1 + horizon, 3, n)), np.zeros((4, n))
        self._command, both = np.zeros(n), (parameters, state)
        self._room = np.zeros((steps + needed + 2, 3, n)), np.zeros((steps, n))
        self._used_up = type(state)(*(np.zeros_like(each) for each in state))
        self._begin = entry_point(begin, state)
        self._step = entry_point(step, *both, self._points, self._measured, self._command)
        self._stop = entry_point(stop, *both, self._points, *self._room)
        self.reset()

    def reset(self) -> None:
        """Begin a new test."""
        self.limited = False
        self._begin(self.state)

    def estimates(self) -> dict[str, Floats]:
        """Give the errors that are followed, by name."""
        return dict(zip(self.names, self.state.errors.T, strict=True))

    def linear(self) -> LinearControl:
        """Raise an error: there is none."""
        raise NotLinearError("force_controller", self.method)

    def step(self, points: Floats, state: Floats) -> Floats:
        """Find the commands that answer a sample; shape (n,)."""
        known = points[: len(self._points)]
        self._points[: len(known)], self._points[len(known) :] = known, known[-1]
        self._measured[:] = state
        self.limited = self._step(
            self.parameters, self.state, self._points, self._measured, self._command
        )
        return self._command.copy()

    def stop(self, plan: Floats) -> Floats:
        """Give the commands that bring the rig to rest, from the next step on; shape (N, n).

        ``plan`` has the target's points of the last step and the coming ones, shape `shape` and n.
        """
        for used, own in zip(self._used_up, self.state, strict=True):
            used[...] = own
        self._stop(self.parameters, self._used_up, plan, *self._room)
        return self._room[-1].copy()
