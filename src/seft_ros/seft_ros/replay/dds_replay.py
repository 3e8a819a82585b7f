"""A replay over DDS: the node as a process of its own, the others played."""

import time
from collections.abc import Callable, Iterable

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, InputError, WireError
from seft_msgs_py.wire.outcome import TRIPPED, State
from seft_msgs_py.wire.topics import ESTIMATES, REFERENCE_FORCE, Topic
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.recording.gathering import EstimatesGatherer, SeriesGatherer
from seft_ros.recording.message_block import MessageBlock
from seft_ros.reference_force.reference_force_parameters import reference_force_topic
from seft_ros.replay.replay_step import Answers, Replay, ReplayStep
from seft_ros.test_run.observer import alone_on_the_graph
from seft_ros.test_run.player import Player
from seft_ros.test_run.processes import NodeProcesses, one_node

READY_TIMEOUT = 60.0  # s
POLL = 0.05  # s
ANSWER_TIMEOUT = 10.0  # s for an answer
AGAIN = 1.0  # s after which is sent again what may be lost: the loop reads best effort
LAST = 0.5  # s for what follows the last answer

Progress = Callable[[str, int], None]


def replay_over_dds(replay: Replay, experiment: Experiment, progress: Progress) -> Answers:
    """Start a node with an experiment's parameters, feed it with a recorded test, and end it.

    ``progress`` is told what goes on, and the steps answered.

    Raises
    ------
    InputError
        If another test is on the graph, or the node does not come up.
    ExperimentError
        If it ends meanwhile.
    """
    progress("looking for other tests", 0)
    alone_on_the_graph()
    progress(f"starting {replay.node}", 0)
    with one_node(replay.node, experiment, lockstep=True) as processes:
        fed = _FedNode(replay, experiment, processes, progress)
        try:
            return fed.answers()
        finally:
            fed.player.close()


class _FedNode:
    def __init__(
        self, replay: Replay, experiment: Experiment, processes: NodeProcesses, progress: Progress
    ) -> None:
        self._replay, self._processes, self._progress = replay, processes, progress
        self._experiment = experiment
        # with other parameters, a reference force may be of a target, or not be
        self._answer = replay.answer
        if replay.answer.name == REFERENCE_FORCE.name:
            self._answer = reference_force_topic(experiment["reference_force"])
        self._codec = TrajectoryCodec(self._answer, experiment.axes, experiment.timebase)
        self._raws: list[bytes] = []
        self._estimates = EstimatesGatherer(experiment)
        hears = {
            replay.answer: self._on_answer,
            ESTIMATES: lambda raw, *_: self._estimates.take(raw, 0),
        }
        self.player = Player("seft_replay", replay.sends, hears)
        self._answered = -1

    def answers(self) -> Answers:
        """Feed the node step by step, each when the one before is answered."""
        self._wait_until_ready()
        player = self.player
        player.say(State.READY)
        player.say(State.RUNNING, self._replay.steps, pace="realtime")
        start, ended = time.monotonic(), ""
        for replay_step in self._replay.replay_steps():
            ended = self._feed(replay_step)
            if ended:
                break
        wall = time.monotonic() - start
        player.listen_for(LAST)
        player.say(State.DONE)
        gatherer = SeriesGatherer(self._answer, self._experiment, len(self._raws))
        none = [0] * len(self._raws)
        gatherer.take(MessageBlock.of(none, none, self._raws))
        return Answers(gatherer.series(), self._estimates.series(), wall, ended)

    def _feed(self, told: ReplayStep) -> str:
        """Send the messages of a step and wait for its answer; return why none comes, if so."""
        player, replay = self.player, self._replay
        if told.ramps:
            player.say(State.RAMPING_DOWN, replay.steps, pace="realtime")
        self._send(told.messages)
        started = sent = time.monotonic()
        while self._answered < told.step:
            if player.listen(POLL):
                continue
            for how in self._processes.ended().values():
                raise ExperimentError(f"{how} (at step {told.step})")
            now = time.monotonic()
            status = player.status.get(replay.node)
            if status and status.values.get("phase") == TRIPPED and now - started > AGAIN:
                return status.message
            if now - started > ANSWER_TIMEOUT:
                refused = status.values.get("refused", "0") if status else "0"
                count = f"; it refused {refused} messages" if refused != "0" else ""
                name = replay.answer.name
                return f"no {name} of step {told.step} within {ANSWER_TIMEOUT:g} s{count}"
            if now - sent > AGAIN:
                sent = now
                self._send(message for message in told.messages if not message[0].latched)
        self._progress(f"{replay.node} answers", told.step + 1)
        return ""

    def _wait_until_ready(self) -> None:
        replay, player = self._replay, self.player
        deadline = time.monotonic() + READY_TIMEOUT
        while True:
            player.listen_for(POLL)
            for node, how in self._processes.ended().items():
                wrong = self._processes.exit_status(node) == 2
                raise (InputError if wrong else ExperimentError)(how)
            if player.is_matched(replay.node, replay.sends, [replay.answer]):
                return
            if time.monotonic() > deadline:
                raise ExperimentError(f"{replay.node} was not found within {READY_TIMEOUT:g} s")

    def _on_answer(self, raw: bytes, *_: float) -> None:
        self._raws.append(raw)
        try:
            self._answered = max(self._answered, self._codec.decode(raw)[0])
        except WireError:
            return

    def _send(self, messages: Iterable[tuple[Topic, bytes]]) -> None:
        for topic, raw in messages:
            self.player.send(topic, raw)
