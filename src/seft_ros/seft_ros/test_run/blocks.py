"""The four blocks of a test, made of its experiment, and whether they fit each other."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import FORCE_DRIVEN
from seft_msgs_py.config.parameter_table import group
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import VALVE_COMMAND
from seft_plant_sim.calibration import check_biases
from seft_plant_sim.rig import Rig, Rigs
from seft_plant_sim.simulated.faults import check_times

from seft_ros.force_controller import force_controller_parameters as controllers
from seft_ros.force_controller.interlock import Interlock, Interlocks, interlock_of
from seft_ros.ground_motion.ground_motion_block import GroundMotion
from seft_ros.protection.protected_force import ProtectedForce
from seft_ros.reference_force.reference_force_parameters import TARGET_MOTION

_REMEMBERED = 64
"""Blocks of each kind that are kept for later experiments: more than a study has methods."""


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
        for parameters, block in made:  # few: writing out a key takes as long as hundreds of them
            if parameters == section:
                return block
        made.append((dict(section), make(*arguments)))
        del made[:-_REMEMBERED]
        return made[-1][1]

    motion, force = experiment["ground_motion"], experiment["reference_force"]
    blocks = Blocks(
        reference_force=shared(  # first: a wrong fact of the specimen is named as that
            "reference_force", ProtectedForce.from_parameters, force, axes, timebase
        ),
        ground_motion=shared("ground_motion", GroundMotion, motion, axes, timebase),
        force_controller=shared("force_controller", interlock_of, experiment),
        rig=_rigs(experiment),
    )
    duration = (blocks.ground_motion.steps - 1) * timebase.dt
    check_times(experiment["rig"]["faults"], axes, duration)
    check_lead(experiment, blocks.ground_motion, blocks.reference_force)
    check_target(experiment, blocks)
    biases = check_biases(blocks.rig.zeroed, group(experiment["rig"], "limits"))
    if biases.refusal:
        raise InputError(f"rig: {biases.refusal}")
    return blocks


def _rigs(experiment: Experiment) -> Rig | Rigs:
    if len(experiment.rigs) > 1:
        return Rigs(experiment)
    return Rig(experiment["rig"], experiment.axes, experiment.timebase)


def check_target(experiment: Experiment, blocks: Blocks) -> None:
    """Check that the controller follows a target's motion if, and only if, there is one.

    Raises
    ------
    InputError
        If it is not.
    """
    method = experiment["force_controller"]["method"]
    compensation = experiment["reference_force"]["compensation.method"]
    has_target = blocks.reference_force.reference_force.provides_target
    fitting = controllers.fitting_method(experiment["force_controller"])
    controller = f"force_controller: method {method}"
    if method in controllers.FOLLOW_TARGETS and not has_target:
        other = f"reference_force: compensation.method is {compensation}; make that {TARGET_MOTION}"
        raise InputError(f"{controller} follows the motion of a target, but {other}")
    drives_valve = blocks.rig.drive == VALVE_COMMAND.name
    if method == controllers.TRANSFER_FUNCTION and has_target and drives_valve:
        gives = f"compensation.method {compensation} gives the motion of a target"
        mend = f"which {controller} does not follow; make that {fitting}"
        raise InputError(f"reference_force: {gives}, {mend}")


def check_lead(experiment: Experiment, motion: GroundMotion, force: ProtectedForce) -> None:
    """Check that the ground motion is known as far ahead as the compensation needs it.

    Raises
    ------
    InputError
        If it is not.
    """
    preview = force.preview
    if preview > len(motion.known) - motion.steps:
        lead = f"ground_motion: lead is {experiment['ground_motion']['lead']:g} s"
        needed = f"{preview * experiment.timebase.dt:g} s ahead; make the lead longer"
        raise InputError(f"{lead}, but the compensation looks {needed}")


def with_method(experiment: Experiment, method: str) -> Experiment:
    """Copy an experiment with another compensation method, and a force controller that fits it.

    `target_motion` drives valves and servos by controllers that need the target's motion. Other
    methods do not give it: they use the configured controller, or else the transfer function.
    """
    control = experiment["force_controller"]
    used = control["method"]
    if method == TARGET_MOTION and control["actuator.kind"] not in FORCE_DRIVEN:
        used = controllers.fitting_method(control)
    elif used in controllers.FOLLOW_TARGETS:
        used = controllers.TRANSFER_FUNCTION
    return experiment.changed(
        {"reference_force": {"compensation.method": method}, "force_controller": {"method": used}}
    )
