"""Samples of successive tests: from messages to a history, with their reference."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import GROUND_MOTION, REFERENCE_FORCE, RIG_STATE, Timebase, rigs_of
from seft_msgs_py.wire.trajectory import TrajectoryCodec, decode_batch
from seft_plant_sim.whole_structure import RunningResponse, whole_structure

from seft_ros.analysis import equivalent_motion
from seft_ros.analysis.summary import COMPARED
from seft_ros.ground_motion.response_spectrum import RunningSpectrum
from seft_ros.monitor.history import History, HistoryBatch, RigBatches, Signals, Stretch
from seft_ros.reference_force.reference_force_block import MotionBuffer

_MAX_AT_ONCE = 4000
"""Steps: some milliseconds of work, also while it catches up with a test."""


class LiveReference:
    """Follows the ground motion of successive tests.

    The first part of a test's motion arrives before the test begins; a monitor that starts later
    receives all of it if the publisher still has all.

    Attributes
    ----------
    response : RunningResponse or None
        None: the structure is not known.
    """

    def __init__(self) -> None:
        self.response: RunningResponse | None = None
        self._now: MotionBuffer | None = None
        self._next: MotionBuffer | None = None  # of the next test, or of one without any yet
        self._used = 0  # steps of the running test's

    def begin(self, response: RunningResponse | None) -> None:
        """Begin a test."""
        self.response = response
        if self._used:
            self._now, self._used = None, 0

    def motion(self, first: int, values: Floats) -> None:
        """Add ground motion from a step on, shape (N, n), m/s^2."""
        if first == 0:
            self._next = MotionBuffer(values.shape[1])
        newest = self._next or self._now
        if newest is not None:
            newest.add(first, values)

    def advance(self, until: int) -> tuple[int, Floats, Floats, Floats] | None:
        """Continue to a step, as far as the motion is known and time allows.

        Returns
        -------
        first : int
            Step from which the response is new.
        motion, displacement, acceleration : ndarray
            Ground motion and response to it, shape (N, n), m and m/s^2; None if there is nothing
            new.
        """
        if self._now is None and self.response is not None:
            self._now, self._next = self._next, None
        if self._now is None or self.response is None:
            return None
        first = self._used
        until = min(until, first + _MAX_AT_ONCE, self._now.end)
        motion = self._now.window(first, until - first) if until > first else None
        if motion is None:
            return None
        self._now.drop_before(until)
        self._used = until
        return first, motion, *self.response.advance(motion)


class LiveMotion:
    """Follows a test's equivalent ground motion: its spectrum, and a linear structure's response.

    Parameters
    ----------
    assumed : Experiment
        Assumed structure, see `assumed_structure`.
    """

    def __init__(self, assumed: Experiment) -> None:
        dt, whole = assumed.timebase.dt, whole_structure(assumed)
        self._equivalent = equivalent_motion.EquivalentMotion(whole, dt)
        self._responses = RunningResponse(assumed), RunningResponse(assumed)
        self._natural, _ = whole.structure.modes()
        ends = self._natural[0], self._natural[-1]
        self._frequency = equivalent_motion.spectrum_frequencies(ends, dt)
        self._spectra = RunningSpectrum(1 / self._frequency, dt, equivalent_motion.DAMPING)
        self._squares = np.zeros(2)  # of the response, and of the difference

    def advance(self, asked: Floats, states: Floats) -> None:
        """Continue over the next N steps.

        Parameters
        ----------
        asked : ndarray
            Requested ground acceleration, shape (N, n), m/s^2.
        states : ndarray
            Measured states, shape (N, 4, n); NaN if missing: then the motion is assumed to be the
            requested one.
        """
        missing = ~np.isfinite(states).all(axis=(1, 2))
        tested = self._equivalent.advance(np.where(missing[:, None, None], 0.0, states))
        tested[missing] = asked[missing]
        of_asked, of_tested = self._responses
        wanted, found = of_asked.advance(asked)[0], of_tested.advance(tested)[0]
        with np.errstate(over="ignore", invalid="ignore"):  # of an unstable test
            self._squares += [np.sum(wanted**2), np.sum((found - wanted) ** 2)]
            self._spectra.advance(np.hstack([asked, tested]))

    def summary(self) -> dict[str, Any]:
        """Give the values for the page, JSON values."""
        response, difference = self._squares
        spectra = self._spectra.spectrum.T
        if not (response > 0 and np.isfinite(difference) and np.isfinite(spectra).all()):
            return {}
        asked, tested = np.split(np.round(spectra, 4), 2)
        return {
            "response_nrmse": float(np.sqrt(difference / response)),
            "natural_hz": self._natural.tolist(),
            "frequency_hz": np.round(self._frequency, 4).tolist(),
            "asked": asked.tolist(),
            "tested": tested.tolist(),
        }


HELD_BACK = 8
"""Number of steps that wait for their reference force."""
_LONGEST_GAP = 2**14
"""Steps; after a longer gap a new history begins."""

Messages = list[tuple[bytes, int]]


class Intake:
    """Reads the loop's messages of a graph, for successive tests.

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
        Rigs of the axes.
    number : int
        Counts the tests; 0: none yet.
    history : History
        Of the newest test.
    signals : Signals
        Columns of the history.
    refused : int
        Messages that could not be decoded.
    reference_note : str
        Reason without a reference response, in a sentence; empty with one.
    own_motion : dict
        The test's equivalent ground motion so far, of `LiveMotion.summary`, once a second.
    """

    def __init__(self, axes: tuple[str, ...], timebase: Timebase, number: int = 0) -> None:
        self.timebase, self.signals = timebase, Signals(axes)
        self.history = History(self.signals.count)
        self.number, self.refused, self.reference_note = number, 0, ""
        self._cleared = False  # whether no sample of the counted test has arrived
        self._new: list[Stretch] = []
        self._sections: dict[str, dict[str, Any]] = {}
        self._reference = LiveReference()
        self.own_motion: dict[str, Any] = {}
        self._live_motion: LiveMotion | None = None
        self._next_shown = 0
        self.rigs = rigs_of(axes)
        self._states = [TrajectoryCodec(RIG_STATE, rig.axes, timebase) for rig in self.rigs]
        self._forces = TrajectoryCodec(REFERENCE_FORCE, axes, timebase)
        self._motion = TrajectoryCodec(GROUND_MOTION, axes, timebase)
        self._of_rigs = RigBatches(self.rigs) if len(self.rigs) > 1 else None
        # of the last steps, by step modulo length:
        self._steps = np.full(2**14, -1)
        self._recent = np.full((2**14, 4, len(axes)), np.nan)  # states
        self._sent = np.zeros(2**14, np.int64)  # ns, times of sending

    def describe(self, sections: dict[str, dict[str, Any]]) -> None:
        """Use the parameters of the nodes from the next test on."""
        self._sections = sections
        if self.number and self._reference.response is None:  # it started in the middle of a test
            self._reference.response = self._response()

    def clear(self) -> None:
        """Forget the last test; the next sample is the first of another."""
        self.number += 1
        self.history = History(self.signals.count)
        self.own_motion = {}
        self._cleared = True

    def motion(self, messages: Messages) -> None:
        """Add ground motion."""
        for raw, _ in messages:
            try:
                first, values = self._motion.decode(raw)
                self._reference.motion(first, values[:, 0, :])
            except InputError:
                self.refused += 1

    def samples(self, states: Sequence[Messages], forces: Messages) -> list[Stretch]:
        """Add states of each rig and reference forces; give the new part of the history."""
        self._new = []
        for steps, values, sent in self._batches_of_states(states):
            jumps = np.diff(steps)
            cuts = np.flatnonzero((jumps < 0) | (jumps > _LONGEST_GAP)) + 1
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
        if stretch := self.history.release(until):
            self._new.append(stretch)

    def _batches_of_states(self, states: Sequence[Messages]) -> Iterator[HistoryBatch]:
        """Decode states; with several rigs, give the steps of all rigs."""
        for rig, (codec, messages) in enumerate(zip(self._states, states, strict=True)):
            for batch in self._batches(codec, messages):
                if self._of_rigs is None:
                    yield batch
                else:
                    self._of_rigs.take(rig, batch)
        if self._of_rigs is not None:
            yield self._of_rigs.complete()

    def _batches(self, codec: TrajectoryCodec, messages: Messages) -> Iterator[HistoryBatch]:
        """Decode messages, those of equal length together; use the first point of each."""
        for _, alike in groupby(messages, lambda message: len(message[0])):
            raws, sent = zip(*alike, strict=True)
            rows = np.frombuffer(b"".join(raws), np.uint8).reshape(len(raws), -1)
            batch = decode_batch(codec, rows).up_to(0)
            self.refused += batch.refused
            yield batch.steps, batch.values, np.array(sent, np.int64)[batch.messages]

    def _take_states(self, steps: Ints, values: Floats, sent: Ints) -> None:
        """Add states of increasing steps without long gaps."""
        first = int(steps[0])
        if not self.number or self._cleared or first == 0 < self.history.head:
            self._begin(first)
        elif first < self.history.head:
            return  # of another rig
        elif first > self.history.head + _LONGEST_GAP:
            self._release(0)
            self.history.begin(first)
        for name, row in COMPARED.items():
            self.history.write(steps, self.signals.measured[name], values[:, row])
        slots = steps % len(self._steps)
        self._steps[slots], self._recent[slots], self._sent[slots] = steps, values[:, :4], sent

    def _take_forces(self, steps: Ints, forces: Floats, sent: Ints) -> None:
        near = steps < self.history.head  # the states of those ahead have not arrived
        steps, forces, sent = steps[near], forces[near], sent[near]
        self.history.write(steps, self.signals.reference["force"], forces)
        slots = steps % len(self._steps)
        times = (sent - self._sent[slots]) / 1e6
        known = (self._steps[slots] == steps) & (times >= 0.0)  # negative: clocks of two hosts
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

    def _response(self) -> RunningResponse | None:
        """Make the models of the whole structure from the nodes' descriptions."""
        self.own_motion, self._next_shown, self._live_motion = {}, 0, None
        reason = "reference_force has not described itself"
        try:
            if "reference_force" in self._sections:
                experiment = Experiment(self._sections)
                response = RunningResponse(experiment)
                assumed = equivalent_motion.assumed_structure(experiment)
                self._live_motion = None if assumed is None else LiveMotion(assumed)
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
        steps, columns = np.arange(first, first + len(motion)), self.signals.reference
        self.history.write(steps, columns["displacement"], displacement)
        self.history.write(steps, columns["acceleration"], acceleration)
        if self._live_motion is None:
            return
        slots = steps % len(self._steps)
        known = self._steps[slots] == steps
        states = np.where(known[:, np.newaxis, np.newaxis], self._recent[slots], np.nan)
        self._live_motion.advance(motion, states)
        if steps[-1] >= self._next_shown:
            self._next_shown = int(steps[-1]) + round(1 / self.timebase.dt)
            self.own_motion = self._live_motion.summary()
