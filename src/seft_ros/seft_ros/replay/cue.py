"""What a node is told in a replay, and what is expected of it."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from seft_msgs_py.wire.topics import LoopTopic, Topic

from seft_ros.recording.record import Estimates, Series

FAR = 20.0  # s that ground motion is sent ahead of its step


@dataclass(frozen=True)
class Cue:
    """What a node is told before it answers a step.

    Attributes
    ----------
    step : int
        Of the answer.
    messages : list of (Topic, bytes)
        In their order.
    ramps : bool
        Whether the supervisor says before them that the force is to be brought down.
    """

    step: int
    messages: list[tuple[Topic, bytes]]
    ramps: bool = False


class Part(Protocol):
    """The parts of the other nodes, from a recorded test.

    Attributes
    ----------
    node : str
        Whom they are played for.
    answer : LoopTopic
        Topic of its answers.
    sends : tuple of LoopTopic
        Topics of what it is told.
    steps : int or None
        Steps of the test, for a node that must know.
    fixed : dict
        Parameters that a replay gives the node in place of the recorded ones.
    notes : list of str
        What the replay could not do as the test did.
    """

    node: str
    answer: LoopTopic
    sends: tuple[LoopTopic, ...]
    steps: int | None
    fixed: dict[str, object]
    notes: list[str]

    def cues(self) -> Iterator[Cue]:
        """Give what the node is told, step by step."""

    def expected(self) -> Series:
        """Give the recorded answers that replayed ones are held against."""

    def computed(self, section: dict[str, Any]) -> tuple[Series, Estimates | None]:
        """Give the answers of the node's block without ROS, with a node's parameters."""
