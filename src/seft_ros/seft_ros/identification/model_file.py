"""What was identified as a ROS 2 parameter file of its own."""

from pathlib import Path
from typing import Any

import numpy as np
from seft_msgs_py.config.experiment import write_parameter_file
from seft_plant_sim.lti import TransferFunction

from seft_ros.identification.identified import Identified, ValveResponse
from seft_ros.loop_shaping.roots import polynomial_of

ACTUATOR = (
    *("flow_gain", "oil_stiffness", "leakage", "force_capacity"),
    *("valve_frequency", "valve_damping", "dead_time"),
)
"""Names of an actuator's parameters, as of `ActuatorFit`."""
_LONGEST_DELAY = 1.0  # s, as the table has it


def model_parameters(identified: Identified, specimen: bool) -> dict[str, dict[str, Any]]:
    """Parameters of `reference_force` and `force_controller`, by node.

    The actuators are those of all axes; of a force capacity that the test does not show on every
    axis there is no word, so that what is configured counts. Force loop and plant, of which the
    tables hold one, are those of the first axis, with the specimen of the tests. The specimen's
    matrices are given where ``specimen`` says so.
    """
    reference: dict[str, Any] = {}
    controller: dict[str, Any] = {}
    if specimen:
        for name in ("mass", "damping", "stiffness"):
            reference[f"model.{name}"] = getattr(identified.specimen, name).ravel().tolist()
    if identified.closed_loops:
        closed = identified.closed_loops[0]
        if closed.tracking.delay_s is not None:
            delay = min(max(closed.tracking.delay_s, 0.0), _LONGEST_DELAY)
            reference["compensation.delay"] = float(delay)
        reference |= _response("tracking", closed.fit.model)
    if identified.valves:
        for name in ACTUATOR:
            values = [float(getattr(valve.actuator, name)) for valve in identified.valves]
            if name != "force_capacity" or all(values):
                controller[f"actuator.{name}"] = values
        controller |= _response("plant", _transfer_function(identified.valves[0]))
    sections = {"reference_force": reference, "force_controller": controller}
    return {node: section for node, section in sections.items() if section}


def write_model(identified: Identified, path: Path, source: str, specimen: bool) -> None:
    """Write `model_parameters` to a new file, to be read after the experiment's own.

    ``source`` says for people where they come from. An InputError says if it can't be written.
    """
    comments = [f"Identified by seft identify from {source}", f"Axes: {identified.axes}"]
    if identified.valves:
        comments.append(
            "actuator: of the actuators alone; another specimen needs no new identification"
        )
        comments.append(f"plant and tracking: with this specimen, of axis {identified.axes[0]}")
    write_parameter_file(path, model_parameters(identified, specimen), comments)


def _transfer_function(valve: ValveResponse) -> TransferFunction:
    """Plant of one axis, of its poles and zeros."""
    actuator, plant = valve.actuator, valve.loop.plant
    # f' = k_oil q w and w'' = w_v^2 u at the highest frequencies
    gain = actuator.oil_stiffness * actuator.flow_gain * (2 * np.pi * actuator.valve_frequency) ** 2
    numerator, denominator = gain * polynomial_of(plant.zeros()), polynomial_of(plant.poles())
    return TransferFunction(tuple(numerator.tolist()), tuple(denominator.tolist()), plant.delay)


def _response(prefix: str, model: TransferFunction) -> dict[str, Any]:
    return {
        f"{prefix}.numerator": list(model.numerator),
        f"{prefix}.denominator": list(model.denominator),
        f"{prefix}.dead_time": float(model.dead_time),
    }
