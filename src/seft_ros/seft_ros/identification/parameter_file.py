"""What was identified as a ROS 2 parameter file of its own."""

from pathlib import Path
from typing import Any

from seft_msgs_py.config.parameter_file import write_parameter_file

from seft_ros.identification.identified import Identified
from seft_ros.identification.plant_model import transfer_function
from seft_ros.identification.rational import Rational

ACTUATOR = (
    "flow_gain",
    "oil_stiffness",
    "leakage",
    "force_capacity",
    "valve_frequency",
    "valve_damping",
    "dead_time",
)
"""Names of an actuator's parameters, as of `ActuatorFit`."""
_LONGEST_DELAY = 1.0  # s, as the table has it


def model_parameters(identified: Identified, specimen: bool) -> dict[str, dict[str, Any]]:
    """Parameters of `reference_force` and `force_controller`, by node.

    The actuators are those of all axes; of a force capacity that the test does not show on every
    axis there is no word, so that what is configured counts. Force loop and plant, of which the
    tables hold one, are those of the first axis, with the specimen of the tests.

    Parameters
    ----------
    identified : Identified
        What was identified.
    specimen : bool
        Whether the specimen's matrices are wanted, too.
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
        first = identified.valves[0]
        controller |= _response("plant", transfer_function(first.loop.plant, first.actuator))
    sections = {"reference_force": reference, "force_controller": controller}
    return {node: section for node, section in sections.items() if section}


def write_model(identified: Identified, path: Path, source: str, specimen: bool) -> None:
    """Write the parameters, to be read after the experiment's own file.

    Parameters
    ----------
    identified, specimen
        See `model_parameters`.
    path : Path
        The file.
    source : str
        Where it comes from, for people to read.

    Raises
    ------
    InputError
        If it can't be written.
    """
    comments = [f"Identified by seft identify from {source}", f"Axes: {identified.axes}"]
    if identified.valves:
        comments.append(
            "actuator: of the actuators alone; another specimen needs no new identification"
        )
        comments.append(f"plant and tracking: with this specimen, of axis {identified.axes[0]}")
    write_parameter_file(path, model_parameters(identified, specimen), comments)


def _response(prefix: str, model: Rational) -> dict[str, Any]:
    return {
        f"{prefix}.numerator": list(model.numerator),
        f"{prefix}.denominator": list(model.denominator),
        f"{prefix}.dead_time": float(model.dead_time),
    }
