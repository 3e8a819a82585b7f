"""Samples of a topic, gathered message by message in whatever order they come."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.rigs import RigAxes

from seft_ros.recording.record import Estimates, Series

Floats = npt.NDArray[np.float64]
Steps = npt.NDArray[np.int64]


class SampleBuffer:
    """Arrays that grow in place; memory is that of the samples.

    Parameters
    ----------
    quantities, axes : int
        Sizes q and n of a sample.
    capacity : int
        Number of samples to expect; what of it is not filled takes no memory.
    """

    def __init__(self, quantities: int, axes: int, capacity: int) -> None:
        self._steps = np.empty(max(1, capacity), np.int64)
        self._values = np.empty((max(1, capacity), quantities, axes))
        self._received = np.empty(max(1, capacity), np.int64)
        self._timed = True
        self._count = 0

    def append(self, steps: Steps, values: Floats, received_ns: Steps | None = None) -> None:
        """Add samples, of shapes (p,) and (p, q, n), and when each was received, shape (p,)."""
        end = self._count + len(steps)
        if end > len(self._steps):
            self._resize(max(end, 2 * len(self._steps)))
        self._steps[self._count : end] = steps
        self._values[self._count : end] = values
        if received_ns is None:
            self._timed = False
        else:
            self._received[self._count : end] = received_ns
        self._count = end

    def series(self) -> Series:
        """Give them ordered by step, of those that came twice the first; the buffer is empty then.

        Samples that came in order, as they mostly do, are not copied.
        """
        self._resize(self._count)
        steps, values, self._count = self._steps, self._values, 0
        received = self._received if self._timed else None
        self._steps, self._values = steps[:0].copy(), values[:0].copy()
        self._received = self._steps.copy()
        if (steps[1:] > steps[:-1]).all():
            return Series(steps, values, received_ns=received)
        ordered, first = np.unique(steps, return_index=True)
        times = None if received is None else received[first]
        return Series(ordered, values[first], received_ns=times)

    def _resize(self, count: int) -> None:
        # nobody else has seen the arrays; the check takes a debugger's frames for references
        self._steps.resize(count, refcheck=False)
        self._received.resize(count, refcheck=False)
        self._values.resize((count, *self._values.shape[1:]), refcheck=False)


def require_names(step: int, estimates: Iterable[str], names: Sequence[str]) -> None:
    """Refuse, as WireError, estimates of a step with other names than those of the first."""
    if tuple(estimates) != tuple(names):
        raise WireError(
            f"estimates of step {step} are {', '.join(estimates)}, but were {', '.join(names)}"
        )


class EstimateBuffer:
    """Estimates of a compensation method, all with the names of the first."""

    def __init__(self) -> None:
        self._names: tuple[str, ...] = ()
        self._samples: SampleBuffer | None = None

    def append(self, step: int, estimates: Mapping[str, Floats]) -> None:
        """Add the estimates of a step, name -> shape (n,); of none there is nothing to add.

        Raises
        ------
        WireError
            If they are others than those of the first step.
        """
        if not estimates:
            return
        sample = np.stack(list(estimates.values()))
        if self._samples is None:
            self._names = tuple(estimates)
            self._samples = SampleBuffer(len(sample), sample.shape[1], 0)
        require_names(step, estimates, self._names)
        self._samples.append(np.array([step]), sample[np.newaxis])

    def series(self) -> Estimates | None:
        """Order them by step as `SampleBuffer.series` does; None if there are none."""
        if self._samples is None:
            return None
        samples = self._samples.series()
        return Estimates(samples.steps, samples.values, self._names)


@dataclass(frozen=True)
class Run:
    """Samples of consecutive steps.

    Attributes
    ----------
    first_step : int
        Step of the first.
    values : ndarray
        Shape (p, q, n).
    """

    first_step: int
    values: Floats


def consecutive_runs(series: Series, longest: int) -> list[Run]:
    """Cut a series where steps are missing, and every ``longest`` steps."""
    ends = np.flatnonzero(np.diff(series.steps) != 1) + 1
    runs = []
    for start, end in zip([0, *ends], [*ends, len(series.steps)], strict=True):
        for at in range(int(start), int(end), longest):
            values = series.values[at : min(at + longest, int(end))]
            runs.append(Run(int(series.steps[at]), values))
    return runs


def of_all_rigs(parts: Sequence[Series], rigs: Sequence[RigAxes]) -> Series:
    """Put the series of several rigs together: the steps that all have, received when all were.

    Parameters
    ----------
    parts : sequence of Series
        Of each rig, over its own axes.
    rigs : sequence of RigAxes
        Which these are.
    """
    if len(parts) == 1:
        return parts[0]
    steps = parts[0].steps
    for part in parts[1:]:
        steps = np.intersect1d(steps, part.steps, assume_unique=True)
    rows = [np.searchsorted(part.steps, steps) for part in parts]
    shape = (len(steps), parts[0].values.shape[1], sum(len(rig.axes) for rig in rigs))
    values = np.empty(shape)
    for part, kept, rig in zip(parts, rows, rigs, strict=True):
        values[:, :, list(rig.places)] = part.values[kept]
    times = [
        part.received_ns[kept]
        for part, kept in zip(parts, rows, strict=True)
        if part.received_ns is not None
    ]
    received = np.max(times, axis=0) if len(times) == len(parts) else None
    return Series(steps, values, received_ns=received)


def until(series: Series, last_step: int) -> Series:
    """Cut a series after a step."""
    end = int(np.searchsorted(series.steps, last_step, side="right"))
    received = None if series.received_ns is None else series.received_ns[:end]
    return Series(series.steps[:end], series.values[:end], received_ns=received)


def on_steps_of(other: Series, series: Series) -> Series:
    """Let a series share its steps with another that has the same, to hold them once."""
    steps = other.steps[: len(series.steps)]
    return replace(series, steps=steps) if np.array_equal(steps, series.steps) else series
