"""A controller as a ROS 2 parameter file of its own."""

from pathlib import Path

from seft_msgs_py.config.parameter_file import write_parameter_file
from seft_msgs_py.errors import InputError

from seft_ros.force_controller.kinds import one_controller
from seft_ros.loop_shaping.controller import Controller


def check_new(path: Path) -> None:
    """Refuse a file that exists already, or in a folder that does not.

    Raises
    ------
    InputError
        At either.
    """
    if path.exists():
        raise InputError(f"{path}: exists already; name another file with --out")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {path.parent}")


def write_controller(controller: Controller, path: Path) -> None:
    """Write numerator and denominator, to be read after the experiment's own file.

    Raises
    ------
    InputError
        If the file exists already or can't be written.
    """
    check_new(path)
    section = one_controller(controller.numerator, controller.denominator)
    told = "Controller of the force loop, by seft design: force error (N) to valve (V)"
    write_parameter_file(path, {"force_controller": section}, [told])
