"""What a node is told in a replay, and what it answers."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import LoopTopic, Topic

from seft_ros.recording.record import Estimates, Series
from seft_ros.replay.recorded import Recorded

Steps = npt.NDArray[np.int64]


@dataclass(frozen=True)
class ReplayStep:
    """What a node is told before it answers a step."""

    step: int
    messages: list[tuple[Topic, bytes]] = field(default_factory=list)
    ramps: bool = False  # the supervisor says before them that the force is to be brought down


@dataclass(frozen=True)
class Answers:
    """What a node answered."""

    series: Series  # on its topic
    estimates: Estimates | None
    wall_s: float
    ended: str = ""  # why it answered no more before the end


class Replay(ABC):
    """A recorded test as one node saw it.

    Parameters
    ----------
    recorded : Recorded
        The test.

    Attributes
    ----------
    node : str
        Which node.
    answer : LoopTopic
        Topic of its answers.
    sends : tuple of LoopTopic
        Topics of what it is told.
    expected : Series
        The recorded answers.
    steps : int or None
        Steps of the test; None for a node that keeps no time without that number.
    fixed : dict
        Parameters that a replay gives the node in place of the recorded ones.
    notes : list of str
        What the replay can't do as the test did.

    Raises
    ------
    InputError
        If the bag lacks what the node was told.
    """

    node: ClassVar[str]
    answer: LoopTopic
    sends: tuple[LoopTopic, ...]
    expected: Series

    def __init__(self, recorded: Recorded) -> None:
        self.experiment = recorded.record.experiment
        self.steps: int | None = None
        self.fixed: dict[str, object] = {}
        self.notes: list[str] = []

    @abstractmethod
    def replay_steps(self) -> Iterator[ReplayStep]:
        """Give what the node is told, step by step."""

    @abstractmethod
    def computed(self, section: dict[str, Any]) -> tuple[Series, Estimates | None]:
        """Give the answers of the node's block without ROS, with a node's parameters."""

    def note_steps(self, what: str, steps: npt.ArrayLike) -> None:
        """Note of how many steps something is so, and name the first; nothing if of none."""
        if len(listed := np.asarray(steps).tolist()):
            more = f" and {len(listed) - 1} more" if len(listed) > 1 else ""
            self.notes.append(f"{what}: step {listed[0]}{more}")

    def note_unanswered(self, states: Steps, answered: Steps) -> None:
        """Note which recorded states the node did not answer: these are not sent.

        Raises
        ------
        InputError
            If a state that was answered is not in the bag.
        """
        lost = np.setdiff1d(answered, states)
        if len(lost):
            raise InputError(
                f"the bag lacks rig/state of step {lost[0]}, which {self.node} has answered: "
                "what the node remembers of it can't be replayed"
            )
        unanswered = np.setdiff1d(states, answered)
        self.note_steps("not answered when recorded, and not sent", unanswered)
        self.note_steps(
            "neither rig/state nor its answer is in the bag, and whether the node had them is not "
            "known",
            np.setdiff1d(np.arange(answered[-1] if len(answered) else 0), states),
        )
