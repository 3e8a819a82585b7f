"""Whether a rig refuses what it must, trips when it must, and rests then."""

import numpy as np
from seft_msgs_py.wire.outcome import FINISHED, TRIPPED

from seft_ros.conformance.bad_commands import KINDS, BadCommands
from seft_ros.conformance.drive import Drive
from seft_ros.conformance.finding import Finding, found, not_run
from seft_ros.conformance.trial import Samples, Trial

SEEN = 8.0  # times the noise
PART = 0.3  # of what the same command does when it is obeyed
PATIENCE = 0.5  # s beyond a watchdog's time: for this host, and the message that tells
STOP = 0.3  # s from a word of the supervisor to the last state
SETTLE = 3.0  # s in which a rig rests after a trip
STOP_TIME, STOP_FORCE = "stop time (s)", "stop peak force (N)"
"""Names in the status of a trip, told when the rig rests."""
BACK = 3e-4  # m that it may have gone on from where it was stopped


def check_refusals(
    trial: Trial, samples: Samples, bad: BadCommands, moved: Samples, drive: Drive
) -> list[Finding]:
    """See that no bad command moves the rig, by the force that a good one makes.

    Parameters
    ----------
    trial, samples : Trial, Samples
        The test with bad commands.
    bad : BadCommands
        What was sent.
    moved, drive : Samples, Drive
        The test in which the rig was moved.
    """
    noise = moved.values[drive.rest, 3].std(axis=0)
    pulse = moved.values[drive.doublets[0] :, 3] - moved.values[drive.doublets[0], 3]
    least = np.maximum(SEEN * noise, PART * np.abs(pulse).max(axis=0))
    mend = "refuse it: seft_plant_sim.rig.command.Command shows how; to the rig it is missing"
    findings = []
    for number, kind in enumerate(KINDS):
        name, block = f"command {kind}", bad.block(number)
        index = np.flatnonzero((samples.steps > block.start) & (samples.steps <= block.stop + 2))
        (at,) = np.nonzero(samples.steps == block.start)
        if len(index) < block.stop - block.start or not len(at):
            told = f"the rig ended the test before it: phase {trial.phase or 'none'}"
            findings.append(found(name, False, told, mend))
            continue
        start = int(at[0])
        before = samples.values[max(0, start - 5) : start + 1, 3].mean(axis=0)
        change = np.abs(samples.values[index, 3] - before).max(axis=0)
        worst = int((change / least).argmax())
        told = f"the force changes by {change[worst]:.3g} N, at {least[worst]:.3g} N it was obeyed"
        passed = bool((change < least).all())
        findings.append(found(name, passed, told, mend, change_n=float(change[worst])))
    return findings


def check_over_limit(
    samples: Samples, at: int, limit: float | None, moved: Samples, drive: Drive
) -> Finding:
    """See that a command beyond the rig's limit is not applied, not even held back to it."""
    name = "command beyond the limit"
    if limit is None:
        return not_run(name, "the rig does not tell limits.command in its description")
    noise = moved.values[drive.rest, 3].std(axis=0)
    force = samples.values[:, 3]
    after = force[at : at + 10]
    if len(after) < 5:
        return found(name, False, "the rig ended the test before it")
    change = np.abs(after - force[max(0, at - 10) : at].mean(axis=0)).max(axis=0)
    told = f"of 1.2 times {limit:g}: the force changes by {change.max():.3g} N"
    mend = "refuse it: a command beyond the limit is a fault, and no wish"
    return found(
        name, bool((change < SEEN * noise).all()), told, mend, change_n=float(change.max())
    )


def check_watchdog(trial: Trial, timeout: float, silent: str, mark: str) -> Finding:
    """See that the rig trips by itself when somebody falls silent.

    Parameters
    ----------
    trial : Trial
        In which that was done.
    timeout : float
        In which the rig must trip, s.
    silent : str
        Who.
    mark : str
        Name of the moment.
    """
    name = f"watchdog: {silent} silent"
    mend = f"trip by itself within {timeout:g} s, and tell phase tripped and the reason at once"
    if mark not in trial.marks:
        return found(name, False, "the test ended before", mend)
    after = trial.states_after(mark)
    last = max(after, default=0.0)
    tripped = trial.status_of(TRIPPED)
    longest = timeout + PATIENCE
    if tripped is None:
        told = f"no trip; states came for {last:.3f} s after, {timeout:g} s are configured"
        return found(name, False, told, mend, last_state_s=last)
    took = tripped[0] - trial.marks[mark]
    reason = tripped[1].values.get("reason", "")
    told = f"tripped after {took:.3f} s ({timeout:g} s configured): {reason or 'no reason told'}"
    passed = took <= longest and last <= longest and bool(reason)
    return found(name, passed, told, mend, tripped_s=took, last_state_s=last)


def check_safe_position(trial: Trial, last: Samples, next_one: Samples) -> Finding:
    """See that the rig comes to rest after a trip in the middle of a motion.

    Its diagnostics must tell when it rested, and the next test must find it no farther away.

    Parameters
    ----------
    trial, last : Trial, Samples
        That tripped.
    next_one : Samples
        The test after it.
    """
    name = "safe position"
    mend = (
        "bring the valve to its safe position in every trip, follow the rig to rest, and tell "
        f"'{STOP_TIME}' and '{STOP_FORCE}' in the status of the trip"
    )
    if trial.status_of(TRIPPED) is None:
        return found(name, False, "the rig did not trip, and goes on with the last command", mend)
    values = rested(trial)
    if values is None:
        words = trial.statuses[-1][1].message
        told = f"the rig does not tell that it rests within {SETTLE:g} s: {words}"
        return found(name, False, told, mend)
    took = float(values[STOP_TIME])
    if len(last.times) < 10 or len(next_one.times) < 10:
        return found(name, False, "too few states to see where it came to rest", mend)
    start = last.values[:10, 0].mean(axis=0)
    stopped, again = last.values[-1, 0], next_one.values[:10, 0].mean(axis=0)
    noise = last.values[:10, 0].std(axis=0)
    further = np.abs(again - start) - np.abs(stopped - start) - SEEN * noise
    told = f"at rest after {took:.3g} s"
    if STOP_FORCE in values:
        told += f", peak force {values[STOP_FORCE]} N"
    if further.max() > BACK:
        away = f"{told} as it tells, but {1e3 * further.max():.2f} mm farther away in the next test"
        return found(name, False, away, mend, further_m=float(further.max()))
    return found(name, took <= SETTLE, told, mend, stop_s=took)


def rested(trial: Trial) -> dict[str, str] | None:
    """Give the values of the status in which a rig that tripped tells that it rests."""
    told = [s.values for _, s in trial.statuses if s.values.get("phase") == TRIPPED]
    return next((values for values in told if STOP_TIME in values), None)


def check_latched(trial: Trial) -> Finding:
    """See that after a trip no test moves the rig before the supervisor has said idle."""
    count = len(trial.states)
    told = f"{count} states in a test that was said to run after a trip and no reset"
    mend = "keep a trip until experiment/state is idle"
    passed = not count and trial.status_of(TRIPPED) is not None
    return found("trip is latched", passed, told, mend)


def check_stop(trial: Trial, state: str) -> Finding:
    """See that the rig rests when the supervisor says that the test has ended."""
    name = f"rests when {state}"
    mend = f"end the test at once when experiment/state is {state}"
    last = max(trial.states_after(state), default=0.0)
    told = f"the last state came {last:.3f} s after, phase {trial.phase or 'none'}"
    ended = trial.phase in (FINISHED, TRIPPED)
    return found(name, ended and last <= STOP, told, mend, last_state_s=last)


def check_not_ready(trial: Trial) -> Finding:
    """See that a test which the rig was not ready for does not move it."""
    count = len(trial.states)
    told = f"{count} states in a test that runs without having been ready"
    mend = "begin only where experiment/state was ready before: a rig that comes up late rests"
    return found("rests in a test under way", not count, told, mend)
