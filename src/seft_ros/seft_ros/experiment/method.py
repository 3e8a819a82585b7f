"""An experiment with another compensation method, and with the force controller of that method."""

from seft_msgs_py.config.experiment import Experiment

from seft_ros.force_controller.names import TRANSFER_FUNCTION, VELOCITY_FEEDFORWARD
from seft_ros.reference_force.reference_force_parameters import TARGET_MOTION
from seft_ros.target.force_command import FORCE_DRIVEN


def with_method(experiment: Experiment, method: str) -> Experiment:
    """Copy an experiment with another compensation method.

    `target_motion` drives valves by velocity feedforward. No other method tells the motion that
    this needs: they have the controller as configured, or else the configured transfer function.
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
