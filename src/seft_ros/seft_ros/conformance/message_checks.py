"""Checks that a rig's description and messages follow the contract, and come in time."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.outcome import FINISHED, TRIPPED, read_outcome
from seft_msgs_py.wire.topics import QUANTITIES, RIG_STATE
from seft_msgs_py.wire.trajectory import Trajectory, parse_trajectory

from seft_ros.conformance.driver import Finding, Samples, Trial, found, not_run

SLOWEST_STATUS = 0.5  # s between two diagnostics, median
SLOWEST_CLOCK = 0.25  # s between two messages of /clock, median; 0.1 s is required
_WINDOW = 20  # samples
PERCENTILE = 95.0
_LATEST = 0.5  # of a period
OFF = 0.01  # of the period
ENOUGH = 3  # windows
SOME = 0.1
"""Share of the windows with a stall of this host up to which only the others count."""
BEST = 0.2
"""Share of the windows that counts if there are more stalls: they delay the rig, too."""

Stalls = Sequence[tuple[float, float]]
"""Begin and end of host scheduling stalls, s, monotonic."""


def check_description(description: Mapping[str, Any] | None, experiment: Experiment) -> Finding:
    """Check that the rig describes itself, with the rate and the axes of the experiment."""
    name, rate, axes = "description", experiment.timebase.rate, list(experiment.axes)
    if description is None:
        return found(name, False, "nothing of node rig on experiment/description")
    parameters = description["parameters"]
    for key, value in {"rate": rate, "axes": axes}.items():
        if parameters.get(key) != value:
            remedy = "start the rig with the experiment's own file"
            return found(name, False, f"{key} is {parameters.get(key)}, not {value}", remedy)
    pace = parameters.get("pace", "realtime")
    if pace != "realtime":
        remedy = "start it with -p rig:pace:=realtime: timing is part of the contract"
        return found(name, False, f"the rig's pace is {pace}", remedy)
    return found(name, True, f"{rate:g} Hz, axes {', '.join(axes)}, {pace}")


def check_signs_of_life(trial: Trial) -> Finding:
    """Check that the rig reports its phase often enough in idle."""
    name, times = "diagnostics", [at for at, _ in trial.statuses]
    if len(times) < 2:
        return found(name, False, f"{len(times)} statuses of the rig were received")
    if trial.phase != "idle":
        text = f"phase {trial.phase or 'none'} before a test, not idle"
        return found(name, False, text, "report phase idle between tests, see docs/hardware.md")
    return _check_gaps(name, "phase idle, diagnostics", times, SLOWEST_STATUS)


def check_form(trial: Trial, axes: Sequence[str]) -> Finding:
    """Check that all states have the axes, all quantities and what is applied, all finite."""
    name = "form of rig/state"
    if not trial.states:
        text = "no rig/state in a running test"
        return found(name, False, text, "publish a state each period from step 0 on")
    for number, (_, raw) in enumerate(trial.states):
        try:
            fault = _fault(parse_trajectory(raw, RIG_STATE.name), axes)
        except WireError as error:
            fault = str(error)
        if fault:
            return found(name, False, f"message {number}: {fault}")
    return found(name, True, f"{len(trial.states)} messages, axes {', '.join(axes)}, all finite")


def _fault(message: Trajectory, axes: Sequence[str]) -> str:
    if message.axes != tuple(axes):
        return f"axes are {list(message.axes)}, not {list(axes)}"
    if len(message.points) != 2:
        return f"points {len(message.points)}, not 2: the sample, and what is applied from then on"
    for point, quantity in (*((0, quantity) for quantity in QUANTITIES), (1, "effort")):
        values = getattr(message.points[point], quantity)
        if len(values) != len(axes):
            return f"{len(values)} {quantity} for {len(axes)} axes"
        if not np.isfinite(values).all():
            return f"{quantity} are {values.tolist()}"
    return ""


def check_stamps(trial: Trial, period_ns: int) -> Finding:
    """Check that message k is stamped with exactly k periods from the start of the test."""
    name = "stamps"
    try:
        stamps = [parse_trajectory(raw, RIG_STATE.name).stamp_ns for _, raw in trial.states]
    except WireError:
        return found(name, False, "a state can't be read")
    for number, stamp in enumerate(stamps):
        if off := stamp - number * period_ns:
            text = f"message {number} is stamped {stamp} ns, {off:+d} ns from {number} periods"
            return found(name, False, text, off_ns=float(off))
    return found(name, True, f"{len(stamps)} messages, each exactly its number of periods")


def check_end(trial: Trial, steps: int, experiment: Experiment) -> Finding:
    """Check that a test ends after its steps, and that the rig reports it."""
    name = "end of a test"
    if trial.fault:
        return found("stays within limits", False, trial.fault)
    ended, tripped = trial.status_of(FINISHED), trial.status_of(TRIPPED)
    if ended is None:
        last = tripped[1].message if tripped is not None else f"phase {trial.phase or 'none'}"
        limit = "if the rig did not move so, a sensor's unit, sign or factor is wrong"
        text = f"{len(trial.states)} of {steps} states, {last}"
        return found(name, False, text, limit if "limit" in last else "")
    try:
        outcome = read_outcome(ended[1], experiment.timebase)
    except WireError as error:
        return found(name, False, str(error))
    assert outcome is not None  # it has ended
    if outcome.steps != steps or len(trial.states) != steps:
        text = f"{outcome.steps} steps reported, {len(trial.states)} states received, of {steps}"
        return found(name, False, text)
    if trial.phase != "idle":
        return found(name, False, f"phase {trial.phase} after experiment/state was idle")
    text = f"finished after {steps} steps ({outcome.missed} commands missed), then idle"
    return found(name, True, text)


def check_clock(trial: Trial, period_ns: int) -> Finding:
    """Check that /clock follows the test: the ground motion is published ahead of it."""
    times = [at for at, _ in trial.clocks]
    if len(times) < 2 or any(stamp % period_ns for _, stamp in trial.clocks):
        return found("/clock", False, f"{len(times)} messages with stamps of samples")
    return _check_gaps("/clock", f"{len(times)} messages, one", times, SLOWEST_CLOCK)


def _check_gaps(name: str, what: str, times: Sequence[float], slowest: float) -> Finding:
    """Check the usual time from one message to the next; the median must not exceed a time in s."""
    usual, longest = np.percentile(np.diff(times), (50, 100)).tolist()
    text = f"{what} every {usual:.2f} s, {longest:.2f} s at most"
    return found(name, usual <= slowest, text, usual_s=usual, longest_s=longest)


def check_timing(samples: Samples, dt: float, stalls: Stalls) -> list[Finding]:
    """Check that the rig's clock has the experiment's rate, and states meet their deadlines.

    The deadlines of a window are those of its earliest state: a single overrun of the clock, after
    which it continues from there, counts once. A rig may wait for the answer to its first state
    before its time begins. If this host stalled often, the best windows count, and of these the
    typical one.
    """
    times = samples.times[1:]
    count = len(times) // _WINDOW
    if count < ENOUGH:
        text = f"{len(times)} states are too few"
        return [not_run(name, text) for name in ("period", "late states")]
    windows = times[: count * _WINDOW].reshape(count, _WINDOW)
    late = windows - (np.arange(count * _WINDOW) * dt).reshape(count, _WINDOW)
    late -= late.min(axis=1, keepdims=True)
    chosen, left_out = _quiet_windows(windows, late, stalls)
    windows, late = windows[chosen], late[chosen]
    period = float(np.median((windows[:, -1] - windows[:, 0]) / (_WINDOW - 1)))
    text = f"{1e3 * period:.4f} ms, {1e3 * dt:g} ms wanted{left_out}"
    right_rate = found("period", abs(period / dt - 1) <= OFF, text, period_s=period)
    typical = float(np.median(np.percentile(late, PERCENTILE, axis=1)))
    p50, p99, largest = np.percentile(late, (50, 99, 100)).tolist()
    text = (
        f"{PERCENTILE:g} of 100 within {1e3 * typical:.3f} ms of their deadline "
        f"(median {1e3 * p50:.3f}, p99 {1e3 * p99:.3f}, largest {1e3 * largest:.3f} ms){left_out}"
    )
    remedy = (
        f"at most {1e3 * _LATEST * dt:g} ms, half a period, is allowed: publish before anything "
        "else in a period, and take a real-time priority (docs/realtime.md)"
    )
    numbers = {"p50_s": p50, "p95_s": typical, "p99_s": p99, "largest_s": largest}
    assessed = typical if left_out else max(typical, p99)
    return [right_rate, found("late states", assessed <= _LATEST * dt, text, remedy, **numbers)]


def _quiet_windows(windows: Floats, late: Floats, stalls: Stalls) -> tuple[npt.NDArray[Any], str]:
    """Choose the windows without a stall of this host, else the best; say which."""
    begins, ends = np.reshape(stalls, (-1, 2)).T
    disturbed = ((begins < windows[:, [-1]]) & (ends > windows[:, [0]])).any(axis=1)
    if not disturbed.any():
        return np.arange(len(late)), ""
    if disturbed.mean() <= SOME:
        text = f"; {disturbed.sum()} of {len(late)} windows left out, in which this host stalled"
        return np.flatnonzero(~disturbed), text
    best = np.argsort(np.percentile(late, PERCENTILE, axis=1))
    best = best[: max(ENOUGH, round(BEST * len(late)))]
    return np.sort(best), "; this host stalled again and again: only the best fifth counts"
