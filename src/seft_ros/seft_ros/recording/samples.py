"""Samples of a topic, gathered message by message in whatever order they come."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.topics import RigAxes

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
        self._samples: dict[int, Floats] = {}

    def append(self, step: int, estimates: Mapping[str, Floats]) -> None:
        """Add the estimates of a step, name -> shape (n,); of none there is nothing to add.

        Raises
        ------
        WireError
            If they are others than those of the first step.
        """
        if estimates:
            self._names = self._names or tuple(estimates)
            require_names(step, estimates, self._names)
            self._samples.setdefault(step, np.stack(list(estimates.values())))

    def series(self) -> Estimates | None:
        """Order them by step, of those that came twice the first; None if there are none."""
        if not self._samples:
            return None
        steps = sorted(self._samples)
        values = np.stack([self._samples[step] for step in steps])
        return Estimates(np.array(steps, np.int64), values, self._names)


def consecutive_runs(series: Series, longest: int) -> list[tuple[int, Floats]]:
    """Cut a series where steps are missing, and every ``longest`` steps: first step, values."""
    ends = (np.flatnonzero(np.diff(series.steps) != 1) + 1).tolist()
    runs = zip([0, *ends], [*ends, len(series.steps)], strict=True)
    return [
        (int(series.steps[at]), series.values[at : min(at + longest, end)])
        for start, end in runs
        for at in range(start, end, longest)
    ]


def of_all_rigs(parts: Sequence[Series], rigs: Sequence[RigAxes]) -> Series:
    """Put the series of several rigs together: the steps that all have, received when all were."""
    if len(parts) == 1:
        return parts[0]
    steps = parts[0].steps
    for part in parts[1:]:
        steps = np.intersect1d(steps, part.steps, assume_unique=True)
    rows = [np.searchsorted(part.steps, steps) for part in parts]
    axes = sum(len(rig.axes) for rig in rigs)
    values = np.empty((len(steps), parts[0].values.shape[1], axes))
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


def of_steps(series: Series, steps: Steps) -> Series:
    """Keep the samples of some steps."""
    kept = np.isin(series.steps, steps)
    return Series(series.steps[kept], series.values[kept])


def on_steps_of(other: Series, series: Series) -> Series:
    """Let a series share its steps with another that has the same, to hold them once."""
    steps = other.steps[: len(series.steps)]
    return replace(series, steps=steps) if np.array_equal(steps, series.steps) else series
