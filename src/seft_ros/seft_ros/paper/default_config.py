"""Where the experiment of the paper's rig stands, however the package was installed."""

from pathlib import Path

from seft_msgs_py.errors import InputError

import seft_ros

NAME = "jhu.yaml"


def default_config() -> Path:
    """Find config/jhu.yaml: in the source tree, or under share of what pip or colcon installed.

    Raises
    ------
    InputError
        If it is not there.
    """
    assert seft_ros.__file__ is not None
    package = Path(seft_ros.__file__).parent
    for place in (package, package.resolve()):  # colcon --symlink-install links to the source
        sources = place.parent / "config"
        shares = (prefix / "share" / "seft_ros" / "config" for prefix in place.parents)
        for folder in (sources, *shares):
            if (folder / NAME).is_file():
                return folder / NAME
    raise InputError(
        f"{NAME}: the paper's rig was not installed with seft_ros; name an experiment: "
        "seft paper config/jhu.yaml"
    )
