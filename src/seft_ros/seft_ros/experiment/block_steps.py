"""The steps of the blocks that a compiled loop can call, each found by its parameters' type."""

from typing import Any

import numpy as np
import numpy.typing as npt
from numba.extending import overload
from seft_plant_sim.compiled import OPTIONS
from seft_plant_sim.rig import Rig

from seft_ros.experiment.blocks import Blocks
from seft_ros.force_controller.block import ForceController
from seft_ros.force_controller.interlock import Interlock
from seft_ros.force_controller.transfer_step import TransferParameters, transfer_step
from seft_ros.force_controller.velocity_feedforward import (
    FeedforwardParameters,
    VelocityFeedforward,
    feedforward_step,
)
from seft_ros.reference_force.linear_filter import LinearCompensator, LinearParameters, linear_step
from seft_ros.target.target_motion import TargetMotion
from seft_ros.target.target_step import TargetParameters, target_estimates, target_step

Floats = npt.NDArray[np.float64]

FORCE_STEPS = {LinearParameters: linear_step, TargetParameters: target_step}
CONTROL_STEPS = {TransferParameters: transfer_step, FeedforwardParameters: feedforward_step}
"""Steps of the blocks that can be compiled, by their parameters."""
_OPTIONS: dict[str, Any] = {"jit_options": OPTIONS}


def obstacle(blocks: Blocks) -> str:
    """Say why a test can't run in the compiled loop; empty if it can."""
    method = blocks.reference_force.reference_force.compensator
    if not isinstance(blocks.rig, Rig) or not isinstance(blocks.force_controller, Interlock):
        return "several rigs"
    if type(method) not in (LinearCompensator, TargetMotion):
        return "the compensation changes while the test runs"
    if isinstance(method, TargetMotion) and method.command is not None:
        return "the target's force is sent ahead"
    if "step" in vars(method):
        return "the compensation has a step of its own"
    controller = type(blocks.force_controller.controller)
    if controller not in (ForceController, VelocityFeedforward):
        return "a force controller of another package"
    if controller is VelocityFeedforward and type(method) is not TargetMotion:
        return "velocity_feedforward without target_motion"
    return ""


def respond(
    parameters: Any, state: Any, ground: Floats, measured: Floats, pace: float, points: Floats
) -> None:
    """Step of a compensation method, see `FORCE_STEPS`."""
    raise NotImplementedError


def answer(parameters: Any, state: Any, points: Floats, measured: Floats, command: Floats) -> bool:
    """Step of a force controller, see `CONTROL_STEPS`."""
    raise NotImplementedError


def estimate(parameters: Any, state: Any, result: Floats) -> None:
    """Sample the estimates of a compensation method, shape (k, n)."""
    raise NotImplementedError


@overload(respond, **_OPTIONS)
def _respond(parameters, state, ground, measured, pace, points):  # type: ignore[no-untyped-def]
    step: Any = FORCE_STEPS[parameters.instance_class]
    return lambda parameters, state, ground, measured, pace, points: step(
        parameters, state, ground, measured, pace, points
    )


@overload(answer, **_OPTIONS)
def _answer(parameters, state, points, measured, command):  # type: ignore[no-untyped-def]
    step: Any = CONTROL_STEPS[parameters.instance_class]
    return lambda parameters, state, points, measured, command: step(
        parameters, state, points, measured, command
    )


@overload(estimate, **_OPTIONS)
def _estimate(parameters, state, result):  # type: ignore[no-untyped-def]
    if parameters.instance_class is TargetParameters:
        return lambda parameters, state, result: target_estimates(parameters, state, result)
    return lambda parameters, state, result: None
