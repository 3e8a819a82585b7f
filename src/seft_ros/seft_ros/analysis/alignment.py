"""Alignment of samples: common steps of two series, common axes of two records."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import LOOP_TOPICS

from seft_ros.bags.record import Record, Series

Floats = npt.NDArray[np.float64]
Steps = npt.NDArray[np.int64]
Where = slice | npt.NDArray[np.intp]


def common_steps(one: Steps, other: Steps) -> tuple[Steps, Where, Where]:
    """Find the steps that are in both, and their indices in each; both strictly increase.

    Where both are the same, as they mostly are, indices are slices: they copy nothing.
    """
    if np.array_equal(one, other):
        return one, slice(None), slice(None)
    common, in_one, in_other = np.intersect1d(one, other, assume_unique=True, return_indices=True)
    return common, in_one, in_other


def every_step(series: Series, every: Steps) -> Floats:
    """Values at every one of these consecutive steps, shape (N, q, n); lost ones interpolated."""
    if len(every) == 0 or np.array_equal(series.steps[: len(every)], every):
        return series.values[: len(every)]
    flat = series.values.reshape(len(series.steps), -1)
    columns = [np.interp(every, series.steps, column) for column in flat.T]
    return np.stack(columns, axis=1).reshape(len(every), *series.values.shape[1:])


@dataclass(frozen=True)
class Alignment:
    """Common axes of two records, and the grid of instants on which both have steps.

    Attributes
    ----------
    axes : tuple of str
        Common axes, in the order of the first record.
    only : pair of tuple of str
        Axes that one record has and the other has not.
    columns : pair of list of int
        Indices of the common axes in each record.
    every : pair of int
        Steps of each record from one instant of the grid to the next; both 1 at equal rates.
    """

    axes: tuple[str, ...]
    only: tuple[tuple[str, ...], ...]
    columns: tuple[list[int], ...]
    every: tuple[int, ...]

    @classmethod
    def of(cls, a: Record, b: Record) -> Self:
        """Align two records.

        Raises
        ------
        InputError
            If they have no axis in common, or at different rates no instants but the start.
        """
        one, other = a.experiment, b.experiment
        axes = tuple(axis for axis in one.axes if axis in other.axes)
        if not axes:
            raise InputError(
                "the tests can't be compared because they have no axis in common: axes are "
                f"{list(one.axes)} in the first and {list(other.axes)} in the second"
            )
        grid = math.lcm(one.timebase.period_ns, other.timebase.period_ns)
        both = (one, other)
        alignment = cls(
            axes,
            tuple(tuple(axis for axis in test.axes if axis not in axes) for test in both),
            tuple([test.axes.index(axis) for axis in axes] for test in both),
            tuple(grid // test.timebase.period_ns for test in both),
        )
        if alignment.by_time and not alignment._meet(a, b):
            raise InputError(
                f"the tests can't be compared: at {one.timebase.rate:g} Hz in the first and "
                f"{other.timebase.rate:g} Hz in the second they have no samples at the same "
                f"times, which would be {grid * 1e-9:g} s apart"
            )
        return alignment

    @property
    def by_time(self) -> bool:
        """Whether the rates differ, so that steps do not coincide."""
        return self.every[0] != self.every[1]

    def on_grid(self, one: Series, other: Series) -> tuple[Series, Series]:
        """Keep of both the samples at instants of the grid, and the common axes.

        One is of the first record, the other of the second; their steps are of the grid then.
        """
        return self._thinned(one, 0), self._thinned(other, 1)

    def _thinned(self, series: Series, record: int) -> Series:
        every, columns = self.every[record], self.columns[record]
        if every == 1 and columns == list(range(series.values.shape[2])):
            return series
        kept = series.steps % every == 0
        return Series(series.steps[kept] // every, series.values[kept][:, :, columns])

    def _meet(self, a: Record, b: Record) -> bool:
        pairs = (self.on_grid(a.series[t.name], b.series[t.name]) for t in LOOP_TOPICS)
        # the start alone is none
        return any(np.intersect1d(one.steps, other.steps).any() for one, other in pairs)
