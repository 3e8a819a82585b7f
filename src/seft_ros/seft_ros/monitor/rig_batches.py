"""States of several rigs as they come to a monitor, put together by step."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from seft_msgs_py.wire.rigs import RigAxes

Floats = npt.NDArray[np.float64]
Steps = npt.NDArray[np.int64]
Batch = tuple[Steps, Floats, Steps]
"""Steps, values of shape (N, 4, axes), and when each was sent, ns."""

MOST_WAITING = 2**14
"""Steps of a rig that are kept while another is silent."""


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
