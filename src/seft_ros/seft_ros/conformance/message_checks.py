"""What a rig says of itself, and whether its messages are those of the contract."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.outcome import FINISHED, TRIPPED, read_outcome
from seft_msgs_py.wire.topics import QUANTITIES, RIG_STATE
from seft_msgs_py.wire.trajectory_message import Trajectory, parse_trajectory

from seft_ros.conformance.finding import Finding, found
from seft_ros.conformance.trial import Trial

SLOWEST_STATUS = 0.5  # s between two signs of life, as a rule
SLOWEST_CLOCK = 0.25  # s between two messages of /clock, as a rule; a tenth is asked for


def check_description(description: Mapping[str, Any] | None, experiment: Experiment) -> Finding:
    """See that the rig describes itself, at the rate and with the axes of the experiment."""
    name = "description"
    if description is None:
        mend = "publish JSON with node and parameters on experiment/description, latched"
        return found(name, False, "nothing of node rig on experiment/description", mend)
    told = description["parameters"]
    wanted = {"rate": experiment.timebase.rate, "axes": list(experiment.axes)}
    for key, value in wanted.items():
        if told.get(key) != value:
            mend = "start the rig with the experiment's own file"
            return found(name, False, f"{key} is {told.get(key)}, not {value}", mend)
    pace = told.get("pace", "realtime")
    if pace != "realtime":
        mend = "start it with -p rig:pace:=realtime: timing is part of the contract"
        return found(name, False, f"the rig's pace is {pace}", mend)
    return found(name, True, f"{wanted['rate']:g} Hz, axes {', '.join(experiment.axes)}, {pace}")


def check_signs_of_life(trial: Trial) -> Finding:
    """See that the rig tells its phase while nothing moves, often enough."""
    name = "diagnostics"
    mend = "send a status named rig with its phase five times a second"
    times = [at for at, _ in trial.statuses]
    if len(times) < 2:
        return found(name, False, f"{len(times)} statuses of the rig were heard", mend)
    if trial.phase != "idle":
        told = f"phase {trial.phase or 'none'} before a test, not idle"
        return found(name, False, told, "tell phase idle where no test is, see docs/hardware.md")
    usual, longest = (float(part) for part in np.percentile(np.diff(times), (50, 100)))
    told = f"phase idle, a sign of life every {usual:.2f} s, {longest:.2f} s at most"
    return found(name, usual <= SLOWEST_STATUS, told, mend, usual_s=usual, longest_s=longest)


def check_silence(trial: Trial) -> Finding:
    """See that the rig publishes no state before a test."""
    count = len(trial.states)
    mend = "publish rig/state only while experiment/state is running or ramping_down"
    return found("silent before a test", not count, f"{count} states while idle", mend)


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
            mend = "one point with positions, velocities, accelerations and effort of each axis"
            return found(name, False, f"message {number}: {fault}", mend)
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
    mend = (
        "stamp sample k with exactly k periods in integer nanoseconds, from 0 at the test's "
        "start; neither a wall clock nor floats (seft_msgs_py's TrajectoryCodec does)"
    )
    stamps = []
    for _, raw in trial.states:
        try:
            stamps.append(parse_trajectory(raw, RIG_STATE.name).stamp_ns)
        except WireError:
            return found(name, False, "a state can't be read", mend)
    for number, stamp in enumerate(stamps):
        if stamp != number * period_ns:
            off = stamp - number * period_ns
            told = f"message {number} is stamped {stamp} ns, {off:+d} ns from {number} periods"
            return found(name, False, told, mend, off_ns=float(off))
    return found(name, True, f"{len(stamps)} messages, each exactly its number of periods")


def check_end(trial: Trial, steps: int, experiment: Experiment) -> Finding:
    """See that a test of so many steps ends with them, and the rig says so."""
    name = "end of a test"
    mend = "end after as many states as experiment/state says (steps); tell phase finished with "
    mend += "seft_msgs_py's rig_status, and idle again when the supervisor says idle"
    ended = trial.status_of(FINISHED)
    if ended is None:
        tripped = trial.status_of(TRIPPED)
        last = tripped[1].message if tripped is not None else f"phase {trial.phase or 'none'}"
        if "limit" in last:
            mend = "if the rig did not move so, a sensor's unit, sign or factor is wrong"
        return found(name, False, f"{len(trial.states)} of {steps} states, {last}", mend)
    try:
        outcome = read_outcome(ended[1], experiment.timebase)
    except WireError as error:
        return found(name, False, str(error), mend)
    counted = outcome.steps if outcome is not None else -1
    if counted != steps or len(trial.states) != steps:
        told = f"{counted} steps told, {len(trial.states)} states came, of {steps}"
        return found(name, False, told, mend)
    if trial.phase != "idle":
        return found(name, False, f"phase {trial.phase} after the supervisor said idle", mend)
    missed = outcome.missed if outcome is not None else 0
    return found(name, True, f"finished after {steps} steps ({missed} commands missed), then idle")


def check_clock(trial: Trial, period_ns: int) -> Finding:
    """See that /clock goes with the test: the ground motion is sent ahead of it."""
    mend = "publish the stamp of the last state on /clock, ten times a second"
    times = [at for at, _ in trial.clocks]
    if len(times) < 2 or any(stamp % period_ns for _, stamp in trial.clocks):
        return found("/clock", False, f"{len(times)} messages with stamps of samples", mend)
    usual, longest = (float(part) for part in np.percentile(np.diff(times), (50, 100)))
    told = f"{len(times)} messages, one every {usual:.2f} s, {longest:.2f} s at most"
    return found("/clock", usual <= SLOWEST_CLOCK, told, mend, usual_s=usual, longest_s=longest)
