"""Rigs of a test: which axes each has, and how its nodes are called.

An axis that is named ``west/x`` belongs to the rig ``west``, whose nodes run in the namespace of
that name below the test's. Axes without such a name belong to one rig beside the other nodes.
"""

import re
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from seft_msgs_py.errors import InputError

RIG_NODES = ("force_controller", "rig")
"""Nodes that each rig has of its own; the others serve all rigs."""

START = "start_ns"
"""Key of a running test's state: when several rigs start together, ns of the wall clock."""
FARTHEST_START = 5.0  # s

_NAMESPACE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


@dataclass(frozen=True)
class RigAxes:
    """One rig of a test.

    Attributes
    ----------
    name : str
        Namespace of its nodes below the test's; empty where a test has but one rig.
    axes : tuple of str
        Its axes, in order.
    places : tuple of int
        Where they stand among the test's axes.
    """

    name: str
    axes: tuple[str, ...]
    places: tuple[int, ...]

    @classmethod
    def whole(cls, axes: Sequence[str]) -> "RigAxes":
        """Take all axes of a test for those of one rig."""
        return cls("", tuple(axes), tuple(range(len(axes))))

    def node(self, name: str) -> str:
        """Name of one of its nodes, as seen from the test's namespace."""
        return f"{self.name}/{name}" if self.name else name


def rigs_of(axes: Sequence[str]) -> tuple[RigAxes, ...]:
    """Sort the axes of a test by rig, in the order in which rigs are first named.

    Raises
    ------
    InputError
        If only some axes name a rig, or a rig's name can't be a namespace.
    """
    names = {axis: axis.rpartition("/")[0] for axis in axes}
    rigs = list(dict.fromkeys(names.values()))
    for name in rigs if rigs != [""] else ():
        if not _NAMESPACE.fullmatch(name):
            without = [axis for axis in axes if "/" not in axis]
            raise InputError(
                f"axes are {list(axes)}, but {without[0]} names no rig as the others do"
                if without
                else f"axes are {list(axes)}, but a rig named {name} can't have a namespace: give "
                "it letters, digits and _, a digit not first"
            )
    return tuple(
        RigAxes(
            rig,
            tuple(axis for axis in axes if names[axis] == rig),
            tuple(place for place, axis in enumerate(axes) if names[axis] == rig),
        )
        for rig in rigs
    )


def until_start(values: Mapping[str, str]) -> float:
    """Tell for how long a rig is still to wait before it begins a test together with others.

    Parameters
    ----------
    values : mapping
        What the state of the running test comes with.

    Returns
    -------
    float
        s, below zero where that moment has passed; 0 where the test has one rig.

    Raises
    ------
    InputError
        If that is far away: the clocks of the hosts do not agree.
    """
    start = values.get(START, "")
    if not start.isdecimal() or len(start) > 19:
        return 0.0
    ahead = (int(start) - time.time_ns()) / 1e9
    if abs(ahead) > FARTHEST_START:
        raise InputError(
            f"the common start of the rigs is {ahead:.3g} s from now by this host's clock: set "
            "the clocks of all hosts by one (PTP, or NTP)"
        )
    return ahead


def bare(node: str) -> str:
    """Name of a node without its rig's."""
    return node.rpartition("/")[2]


def rig_name(node: str) -> str:
    """Name of the rig that a node is said to belong to; empty if it serves all, or the only one."""
    return node.rpartition("/")[0]


def with_rigs(nodes: Iterable[str], rigs: Sequence[RigAxes]) -> list[str]:
    """Name nodes as a test of these rigs has them: one of each rig, where rigs have their own."""
    return [
        named
        for node in nodes
        for named in ([rig.node(node) for rig in rigs] if node in RIG_NODES else [node])
    ]
