"""A replay over DDS: the node as a process of its own, the others played."""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, InputError, WireError
from seft_msgs_py.wire.outcome import TRIPPED
from seft_msgs_py.wire.topics import ESTIMATES, REFERENCE_FORCE, Topic
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.experiment.state_machine import State
from seft_ros.recording.gathering import EstimatesGatherer, SeriesGatherer
from seft_ros.recording.message_block import MessageBlock
from seft_ros.reference_force.topic import reference_force_topic
from seft_ros.replay.answers import Answers
from seft_ros.replay.cue import Cue, Part
from seft_ros.running.one_node import alone_on_the_graph, one_node
from seft_ros.running.player import Player
from seft_ros.running.processes import NodeProcesses

READY_TIMEOUT = 60.0  # s
LOOK = 0.05  # s
ANSWER_TIMEOUT = 10.0  # s for an answer
AGAIN = 1.0  # s after which is sent again what may be lost: the loop reads best effort
LAST = 0.5  # s for what follows the last answer

Progress = Callable[[str, int], None]


def play(part: Part, experiment: Experiment, progress: Progress) -> Answers:
    """Start a node, feed it with a recorded test, and end it.

    Parameters
    ----------
    part : Part
        What it is told.
    experiment : Experiment
        Its parameters.
    progress : callable
        Told what goes on, and the steps answered.

    Raises
    ------
    InputError
        If another test is on the graph, or the node does not come up.
    ExperimentError
        If it ends meanwhile.
    """
    progress("looking for other tests", 0)
    alone_on_the_graph()
    progress(f"starting {part.node}", 0)
    with one_node(part.node, experiment, lockstep=True) as processes:
        stage = _Stage(part, experiment, processes, progress)
        try:
            return stage.play()
        finally:
            stage.player.close()


@dataclass
class _Heard:
    """Messages of a topic."""

    raws: list[bytes] = field(default_factory=list)

    def take(self, raw: bytes, at: float, sent: float) -> None:
        del at, sent
        self.raws.append(raw)


class _Stage:
    def __init__(
        self, part: Part, experiment: Experiment, processes: NodeProcesses, progress: Progress
    ) -> None:
        self._part, self._processes, self._progress = part, processes, progress
        self._experiment = experiment
        # with other parameters, a reference force may be of a target, or not be
        self._answer = part.answer
        if part.answer.name == REFERENCE_FORCE.name:
            self._answer = reference_force_topic(experiment["reference_force"])
        self._codec = TrajectoryCodec(self._answer, experiment.axes, experiment.timebase)
        self._answers, self._estimates = _Heard(), _Heard()
        hears = {part.answer: self._on_answer, ESTIMATES: self._estimates.take}
        self.player = Player("seft_replay", part.sends, hears)
        self._answered = -1

    def play(self) -> Answers:
        """Feed the node step by step, each when the one before is answered."""
        self._wait_until_ready()
        player = self.player
        player.say(State.READY)
        player.say(State.RUNNING, self._part.steps, pace="realtime")
        start, ended = time.monotonic(), ""
        for cue in self._part.cues():
            ended = self._answer_to(cue)
            if ended:
                break
        wall = time.monotonic() - start
        player.listen_for(LAST)
        player.say(State.DONE)
        experiment = self._experiment
        gatherer = SeriesGatherer(self._answer, experiment, len(self._answers.raws))
        gatherer.take(_block(self._answers.raws))
        estimates = EstimatesGatherer(experiment)
        for raw in self._estimates.raws:
            estimates.take(raw, 0)
        return Answers(gatherer.series(), estimates.series(), wall, ended)

    def _answer_to(self, cue: Cue) -> str:
        """Tell a cue and wait for its answer; return why none comes, if so."""
        player = self.player
        if cue.ramps:
            player.say(State.RAMPING_DOWN, self._part.steps, pace="realtime")
        _send(player, cue.messages)
        started = sent = time.monotonic()
        while self._answered < cue.step:
            if player.listen(LOOK):
                continue
            for how in self._processes.ended().values():
                raise ExperimentError(f"{how} (at step {cue.step})")
            now = time.monotonic()
            status = player.status.get(self._part.node)
            tripped = status is not None and status.values.get("phase") == TRIPPED
            if tripped and now - started > AGAIN:
                assert status is not None
                return status.message
            if now - started > ANSWER_TIMEOUT:
                refused = status.values.get("refused", "0") if status is not None else "0"
                told = f"; it refused {refused} messages" if refused != "0" else ""
                name = self._part.answer.name
                return f"no {name} of step {cue.step} within {ANSWER_TIMEOUT:g} s{told}"
            if now - sent > AGAIN:
                sent = now
                _send(player, [told for told in cue.messages if not told[0].latched])
        self._progress(f"{self._part.node} answers", cue.step + 1)
        return ""

    def _wait_until_ready(self) -> None:
        part, player = self._part, self.player
        deadline = time.monotonic() + READY_TIMEOUT
        while True:
            player.listen_for(LOOK)
            for node, how in self._processes.ended().items():
                wrong = self._processes.exit_status(node) == 2
                raise (InputError if wrong else ExperimentError)(how)
            if player.is_matched(part.node, part.sends, [part.answer]):
                return
            if time.monotonic() > deadline:
                raise ExperimentError(f"{part.node} was not found within {READY_TIMEOUT:g} s")

    def _on_answer(self, raw: bytes, at: float, sent: float) -> None:
        self._answers.take(raw, at, sent)
        try:
            self._answered = max(self._answered, self._codec.decode(raw)[0])
        except WireError:
            return


def _send(player: Player, messages: Iterable[tuple[Topic, bytes]]) -> None:
    for topic, raw in messages:
        player.send(topic, raw)


def _block(raws: list[bytes]) -> MessageBlock:
    none = [0] * len(raws)
    return MessageBlock.of(none, none, raws)
