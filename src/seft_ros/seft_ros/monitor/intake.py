"""The samples of one test after another: from messages of the loop to a history."""

from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError
from seft_msgs_py.experiment import Experiment
from seft_msgs_py.timebase import Timebase
from seft_msgs_py.topics import GROUND_MOTION, REFERENCE_FORCE, RIG_STATE, LoopTopic
from seft_msgs_py.trajectory import TrajectoryCodec
from seft_msgs_py.trajectory_batch import Batch, decode_batch
from seft_plant_sim.running_response import RunningResponse

from seft_ros.monitor.envelope import Samples
from seft_ros.monitor.history import History, Stretch
from seft_ros.monitor.live_reference import LiveReference
from seft_ros.monitor.signals import MEASURED, ROWS, Signals

HELD_BACK = 8
"""Steps that wait for what answers them."""
LONGEST_GAP = 2**14
"""Steps; beyond, the history goes on as if nothing had been before."""

Floats = npt.NDArray[np.float64]
Steps = npt.NDArray[np.int64]
Messages = list[tuple[bytes, int]]


class Intake:
    """Takes in the loop's messages of a graph, one test after another.

    Attributes
    ----------
    number : int
        Counts the tests seen; 0: none yet.
    history : History
        Of the newest test.
    signals : Signals
        Its columns.
    refused : int
        Messages that were not understood.
    reference_note : str
        Why there is no exact response, in a sentence; empty if there is one.
    """

    def __init__(self, axes: tuple[str, ...], timebase: Timebase, number: int = 0) -> None:
        self.timebase = timebase
        self.signals = Signals(axes)
        self.history = History(self.signals.count)
        self.number, self.refused = number, 0
        self.reference_note = ""
        self._expected = True  # whether the next sample may be the first of a test
        self._new: list[Stretch] = []
        self._sections: dict[str, dict[str, Any]] = {}
        self._reference = LiveReference()
        topics = (RIG_STATE, REFERENCE_FORCE, GROUND_MOTION)
        self._codecs = {topic.name: TrajectoryCodec(topic, axes, timebase) for topic in topics}
        self._sent = np.zeros(2**14, np.int64)  # ns, when the states of the last steps were
        self._sent_step = np.full(2**14, -1)

    def describe(self, sections: dict[str, dict[str, Any]]) -> None:
        """Take in the parameters of the nodes; they hold from the next test on."""
        self._sections = sections
        if self.number and self._reference.response is None:
            self._reference.response = self._response()  # of who came up in the middle of a test

    def expect(self) -> None:
        """Take in that a test begins: the next sample is its first that is seen."""
        self._expected = True

    def motion(self, messages: Messages) -> None:
        """Take in ground motion."""
        codec = self._codecs[GROUND_MOTION.name]
        for raw, _ in messages:
            try:
                first, values = codec.decode(raw)
            except InputError:
                self.refused += 1
            else:
                self._reference.motion(first, values[:, 0, :])

    def samples(self, states: Messages, forces: Messages) -> list[Stretch]:
        """Take in what came of the rig's states and of reference forces.

        Returns
        -------
        list of Stretch
            What of the history is new, and will not change.
        """
        self._new = []
        for part, sent in self._batches(RIG_STATE, states):
            jumps = np.diff(part.steps)
            cuts = np.flatnonzero((jumps < 0) | (jumps > LONGEST_GAP)) + 1
            for piece in np.split(np.arange(len(sent)), cuts):
                if len(piece):
                    self._take_states(part.steps[piece], part.values[piece], sent[piece])
        for part, sent in self._batches(REFERENCE_FORCE, forces):
            self._take_forces(part.steps, part.values[:, 0].astype(np.float32), sent)
        self._advance_reference()
        self._release(HELD_BACK if states else 0)
        return self._new

    def _release(self, held_back: int) -> None:
        stretch = self.history.release(self.history.head - held_back)
        if stretch is not None:
            self._new.append(stretch)

    def _batches(self, topic: LoopTopic, messages: Messages) -> list[tuple[Batch, Steps]]:
        """Decode messages, those of equal length together; with the time each was sent."""
        found, start = [], 0
        for end in range(1, len(messages) + 1):
            if end < len(messages) and len(messages[end][0]) == len(messages[start][0]):
                continue
            raws = [raw for raw, _ in messages[start:end]]
            rows = np.frombuffer(b"".join(raws), np.uint8).reshape(end - start, -1)
            batch = decode_batch(self._codecs[topic.name], rows).up_to(0)
            self.refused += batch.refused
            sent = np.array([sent for _, sent in messages[start:end]], np.int64)
            found.append((batch, sent[batch.messages]))
            start = end
        return found

    def _take_states(self, steps: Steps, values: Floats, sent: Steps) -> None:
        """Take in states of increasing steps without long gaps."""
        first = int(steps[0])
        if not self.number or (first < self.history.head and (self._expected or first == 0)):
            self._begin(first)
        elif first < self.history.head:
            return  # of somebody else
        elif first > self.history.head + LONGEST_GAP:
            self._release(0)
            self.history.begin(first)
        self._expected = False
        for name, row in zip(MEASURED, ROWS, strict=True):
            part = values[:, row].astype(np.float32)
            self.history.write(steps, self.signals.measured[name], part)
        slots = steps % len(self._sent)
        self._sent[slots], self._sent_step[slots] = sent, steps

    def _take_forces(self, steps: Steps, forces: Samples, sent: Steps) -> None:
        near = steps < self.history.head  # those ahead are of a state that is not here
        steps, forces, sent = steps[near], forces[near], sent[near]
        self.history.write(steps, self.signals.reference["force"], forces)
        slots = steps % len(self._sent)
        known = self._sent_step[slots] == steps
        times = np.where(known, (sent - self._sent[slots]) / 1e6, np.nan).astype(np.float32)
        times[times < 0.0] = np.nan  # clocks of two hosts
        self.history.write(steps, self.signals.answer, times[:, np.newaxis])

    def _begin(self, first: int) -> None:
        self.number += 1
        self.history = History(self.signals.count)
        self.history.begin(first)
        self._new = []
        self._sent_step[:] = -1
        self._reference.begin(self._response())

    def _response(self) -> RunningResponse | None:
        """Make the model of the whole structure, of what the nodes say of themselves."""
        self.reference_note, nothing = "", "No response of the whole structure: "
        if "reference_force" not in self._sections:
            self.reference_note = f"{nothing}reference_force has not described itself."
            return None
        try:
            response = RunningResponse(Experiment(self._sections))
        except InputError as error:
            self.reference_note = f"{nothing}{error}."
        except (KeyError, TypeError, ValueError):  # of a node of another version
            self.reference_note = f"{nothing}the nodes' parameters do not describe it."
        else:
            if not response.exact:
                self.reference_note = "The specimen yields: its response is near the exact one."
            return response
        return None

    def _advance_reference(self) -> None:
        new = self._reference.advance(self.history.head)
        if new is None:
            return
        first, displacement, acceleration = new
        steps = np.arange(first, first + len(displacement))
        for name, values in (("displacement", displacement), ("acceleration", acceleration)):
            self.history.write(steps, self.signals.reference[name], values.astype(np.float32))
