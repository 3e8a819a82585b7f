"""Samples of a test as a monitor shows them: the signals, and the states of several rigs."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.wire.topics import RIG_STATE, RigAxes

Floats = npt.NDArray[np.float64]
Steps = npt.NDArray[np.int64]
Batch = tuple[Steps, Floats, Steps]
"""Steps, values of shape (N, 4, axes), and when each was sent, ns."""

MOST_WAITING = 2**14
"""Steps of a rig that are kept while another is silent."""
MEASURED = {"displacement": "positions", "acceleration": "accelerations", "force": "effort"}
ROWS = {name: RIG_STATE.quantities.index(quantity) for name, quantity in MEASURED.items()}
"""Rows of a sample of rig/state that are shown."""
FOLLOWED = ("displacement", "force")
"""Of which the error is shown, too."""


class Signals:
    """Columns of a history over n axes: measured, reference, their error, the answer's time.

    Attributes
    ----------
    axes : tuple of str
        Names of the n axes.
    measured, reference : dict of str to slice
        Columns of a quantity in `ROWS`, one an axis; m, m/s^2, N.
    error : dict of str to slice
        Columns of measured less reference, of the quantities in `FOLLOWED`.
    answer : slice
        Time from a state's publication to that of its reference force, ms.
    count : int
        Number of columns.
    """

    def __init__(self, axes: tuple[str, ...]) -> None:
        n, self.axes = len(axes), axes
        starts = {name: 2 * number * n for number, name in enumerate(ROWS)}
        self.measured = {name: slice(start, start + n) for name, start in starts.items()}
        self.reference = {name: slice(start + n, start + 2 * n) for name, start in starts.items()}
        errors = {name: (2 * len(ROWS) + number) * n for number, name in enumerate(FOLLOWED)}
        self.error = {name: slice(start, start + n) for name, start in errors.items()}
        self.count = (2 * len(ROWS) + len(FOLLOWED)) * n + 1
        self.answer = slice(self.count - 1, self.count)

    def layout(self) -> dict[str, Any]:
        """Give the first column of each signal, for the page."""
        return {
            "axes": list(self.axes),
            "measured": {name: part.start for name, part in self.measured.items()},
            "reference": {name: part.start for name, part in self.reference.items()},
            "error": {name: part.start for name, part in self.error.items()},
            "answer": self.answer.start,
        }


class RigBatches:
    """Keeps what rigs have sent until all have sent the same step.

    Parameters
    ----------
    rigs : sequence of RigAxes
        The rigs of the test.
    """

    def __init__(self, rigs: Sequence[RigAxes]) -> None:
        self._rigs = tuple(rigs)
        self._waiting: list[Batch] = [_none(len(rig.axes)) for rig in rigs]

    def take(self, rig: int, batch: Batch) -> None:
        """Take in what a rig has sent; a step before its last begins a new test for it."""
        steps, before = batch[0], self._waiting[rig]
        (back,) = np.nonzero(np.diff(np.concatenate([before[0][-1:], steps])) <= 0)
        if len(back):
            first = int(back[-1]) + (0 if len(before[0]) else 1)
            before, batch = _none(len(self._rigs[rig].axes)), _rows(batch, slice(first, None))
        joined = [np.concatenate(pair) for pair in zip(before, batch, strict=True)]
        self._waiting[rig] = _rows((joined[0], joined[1], joined[2]), slice(-MOST_WAITING, None))

    def complete(self) -> Batch:
        """Give the steps that all rigs have sent by now, once."""
        steps = self._waiting[0][0]
        for other, _, _ in self._waiting[1:]:
            steps = np.intersect1d(steps, other, assume_unique=True)
        values = np.empty((len(steps), 4, sum(len(rig.axes) for rig in self._rigs)))
        sent = np.zeros(len(steps), np.int64)
        for number, (rig, batch) in enumerate(zip(self._rigs, self._waiting, strict=True)):
            at = np.searchsorted(batch[0], steps)
            values[:, :, list(rig.places)] = batch[1][at]
            np.maximum(sent, batch[2][at], out=sent)
            if len(steps):
                passed = int(np.searchsorted(batch[0], steps[-1], side="right"))
                self._waiting[number] = _rows(batch, slice(passed, None))
        return steps, values, sent


def _none(axes: int) -> Batch:
    return np.zeros(0, np.int64), np.zeros((0, 4, axes)), np.zeros(0, np.int64)


def _rows(batch: Batch, rows: slice) -> Batch:
    return batch[0][rows], batch[1][rows], batch[2][rows]
