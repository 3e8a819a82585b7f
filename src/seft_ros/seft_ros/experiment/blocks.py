"""The four blocks of a test, made of one experiment."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import VALVE_COMMAND
from seft_plant_sim.rig import Rig, Rigs

from seft_ros.force_controller.interlock import Interlock
from seft_ros.force_controller.interlocks import Interlocks, interlock_of
from seft_ros.force_controller.names import TRANSFER_FUNCTION, VELOCITY_FEEDFORWARD
from seft_ros.ground_motion.block import GroundMotion
from seft_ros.interlock.protected_force import ProtectedForce
from seft_ros.reference_force.reference_force_parameters import TARGET_MOTION


@dataclass(frozen=True)
class Blocks:
    """Ground motion, reference force, force controller and rig of a test."""

    ground_motion: GroundMotion
    reference_force: ProtectedForce
    force_controller: Interlock | Interlocks
    rig: Rig | Rigs


def build_blocks(experiment: Experiment, known: dict[str, Any] | None = None) -> Blocks:
    """Make the blocks of an experiment.

    Parameters
    ----------
    experiment : Experiment
        Its resolved configuration.
    known : dict, optional
        Blocks of earlier experiments, but their rigs: those with the same parameters are used
        again, new ones are added.

    Raises
    ------
    InputError
        If a parameter makes no sense together with the others, or the record can't be read.
    """
    axes, timebase, known = experiment.axes, experiment.timebase, {} if known is None else known
    common = repr((axes, timebase, experiment.rigs))

    def shared[Block](node: str, make: Callable[[], Block]) -> Block:
        key = repr((node, common, sorted(experiment[node].items())))
        if key not in known:
            known[key] = make()
        found: Block = known[key]
        return found

    def motion() -> GroundMotion:
        return GroundMotion.from_parameters(experiment["ground_motion"], axes, timebase)

    def force() -> ProtectedForce:
        return ProtectedForce.from_parameters(experiment["reference_force"], axes, timebase)

    blocks = Blocks(
        shared("ground_motion", motion),
        shared("reference_force", force),
        shared("force_controller", lambda: interlock_of(experiment)),
        _rigs(experiment),
    )
    check_lead(experiment, blocks.ground_motion, blocks.reference_force)
    check_target(experiment, blocks)
    return blocks


def _rigs(experiment: Experiment) -> Rig | Rigs:
    section, axes, timebase = experiment["rig"], experiment.axes, experiment.timebase
    if len(experiment.rigs) == 1:
        return Rig.from_parameters(section, axes, timebase)
    return Rigs.from_parameters(section, axes, timebase, experiment.rigs)


def check_target(experiment: Experiment, blocks: Blocks) -> None:
    """See that the motion of a target is followed where it is given, and given where it is.

    Raises
    ------
    InputError
        If it is not.
    """
    method = experiment["force_controller"]["method"]
    compensation = experiment["reference_force"]["compensation.method"]
    has_target = blocks.reference_force.reference_force.tells_motion
    if method == VELOCITY_FEEDFORWARD and not has_target:
        raise InputError(
            f"force_controller: method {method} follows the motion of a target, but "
            f"reference_force: compensation.method is {compensation}; make that {TARGET_MOTION}"
        )
    if method == TRANSFER_FUNCTION and has_target and blocks.rig.drive == VALVE_COMMAND.name:
        raise InputError(
            f"reference_force: compensation.method {compensation} gives the motion of a target, "
            f"which force_controller: method {method} does not follow; make that "
            f"{VELOCITY_FEEDFORWARD}"
        )


def check_lead(experiment: Experiment, motion: GroundMotion, force: ProtectedForce) -> None:
    """See that the ground motion is known as far ahead as the compensation looks.

    Raises
    ------
    InputError
        If it is not.
    """
    preview = force.preview
    if preview > len(motion.known) - motion.steps:
        raise InputError(
            f"ground_motion: lead is {experiment['ground_motion']['lead']:g} s, but the "
            f"compensation looks {preview * experiment.timebase.dt:g} s ahead; make "
            "the lead longer"
        )
