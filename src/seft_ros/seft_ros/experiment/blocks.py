"""The four blocks of a test, made of one experiment."""

from dataclasses import dataclass

from seft_msgs_py.errors import InputError
from seft_msgs_py.experiment import Experiment
from seft_plant_sim.rig import Rig

from seft_ros.force_controller.force_control import ForceControl
from seft_ros.force_controller.methods import force_control
from seft_ros.ground_motion.block import GroundMotion
from seft_ros.interlock.protected_force import ProtectedForce
from seft_ros.reference_force.continuation import Continuation


@dataclass(frozen=True)
class Blocks:
    """Ground motion, reference force, force controller and rig of a test."""

    ground_motion: GroundMotion
    reference_force: ProtectedForce
    force_controller: ForceControl
    rig: Rig


def build_blocks(experiment: Experiment) -> Blocks:
    """Make the blocks of an experiment.

    Raises
    ------
    InputError
        If a parameter makes no sense together with the others, or the record can't be read.
    """
    axes, timebase = experiment.axes, experiment.timebase
    blocks = Blocks(
        GroundMotion.from_parameters(experiment["ground_motion"], axes, timebase),
        ProtectedForce.from_parameters(experiment["reference_force"], axes, timebase),
        force_control(experiment["force_controller"], axes, timebase),
        Rig.from_parameters(experiment["rig"], axes, timebase),
    )
    check_lead(experiment, blocks.ground_motion, blocks.reference_force)
    return blocks


def check_lead(experiment: Experiment, motion: GroundMotion, force: ProtectedForce) -> None:
    """See that the ground motion is known as far ahead as the compensation looks.

    Raises
    ------
    InputError
        If it is not.
    """
    section, preview = experiment["reference_force"], force.preview
    if section["loop_delay"]:
        continuation = Continuation(section, experiment.axes, experiment.timebase)
        preview = max(preview, continuation.preview)
    if preview > len(motion.known) - motion.steps:
        raise InputError(
            f"ground_motion: lead is {experiment['ground_motion']['lead']:g} s, but the "
            f"compensation looks {preview * experiment.timebase.dt:g} s ahead; make "
            "the lead longer"
        )
