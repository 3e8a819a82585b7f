"""The four blocks of a test, made of one experiment."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import VALVE_COMMAND
from seft_plant_sim.rig import Rig, Rigs

from seft_ros.force_controller.interlock import Interlock, Interlocks, interlock_of
from seft_ros.force_controller.parameters import TRANSFER_FUNCTION, VELOCITY_FEEDFORWARD
from seft_ros.ground_motion.ground_motion_block import GroundMotion
from seft_ros.protection.protected_force import ProtectedForce
from seft_ros.reference_force.force_command import FORCE_DRIVEN
from seft_ros.reference_force.reference_force_parameters import TARGET_MOTION

_REMEMBERED = 64
"""Blocks of each kind that are kept for later experiments: more than a tournament has methods."""


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
        The last blocks of earlier experiments, except rigs: those with the same parameters are used
        again, new ones are added.

    Raises
    ------
    InputError
        If a parameter makes no sense together with the others, or the record can't be read.
    """
    axes, timebase, known = experiment.axes, experiment.timebase, {} if known is None else known

    def shared(node: str, make: Callable[..., Any], *arguments: Any) -> Any:
        section, made = experiment[node], known.setdefault(node, [])
        for parameters, block in made:  # few: to write a key out takes as long as hundreds of them
            if parameters == section:
                return block
        made.append((dict(section), make(*arguments)))
        del made[:-_REMEMBERED]
        return made[-1][1]

    motion, force = experiment["ground_motion"], experiment["reference_force"]
    blocks = Blocks(
        shared("ground_motion", GroundMotion.from_parameters, motion, axes, timebase),
        shared("reference_force", ProtectedForce.from_parameters, force, axes, timebase),
        shared("force_controller", interlock_of, experiment),
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
    """Check that the controller follows a target's motion if, and only if, there is one.

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
    """Check that the ground motion is known as far ahead as the compensation needs it.

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


def with_method(experiment: Experiment, method: str) -> Experiment:
    """Copy an experiment with another compensation method, and a force controller that fits it.

    `target_motion` drives valves by velocity feedforward, which needs the target's motion. Other
    methods do not give it: they use the configured controller, or else the transfer function.
    """
    control = experiment["force_controller"]
    used = control["method"]
    if method == TARGET_MOTION and experiment["rig"]["actuator.kind"] not in FORCE_DRIVEN:
        used = VELOCITY_FEEDFORWARD
    elif used == VELOCITY_FEEDFORWARD:
        used = TRANSFER_FUNCTION
    force = experiment["reference_force"] | {"compensation.method": method}
    return Experiment(
        experiment.sections
        | {"reference_force": force, "force_controller": control | {"method": used}}
    )
