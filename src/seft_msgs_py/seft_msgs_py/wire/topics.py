"""Topics of a test: names, types, publisher, subscribers, quality of service; rigs and time.

The table in docs/nodes.md describes these topics. Names are relative, so that a test can be in a
namespace; in a bag they have a leading slash.

An axis that is named ``west/x`` belongs to the rig ``west``, whose nodes run in the namespace of
that name below the test's. Axes without such a name belong to the only rig.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from seft_msgs_py.arrays import Ints
from seft_msgs_py.errors import InputError, WireError

NANOSECONDS_PER_SECOND = 1_000_000_000


@dataclass(frozen=True)
class Timebase:
    """Sampling clock of a test: step k is at experiment time k / rate, rounded to a nanosecond.

    Attributes
    ----------
    rate : float
        Sampling rate in Hz.
    """

    rate: float

    @classmethod
    def from_rate(cls, rate: float) -> "Timebase":
        """Make the time base from a rate in Hz.

        Raises
        ------
        InputError
            If the rate is not positive, or above 1 GHz: then stamps could not tell steps apart.
        """
        if not 1e-6 < rate <= NANOSECONDS_PER_SECOND:
            raise InputError(f"rate must be positive and at most 1e9 Hz, but is {rate:g} Hz")
        return cls(rate=float(rate))

    @property
    def dt(self) -> float:
        """Sampling period in seconds."""
        return 1.0 / self.rate

    @cached_property
    def _period(self) -> tuple[int, int]:
        """Sampling period in nanoseconds, exact: numerator and denominator."""
        return (NANOSECONDS_PER_SECOND / Fraction(self.rate)).as_integer_ratio()

    def stamp_ns(self, step: int) -> int:
        """Experiment time of a step, rounded to a nanosecond, half to even."""
        period, per = self._period
        whole, rest = divmod(step * period, per)
        return whole + (2 * rest + (whole & 1) > per)

    def step(self, stamp_ns: int) -> int:
        """Step whose experiment time is ``stamp_ns``.

        Raises
        ------
        WireError
            If the stamp is negative or lies between two steps.
        """
        step, fits = self.nearest(stamp_ns)
        if not fits or step < 0:
            raise WireError(
                f"stamp {stamp_ns} ns is not on the {self.rate:g} Hz grid (period "
                f"{1e9 * self.dt:.12g} ns); does the sender run at another rate?"
            )
        return step

    def steps(self, stamps_ns: Ints) -> tuple[Ints, npt.NDArray[np.bool_]]:
        """Give the step of each stamp, and whether `step` finds one."""
        (period, per), largest = self._period, int(np.abs(stamps_ns).max(initial=0))
        if 2 * (largest * per + period) >= 2**63:  # too much for int64: as Python's integers
            stamps_ns = stamps_ns.astype(object)
        steps, fits = self.nearest(stamps_ns)
        return steps.astype(np.int64), (fits & (steps >= 0)).astype(bool)

    def nearest(self, stamp_ns: Any) -> tuple[Any, Any]:
        """Find the nearest step, and whether the stamp is less than a nanosecond from its time.

        So a stamp counts as its step's, whichever way its sender rounds.
        """
        period, per = self._period
        step = (2 * stamp_ns * per + period) // (2 * period)
        return step, abs(stamp_ns * per - step * period) < per


JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
DIAGNOSTIC_STATUS = "diagnostic_msgs/msg/DiagnosticStatus"
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
STRING = "std_msgs/msg/String"
CLOCK = "rosgraph_msgs/msg/Clock"

NODES = ("ground_motion", "reference_force", "force_controller", "rig", "supervisor", "recorder")
LOOP_NODES = ("rig", "reference_force", "force_controller")
"""Nodes that work one after the other within a step. The rig comes first: it is the clock, and in
one process spins for all."""

QUANTITIES = ("positions", "velocities", "accelerations", "effort")
"""Arrays of a JointTrajectoryPoint, in the order of the wire."""
IS_SUSPECT, DRIVE = "suspect", "drive"
"""Whether a sample is suspect, 1 or 0, and what the rig applies from it on: the positions and the
effort of a second point, a period later."""
RIG_NODES = ("force_controller", "rig")
"""Nodes of which each rig has its own; the others serve all rigs."""

_NAMESPACE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


@dataclass(frozen=True)
class RigAxes:
    """One rig of a test.

    Attributes
    ----------
    name : str
        Namespace of its nodes below the test's; empty if a test has only one rig.
    axes : tuple of str
        Its axes, in order.
    places : tuple of int
        Their indices among the test's axes.
    """

    name: str
    axes: tuple[str, ...]
    places: tuple[int, ...]

    @classmethod
    def whole(cls, axes: Sequence[str]) -> "RigAxes":
        """Make the rig that has all axes of a test."""
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
    names = {axis: rig_name(axis) for axis in axes}
    rigs = list(dict.fromkeys(names.values()))
    for name in rigs:
        if rigs != [""] and not _NAMESPACE.fullmatch(name):
            without = [axis for axis in axes if "/" not in axis]
            raise InputError(
                f"/**: axes are {list(axes)}, but {without[0]} names no rig as the others do"
                if without
                else f"/**: axes are {list(axes)}, but a rig named {name} can't have a namespace: "
                "give it letters, digits and _, a digit not first"
            )
    return tuple(
        RigAxes(
            rig,
            tuple(axis for axis in axes if names[axis] == rig),
            tuple(place for place, axis in enumerate(axes) if names[axis] == rig),
        )
        for rig in rigs
    )


def bare(node: str) -> str:
    """Name of a node without its rig's."""
    return node.rpartition("/")[2]


def rig_name(node: str) -> str:
    """Name of the rig in that of a node or axis; empty if it serves all rigs, or the only one."""
    return node.rpartition("/")[0]


def of_one_rig(axes: Sequence[str]) -> npt.NDArray[np.bool_]:
    """Say which pairs of axes belong to one rig, shape (n, n)."""
    names = np.array([rig_name(axis) for axis in axes])
    return np.equal.outer(names, names)


def with_rigs(nodes: Iterable[str], rigs: Sequence[RigAxes]) -> list[str]:
    """Names of nodes in a test of these rigs: one for each rig, if rigs have their own."""
    return [
        named
        for node in nodes
        for named in ([rig.node(node) for rig in rigs] if node in RIG_NODES else [node])
    ]


@dataclass(frozen=True)
class Topic:
    """One topic and its quality of service.

    Attributes
    ----------
    name : str
        Relative name.
    type : str
        Message type.
    publisher : str
        Node that publishes it; empty if every node does.
    subscribers : tuple of str
        Nodes that must be connected before a test starts (the recorder subscribes to all).
    latched : bool
        Transient local: a late subscriber also gets the last messages.
    depth : int
        Samples that the publisher keeps for a slow reader, until it acknowledges them: in lockstep
        there are thousands a second.
    recorded : bool
        Whether the bag contains it.
    """

    name: str
    type: str
    publisher: str = field(default="", compare=False)  # differs between several rigs
    subscribers: tuple[str, ...] = field(default=(), compare=False)
    latched: bool = False
    depth: int = 4096
    recorded: bool = True

    def of(self, rig: RigAxes) -> Self:
        """Give the topic in the namespace of one of several rigs."""
        if not rig.name:
            return self
        return replace(
            self,
            name=rig.node(self.name),
            publisher=rig.node(self.publisher) if self.publisher else "",
            subscribers=tuple(rig.node(n) if n in RIG_NODES else n for n in self.subscribers),
        )


@dataclass(frozen=True)
class LoopTopic(Topic):
    """A topic of the loop: JointTrajectory, of which only the arrays of ``quantities`` have values.

    Quantities and their units are in the order of the wire.

    Attributes
    ----------
    finite : bool
        Whether a message with a value that is no number is refused.
    every_point : bool
        Whether each point of a message is a sample of its own step, and none a forecast.
    """

    type: str = JOINT_TRAJECTORY
    quantities: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    finite: bool = True
    every_point: bool = False

    def points(self, count: int) -> tuple[tuple[str, ...], ...]:
        """Give the arrays of each point of a message of ``count`` samples.

        Their values, one after another, are those of ``quantities``, sample by sample.
        """
        if self.quantities[-1] == DRIVE:
            return self.quantities[:-2], ("positions", "effort")
        return (self.quantities,) * count


GROUND_MOTION = LoopTopic(
    "ground_motion",
    publisher="ground_motion",
    subscribers=("reference_force",),
    latched=True,
    depth=256,
    quantities=("accelerations",),
    units=("m/s^2",),
    every_point=True,
)
RIG_STATE = LoopTopic(
    "rig/state",
    publisher="rig",
    subscribers=("reference_force", "force_controller"),
    quantities=(*QUANTITIES, IS_SUSPECT, DRIVE),
    units=("m", "m/s", "m/s^2", "N", "", "V or N"),  # as the rig is driven
)
"""The judged sample: a value that differs from rig/measured was wrong, and is replaced."""
MEASURED = replace(
    RIG_STATE,
    name="rig/measured",
    subscribers=(),
    quantities=QUANTITIES,
    units=RIG_STATE.units[:4],
    finite=False,  # a sensor may fail
    every_point=True,
)
"""Samples as measured, calibrated and aligned, for the recorder alone: `MEASURED_STEPS` in one
message, or fewer at the end of a test."""
MEASURED_STEPS = 16
REFERENCE_FORCE = LoopTopic(
    "reference_force",
    publisher="reference_force",
    subscribers=("force_controller",),  # and a rig that it drives
    quantities=("effort",),
    units=("N",),
)
TARGET = replace(
    REFERENCE_FORCE, quantities=("positions", "velocities", "effort"), units=("m", "m/s", "N")
)
"""The reference force with the target's motion, of this step and future ones."""
VALVE_COMMAND = LoopTopic(
    "valve_command",
    publisher="force_controller",
    subscribers=("rig",),
    quantities=("effort",),
    units=("V",),
)
"""After a trip of its publisher a message has several points: the commands until rest."""
STOP_COMMAND = replace(VALVE_COMMAND, name="stop_command", subscribers=(), depth=4, recorded=False)
"""The commands of a stop that would begin at its step; a rig that ends a test may follow them."""
LOOP_TOPICS = (GROUND_MOTION, RIG_STATE, MEASURED, REFERENCE_FORCE, VALVE_COMMAND)


def rehearsed(topic: LoopTopic) -> LoopTopic:
    """Give the topic of the loop's rehearsal before a test, which is not recorded."""
    return replace(topic, name=f"rehearsal/{topic.name}", recorded=False)


ESTIMATES = Topic(
    "reference_force/estimates", DIAGNOSTIC_ARRAY, publisher="reference_force", depth=256
)
STEP_TOPICS = (*LOOP_TOPICS, ESTIMATES)
"""Topics whose messages belong to steps of the test, and are stamped with their time."""

EXPERIMENT_STATE = Topic(
    "experiment/state",
    DIAGNOSTIC_STATUS,
    publisher="supervisor",
    subscribers=("ground_motion", "rig"),
    latched=True,
    depth=1,
)
DESCRIPTION = Topic("experiment/description", STRING, latched=True, depth=1)
DIAGNOSTICS = Topic("diagnostics", DIAGNOSTIC_ARRAY, subscribers=("supervisor",), depth=256)
CLOCK_TOPIC = Topic(
    "/clock", CLOCK, publisher="rig", subscribers=("ground_motion",), depth=1, recorded=False
)

LINK_PING = Topic("link/ping", STRING, depth=256, recorded=False)
LINK_PONG = Topic("link/pong", STRING, depth=256, recorded=False)
"""Messages over a link and back, for `seft link`."""

TOPICS = (*STEP_TOPICS, STOP_COMMAND, EXPERIMENT_STATE, DESCRIPTION, DIAGNOSTICS, CLOCK_TOPIC)

RIG_TOPICS = (RIG_STATE, MEASURED, VALVE_COMMAND, STOP_COMMAND)
"""Topics of which each of several rigs has its own."""


def topics_of(rigs: Sequence[RigAxes]) -> tuple[Topic, ...]:
    """List the topics of a test of these rigs; the first of them is its clock."""
    found: list[Topic] = []
    for topic in TOPICS:
        if topic in RIG_TOPICS:
            found += [topic.of(rig) for rig in rigs]
        else:
            own, readers = topic.publisher, tuple(with_rigs(topic.subscribers, rigs))
            publisher = rigs[0].node(own) if own in RIG_NODES else own
            found.append(replace(topic, publisher=publisher, subscribers=readers))
    return tuple(found)
