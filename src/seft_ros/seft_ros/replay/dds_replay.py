"""Replay over DDS: the node is a process of its own, this process plays the others."""

import time
from collections.abc import Callable
from contextlib import closing

from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.wire.outcome import TRIPPED, State
from seft_msgs_py.wire.topics import ESTIMATES, REFERENCE_FORCE, LoopTopic
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.bags.gathering import EstimatesGatherer, points_ahead
from seft_ros.bags.record import series_of
from seft_ros.reference_force.reference_force_parameters import reference_force_topic
from seft_ros.replay.recorded_test import Answers, Replay
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
    with (
        one_node(replay.node, experiment, lockstep=True) as processes,
        closing(_Neighbours(replay, experiment, processes)) as neighbours,
    ):
        return neighbours.answers(progress)


class _Neighbours(Player):
    """Plays the nodes around the one to which a test is replayed, and collects its answers."""

    def __init__(self, replay: Replay, experiment: Experiment, processes: NodeProcesses) -> None:
        self._replay, self._processes = replay, processes
        # with other parameters, a reference force may have become that of a target, or the reverse
        answer = replay.answer
        if answer.name == REFERENCE_FORCE.name:
            answer = reference_force_topic(experiment["reference_force"])
        self._ahead = points_ahead(answer, experiment)
        self._codecs = {
            topic: TrajectoryCodec(topic, experiment.axes, experiment.timebase)
            for topic in (answer, *replay.sends)
        }
        self._codec = self._codecs[answer]
        self._samples: dict[int, Floats] = {}
        self._answered = -1
        self._estimates = EstimatesGatherer(experiment)
        receives = {
            replay.answer: self._on_answer,
            ESTIMATES: lambda raw, *_: self._estimates.take(raw, 0),
        }
        super().__init__("seft_replay", replay.sends, receives)

    def answers(self, progress: Progress) -> Answers:
        """Send the steps one by one, each when the one before is answered."""
        replay, codec = self._replay, self._codec
        self._wait_until_ready()
        self.say(State.READY)
        self.say(State.RUNNING, replay.steps, pace="realtime")
        start, ended = time.monotonic(), ""
        for step, inputs in replay.inputs():
            if step == replay.ramp_step:
                self.say(State.RAMPING_DOWN, replay.steps, pace="realtime")
            messages = [(t, self._codecs[t].encode_points(at, v)) for t, at, v in inputs]
            if ended := self._ask(step, messages):
                break
            progress(f"{replay.node} answers", step + 1)
        wall = time.monotonic() - start
        self.listen_for(LAST)
        self.say(State.DONE)
        series = series_of(self._samples, len(codec.topic.quantities), len(codec.axes))
        return Answers(series, self._estimates.series(), wall, ended)

    def _ask(self, step: int, messages: list[tuple[LoopTopic, bytes]]) -> str:
        """Send the messages of a step and wait for its answer; return why none comes, if so."""
        replay = self._replay
        for topic, raw in messages:
            self.send(topic, raw)
        started = sent = time.monotonic()
        while self._answered < step:
            if self.listen(POLL):
                continue
            for how in self._processes.ended().values():
                raise ExperimentError(f"{how} (at step {step})")
            now = time.monotonic()
            status = self.status.get(replay.node)
            if status and status.values.get("phase") == TRIPPED and now - started > AGAIN:
                return status.message
            if now - started > ANSWER_TIMEOUT:
                refused = status.values.get("refused", "0") if status else "0"
                count = f"; it refused {refused} messages" if refused != "0" else ""
                name = replay.answer.name
                return f"no {name} of step {step} within {ANSWER_TIMEOUT:g} s{count}"
            if now - sent > AGAIN:
                sent = now
                for topic, raw in messages:
                    if not topic.latched:
                        self.send(topic, raw)
        return ""

    def _wait_until_ready(self) -> None:
        replay = self._replay
        deadline = time.monotonic() + READY_TIMEOUT
        while True:
            self.listen_for(POLL)
            for node, how in self._processes.ended().items():
                wrong = self._processes.exit_status(node) == 2
                raise (InputError if wrong else ExperimentError)(how)
            if self.is_matched(replay.node, replay.sends, [replay.answer]):
                return
            if time.monotonic() > deadline:
                raise ExperimentError(f"{replay.node} was not found within {READY_TIMEOUT:g} s")

    def _on_answer(self, raw: bytes, *_: float) -> None:
        first, points = self._codec.decode(raw)  # or WireError
        self._answered = max(self._answered, first)
        for at, point in enumerate(points):
            if at <= self._ahead:
                self._samples.setdefault(first + at, point)
