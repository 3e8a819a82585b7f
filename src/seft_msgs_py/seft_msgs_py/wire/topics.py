"""Topics of a test: names, message types, who sends and who listens, quality of service.

The table in the README is made of these rows. Names are relative, so that a test can be
put in a namespace; a bag holds them with a leading slash.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

from seft_msgs_py.wire.rigs import RIG_NODES, RigAxes, with_rigs

JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
DIAGNOSTIC_STATUS = "diagnostic_msgs/msg/DiagnosticStatus"
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
STRING = "std_msgs/msg/String"
CLOCK = "rosgraph_msgs/msg/Clock"

NODES = (
    "ground_motion",
    "reference_force",
    "force_controller",
    "rig",
    "supervisor",
    "recorder",
)

QUANTITIES = ("positions", "velocities", "accelerations", "effort")
"""Arrays of a JointTrajectoryPoint, in the order of the wire."""


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
        Node that publishes it; empty where every node does.
    subscribers : tuple of str
        Nodes that a test can't start without having matched (the recorder listens to all).
    latched : bool
        Transient local: who comes late gets the last ones too.
    depth : int
        Samples the publisher keeps for a reader that is held up, until it acknowledges them:
        in lockstep thousands go by in a second.
    recorded : bool
        Whether the bag holds it.
    """

    name: str
    type: str
    publisher: str = field(default="", compare=False)  # which of several rigs', the test says
    subscribers: tuple[str, ...] = field(default=(), compare=False)
    latched: bool = False
    depth: int = 4096
    recorded: bool = True

    def of(self, rig: RigAxes) -> Self:
        """Give the topic as one rig of several has it of its own: in its namespace."""
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
    """A topic of the loop: JointTrajectory, of which some arrays carry values.

    Attributes
    ----------
    quantities : tuple of str
        Arrays that carry values, in the order of the wire; the others are empty.
    units : tuple of str
        Unit of each.
    """

    quantities: tuple[str, ...] = ()
    units: tuple[str, ...] = ()


GROUND_MOTION = LoopTopic(
    "ground_motion",
    JOINT_TRAJECTORY,
    publisher="ground_motion",
    subscribers=("reference_force",),
    latched=True,
    depth=256,
    quantities=("accelerations",),
    units=("m/s^2",),
)
RIG_STATE = LoopTopic(
    "rig/state",
    JOINT_TRAJECTORY,
    publisher="rig",
    subscribers=("reference_force", "force_controller"),
    quantities=QUANTITIES,
    units=("m", "m/s", "m/s^2", "N"),
)
REFERENCE_FORCE = LoopTopic(
    "reference_force",
    JOINT_TRAJECTORY,
    publisher="reference_force",
    subscribers=("force_controller",),  # and a rig that says it is driven by it
    quantities=("effort",),
    units=("N",),
)
TARGET = replace(
    REFERENCE_FORCE,
    quantities=("positions", "velocities", "effort"),
    units=("m", "m/s", "N"),
)
"""The reference force with the motion that belongs to it, of this step and the coming ones."""
VALVE_COMMAND = LoopTopic(
    "valve_command",
    JOINT_TRAJECTORY,
    publisher="force_controller",
    subscribers=("rig",),
    quantities=("effort",),
    units=("V",),
)
LOOP_TOPICS = (GROUND_MOTION, RIG_STATE, REFERENCE_FORCE, VALVE_COMMAND)

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
"""Messages over a link and back, sent by `seft link` while no test runs."""

TOPICS = (*STEP_TOPICS, EXPERIMENT_STATE, DESCRIPTION, DIAGNOSTICS, CLOCK_TOPIC)

RIG_TOPICS = (RIG_STATE, VALVE_COMMAND)
"""Topics that each of several rigs has of its own."""


def topics_of(rigs: Sequence[RigAxes]) -> tuple[Topic, ...]:
    """List the topics of a test of these rigs; the first of them is its clock."""
    found: list[Topic] = []
    for topic in TOPICS:
        if topic in RIG_TOPICS:
            found += [topic.of(rig) for rig in rigs]
            continue
        publisher = topic.publisher
        if publisher in RIG_NODES:
            publisher = rigs[0].node(publisher)
        found.append(
            replace(
                topic, publisher=publisher, subscribers=tuple(with_rigs(topic.subscribers, rigs))
            )
        )
    return tuple(found)
