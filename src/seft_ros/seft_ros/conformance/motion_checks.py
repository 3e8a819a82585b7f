"""Checks that the channels agree in a small motion, and that bad commands are refused."""

import math
import struct
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import Floats
from seft_msgs_py.wire.outcome import TRIPPED
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_plant_sim.simulated.specimen import Specimen

from seft_ros.conformance.driver import CHECK_KINDS, Finding, Samples, Trial, found, not_run

REST, BELL, PAUSE, PULSE_TIME = 0.4, 2.0, 0.3, 0.05  # s
DOUBLETS, DOUBLETS_APART = 5, 0.25  # s from one to the next
FREQUENCIES = (3.0, 6.0)  # Hz
_SETTLING = 0.1  # s at the start that do not count
_TOLERANCE = 0.2
"""Largest distance of a ratio from 1: a gain 20 % off, or 11 degrees of phase."""
SEEN = 5.0  # times the noise: a motion
ONSET_NOISE = 6.0
_VALVE = 0.006  # s, longest delay of valve and oil
_LINES = np.arange(2.0, 8.01, 0.5)
"""Frequencies at which signals are correlated, Hz."""
_FACTORS = {
    1e3: "the unit is a thousandth of SI's (mm, mm/s)",
    1e-3: "the unit is a thousand times SI's (kN)",
    1 / 9.80665: "the unit is g, not m/s^2",
    9.80665: "it is 9.81 times too large",
    1e2: "the unit is cm, not m",
    1e-2: "it is a hundred times too small",
    1 / 0.0254: "the unit is inches, not m",
    4.448: "it is 4.45 times too large",
    1 / 4.448: "the unit is lbf, not N",
}
_SENSOR = "calibration: SI units, and positive where the actuator extends, in all four channels"

Complex = npt.NDArray[np.complex128]


class MotionDrive:
    """A small motion: rest, two frequencies under a bell, doublets.

    Parameters
    ----------
    dt : float
        Sampling period, s.
    amplitude : float
        Largest command, in the unit of what drives the rig.

    Attributes
    ----------
    steps : int
        Of all.
    rest, bell : slice
        Samples at the start that rest; samples that the bell moves, and the rest after it.
    doublets : list of int
        Steps whose answers begin the doublets.
    commands : ndarray
        What answers each step, shape (steps,).
    """

    def __init__(self, dt: float, amplitude: float) -> None:
        self.dt, self.amplitude = dt, amplitude
        first, apart = self.step_at(REST + BELL + PAUSE), self.step_at(DOUBLETS_APART)
        self.rest = slice(self.step_at(_SETTLING), self.step_at(REST))
        self.bell = slice(self.step_at(REST), self.step_at(REST + BELL + PAUSE / 2))
        self.doublets = [first + number * apart for number in range(DOUBLETS)]
        self.steps = first + DOUBLETS * apart
        steps = np.arange(self.steps)
        time = steps * dt - REST
        waves = np.mean([np.sin(2 * np.pi * f * time) for f in FREQUENCIES], axis=0)
        under_bell = waves * np.sin(np.pi * time / BELL) ** 2
        pulse = (steps - first) % apart // max(1, self.step_at(PULSE_TIME))
        moving = [(time >= 0) & (time < BELL), (steps >= first) & (pulse == 0)]
        moving.append((steps >= first) & (pulse == 1))
        self.commands: Floats = amplitude * np.select(moving, [under_bell, 1.0, -1.0])

    def step_at(self, time: float) -> int:
        """Step of a time, s."""
        return round(time / self.dt)


def check_rest(samples: Samples, drive: MotionDrive) -> Finding:
    """Check that the rig does not move at a command of 0."""
    rest = samples.values[drive.rest, 0]
    if len(rest) < 3:
        return found("at rest", False, f"{len(rest)} samples before the motion are too few")
    first, last = rest[: len(rest) // 3].mean(axis=0), rest[-len(rest) // 3 :].mean(axis=0)
    drift = float(np.abs(last - first).max())
    noise = np.diff(rest, axis=0).std(axis=0).max() / math.sqrt(2)  # without the drift
    text = f"displacement changes by {1e3 * drift:.4f} mm under a command of 0, noise "
    text += f"{1e3 * noise:.4f} mm"
    return found("at rest", drift <= max(ONSET_NOISE * noise, 1e-6), text, drift_m=drift)


def check_moves(samples: Samples, drive: MotionDrive) -> Finding:
    """Check that the rig moves at a command, beyond its noise, and in its direction."""
    name = "follows the command"
    rest, moved = samples.values[drive.rest], samples.values[drive.bell]
    noise = rest.std(axis=0)
    size = (moved - rest.mean(axis=0)).std(axis=0)
    seen = float((size[1:] / np.maximum(noise[1:], 1e-300)).min(axis=1).max())
    text = f"its motion is {seen:.1f} times the noise in the sensor that sees it best"
    if not seen >= SEEN / 2:
        return found(name, False, text, seen=seen)
    drives = _correlate(drive.commands[drive.bell][:, np.newaxis], drive.dt)
    for axis in range(moved.shape[2]):
        if _ratio(_correlate(moved[:, 1, [axis]], drive.dt), drives).real <= 0:
            text = f"a positive command moves axis number {axis} backwards"
            remedy = f"reverse the valve's sign: force control would run away; or the {_SENSOR}"
            return found(name, False, text, remedy, seen=seen)
    return found(name, True, f"{text}, a positive command extends", seen=seen)


def check_units(samples: Samples, drive: MotionDrive, specimen: Specimen | None) -> list[Finding]:
    """Check that the channels are derivatives of one another, and the force the specimen's."""
    dt, values = drive.dt, samples.values[drive.bell]
    x, v, a, f = np.moveaxis(values - values.mean(axis=0), 1, 0)
    speed = _ratio(_correlate(v, dt), _correlate(x, dt, derivative=True))
    rate = _ratio(_correlate(a, dt), _correlate(v, dt, derivative=True))
    whose = f"displacement: {_why(_inverse(speed))}", f"acceleration: {_why(rate)}"
    if not (_fits(speed) or _fits(rate)) and abs(speed * rate - 1) <= 2 * _TOLERANCE:
        whose = f"velocity: {_why(speed)}", f"velocity: {_why(_inverse(rate))}"
    findings = [
        _assessed("velocity of displacement", "velocity / d(displacement)/dt", speed, whose[0]),
        _assessed("acceleration of velocity", "acceleration / d(velocity)/dt", rate, whose[1]),
    ]
    name = "force of specimen"
    if specimen is None:
        return [*findings, not_run(name, "mass, damping and stiffness are not known")]
    expected = _correlate(x, dt) @ specimen.stiffness.T + _correlate(v, dt) @ specimen.damping.T
    force = _ratio(_correlate(f, dt), expected + _correlate(a, dt) @ specimen.mass.T)
    why = "it can't be assessed: other channels are wrong"
    if _fits(speed) and _fits(rate):
        why = f"{_why(force)}, or the specimen's values in the experiment are wrong"
    return [*findings, _assessed(name, "force / (m a + c v + k x)", force, why)]


def _assessed(name: str, what: str, ratio: complex, why: str) -> Finding:
    """Assess a ratio that should be 1; ``why`` says whose fault it may be if it is not."""
    size, phase = abs(ratio), _phase(ratio)
    text = f"{what} is {size:.4g} at {phase:+.0f} degrees, 1 at 0 wanted"
    remedy = f"{why}; see the {_SENSOR}"
    return found(name, _fits(ratio), text, remedy, ratio=size, phase_deg=phase)


def _correlate(signal: Floats, dt: float, *, derivative: bool = False) -> Complex:
    """Correlate a signal, or its derivative, with waves; noise is not differentiated.

    The waves w are zero at both ends, so integration by parts moves the derivative from the
    signal y to them, int w y' dt = -int w' y dt (modulating functions, Shinbrot 1957).

    The signal has shape (N, n), the result (lines, n).
    """
    time = np.arange(len(signal)) * dt
    length = max(len(signal) - 1, 1) * dt
    bell = np.sin(np.pi * time / length) ** 2
    omega = 2 * np.pi * _LINES[:, np.newaxis]
    waves: Complex = np.exp(-1j * omega * time)
    if not derivative:
        return (bell * waves) @ signal * dt
    slope = np.pi / length * np.sin(2 * np.pi * time / length)
    return -(((slope - 1j * omega * bell) * waves) @ (signal - signal.mean(axis=0))) * dt


def _ratio(measured: Complex, expected: Complex) -> complex:
    """Least-squares factor from expected to measured; nan if nothing is expected."""
    power = float(np.vdot(expected, expected).real)
    return complex(np.vdot(expected, measured) / power) if power > 0 else complex(np.nan)


def _fits(ratio: complex) -> bool:
    return abs(ratio - 1) <= _TOLERANCE


def _inverse(ratio: complex) -> complex:
    return 1 / ratio if ratio else complex(np.inf)


def _phase(value: complex) -> float:
    return math.degrees(math.atan2(value.imag, value.real))


def _why(factor: complex) -> str:
    """Guess why a channel is too large by a factor."""
    size, is_reversed = abs(factor), factor.real < 0
    if not 0 < size < math.inf:
        return "it does not move"
    if abs(size - 1) <= _TOLERANCE and is_reversed:
        return "the sign is reversed"
    if abs(size - 1) <= _TOLERANCE:
        return f"it is {_phase(factor):.0f} degrees off: the channels are not of one time"
    known = (words for each, words in _FACTORS.items() if abs(size / each - 1) <= _TOLERANCE)
    words = next(known, f"it is {size:.4g} times too large")
    return f"{words}, and the sign is reversed" if is_reversed else words


def check_answer_delay(samples: Samples, drive: MotionDrive, sensor_lag: float) -> Finding:
    """Check that a command is applied from the next sample on, not later.

    The force shows it after ``sensor_lag`` s.
    """
    name, force = "answer applied", samples.values[:, 3]
    noise = np.maximum(force[drive.rest].std(axis=0), 1e-9)
    answers = (samples.steps > 0) & (samples.steps <= drive.steps)
    sent = drive.commands[samples.steps[answers] - 1]
    differs = (samples.drives[answers] != sent[:, np.newaxis]).any(axis=1)[sent != 0.0]
    if 2 * differs.sum() > len(differs):  # fewer may have been missed
        text = f"rig/state tells another drive at {differs.sum()} of {len(differs)} steps"
        return found(name, False, text, "see docs/hardware.md, the contract")
    delays = []
    for start in drive.doublets:
        before = force[start - drive.step_at(0.03) : start + 1].mean(axis=0)
        after = force[start : start + drive.step_at(DOUBLETS_APART)]
        change: Floats = (np.abs(after - before) / noise).max(axis=1)
        delays += np.flatnonzero(change > ONSET_NOISE)[:1].tolist()
    if not delays:
        return found(name, False, "the doublets are not seen in the force")
    longest = _VALVE + sensor_lag
    first, latest = min(delays), 2 + math.floor(longest / drive.dt)
    text = f"the answer to a sample is first seen {first} samples later"
    text += f" (2 to {latest} with up to {1e3 * longest:g} ms of valve, oil and sensor)"
    return found(name, 1 <= first <= latest, text, samples=float(first))


SETTLE, _BLOCK = 0.1, 0.1  # s of rest before each kind of bad command, and of the kind
_BESIDE = ("stale", "a second time")
"""Kinds that are sent after the step's own command; the others in its place, every other step."""
MOVED = 8.0  # times the noise
PART = 0.3  # of the effect of the same command when it is obeyed
REACTION_TIMEOUT_S = 0.5  # s beyond a watchdog's time, for this host and the message
RESTING = 3.0  # s within which a rig is at rest after a trip
STOP_TIME_NAME, STOP_FORCE_NAME = "stop time (s)", "stop peak force (N)"
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
        return self.block(len(CHECK_KINDS)).start

    def block(self, kind: int) -> slice:
        """Give the steps of a kind of command."""
        dt = self.codec.timebase.dt
        settle, length = max(4, round(SETTLE / dt)), max(10, round(_BLOCK / dt))
        start = settle + kind * (settle + length)
        return slice(start, start + length)

    def answers(self, step: int) -> list[bytes]:
        """Give the messages that answer a step."""
        good = self.codec.encode(step, np.zeros(len(self.codec.axes)))
        for number, kind in enumerate(CHECK_KINDS):
            block = self.block(number)
            if block.start <= step < block.stop:
                if kind in _BESIDE:
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


def check_refusals(
    trial: Trial, bad: BadCommands, moved: Samples, drive: MotionDrive
) -> list[Finding]:
    """Check that no bad command moves the rig, by the force of a good one before."""
    steps, force = trial.samples.steps, trial.samples.values[:, 3]
    noise = moved.values[drive.rest, 3].std(axis=0)
    pulse = moved.values[drive.doublets[0] :, 3] - moved.values[drive.doublets[0], 3]
    least = np.maximum(MOVED * noise, PART * np.abs(pulse).max(axis=0))
    findings = []
    for number, kind in enumerate(CHECK_KINDS):
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
    samples: Samples, at: int, limit: float | None, moved: Samples, drive: MotionDrive
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
    passed = bool((change < MOVED * moved.values[drive.rest, 3].std(axis=0)).all())
    return found(name, passed, text, change_n=float(change.max()))


def check_watchdog(trial: Trial, timeout: float, silent: str, *, by_itself: bool = True) -> Finding:
    """Check that the rig trips by itself within its time, s, when messages stop."""
    name = f"watchdog: {silent} silent"
    remedy = f"trip by itself within {timeout:g} s, and report phase tripped and the reason at once"
    if "silent" not in trial.marks:
        return found(name, False, "the test ended before", remedy)
    last, tripped = trial.last_state_after("silent"), trial.status_of(TRIPPED)
    if tripped is None or not by_itself:
        text = f"no trip; last state after {last:.3f} s, {timeout:g} s are configured"
        return found(name, False, text, remedy, last_state_s=last)
    took, reason = tripped[0] - trial.marks["silent"], tripped[1].values.get("reason", "")
    text = f"tripped after {took:.3f} s ({timeout:g} s configured): {reason or 'no reason given'}"
    passed = max(took, last) <= timeout + REACTION_TIMEOUT_S and bool(reason)
    return found(name, passed, text, remedy, tripped_s=took, last_state_s=last)


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


def check_safe_command(trial: Trial, next_one: Samples) -> Finding:
    """Check that the rig comes to rest after a trip in the middle of a motion.

    Its diagnostics must report when, and it must not have moved away until the next test.
    """
    name, last = "safe command", trial.samples
    if trial.status_of(TRIPPED) is None:
        return found(name, False, "the rig did not trip, and continues with the last command")
    values = rested(trial)
    if values is None:
        text = f"the rig does not report rest within {RESTING:g} s: "
        return found(name, False, text + trial.statuses[-1][1].message)
    took = float(values[STOP_TIME_NAME])
    if len(last.times) < 10 or len(next_one.times) < 10:
        return found(name, False, "too few states to see where it came to rest")
    start = last.values[:10, 0].mean(axis=0)
    stopped, again = last.values[-1, 0], next_one.values[:10, 0].mean(axis=0)
    noise = last.values[:10, 0].std(axis=0)
    further = float((np.abs(again - start) - np.abs(stopped - start) - MOVED * noise).max())
    text = f"at rest after {took:.3g} s"
    if STOP_FORCE_NAME in values:
        text += f", peak force {values[STOP_FORCE_NAME]} N"
    if further > BACK:
        text = f"{text} as reported, but {1e3 * further:.2f} mm farther away in the next test"
        return found(name, False, text, further_m=further)
    return found(name, took <= RESTING, text, stop_s=took)


def rested(trial: Trial) -> dict[str, str] | None:
    """Give the values of the status in which a rig that tripped reports rest."""
    trips = [s.values for _, s in trial.statuses if s.values.get("phase") == TRIPPED]
    return next((values for values in trips if STOP_TIME_NAME in values), None)
