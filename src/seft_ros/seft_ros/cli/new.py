"""``seft new``: a package to begin with."""

import keyword
import sys
from pathlib import Path

import typer
from seft_msgs_py.errors import InputError

TEMPLATES = Path(__file__).parent / "templates"
NAME = "rig_driver"  # of the template's package
ROS2_CONTROL = "ros2_control"  # of what replaces or completes it


def new(
    what: str = typer.Argument(
        ..., help="driver: the node rig for your hardware.", metavar="driver"
    ),
    name: str = typer.Argument(..., help="Name of the package, and of the folder.", metavar="NAME"),
    ros2_control: bool = typer.Option(
        False, "--ros2-control", help="For a rig with a hardware interface of ros2_control."
    ),
) -> int:
    """Make a ROS 2 package for your own rig, in a new folder here.

    It has the driver with its watchdogs and safe position, a simulated converter board in place of
    your hardware, a calibration file, and tests. It conforms as it is (seft conform), so that you
    change one thing at a time. docs/hardware.md shows the way from here to the first test.

    With --ros2-control the driver reads joint states and commands an effort, and the package has
    a launch file for controller_manager, on mock_components in place of your hardware interface.

    Examples:

        seft new driver my_rig

        seft new driver my_rig --ros2-control
    """
    if what != "driver":
        raise InputError(f"can't make a new {what}; seft new driver NAME makes a driver")
    if not name.isidentifier() or keyword.iskeyword(name) or name != name.lower():
        raise InputError(f"{name}: not a package name; use lower-case letters, digits and _")
    if name in sys.stdlib_module_names or name.startswith("seft_"):
        raise InputError(f"{name}: another package has this name; choose another")
    folder = Path(name)
    try:
        folder.mkdir()
        for template in (NAME, ROS2_CONTROL)[: 1 + ros2_control]:
            _copy(template, name, folder)
        if ros2_control:
            setup = folder / "setup.py"
            setup.write_text(setup.read_text().replace("driver_node:main", f"{ROS2_CONTROL}:main"))
    except FileExistsError:
        raise InputError(f"{folder}: exists already; choose another name") from None
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror}") from None
    module = f"{name}.{ROS2_CONTROL if ros2_control else 'driver_node'}"
    start = f"-m {module} --ros-args --params-file {name}/config/rig.yaml"
    print(f"made {folder}/; next:")
    if ros2_control:
        print(f"  your rig:   colcon build; ros2 launch {name} ros2_control.launch.py")
    print(f"  start it:   PYTHONPATH={name} {sys.executable} {start}")
    print("  check it:   seft conform CONFIG")
    print(f"  its tests:  PYTHONPATH={name} {sys.executable} -m pytest {name}/test")
    if ros2_control:
        print(f"  your board: the plugin in {name}/urdf/rig.urdf")
    else:
        print(f"  your board: {name}/{name}/hardware.py, then stand_in() in driver_node.py")
    return 0


def _copy(template: str, name: str, folder: Path) -> None:
    """Copy a template's files under a package's name; they replace those that are there."""
    for file in sorted((TEMPLATES / template).rglob("*")):
        parts = file.relative_to(TEMPLATES / template).parts
        if file.is_dir() or any(part.startswith((".", "__pycache__")) for part in parts):
            continue
        place = folder.joinpath(*(part.replace(NAME, name) for part in parts))
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(file.read_text().replace(NAME, name))
