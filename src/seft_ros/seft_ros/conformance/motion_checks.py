"""Whether displacement, velocity, acceleration and force of a small motion fit one another."""

import math

import numpy as np
from seft_msgs_py.wire.trajectory import Floats

from seft_ros.conformance.drive import APART, Drive
from seft_ros.conformance.facts import Facts
from seft_ros.conformance.finding import Finding, found, not_run
from seft_ros.conformance.projection import project, project_derivative, ratio
from seft_ros.conformance.trial import Samples

TOLERANCE = 0.2
"""Largest distance of a ratio from 1: a gain 20 % off, or 11 degrees of phase."""
SEEN = 5.0  # times the noise: a motion
ONSET_NOISE = 6.0
VALVE = 0.006  # s that valve and oil may take until a command is seen
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
    1.0: "the sign is reversed",
}
_SENSOR = "calibration: SI units, and positive where the actuator extends, in all four channels"


def check_rest(samples: Samples, drive: Drive) -> Finding:
    """See that the rig does not move while it is told 0."""
    rest = samples.values[drive.rest]
    if len(rest) < 3:
        return found("at rest", False, f"{len(rest)} samples before the motion, too few to tell")
    drift = np.abs(rest[-len(rest) // 3 :, 0].mean(0) - rest[: len(rest) // 3, 0].mean(0)).max()
    noise = np.diff(rest[:, 0], axis=0).std(axis=0).max() / math.sqrt(2)  # a drift is none
    least = max(ONSET_NOISE * noise, 1e-6)
    told = f"displacement changes by {1e3 * drift:.4f} mm under a command of 0, noise "
    told += f"{1e3 * noise:.4f} mm"
    mend = "the valve is not at its centre, or something moves the rig: trim the valve's null"
    return found("at rest", bool(drift <= least), told, mend, drift_m=float(drift))


def check_moves(samples: Samples, drive: Drive) -> Finding:
    """See that the rig moves when told to, beyond its noise, and in the direction of the drive."""
    rest, moved = samples.values[drive.rest], samples.values[drive.bell]
    noise = rest.std(axis=0)
    size = (moved - rest.mean(axis=0)).std(axis=0)
    seen = float((size[1:] / np.maximum(noise[1:], 1e-300)).min(axis=1).max())
    told = f"its motion is {seen:.1f} times the noise in the sensor that sees it best"
    if not seen >= SEEN / 2:
        mend = "is the pressure on? Then raise --amplitude"
        return found("moves as told", False, told, mend, seen=seen)
    drives = project(drive.commands()[drive.bell][:, np.newaxis], drive.dt)
    towards = [ratio(project(moved[:, 1, [i]], drive.dt), drives) for i in range(moved.shape[2])]
    wrong = [index for index, way in enumerate(towards) if way.real <= 0]
    if wrong:
        told = f"a positive command moves axis number {wrong[0]} backwards"
        mend = f"reverse the valve's sign: force control would run away; or the {_SENSOR}"
        return found("moves as told", False, told, mend, seen=seen)
    return found("moves as told", True, f"{told}, a positive command extends", seen=seen)


def check_units(samples: Samples, drive: Drive, facts: Facts) -> list[Finding]:
    """See that the channels are derivatives of one another, and the force the specimen's."""
    dt, values = facts.dt, samples.values[drive.bell]
    x, v, a, f = (values[:, row] - values[:, row].mean(axis=0) for row in range(4))
    speed = ratio(project(v, dt), project_derivative(x, dt))
    rate = ratio(project(a, dt), project_derivative(v, dt))
    findings = [
        _judged("velocity of displacement", "velocity / d(displacement)/dt", speed, rate, "x"),
        _judged("acceleration of velocity", "acceleration / d(velocity)/dt", rate, speed, "a"),
    ]
    name = "force of specimen"
    if facts.specimen is None:
        return [*findings, not_run(name, "mass, damping and stiffness are not known")]
    mass, damping, stiffness = facts.specimen
    expected = project(x, dt) @ stiffness.T + project(v, dt) @ damping.T + project(a, dt) @ mass.T
    force = ratio(project(f, dt), expected)
    is_last = all(finding.verdict == "passed" for finding in findings)
    told, mend = _told("force / (m a + c v + k x)", force), ""
    if not abs(force - 1) <= TOLERANCE:
        why = _why(force) if is_last else "other channels are wrong, and so is what it is held to"
        mend = f"{why}; see the {_SENSOR}, and the specimen's values in the experiment"
    return [*findings, found(name, not mend, told, mend, ratio=abs(force))]


def _judged(name: str, what: str, value: complex, other: complex, first: str) -> Finding:
    """Judge one ratio; where both are wrong it is the velocity's doing, else the other's."""
    told = _told(what, value)
    if abs(value - 1) <= TOLERANCE:
        return found(name, True, told, ratio=abs(value), phase_deg=_phase(value))
    both = not abs(other - 1) <= TOLERANCE
    if both and abs(value * other - 1) <= 2 * TOLERANCE:
        factor = value if first == "x" else 1 / value
        culprit = "velocity"
    else:
        culprit = "displacement" if first == "x" else "acceleration"
        factor = 1 / value if first == "x" else value
    mend = f"{culprit}: {_why(factor)}; see the {_SENSOR}"
    return found(name, False, told, mend, ratio=abs(value), phase_deg=_phase(value))


def _told(what: str, value: complex) -> str:
    return f"{what} is {abs(value):.4g} at {_phase(value):+.0f} degrees, 1 at 0 wanted"


def _phase(value: complex) -> float:
    return math.degrees(math.atan2(value.imag, value.real))


def _why(factor: complex) -> str:
    """Guess what makes a channel so many times too large."""
    if not math.isfinite(abs(factor)) or abs(factor) == 0:
        return "it does not move"
    sign = ", and the sign is reversed" if factor.real < 0 else ""
    for known, words in _FACTORS.items():
        if abs(abs(factor) / known - 1) <= TOLERANCE:
            if known == 1.0:
                if sign:
                    return words
                return f"it is {_phase(factor):.0f} degrees off: the channels are not of one time"
            return words + sign
    return f"it is {abs(factor):.4g} times too large{sign}"


def check_answer_delay(samples: Samples, drive: Drive, facts: Facts) -> Finding:
    """See that a command is applied from the next sample on, not later."""
    name = "answer applied"
    force = samples.values[:, 3]
    rest = force[drive.rest]
    noise = np.maximum(rest.std(axis=0), 1e-9)
    delays = []
    for start in drive.doublets:  # one that this host sent too late for its step is a later one
        before = force[start - drive.step_at(0.03) : start + 1].mean(axis=0)
        after = force[start : start + drive.step_at(APART)]
        change: Floats = (np.abs(after - before) / noise).max(axis=1)
        delays += np.flatnonzero(change > ONSET_NOISE)[:1].tolist()
    mend = "apply the command that answers sample k from sample k+1 on, without a queue"
    if not delays:
        return found(name, False, "the doublets are not seen in the force", mend)
    first, latest = min(delays), 2 + math.floor(VALVE / facts.dt)
    told = f"the answer to a sample is first seen {first} samples later"
    told += f" (2 to {latest} with up to {1e3 * VALVE:g} ms of valve and oil)"
    return found(name, 1 <= first <= latest, told, mend, samples=float(first))
