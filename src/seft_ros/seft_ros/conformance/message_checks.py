"""What a rig says of itself, and whether its messages are those of the contract, and in time."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.outcome import FINISHED, TRIPPED, read_outcome
from seft_msgs_py.wire.topics import QUANTITIES, RIG_STATE
from seft_msgs_py.wire.trajectory import Floats
from seft_msgs_py.wire.trajectory_layout import Trajectory, parse_trajectory

from seft_ros.conformance.driver import Samples, Trial
from seft_ros.conformance.finding import Finding, found, not_run

SLOWEST_STATUS = 0.5  # s between two signs of life, as a rule
SLOWEST_CLOCK = 0.25  # s between two messages of /clock, as a rule; a tenth is asked for
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


def check_description(description: Mapping[str, Any] | None, experiment: Experiment) -> Finding:
    """See that the rig describes itself, at the rate and with the axes of the experiment."""
    name, rate, axes = "description", experiment.timebase.rate, list(experiment.axes)
    if description is None:
        return found(name, False, "nothing of node rig on experiment/description")
    told = description["parameters"]
    for key, value in {"rate": rate, "axes": axes}.items():
        if told.get(key) != value:
            mend = "start the rig with the experiment's own file"
            return found(name, False, f"{key} is {told.get(key)}, not {value}", mend)
    pace = told.get("pace", "realtime")
    if pace != "realtime":
        mend = "start it with -p rig:pace:=realtime: timing is part of the contract"
        return found(name, False, f"the rig's pace is {pace}", mend)
    return found(name, True, f"{rate:g} Hz, axes {', '.join(axes)}, {pace}")


def check_signs_of_life(trial: Trial) -> Finding:
    """See that the rig tells its phase while nothing moves, often enough."""
    name, times = "diagnostics", [at for at, _ in trial.statuses]
    if len(times) < 2:
        return found(name, False, f"{len(times)} statuses of the rig were heard")
    if trial.phase != "idle":
        told = f"phase {trial.phase or 'none'} before a test, not idle"
        return found(name, False, told, "tell phase idle where no test is, see docs/hardware.md")
    usual, longest = _gaps(times)
    told = f"phase idle, a sign of life every {usual:.2f} s, {longest:.2f} s at most"
    return found(name, usual <= SLOWEST_STATUS, told, usual_s=usual, longest_s=longest)


def check_form(trial: Trial, axes: Sequence[str]) -> Finding:
    """See that all states have the axes, one point, all quantities, and finite values."""
    name = "form of rig/state"
    if not trial.states:
        told = "no rig/state came in a test that was said to run"
        return found(name, False, told, "publish a state each period from step 0 on")
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
    if len(message.points) != 1:
        return f"{len(message.points)} points, not 1"
    for quantity in QUANTITIES:
        values = getattr(message.points[0], quantity)
        if len(values) != len(axes):
            return f"{len(values)} {quantity} for {len(axes)} axes"
        if not np.isfinite(values).all():
            return f"{quantity} are {list(values)}"
    return ""


def check_stamps(trial: Trial, period_ns: int) -> Finding:
    """See that message k is stamped with exactly k periods from the start of the test."""
    name = "stamps"
    try:
        stamps = [parse_trajectory(raw, RIG_STATE.name).stamp_ns for _, raw in trial.states]
    except WireError:
        return found(name, False, "a state can't be read")
    for number, stamp in enumerate(stamps):
        if off := stamp - number * period_ns:
            told = f"message {number} is stamped {stamp} ns, {off:+d} ns from {number} periods"
            return found(name, False, told, off_ns=float(off))
    return found(name, True, f"{len(stamps)} messages, each exactly its number of periods")


def check_end(trial: Trial, steps: int, experiment: Experiment) -> Finding:
    """See that a test of so many steps ends with them, and the rig says so."""
    name = "end of a test"
    if trial.fault:
        return found("stays within limits", False, trial.fault)
    ended, tripped = trial.status_of(FINISHED), trial.status_of(TRIPPED)
    if ended is None:
        last = tripped[1].message if tripped is not None else f"phase {trial.phase or 'none'}"
        limit = "if the rig did not move so, a sensor's unit, sign or factor is wrong"
        told = f"{len(trial.states)} of {steps} states, {last}"
        return found(name, False, told, limit if "limit" in last else "")
    try:
        outcome = read_outcome(ended[1], experiment.timebase)
    except WireError as error:
        return found(name, False, str(error))
    assert outcome is not None  # it has ended
    if outcome.steps != steps or len(trial.states) != steps:
        told = f"{outcome.steps} steps told, {len(trial.states)} states came, of {steps}"
        return found(name, False, told)
    if trial.phase != "idle":
        return found(name, False, f"phase {trial.phase} after the supervisor said idle")
    missed = outcome.missed
    return found(name, True, f"finished after {steps} steps ({missed} commands missed), then idle")


def check_clock(trial: Trial, period_ns: int) -> Finding:
    """See that /clock goes with the test: the ground motion is sent ahead of it."""
    times = [at for at, _ in trial.clocks]
    if len(times) < 2 or any(stamp % period_ns for _, stamp in trial.clocks):
        return found("/clock", False, f"{len(times)} messages with stamps of samples")
    usual, longest = _gaps(times)
    told = f"{len(times)} messages, one every {usual:.2f} s, {longest:.2f} s at most"
    return found("/clock", usual <= SLOWEST_CLOCK, told, usual_s=usual, longest_s=longest)


def _gaps(times: Sequence[float]) -> tuple[float, float]:
    """Median and largest time from one message to the next, s."""
    usual, longest = np.percentile(np.diff(times), (50, 100)).tolist()
    return usual, longest


def check_timing(samples: Samples, dt: float, stalls: Stalls) -> list[Finding]:
    """See that the rig's clock has the experiment's rate, and states come at their deadlines.

    A state is late by what it came later than the earliest of its window would have it: a clock
    that was held up once, and goes on from there, is not late for ever. A rig may wait for the
    answer to its first state before its time begins. Where this host stood still again and again,
    the best windows count, and of these the typical one.
    """
    times = samples.times[1:]
    count = len(times) // WINDOW
    if count < ENOUGH:
        told = f"{len(times)} states, too few to tell"
        return [not_run(name, told) for name in ("period", "late states")]
    windows = times[: count * WINDOW].reshape(count, WINDOW)
    late = windows - (np.arange(count * WINDOW) * dt).reshape(count, WINDOW)
    late -= late.min(axis=1, keepdims=True)
    chosen, left_out = _quiet_windows(windows, late, stalls)
    windows, late = windows[chosen], late[chosen]
    period = float(np.median((windows[:, -1] - windows[:, 0]) / (WINDOW - 1)))
    told = f"{1e3 * period:.4f} ms, {1e3 * dt:g} ms wanted{left_out}"
    right_rate = found("period", abs(period / dt - 1) <= OFF, told, period_s=period)
    typical = float(np.median(np.percentile(late, PERCENTILE, axis=1)))
    p50, p99, largest = np.percentile(late, (50, 99, 100)).tolist()
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
    return [right_rate, found("late states", judged <= LATEST * dt, told, mend, **numbers)]


def _quiet_windows(windows: Floats, late: Floats, stalls: Stalls) -> tuple[npt.NDArray[Any], str]:
    """Choose the windows in which this host did not stand still, else the best; say which."""
    begins, ends = np.reshape(stalls, (-1, 2)).T
    disturbed = ((begins < windows[:, [-1]]) & (ends > windows[:, [0]])).any(axis=1)
    if not disturbed.any():
        return np.arange(len(late)), ""
    if disturbed.mean() <= SOME:
        told = f"; {disturbed.sum()} of {len(late)} windows in which this host stood still left out"
        return np.flatnonzero(~disturbed), told
    best = np.argsort(np.percentile(late, PERCENTILE, axis=1))
    best = best[: max(ENOUGH, round(BEST * len(late)))]
    return np.sort(best), "; this host stood still again and again: only the best fifth counts"
