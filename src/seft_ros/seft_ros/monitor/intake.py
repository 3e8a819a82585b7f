"""Samples of one test after another: from messages of the loop to a history."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import Floats
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import GROUND_MOTION, REFERENCE_FORCE, RIG_STATE, Timebase, rigs_of
from seft_msgs_py.wire.trajectory import TrajectoryCodec, decode_batch
from seft_plant_sim.whole_structure import RunningResponse

from seft_ros.monitor.history import ROWS, Batch, History, RigBatches, Signals, Steps, Stretch
from seft_ros.monitor.live_response import LiveMotion, LiveReference

HELD_BACK = 8
"""Steps that wait for their reference force."""
LONGEST_GAP = 2**14
"""Steps; after a longer gap the history begins anew."""

Messages = list[tuple[bytes, int]]


class Intake:
    """Takes in the loop's messages of a graph, one test after another.

    Parameters
    ----------
    axes : tuple of str
        Names of the axes.
    timebase : Timebase
        Sampling clock.
    number : int
        Tests seen so far.

    Attributes
    ----------
    rigs : tuple of RigAxes
        Whose the axes are.
    number : int
        Counts the tests seen; 0: none yet.
    history : History
        Of the newest test.
    signals : Signals
        Its columns.
    refused : int
        Messages that could not be decoded.
    reference_note : str
        Why there is no reference response, in a sentence; empty if there is one.
    own_motion : dict
        The test's own ground motion so far, of `LiveMotion.summary`, once a second.
    """

    def __init__(self, axes: tuple[str, ...], timebase: Timebase, number: int = 0) -> None:
        self.timebase = timebase
        self.signals = Signals(axes)
        self.history = History(self.signals.count)
        self.number, self.refused = number, 0
        self.reference_note = ""
        self._expected = True  # whether the next sample may be the first of a test
        self._cleared = False  # whether nothing has been seen of the test that is counted
        self._new: list[Stretch] = []
        self._sections: dict[str, dict[str, Any]] = {}
        self._reference = LiveReference()
        self.own_motion: dict[str, Any] = {}
        self._live_motion: LiveMotion | None = None
        self._next_told = 0
        self.rigs = rigs_of(axes)
        self._states = [TrajectoryCodec(RIG_STATE, rig.axes, timebase) for rig in self.rigs]
        self._forces = TrajectoryCodec(REFERENCE_FORCE, axes, timebase)
        self._motion = TrajectoryCodec(GROUND_MOTION, axes, timebase)
        self._of_rigs = RigBatches(self.rigs) if len(self.rigs) > 1 else None
        # of the last steps, by step modulo length:
        self._steps = np.full(2**14, -1)
        self._recent = np.full((2**14, 4, len(axes)), np.nan)  # states
        self._sent = np.zeros(2**14, np.int64)  # ns, when they were

    def describe(self, sections: dict[str, dict[str, Any]]) -> None:
        """Take in the parameters of the nodes; they hold from the next test on."""
        self._sections = sections
        if self.number and self._reference.response is None:
            self._reference.response = (
                self._response()
            )  # the monitor started in the middle of a test
            self._follow_motion()

    def clear(self) -> None:
        """Forget the last test; the next sample is the first that is seen of another."""
        self.number += 1
        self.history = History(self.signals.count)
        self.own_motion = {}
        self._cleared = self._expected = True

    def motion(self, messages: Messages) -> None:
        """Take in ground motion."""
        for raw, _ in messages:
            try:
                first, values = self._motion.decode(raw)
            except InputError:
                self.refused += 1
            else:
                self._reference.motion(first, values[:, 0, :])

    def samples(self, states: Sequence[Messages], forces: Messages) -> list[Stretch]:
        """Take in states of each rig and reference forces; give what is new in the history."""
        self._new = []
        for steps, values, sent in self._batches_of_states(states):
            jumps = np.diff(steps)
            cuts = np.flatnonzero((jumps < 0) | (jumps > LONGEST_GAP)) + 1
            for piece in np.split(np.arange(len(sent)), cuts):
                if len(piece):
                    self._take_states(steps[piece], values[piece], sent[piece])
        for steps, values, sent in self._batches(self._forces, forces):
            self._take_forces(steps, values[:, 0], sent)
        self._advance_reference()
        self._release(HELD_BACK if any(states) else 0)
        return self._new

    def _release(self, held_back: int) -> None:
        signals, until = self.signals, self.history.head - held_back
        for name, error in signals.error.items():
            self.history.subtract(until, error, signals.measured[name], signals.reference[name])
        stretch = self.history.release(until)
        if stretch is not None:
            self._new.append(stretch)

    def _batches_of_states(self, states: Sequence[Messages]) -> Iterator[Batch]:
        """Decode states; of several rigs, give what is there of all."""
        for rig, (codec, messages) in enumerate(zip(self._states, states, strict=True)):
            for batch in self._batches(codec, messages):
                if self._of_rigs is None:
                    yield batch
                else:
                    self._of_rigs.take(rig, batch)
        if self._of_rigs is not None:
            yield self._of_rigs.complete()

    def _batches(self, codec: TrajectoryCodec, messages: Messages) -> Iterator[Batch]:
        """Decode messages, those of equal length together; of each its own step counts."""
        for _, alike in groupby(messages, lambda message: len(message[0])):
            raws, sent = zip(*alike, strict=True)
            rows = np.frombuffer(b"".join(raws), np.uint8).reshape(len(raws), -1)
            batch = decode_batch(codec, rows).up_to(0)
            self.refused += batch.refused
            yield batch.steps, batch.values, np.array(sent, np.int64)[batch.messages]

    def _take_states(self, steps: Steps, values: Floats, sent: Steps) -> None:
        """Take in states of increasing steps without long gaps."""
        first = int(steps[0])
        if (
            not self.number
            or self._cleared
            or (first < self.history.head and (self._expected or first == 0))
        ):
            self._begin(first)
        elif first < self.history.head:
            return  # of another rig
        elif first > self.history.head + LONGEST_GAP:
            self._release(0)
            self.history.begin(first)
        self._expected = False
        for name, row in ROWS.items():
            self.history.write(steps, self.signals.measured[name], values[:, row])
        slots = steps % len(self._steps)
        self._steps[slots], self._recent[slots], self._sent[slots] = steps, values, sent

    def _take_forces(self, steps: Steps, forces: Floats, sent: Steps) -> None:
        near = steps < self.history.head  # the states of those ahead have not arrived
        steps, forces, sent = steps[near], forces[near], sent[near]
        self.history.write(steps, self.signals.reference["force"], forces)
        slots = steps % len(self._steps)
        times = (sent - self._sent[slots]) / 1e6
        known = (self._steps[slots] == steps) & (times >= 0.0)  # else clocks of two hosts
        times = np.where(known, times, np.nan)
        self.history.write(steps, self.signals.answer, times[:, np.newaxis])

    def _begin(self, first: int) -> None:
        self.number += not self._cleared
        self._cleared = False
        self.history = History(self.signals.count)
        self.history.begin(first)
        self._new = []
        self._steps[:] = -1
        self._reference.begin(self._response())
        self._follow_motion()

    def _follow_motion(self) -> None:
        self.own_motion, self._next_told = {}, 0
        known = self._reference.response is not None
        self._live_motion = LiveMotion.of(Experiment(self._sections)) if known else None

    def _response(self) -> RunningResponse | None:
        """Make the model of the whole structure, of what the nodes say of themselves."""
        if "reference_force" not in self._sections:
            reason = "reference_force has not described itself"
        else:
            try:
                response = RunningResponse(Experiment(self._sections))
                note = "The specimen yields: its response is near the exact one."
                self.reference_note = "" if response.exact else note
                return response
            except InputError as error:
                reason = str(error)
            except (KeyError, TypeError, ValueError):  # a node of another version
                reason = "the nodes' parameters do not describe it"
        self.reference_note = f"No response of the whole structure: {reason}."
        return None

    def _advance_reference(self) -> None:
        new = self._reference.advance(self.history.head)
        if new is None:
            return
        first, motion, displacement, acceleration = new
        steps = np.arange(first, first + len(motion))
        for name, values in (("displacement", displacement), ("acceleration", acceleration)):
            self.history.write(steps, self.signals.reference[name], values)
        if self._live_motion is None:
            return
        slots = steps % len(self._steps)
        known = self._steps[slots] == steps
        states = np.where(known[:, np.newaxis, np.newaxis], self._recent[slots], np.nan)
        self._live_motion.advance(motion, states)
        if steps[-1] >= self._next_told:
            self._next_told = int(steps[-1]) + round(1 / self.timebase.dt)
            self.own_motion = self._live_motion.summary()
