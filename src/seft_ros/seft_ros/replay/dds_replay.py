"""Replay over DDS: the node is a process of its own, this process plays the others."""

import time
from collections.abc import Callable

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.wire.outcome import TRIPPED, State
from seft_msgs_py.wire.topics import ESTIMATES, REFERENCE_FORCE
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.bags.gathering import EstimatesGatherer, SeriesGatherer
from seft_ros.bags.message_blocks import MessageBlock
from seft_ros.reference_force.reference_force_parameters import reference_force_topic
from seft_ros.replay.recorded_test import Answers, Replay, ReplayStep
from seft_ros.test_run.observer import Player, alone_on_the_graph
from seft_ros.test_run.processes import NodeProcesses, one_node

READY_TIMEOUT = 60.0  # s
POLL = 0.05  # s
ANSWER_TIMEOUT = 10.0  # s for an answer
AGAIN = 1.0  # s between repeats of messages that may be lost: the loop reads best effort
LAST = 0.5  # s for messages after the last answer

Progress = Callable[[str, int], None]


def replay_over_dds(replay: Replay, experiment: Experiment, progress: Progress) -> Answers:
    """Start a node with an experiment's parameters, send it a recorded test, and end it.

    ``progress`` is called with the present stage and the number of steps answered.

    Raises
    ------
    InputError
        If another test is on the graph, or the node does not start.
    ExperimentError
        If it ends meanwhile.
    """
    progress("looking for other tests", 0)
    alone_on_the_graph()
    progress(f"starting {replay.node}", 0)
    with one_node(replay.node, experiment, lockstep=True) as processes:
        session = _Session(replay, experiment, processes)
        try:
            return session.answers(progress)
        finally:
            session.player.close()


class _Session:
    def __init__(self, replay: Replay, experiment: Experiment, processes: NodeProcesses) -> None:
        self._replay, self._processes, self._experiment = replay, processes, experiment
        # with other parameters, a reference force may have become that of a target, or the reverse
        self._answer = replay.answer
        if replay.answer.name == REFERENCE_FORCE.name:
            self._answer = reference_force_topic(experiment["reference_force"])
        self._codec = TrajectoryCodec(self._answer, experiment.axes, experiment.timebase)
        self._raws: list[bytes] = []
        self._answered = -1
        self._estimates = EstimatesGatherer(experiment)
        receives = {
            replay.answer: self._on_answer,
            ESTIMATES: lambda raw, *_: self._estimates.take(raw),
        }
        self.player = Player("seft_replay", replay.sends, receives)

    def answers(self, progress: Progress) -> Answers:
        """Send the steps one by one, each when the one before is answered."""
        self._wait_until_ready()
        player, replay = self.player, self._replay
        player.say(State.READY)
        player.say(State.RUNNING, replay.steps, pace="realtime")
        start, ended = time.monotonic(), ""
        for step in replay.replay_steps():
            ended = self._send(step)
            if ended:
                break
            progress(f"{replay.node} answers", step.step + 1)
        wall = time.monotonic() - start
        player.listen_for(LAST)
        player.say(State.DONE)
        gatherer = SeriesGatherer(self._answer, self._experiment, len(self._raws))
        none = [0] * len(self._raws)
        gatherer.take(MessageBlock.of(none, none, self._raws))
        return Answers(gatherer.series(), self._estimates.series(), wall, ended)

    def _send(self, step: ReplayStep) -> str:
        """Send the messages of a step and wait for its answer; return why none comes, if so."""
        player, replay = self.player, self._replay
        if step.ramps:
            player.say(State.RAMPING_DOWN, replay.steps, pace="realtime")
        for topic, raw in step.messages:
            player.send(topic, raw)
        started = sent = time.monotonic()
        while self._answered < step.step:
            if player.listen(POLL):
                continue
            for how in self._processes.ended().values():
                raise ExperimentError(f"{how} (at step {step.step})")
            now = time.monotonic()
            status = player.status.get(replay.node)
            if status and status.values.get("phase") == TRIPPED and now - started > AGAIN:
                return status.message
            if now - started > ANSWER_TIMEOUT:
                refused = status.values.get("refused", "0") if status else "0"
                count = f"; it refused {refused} messages" if refused != "0" else ""
                name = replay.answer.name
                return f"no {name} of step {step.step} within {ANSWER_TIMEOUT:g} s{count}"
            if now - sent > AGAIN:
                sent = now
                for topic, raw in step.messages:
                    if not topic.latched:
                        player.send(topic, raw)
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
        self._answered = max(self._answered, self._codec.decode(raw)[0])  # or WireError
