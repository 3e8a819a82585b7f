"""The description of a test in its bag: one text (JSON) for each node, one for the environment.

Where nobody recorded these, the messages of the loop give axes and rate.
"""

import json
import os
import platform
import subprocess
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import Section
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.topics import NANOSECONDS_PER_SECOND, RIG_STATE, bare
from seft_msgs_py.wire.trajectory import Trajectory, parse_trajectory

_ENOUGH = 2000  # messages from which axes and rate are found
PACKAGES = ("numpy", "scipy", "rosbags", "rclpy", "seft_msgs_py", "seft_plant_sim", "seft_ros")
GIT_TIMEOUT = 5.0  # s


@dataclass
class Description:
    """What a test was, as far as it was recorded.

    Attributes
    ----------
    sections : dict
        Node -> its resolved parameters.
    environment : dict
        See `describe_environment`.
    facts : dict
        Node -> what else it says of itself.
    """

    sections: dict[str, Section] = field(default_factory=dict)
    environment: dict[str, Any] = field(default_factory=dict)
    facts: dict[str, dict[str, Any]] = field(default_factory=dict)

    def experiment(self) -> Experiment:
        """Make the experiment of the nodes' parameters; of several rigs the first's count.

        Raises
        ------
        InputError
            If no node published its parameters, or they contradict one another.
        """
        if not self.sections:
            raise InputError("no node published its parameters")
        sections: dict[str, Section] = {}
        for node, section in self.sections.items():
            sections.setdefault(bare(node), section)
        try:
            return Experiment(sections)
        except (KeyError, TypeError, ValueError, AttributeError):
            raise InputError(
                "the nodes' parameters make no experiment: rate or axes are missing, or are none"
            ) from None


def write_description(
    sections: Mapping[str, Section],
    environment: Mapping[str, Any],
    facts: Mapping[str, dict[str, Any]] | None = None,
) -> list[str]:
    """Texts that describe a test: one for each node with its facts, one for the environment."""
    nodes = [
        {"node": node, "parameters": dict(section), **(facts or {}).get(node, {})}
        for node, section in sections.items()
    ]
    return [
        json.dumps(part, allow_nan=False) for part in (*nodes, {"environment": dict(environment)})
    ]


def read_description(texts: Iterable[str]) -> tuple[Description, int]:
    """Read a bag's texts, and count those that are no description.

    Of a node that published two descriptions the last counts.
    """
    description = Description()
    refused = 0
    for text in texts:
        try:
            part = json.loads(text)
        except (ValueError, RecursionError):
            part = None
        match part:
            case {"node": str(node), "parameters": dict(parameters), **facts}:
                description.sections[node] = parameters
                if facts:
                    description.facts[node] = {str(name): fact for name, fact in facts.items()}
            case {"environment": dict(environment)}:
                description.environment = environment
            case _:
                refused += 1
    return description, refused


def infer_experiment(raws: Iterable[bytes]) -> Experiment:
    """Make an experiment of axes and rate alone.

    The rate follows from the most frequent spacing of samples, so that lost ones do no harm.

    Parameters
    ----------
    raws : iterable of bytes
        Messages of one loop topic, of which the first few thousand are read.

    Raises
    ------
    InputError
        If they do not give axes and rate.
    """
    messages: list[Trajectory] = []
    for raw in islice(raws, _ENOUGH):
        with suppress(WireError):
            messages.append(parse_trajectory(raw))
    messages = [message for message in messages if message.axes and message.points]
    if not messages:
        raise InputError("no message of the loop can be understood")
    axes = Counter(message.axes for message in messages).most_common(1)[0][0]
    stamps = sorted({message.stamp_ns for message in messages})
    known = Counter(m.points[1].time_from_start_ns for m in messages if len(m.points) > 1)
    spacings = known or Counter(late - early for early, late in pairwise(stamps))
    if not spacings:
        raise InputError("one sample alone does not give the rate")
    period_ns = spacings.most_common(1)[0][0]
    on_grid = sum(1 for stamp in stamps if period_ns > 0 and stamp % period_ns == 0)
    if 2 * on_grid <= len(stamps):
        raise InputError("stamps are not whole numbers of sampling periods")
    rate = NANOSECONDS_PER_SECOND / period_ns
    return Experiment({RIG_STATE.publisher: {"rate": rate, "axes": list(axes)}})


def describe_environment(mode: str) -> dict[str, Any]:
    """Describe where and with what a test is run; no names of people, hosts or folders.

    All are JSON values.

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

    None if git does not track the file: one that was installed into another project's folder
    does not belong to that project. Git runs once in a process (some 20 ms).
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


@cache
def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
