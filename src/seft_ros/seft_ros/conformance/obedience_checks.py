"""Whether a rig refuses bad commands, trips in time, and then comes to rest."""

import struct
from dataclasses import dataclass

import numpy as np
from seft_msgs_py.wire.outcome import TRIPPED
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.conformance.driver import Samples, Trial
from seft_ros.conformance.finding import Finding, found, not_run
from seft_ros.conformance.motion_checks import Drive

SETTLE, BLOCK = 0.1, 0.1  # s of rest before each kind of bad command, and of the kind
KINDS = (
    "stale",
    "a second time",
    "of the future",
    "of another axis",
    "not a number",
    "between two steps",
)
BESIDE = ("stale", "a second time")
"""Kinds that are sent after the step's own command; the others in its place, every other step."""
SEEN = 8.0  # times the noise
PART = 0.3  # of the effect of the same command when it is obeyed
PATIENCE = 0.5  # s beyond a watchdog's time, for this host and the message
RESTING = 3.0  # s within which a rig is at rest after a trip
STOP_TIME, STOP_FORCE = "stop time (s)", "stop peak force (N)"
"""Names in the status of a trip, when the rig is at rest."""
BACK = 3e-4  # m that it may have moved after it was stopped


@dataclass(frozen=True)
class BadCommands:
    """Commands of a test in which most are bad.

    Attributes
    ----------
    codec : TrajectoryCodec
        Of what drives the rig.
    value : float
        Of the bad ones, in the topic's unit; the good ones are 0.
    """

    codec: TrajectoryCodec
    value: float

    @property
    def steps(self) -> int:
        """Steps of the test."""
        return self.block(len(KINDS)).start

    def block(self, kind: int) -> slice:
        """Give the steps of a kind of command."""
        dt = self.codec.timebase.dt
        settle, length = max(4, round(SETTLE / dt)), max(10, round(BLOCK / dt))
        start = settle + kind * (settle + length)
        return slice(start, start + length)

    def answers(self, step: int) -> list[bytes]:
        """Give the messages that answer a step."""
        good = self.codec.encode(step, np.zeros(len(self.codec.axes)))
        for number, kind in enumerate(KINDS):
            block = self.block(number)
            if block.start <= step < block.stop:
                if kind in BESIDE:
                    return [good, self._bad(kind, step)]
                return [self._bad(kind, step) if (step - block.start) % 2 else good]
        return [good]

    def _bad(self, kind: str, step: int) -> bytes:
        codec, value = self.codec, np.full(len(self.codec.axes), self.value)
        if kind == "of another axis":
            others = [f"{axis}_other" for axis in codec.axes]
            codec = TrajectoryCodec(codec.topic, others, codec.timebase)
        shift = {"stale": max(0, step - 3), "of the future": step + 1000}
        raw = codec.encode(shift.get(kind, step), value)
        if kind == "not a number":
            return raw.replace(struct.pack("<d", self.value), struct.pack("<d", float("nan")))
        if kind == "between two steps":
            (nanoseconds,) = struct.unpack_from("<I", raw, 8)
            return raw[:8] + struct.pack("<I", nanoseconds + 1) + raw[12:]
        return raw


def check_refusals(trial: Trial, bad: BadCommands, moved: Samples, drive: Drive) -> list[Finding]:
    """Check that no bad command moves the rig, by the force of a good one before."""
    steps, force = trial.samples.steps, trial.samples.values[:, 3]
    noise = moved.values[drive.rest, 3].std(axis=0)
    pulse = moved.values[drive.doublets[0] :, 3] - moved.values[drive.doublets[0], 3]
    least = np.maximum(SEEN * noise, PART * np.abs(pulse).max(axis=0))
    findings = []
    for number, kind in enumerate(KINDS):
        name, block = f"command {kind}", bad.block(number)
        index = np.flatnonzero((steps > block.start) & (steps <= block.stop + 2))
        at = np.flatnonzero(steps == block.start)
        if len(index) < block.stop - block.start or not len(at):
            text = f"the rig ended the test before it: phase {trial.phase or 'none'}"
            findings.append(found(name, False, text))
            continue
        before = force[max(0, at[0] - 5) : at[0] + 1].mean(axis=0)
        change = np.abs(force[index] - before).max(axis=0)
        worst = int((change / least).argmax())
        text = f"the force changes by {change[worst]:.3g} N ({least[worst]:.3g} N: obeyed)"
        passed = bool((change < least).all())
        findings.append(found(name, passed, text, change_n=float(change[worst])))
    return findings


def check_over_limit(
    samples: Samples, at: int, limit: float | None, moved: Samples, drive: Drive
) -> Finding:
    """Check that a command beyond the rig's limit is refused, not clipped."""
    name = "command beyond the limit"
    if limit is None:
        return not_run(name, "limits.command is not in the description of the rig")
    force = samples.values[:, 3]
    after = force[at : at + 10]
    if len(after) < 5:
        return found(name, False, "the rig ended the test before it")
    change = np.abs(after - force[max(0, at - 10) : at].mean(axis=0)).max(axis=0)
    text = f"of 1.2 times {limit:g}: the force changes by {change.max():.3g} N"
    passed = bool((change < SEEN * moved.values[drive.rest, 3].std(axis=0)).all())
    return found(name, passed, text, change_n=float(change.max()))


def check_watchdog(trial: Trial, timeout: float, silent: str, *, by_itself: bool = True) -> Finding:
    """Check that the rig trips by itself within its time, s, when messages stop."""
    name = f"watchdog: {silent} silent"
    mend = f"trip by itself within {timeout:g} s, and report phase tripped and the reason at once"
    if "silent" not in trial.marks:
        return found(name, False, "the test ended before", mend)
    last, tripped = trial.last_state_after("silent"), trial.status_of(TRIPPED)
    if tripped is None or not by_itself:
        text = f"no trip; last state after {last:.3f} s, {timeout:g} s are configured"
        return found(name, False, text, mend, last_state_s=last)
    took, reason = tripped[0] - trial.marks["silent"], tripped[1].values.get("reason", "")
    text = f"tripped after {took:.3f} s ({timeout:g} s configured): {reason or 'no reason given'}"
    passed = max(took, last) <= timeout + PATIENCE and bool(reason)
    return found(name, passed, text, mend, tripped_s=took, last_state_s=last)


def check_stood_still(trial: Trial) -> Finding:
    """Check that a rig whose process was stopped trips before it takes the next sample.

    One state may have been taken before and be sent after.
    """
    name, tripped = "stands still", trial.status_of(TRIPPED)
    if "goes on" not in trial.marks or not trial.states:
        return found(name, False, "the test ended before")
    later = int((trial.samples.times > trial.marks["goes on"]).sum())
    text = f"{later} states after its process was stopped and continued"
    reason = tripped[1].values.get("reason", "") if tripped else ""
    text += f", tripped: {reason or 'no reason given'}" if tripped else ", no trip"
    return found(name, later <= 1 and bool(reason), text, states=later)


def check_safe_position(trial: Trial, next_one: Samples) -> Finding:
    """Check that the rig comes to rest after a trip in the middle of a motion.

    Its diagnostics must report when, and it must not have moved away until the next test.
    """
    name, last = "safe position", trial.samples
    if trial.status_of(TRIPPED) is None:
        return found(name, False, "the rig did not trip, and continues with the last command")
    values = rested(trial)
    if values is None:
        text = f"the rig does not report rest within {RESTING:g} s: "
        return found(name, False, text + trial.statuses[-1][1].message)
    took = float(values[STOP_TIME])
    if len(last.times) < 10 or len(next_one.times) < 10:
        return found(name, False, "too few states to see where it came to rest")
    start = last.values[:10, 0].mean(axis=0)
    stopped, again = last.values[-1, 0], next_one.values[:10, 0].mean(axis=0)
    noise = last.values[:10, 0].std(axis=0)
    further = float((np.abs(again - start) - np.abs(stopped - start) - SEEN * noise).max())
    text = f"at rest after {took:.3g} s"
    if STOP_FORCE in values:
        text += f", peak force {values[STOP_FORCE]} N"
    if further > BACK:
        text = f"{text} as reported, but {1e3 * further:.2f} mm farther away in the next test"
        return found(name, False, text, further_m=further)
    return found(name, took <= RESTING, text, stop_s=took)


def rested(trial: Trial) -> dict[str, str] | None:
    """Give the values of the status in which a rig that tripped reports rest."""
    trips = [s.values for _, s in trial.statuses if s.values.get("phase") == TRIPPED]
    return next((values for values in trips if STOP_TIME in values), None)
