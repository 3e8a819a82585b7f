"""Whether states come when they are due."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from seft_msgs_py.wire.trajectory import Floats

from seft_ros.conformance.finding import Finding, found, not_run
from seft_ros.conformance.trial import Samples

WINDOW = 20  # samples
PERCENTILE = 95.0
LATEST = 0.5  # of a period
OFF = 0.01  # of the period
ENOUGH = 3  # windows
SOME = 0.1
"""Part of the windows in which this host may stand still: the others show how the rig is."""
BEST = 0.2
"""Part of the windows that counts where it stood still in more: it holds up the rig, too."""

Stalls = Sequence[tuple[float, float]]
"""Begin and end of times in which this host stood still, s, monotonic."""


def lateness(times: Floats, dt: float) -> Floats:
    """How much later each sample came than the earliest of its window would have it, s.

    Within a window, so that a clock that was held up once, and goes on from there, is not late
    for ever.

    Returns
    -------
    ndarray
        Shape (windows, `WINDOW`).
    """
    count = len(times) // WINDOW
    due = times[: count * WINDOW] - np.arange(count * WINDOW) * dt
    windows = due.reshape(count, WINDOW)
    late: Floats = windows - windows.min(axis=1, keepdims=True)
    return late


def quiet_windows(times: Floats, late: Floats, stalls: Stalls) -> tuple[npt.NDArray[np.int64], str]:
    """Choose the windows in which this host did not stand still, else the best of all.

    Returns
    -------
    chosen : ndarray of int64
        Numbers of windows.
    told : str
        What was left out, if anything.
    """
    edges = times[: late.size].reshape(late.shape)[:, [0, -1]]
    begins, ends = (np.array([stall[at] for stall in stalls]) for at in (0, 1))
    disturbed = ((begins < edges[:, [1]]) & (ends > edges[:, [0]])).any(axis=1)
    if not disturbed.any():
        return np.arange(len(late)), ""
    if disturbed.mean() <= SOME:
        told = f"; {disturbed.sum()} of {len(late)} windows in which this host stood still left out"
        return np.flatnonzero(~disturbed), told
    best = np.argsort(np.percentile(late, PERCENTILE, axis=1))
    best = best[: max(ENOUGH, round(BEST * len(late)))]
    return np.sort(best), "; this host stood still again and again: only the best fifth counts"


def check_timing(samples: Samples, dt: float, stalls: Stalls) -> list[Finding]:
    """See that the rig's clock has the experiment's rate, and states come at their deadlines.

    A rig may wait for the answer to its first state before its time begins.

    Parameters
    ----------
    samples : Samples
        Of a test.
    dt : float
        Sampling period, s.
    stalls : sequence of (float, float)
        When this host stood still.
    """
    names = ("period", "late states")
    times = samples.times[1:]
    if len(times) < ENOUGH * WINDOW:
        return [not_run(name, f"{len(times)} states, too few to tell") for name in names]
    late = lateness(times, dt)
    chosen, left_out = quiet_windows(times, late, stalls)
    windows = times[: late.size].reshape(late.shape)[chosen]
    period = float(np.median((windows[:, -1] - windows[:, 0]) / (WINDOW - 1)))
    told = f"{1e3 * period:.4f} ms, {1e3 * dt:g} ms wanted{left_out}"
    mend = "sample at absolute deadlines, start + k periods; a sleep of a period adds up"
    judged = found(names[0], abs(period / dt - 1) <= OFF, told, mend, period_s=period)
    return [judged, _lateness(names[1], late[chosen], dt, left_out)]


def _lateness(name: str, late: Floats, dt: float, left_out: str) -> Finding:
    """Judge what was measured of windows; of a host that stood still the typical window counts."""
    typical = float(np.median(np.percentile(late, PERCENTILE, axis=1)))
    p50, p99, largest = (float(np.percentile(late, p)) for p in (50, 99, 100))
    told = (
        f"{PERCENTILE:g} of 100 within {1e3 * typical:.3f} ms of their deadline "
        f"(median {1e3 * p50:.3f}, p99 {1e3 * p99:.3f}, largest {1e3 * largest:.3f} ms){left_out}"
    )
    mend = (
        f"at most {1e3 * LATEST * dt:g} ms, half a period, is allowed: publish before anything "
        "else in a period, and take a real-time priority (docs/realtime.md)"
    )
    numbers = {"p50_s": p50, "p95_s": typical, "p99_s": p99, "largest_s": largest}
    judged = typical if left_out else max(typical, p99)
    return found(name, judged <= LATEST * dt, told, mend, **numbers)
