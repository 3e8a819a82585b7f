"""The parts of supervisor and force controller, played for a rig that is looked at."""

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from seft_msgs_py.errors import ExperimentError, InputError, WireError
from seft_msgs_py.wire.messages import Status, decode_clock, decode_description
from seft_msgs_py.wire.outcome import FINISHED, TRIPPED
from seft_msgs_py.wire.topics import (
    CLOCK_TOPIC,
    DESCRIPTION,
    EXPERIMENT_STATE,
    LOOP_TOPICS,
    RIG_STATE,
    LoopTopic,
)
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.conformance.facts import Facts
from seft_ros.conformance.guard import Guard
from seft_ros.conformance.trial import Trial
from seft_ros.experiment.state_machine import State
from seft_ros.running.player import Player

FOUND = 20.0  # s until the rig is found
LOOK = 0.02  # s
NOTED = 0.15  # s for the rig to take in a state
ATTEMPTS = 3
"""Tests that are run until one goes as planned: this host may stand still meanwhile."""
SLOW = 10.0  # s more than planned that a test may take
ENDED = 2.0  # s for it to say that it has ended, and that it is idle again
Answer = Callable[[int], list[bytes]]
"""Gives the messages that answer a step."""


class Conductor:
    """Runs short tests on a rig, and writes down what it does.

    Parameters
    ----------
    facts : Facts
        The rig.
    guard : Guard
        Looks at each sample.
    alive : callable
        Raises where the rig's process has ended, if it is known.
    """

    def __init__(self, facts: Facts, guard: Guard, alive: Callable[[], None]) -> None:
        self._facts, self._guard, self._alive = facts, guard, alive
        experiment = facts.experiment
        self.description: Mapping[str, Any] | None = None
        self.trial = Trial()
        self._codec = TrajectoryCodec(RIG_STATE, experiment.axes, experiment.timebase)
        self._answer: Answer | None = None
        self._topic: LoopTopic | None = None
        hears = {
            RIG_STATE: self._on_state,
            CLOCK_TOPIC: self._on_clock,
            DESCRIPTION: self._on_description,
        }
        self.player = Player("seft_conform", [], hears)
        self.player.on_status = self._on_status

    def meet(self, duration: float) -> Trial:
        """Find the rig and listen to it for some time, while nothing is asked of it.

        Raises
        ------
        InputError
            If no node rig publishes rig/state.
        """
        deadline = time.monotonic() + FOUND
        self.player.say(State.IDLE)
        while not self._is_found():
            self.player.listen_for(LOOK)
            self._alive()
            if time.monotonic() > deadline:
                raise InputError(
                    f"no node rig with rig/state and experiment/state within {FOUND:g} s; start "
                    "it on this ROS domain, or use --start-rig for the simulated one"
                )
        self.trial = Trial()
        self.player.listen_for(duration)
        return self.trial

    def connect(self, drive: str) -> None:
        """Be the one whose commands drive the rig; wait until it hears them."""
        self._topic = next(topic for topic in LOOP_TOPICS if topic.name == drive)
        axes, timebase = self._facts.experiment.axes, self._facts.experiment.timebase
        self._commands = TrajectoryCodec(self._topic, axes, timebase)
        self.player.publish_on(self._topic)
        deadline = time.monotonic() + FOUND
        while not self.player.is_matched("rig", [EXPERIMENT_STATE, self._topic], [RIG_STATE]):
            self.player.listen_for(LOOK)
            self._alive()
            if time.monotonic() > deadline:
                raise ExperimentError(f"the rig does not listen to {drive} within {FOUND:g} s")

    def command(self, step: int, value: float) -> bytes:
        """Make the message that answers a step with the same command for each axis."""
        return self._commands.encode(step, np.full(len(self._commands.axes), value))

    def run(
        self,
        steps: int,
        answer: Answer,
        until: Callable[[Trial], bool],
        patience: float,
        ready: bool = True,
    ) -> Trial:
        """Run a test until something has been seen, the time is over, or the guard says stop.

        Parameters
        ----------
        steps : int
            That the test is said to have.
        answer : callable
            What answers each step.
        until : callable
            Whether enough has been seen.
        patience : float
            Longest time of the test, s.
        ready : bool
            Whether ready is said before.
        """
        self.trial = trial = Trial()
        self._guard.reset()
        if ready:
            self.player.say(State.READY)
            self.player.listen_for(NOTED)
        self._answer = answer
        self.mark("running")
        self.player.say(State.RUNNING, steps, pace="realtime")
        deadline = time.monotonic() + patience
        while not until(trial) and not trial.fault and time.monotonic() < deadline:
            self.player.listen(LOOK)
            self._alive()
        if trial.fault:
            self.player.say(State.TRIPPED)
        return trial

    def mark(self, name: str) -> None:
        """Note when something is done."""
        self.trial.marks[name] = time.monotonic()

    def say(self, state: State) -> None:
        """Say a state of the test, and note when."""
        self.mark(state)
        self.player.say(state)

    def listen(self, duration: float) -> None:
        """Hear the rig for some time; what it publishes is answered as before."""
        self.player.listen_for(duration)

    def end(self, state: State = State.DONE) -> None:
        """End a test, and bring the rig back to idle."""
        self.player.say(state)
        self._wait(lambda: self.trial.phase in (FINISHED, TRIPPED, "idle"))
        self._answer = None
        self.player.say(State.IDLE)
        self._wait(lambda: self.trial.phase == "idle")

    def close(self) -> None:
        """Leave the rig at rest, and the graph."""
        try:
            self.player.say(State.IDLE)
        except ExperimentError:
            pass
        finally:
            self.player.close()

    def _wait(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + ENDED
        while not condition() and time.monotonic() < deadline:
            self.player.listen(LOOK)

    def _is_found(self) -> bool:
        known = self.description is not None and "rig" in self.player.status
        return known and self.player.is_matched("rig", [EXPERIMENT_STATE], [RIG_STATE])

    def _on_state(self, raw: bytes, at: float, sent: float) -> None:
        self.trial.states.append((at, raw))
        self.trial.sent.append(sent)
        if self._answer is None or self._topic is None:
            return
        try:
            step, values = self._codec.decode(raw)
        except WireError:
            return  # what can't be read can't be answered
        for message in self._answer(step):
            self.player.send(self._topic, message)
        self.trial.fault = self.trial.fault or self._guard.fault(values[0])

    def _on_clock(self, raw: bytes, at: float, sent: float) -> None:
        del sent
        try:
            self.trial.clocks.append((at, decode_clock(raw)))
        except WireError:
            return

    def _on_description(self, raw: bytes, at: float, sent: float) -> None:
        del at, sent
        try:
            node, description = decode_description(raw)
        except WireError:
            return
        if node == "rig":
            self.description = description

    def _on_status(self, status: Status, at: float) -> None:
        if status.name == "rig":
            self.trial.statuses.append((at, status))
