"""What was identified as a ROS 2 parameter file of its own."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from seft_msgs_py.parameter_file import write_parameter_file

from seft_ros.identification.identified import Identified
from seft_ros.identification.rational import Rational

_WITH_NOMINAL = "with the uncoupled specimen of tracking.mass, tracking.damping, tracking.stiffness"
_LONGEST_DELAY = 1.0  # s, as the table has it


def model_parameters(identified: Identified) -> dict[str, dict[str, Any]]:
    """Parameters of `reference_force` and `force_controller`, by node.

    The specimen's matrices are those of all axes; the plant, of which the table holds one, is
    that of the first axis. The specimen that the tracking was identified with is told beside it
    where a valve drives the rig, of several axes the nominal one unless the force controller
    inverts the specimen; the tracking of a rig without a valve does not feel it. There is also
    what the loop's pistons, held still, do to a specimen that departs from it.
    """
    specimen = identified.specimen
    reference: dict[str, Any] = {
        f"model.{name}": getattr(specimen, name).ravel().tolist()
        for name in ("mass", "damping", "stiffness")
    }
    controller: dict[str, Any] = {}
    if identified.closed_loops:
        closed = identified.closed_loops[0]
        if closed.tracking.delay_s is not None:
            delay = min(max(closed.tracking.delay_s, 0.0), _LONGEST_DELAY)
            reference["compensation.delay"] = float(delay)
        feels = identified.valves or identified.unusable  # a valve's test that was not usable
        if feels and identified.nominal is not None and identified.tracking is not None:
            reference |= _response("tracking", identified.tracking.fit.model)
            reference |= {f"tracking.{k}": [v] for k, v in asdict(identified.nominal).items()}
            if identified.valves and identified.valves[0].blocked_error:
                reference["tracking.blocked_error"] = list(identified.valves[0].blocked_error)
        else:
            of_all = identified.tracking if feels else None
            reference |= _response("tracking", (of_all or closed).fit.model)
            if of_all:  # what a nominal specimen would need, and this one not
                reference |= {"tracking.mass": [0.0], "tracking.blocked_error": [0.0]}
            if of_all and identified.compliance is not None:
                reference |= {
                    "tracking.blocked_compliance": list(identified.compliance.polynomial),
                    "tracking.actuator_size": list(identified.compliance.sizes),
                }
            for name in ("stiffness", "damping"):  # copies: ROS 2 reads no YAML aliases
                reference[f"tracking.{name}"] = list(reference[f"model.{name}"]) if feels else [0.0]
    if identified.valves:
        controller = _response("plant", identified.valves[0].fit.model.rational())
    sections = {"reference_force": reference, "force_controller": controller}
    return {node: section for node, section in sections.items() if section}


def write_model(identified: Identified, path: Path, source: str) -> None:
    """Write the parameters, to be read after the experiment's own file.

    Parameters
    ----------
    identified : Identified
        What was identified.
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
    if len(identified.axes) > 1:
        plant = f"plant.* is that of axis {identified.axes[0]}; tracking.* that of all axes"
        if identified.nominal is not None:
            comments += [f"{plant}, as it is", _WITH_NOMINAL]
        else:
            comments.append(plant)
    write_parameter_file(path, model_parameters(identified), comments)


def _response(prefix: str, model: Rational) -> dict[str, Any]:
    return {
        f"{prefix}.numerator": list(model.numerator),
        f"{prefix}.denominator": list(model.denominator),
        f"{prefix}.dead_time": float(model.dead_time),
    }
