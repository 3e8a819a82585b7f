"""Where and with what a test was run, for the bag; no names of people, hosts or folders."""

import os
import platform
import subprocess
from datetime import datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGES = ("numpy", "scipy", "rosbags", "rclpy", "seft_msgs_py", "seft_plant_sim", "seft_ros")
GIT_TIMEOUT = 5.0  # s


def describe_environment(mode: str) -> dict[str, Any]:
    """Describe what a test is run with; JSON values only.

    Parameters
    ----------
    mode : str
        How the test is run: ``simulate``, or the rig's pace.

    Returns
    -------
    dict
        ``start`` (wall clock, ISO 8601 with zone), ``mode``, ``git`` (``revision`` and
        whether Python files are ``dirty``, of the checkout this file is part of, or None),
        ``python``, ``platform``, ``cpus``, ``versions`` (of packages; None: not installed).
    """
    return {
        "start": datetime.now().astimezone().isoformat(),
        "mode": mode,
        "git": git_state(Path(__file__).resolve()),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpus": os.cpu_count(),
        "versions": {package: _version(package) for package in PACKAGES},
    }


@cache
def git_state(file: Path) -> dict[str, Any] | None:
    """Revision of the checkout that tracks a file, and whether its Python files differ.

    None if the file is under no git's control: one that was installed into another project's
    folder is none of that project's. Git is asked once in a process (some 20 ms).
    """
    top = _git(file.parent, "rev-parse", "--show-toplevel")
    if top is None or _git(file.parent, "ls-files", "--error-unmatch", file.name) is None:
        return None
    revision = _git(file.parent, "rev-parse", "HEAD")
    changes = _git(Path(top), "status", "--porcelain", "--", "*.py")
    if revision is None or changes is None:
        return None
    return {"revision": revision, "dirty": bool(changes)}


def _git(folder: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "--no-optional-locks", "-C", str(folder), *arguments],
            capture_output=True,
            text=True,
            timeout=GIT_TIMEOUT,
            check=True,
        )
    except (OSError, subprocess.SubprocessError, UnicodeDecodeError):
        return None
    return done.stdout.strip()


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
