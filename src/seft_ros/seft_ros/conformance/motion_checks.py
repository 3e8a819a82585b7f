"""Whether displacement, velocity, acceleration and force of a small motion are consistent."""

import math

import numpy as np
import numpy.typing as npt
from seft_msgs_py.wire.trajectory import Floats
from seft_plant_sim.specimen import Specimen

from seft_ros.conformance.driver import Samples
from seft_ros.conformance.finding import Finding, found, not_run

REST, BELL, PAUSE, PULSE = 0.4, 2.0, 0.3, 0.05  # s
DOUBLETS, APART = 5, 0.25  # s from one to the next
FREQUENCIES = (3.0, 6.0)  # Hz
SETTLING = 0.1  # s at the start that do not count
TOLERANCE = 0.2
"""Largest distance of a ratio from 1: a gain 20 % off, or 11 degrees of phase."""
SEEN = 5.0  # times the noise: a motion
ONSET_NOISE = 6.0
VALVE = 0.006  # s, longest delay of valve and oil
LINES = np.arange(2.0, 8.01, 0.5)
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


class Drive:
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
        first, apart = self.step_at(REST + BELL + PAUSE), self.step_at(APART)
        self.rest = slice(self.step_at(SETTLING), self.step_at(REST))
        self.bell = slice(self.step_at(REST), self.step_at(REST + BELL + PAUSE / 2))
        self.doublets = [first + number * apart for number in range(DOUBLETS)]
        self.steps = first + DOUBLETS * apart
        steps = np.arange(self.steps)
        time = steps * dt - REST
        waves = np.mean([np.sin(2 * np.pi * f * time) for f in FREQUENCIES], axis=0)
        under_bell = waves * np.sin(np.pi * time / BELL) ** 2
        pulse = (steps - first) % apart // max(1, self.step_at(PULSE))
        moving = [(time >= 0) & (time < BELL), (steps >= first) & (pulse == 0)]
        moving.append((steps >= first) & (pulse == 1))
        self.commands: Floats = amplitude * np.select(moving, [under_bell, 1.0, -1.0])

    def step_at(self, time: float) -> int:
        """Step of a time, s."""
        return round(time / self.dt)


def check_rest(samples: Samples, drive: Drive) -> Finding:
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


def check_moves(samples: Samples, drive: Drive) -> Finding:
    """Check that the rig moves at a command, beyond its noise, and in its direction."""
    name, rest, moved = (
        "follows the command",
        samples.values[drive.rest],
        samples.values[drive.bell],
    )
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
            mend = f"reverse the valve's sign: force control would run away; or the {_SENSOR}"
            return found(name, False, text, mend, seen=seen)
    return found(name, True, f"{text}, a positive command extends", seen=seen)


def check_units(samples: Samples, drive: Drive, specimen: Specimen | None) -> list[Finding]:
    """Check that the channels are derivatives of one another, and the force the specimen's."""
    dt, values = drive.dt, samples.values[drive.bell]
    x, v, a, f = np.moveaxis(values - values.mean(axis=0), 1, 0)
    speed = _ratio(_correlate(v, dt), _correlate(x, dt, derivative=True))
    rate = _ratio(_correlate(a, dt), _correlate(v, dt, derivative=True))
    culprits = ("displacement", _inverse(speed)), ("acceleration", rate)
    if not (_fits(speed) or _fits(rate)) and abs(speed * rate - 1) <= 2 * TOLERANCE:
        culprits = ("velocity", speed), ("velocity", _inverse(rate))
    findings = []
    for name, what, ratio, (culprit, factor) in (
        ("velocity of displacement", "velocity / d(displacement)/dt", speed, culprits[0]),
        ("acceleration of velocity", "acceleration / d(velocity)/dt", rate, culprits[1]),
    ):
        mend = f"{culprit}: {_why(factor)}; see the {_SENSOR}"
        numbers = {"ratio": abs(ratio), "phase_deg": _phase(ratio)}
        findings.append(found(name, _fits(ratio), _described(what, ratio), mend, **numbers))
    name = "force of specimen"
    if specimen is None:
        return [*findings, not_run(name, "mass, damping and stiffness are not known")]
    expected = _correlate(x, dt) @ specimen.stiffness.T + _correlate(v, dt) @ specimen.damping.T
    force = _ratio(_correlate(f, dt), expected + _correlate(a, dt) @ specimen.mass.T)
    why = "it can't be judged: other channels are wrong"
    if _fits(speed) and _fits(rate):
        why = _why(force)
    text = _described("force / (m a + c v + k x)", force)
    mend = f"{why}; see the {_SENSOR}, and the specimen's values in the experiment"
    return [*findings, found(name, _fits(force), text, mend, ratio=abs(force))]


def _correlate(signal: Floats, dt: float, *, derivative: bool = False) -> Complex:
    """Correlate a signal, or its derivative, with waves; noise is not differentiated.

    The waves w are zero at both ends, so that by parts the derivative of the signal y goes over to
    them, int w y' dt = -int w' y dt (modulating functions, Shinbrot 1957).

    The signal has shape (N, n), the result (lines, n).
    """
    time = np.arange(len(signal)) * dt
    length = max(len(signal) - 1, 1) * dt
    bell = np.sin(np.pi * time / length) ** 2
    omega = 2 * np.pi * LINES[:, np.newaxis]
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
    return abs(ratio - 1) <= TOLERANCE


def _inverse(ratio: complex) -> complex:
    return 1 / ratio if ratio else complex(np.inf)


def _described(what: str, value: complex) -> str:
    return f"{what} is {abs(value):.4g} at {_phase(value):+.0f} degrees, 1 at 0 wanted"


def _phase(value: complex) -> float:
    return math.degrees(math.atan2(value.imag, value.real))


def _why(factor: complex) -> str:
    """Guess why a channel is too large by a factor."""
    size, is_reversed = abs(factor), factor.real < 0
    if not 0 < size < math.inf:
        return "it does not move"
    if abs(size - 1) <= TOLERANCE and is_reversed:
        return "the sign is reversed"
    if abs(size - 1) <= TOLERANCE:
        return f"it is {_phase(factor):.0f} degrees off: the channels are not of one time"
    known = (words for each, words in _FACTORS.items() if abs(size / each - 1) <= TOLERANCE)
    words = next(known, f"it is {size:.4g} times too large")
    return f"{words}, and the sign is reversed" if is_reversed else words


def check_answer_delay(samples: Samples, drive: Drive) -> Finding:
    """Check that a command is applied from the next sample on, not later."""
    name, force = "answer applied", samples.values[:, 3]
    noise = np.maximum(force[drive.rest].std(axis=0), 1e-9)
    delays = []
    for start in drive.doublets:
        before = force[start - drive.step_at(0.03) : start + 1].mean(axis=0)
        after = force[start : start + drive.step_at(APART)]
        change: Floats = (np.abs(after - before) / noise).max(axis=1)
        delays += np.flatnonzero(change > ONSET_NOISE)[:1].tolist()
    if not delays:
        return found(name, False, "the doublets are not seen in the force")
    first, latest = min(delays), 2 + math.floor(VALVE / drive.dt)
    text = f"the answer to a sample is first seen {first} samples later"
    text += f" (2 to {latest} with up to {1e3 * VALVE:g} ms of valve and oil)"
    return found(name, 1 <= first <= latest, text, samples=float(first))
