"""Faults of the simulated rig: what a parameter file says of them, and their arrays.

A fault is a line, ``[AXIS/]WHAT KIND [VALUE] at TIME [for STEPS]``; docs/rig.md has the kinds.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.config.facts import CHANNELS, FORCE_DRIVEN, POSITION_SERVO
from seft_msgs_py.config.parameter_table import nearest
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RigAxes, Timebase

from seft_plant_sim.compiled import compiled
from seft_plant_sim.rig_parameters import is_imposed
from seft_plant_sim.simulated.continuous_model import Dynamics, Motion
from seft_plant_sim.simulated.specimen import Specimen
from seft_plant_sim.simulated.springs import ONE_SIDED, SPRING_KIND, Spring

GRAMMAR = "[AXIS/]WHAT KIND [VALUE] at TIME [for STEPS]"
VALVE = 4  # row of the first of KINDS that is no channel
SET, ADD, SCALE, DRIFT, NOISE, HOLD, LATE, LOW_PASS, FLIP, BIT, PLAY = range(11)
"""What is done to a signal."""
_SUPPLIED, _BREAK, _SLIP, _COLLIDE = range(PLAY + 1, PLAY + 5)
_KINDS = ("set", "add", "scale", "drift", "noise", "freeze", "late", "lowpass", "flip", "bit")
_OF_CHANNELS = dict(zip(_KINDS, range(PLAY), strict=True))
_OF_FORCES = {"stick": HOLD, "slow": LOW_PASS}
_OF_FORCES |= {kind: _OF_CHANNELS[kind] for kind in ("set", "add", "scale", "flip", "late")}
_OF_VALVES = {"stick": HOLD, "open": SET, "slow": LOW_PASS, "null": DRIFT, "hysteresis": PLAY}
KINDS: dict[str, dict[str, int]] = {
    **dict.fromkeys(CHANNELS, _OF_CHANNELS),
    "valve": _OF_VALVES | _OF_FORCES,
    "supply": {"scale": _SUPPLIED},
    "specimen": {"break": _BREAK, "slip": _SLIP, "collide": _COLLIDE},
}
"""WHAT -> its kinds of fault."""
WITHOUT_VALUE = ("freeze", "flip", "stick")
_ROWS = {what: row for row, what in enumerate(KINDS)}
NEEDS = {
    "noise": (0.0, math.inf, "an RMS of at least 0"),
    "late": (0.0, 10.0, "a time of 0 to 10 s"),
    "lowpass": (1e-6, math.inf, "a cut-off above 0 Hz"),
    "slow": (1e-6, math.inf, "a cut-off above 0 Hz"),
    "hysteresis": (0.0, math.inf, "a width of at least 0 V"),
    "break": (0.0, 1.0, "the stiffness that is left, 0 to 1"),
    "collide": (1e-6, math.inf, "the stiffness of a stop, above 0 N/m"),
}
"""Kind -> least and largest value, and what that is."""
MOST_LATE = 1_000_000  # samples that a late signal is kept
_END = 2**62  # step of a fault that does not end
_LATEST = 1e9  # s; at 1 MHz the step of a later one would not be below that


@dataclass(frozen=True)
class Fault:
    """One fault of a rig.

    Attributes
    ----------
    text : str
        As it was given.
    axis : str
        Name of its axis; empty for all.
    what, kind : str
        Keys of `KINDS`.
    value : float
        In SI units; 0 for a kind without a value.
    time : float
        When it begins, s of the test.
    steps : int or None
        Samples that it lasts; None: to the end.
    """

    text: str
    axis: str
    what: str
    kind: str
    value: float
    time: float
    steps: int | None

    def error(self, reason: str) -> InputError:
        """Give the error of this fault."""
        return _error(self.text, reason)


def _error(text: str, reason: str) -> InputError:
    return InputError(f'rig: faults: "{text}": {reason}')


def read_faults(given: str | Sequence[str], axes: Sequence[str]) -> list[Fault]:
    """Read the parameter ``faults``: one line, a list of them, or an empty text.

    Raises
    ------
    InputError
        If a line is no fault, or its axis is none of ``axes``.
    """
    lines = [given] if isinstance(given, str) else given
    return [_read(line, axes) for line in lines if line.strip()]


def _read(text: str, axes: Sequence[str]) -> Fault:
    error = partial(_error, text)
    words = text.split()
    head, at, tail = words[:2], words[2:], []
    if "at" in at:
        place = at.index("at")
        at, tail = at[:place], at[place + 1 :]
    if len(words) < 2 or len(at) > 1 or len(tail) not in (1, 3) or tail[1:2] not in ([], ["for"]):
        raise error(f"a fault is {GRAMMAR}, such as force scale 0.7 at 5.25 for 100")
    axis, _, what = head[0].rpartition("/")
    kind = head[1]
    if what not in KINDS:
        raise error(f"{what} can't fail; {', '.join(KINDS)} can{nearest(what, KINDS)}")
    if kind not in KINDS[what]:
        raise error(f"{what} can't {kind}; it can {', '.join(KINDS[what])}")
    if axis and axis not in axes:
        raise error(f"there is no axis {axis}; there are {', '.join(axes)}{nearest(axis, axes)}")
    if bool(at) == (kind in WITHOUT_VALUE):
        raise error(f"{kind} takes no value" if at else f"{kind} needs a value")
    value = _number(at[0]) if at else 0.0
    is_any = kind == "set" and what in CHANNELS  # a converter may give NaN
    if value is None or not (is_any or math.isfinite(value)):
        raise error(f"{at[0]} is no number")
    least, most, needed = NEEDS.get(kind, (-math.inf, math.inf, ""))
    if needed and not least <= value <= most:
        raise error(f"{kind} needs {needed}")
    if kind == "bit" and not (value.is_integer() and 0 <= value < 32):
        raise error("bit needs the number of a bit, 0 the lowest")
    time, steps = _number(tail[0]), _number(tail[2]) if len(tail) == 3 else None
    if time is None or not 0.0 <= time <= _LATEST:
        raise error(f"TIME is {tail[0]}, but must be a time in s of the test, 0 to {_LATEST:g}")
    whole = steps is not None and 1 <= steps <= _END and steps.is_integer()
    if len(tail) == 3 and not whole:
        need = "must be a whole number of samples, at least 1 (leave it out to go on to the end)"
        raise error(f"STEPS is {tail[2]}, but {need}")
    return Fault(text, axis, what, kind, value, time, None if steps is None else int(steps))


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def check_times(given: str | Sequence[str], axes: Sequence[str], duration: float) -> None:
    """Raise `InputError` for a fault that begins after a test of ``duration`` s."""
    for fault in read_faults(given, axes):
        if fault.time > duration:
            raise fault.error(f"the test ends at {duration:g} s, before the fault begins")


_apart = partial(compiled, inline=False)  # few rigs fail
_WHAT, _KIND, _AXIS, _FIRST, _LAST, _PLACE = range(6)


class Faults(NamedTuple):
    """Faults of a rig, one for each axis that they concern, F of them.

    Attributes
    ----------
    numbers : ndarray
        Shape (F, 6): row of the channel or `VALVE`, what is done, place of the axis, first step,
        the step after the last, row of the noise or place of a stop among the springs.
    values : ndarray
        Shape (F, 3): the value per step; resolution of the converter, or the filter's pole; half of
        the converter's codes.
    """

    numbers: Ints
    values: Floats


def faults_of(
    faults: Sequence[Fault],
    own: RigAxes,
    timebase: Timebase,
    resolution: Floats,
    springs: int,
    section: dict[str, Any],
) -> tuple[Faults, int]:
    """Give the arrays of a rig's faults, and the numbers that each keeps in memory.

    Parameters
    ----------
    faults : sequence of Fault
        Of all rigs of the test.
    own : RigAxes
        Axes of the rig, n of them.
    timebase : Timebase
        Sampling clock.
    resolution : ndarray
        Of the converters, shape (4, n); 0: there is none.
    springs : int
        Number of springs before the stops of `failing_specimen`.
    section : dict
        Parameters of the rig.

    Raises
    ------
    InputError
        If the rig has no such part.
    """
    dt, places = timebase.dt, {axis: place for place, axis in enumerate(own.axes)}
    draws = [fault for fault in faults if fault.kind == "noise"]
    bits = section["simulated.sensors.adc_bits"]
    half = 2 ** (bits - 1) if bits else 0
    numbers, values, width = [], [], 2
    for fault in faults:
        _check_part(fault, section)
        code = KINDS[fault.what][fault.kind]
        row = _ROWS[fault.what]
        first = math.ceil(fault.time / dt - 1e-6)
        last = _END if fault.steps is None else first + fault.steps
        own_place = 4 + draws.index(fault) if code == NOISE else 0
        value, more = fault.value, 0.0
        if code == DRIFT:
            value *= dt
        elif code == LATE:
            value /= dt
            if value > MOST_LATE:
                raise fault.error(f"late needs at most {MOST_LATE} samples, {MOST_LATE * dt:g} s")
            width = max(width, math.ceil(value) + 2)
        elif code == LOW_PASS:  # 1 / (1 + s / w_c) by the bilinear transform
            over = math.pi * value * dt
            value, more = over / (1.0 + over), (1.0 - over) / (1.0 + over)
        for axis in [fault.axis] if fault.axis else own.axes:
            if axis in places:
                place = places[axis]
                more = resolution[row, place] if code == BIT else more
                if code == _COLLIDE:
                    own_place, springs = springs, springs + 1
                numbers.append([row, code, place, first, last, own_place])
                values.append([value, more, half])
    arrays = np.array(numbers, dtype=np.int64), np.array(values, dtype=np.float64)
    return Faults(arrays[0].reshape(-1, 6), arrays[1].reshape(-1, 3)), width


def _check_part(fault: Fault, section: dict[str, Any]) -> None:
    """Raise `InputError` if a rig has no such part."""
    actuator, bits = section["actuator.kind"], section["simulated.sensors.adc_bits"]
    what, is_bit = fault.what, fault.kind == "bit"
    if what in ("velocity", "acceleration") and section[f"sensors.{what}"] == "derived":
        why = f"it is derived (sensors.{what}): there is no sensor of it; let the displacement fail"
    elif is_bit and not bits:
        why = "there is no converter; give rig: simulated.sensors.adc_bits, /**: sensors.*_range"
    elif is_bit and fault.value >= bits:
        why = f"the converter has the bits 0 to {bits - 1} (simulated.sensors.adc_bits)"
    elif what == "supply" and is_imposed(section):
        why = "it has no valve; give its vendor's loop, simulated.actuator.servo.proportional"
    elif what == "supply" and actuator not in ("servo_hydraulic", POSITION_SERVO):
        why = f"actuator.kind {actuator} has no supply pressure; make that servo_hydraulic"
    elif what == "valve" and actuator in FORCE_DRIVEN and fault.kind not in _OF_FORCES:
        why = f"actuator.kind {actuator} has no valve: its force can {', '.join(_OF_FORCES)}"
    else:
        return
    raise fault.error(why)


def failing_specimen(faults: Sequence[Fault], own: RigAxes, specimen: Specimen) -> Specimen:
    """Give a rig's specimen the springs that may break or slip, and stops to collide with.

    A linear specimen becomes one of springs between each two axes, and to the ground, which add up
    to its stiffness.
    """
    faults = [f for f in faults if f.what == "specimen" and f.axis in ("", *own.axes)]
    n, k = specimen.axes, specimen.stiffness
    springs, rows = list(specimen.springs), [*specimen.deformation] if specimen.springs else []
    if faults and not springs:
        ground = k.diagonal() - (np.abs(k).sum(axis=1) - np.abs(k.diagonal()))
        for i in range(n):
            springs.append(Spring.elastic(ground[i]))
            rows.append(np.eye(n)[i])
            for j in np.flatnonzero(k[i, :i]):
                springs.append(Spring.elastic(abs(k[i, j])))
                rows.append(np.eye(n)[i] + np.sign(k[i, j]) * np.eye(n)[j])
    for fault in faults:
        if fault.kind == "collide":
            for axis in [fault.axis] if fault.axis else own.axes:
                springs.append(Spring.stop(fault.value))
                rows.append(np.eye(n)[own.axes.index(axis)])
    if not faults:
        return specimen
    return replace(specimen, springs=tuple(springs), deformation=np.array(rows))


@_apart
def wear(faults: Faults, step: int, dynamics: Dynamics, motion: Motion) -> None:
    """Let the faults of supply and specimen act on a motion from the sample of a step on."""
    n = len(motion.supply)
    motion.supply[:], motion.left[:], motion.slipped[:] = 1.0, 1.0, 0.0
    for j in range(len(faults.numbers)):
        kind, i, value = faults.numbers[j, _KIND], faults.numbers[j, _AXIS], faults.values[j, 0]
        first, last = faults.numbers[j, _FIRST], faults.numbers[j, _LAST]
        if kind == _COLLIDE:
            stop = motion.springs[faults.numbers[j, _PLACE]]
            if step == first:
                stop[1], stop[2] = motion.work[i], 1.0 if motion.work[n + i] >= 0.0 else -1.0
            elif step == last:
                stop[2] = 0.0
        elif kind == _SUPPLIED and first <= step < last:
            motion.supply[i] *= value
        elif kind in (_BREAK, _SLIP) and first <= step < last:
            for p in range(len(motion.left)):
                factor = dynamics.deformation[p, i]
                if factor == 0.0 or dynamics.laws[p, SPRING_KIND] == ONE_SIDED:
                    continue
                if kind == _BREAK:
                    motion.left[p] = min(motion.left[p], value)
                else:
                    motion.slipped[p] += factor * value


@_apart
def show_fault(faults: Faults, step: int, noise: Floats, memory: Floats, measured: Floats) -> None:
    """Let the faults of the sensors of a sample act, in their order.

    Noise, RMS 1, has shape (4 + number of noises, n); the sample of shape (4, n) is changed.
    """
    for j in range(len(faults.numbers)):
        row, i = faults.numbers[j, _WHAT], faults.numbers[j, _AXIS]
        if row < VALVE:
            draw = noise[faults.numbers[j, _PLACE], i]
            measured[row, i] = _altered(faults, j, step, draw, memory, measured[row, i])


@_apart
def obey(faults: Faults, step: int, memory: Floats, i: int, drive: float) -> float:
    """Give what axis i does for a drive after the sample of a step, V or N."""
    for j in range(len(faults.numbers)):
        if faults.numbers[j, _WHAT] == VALVE and faults.numbers[j, _AXIS] == i:
            drive = _altered(faults, j, step, 0.0, memory, drive)
    return drive


@_apart
def _altered(
    faults: Faults, j: int, step: int, draw: float, memory: Floats, fault_free: float
) -> float:
    """Give a signal with fault j; the fault follows the fault-free signal from step 0 on."""
    kind, first = faults.numbers[j, _KIND], faults.numbers[j, _FIRST]
    value, more, own = faults.values[j, 0], faults.values[j, 1], memory[j]
    found = fault_free
    if kind == SET:
        found = value
    elif kind == ADD:
        found = fault_free + value
    elif kind == SCALE:
        found = fault_free * value
    elif kind == DRIFT:
        found = fault_free + value * (step - first)
    elif kind == NOISE:
        found = fault_free + value * draw
    elif kind == FLIP:
        found = -fault_free
    elif kind == HOLD:
        if step <= first:
            own[0] = fault_free
        found = own[0]
    elif kind == LATE:
        places = len(own)
        own[step % places] = fault_free
        whole = int(value)
        part, newer = value - whole, max(step - whole, 0)
        found = own[newer % places]
        if part > 0.0:
            found += part * (own[max(newer - 1, 0) % places] - found)
    elif kind == LOW_PASS:
        if step <= first:
            own[0] = own[1] = fault_free
        own[1] = more * own[1] + value * (fault_free + own[0])
        own[0] = found = fault_free
        found = own[1]
    elif kind == PLAY:
        if step < first:
            own[0] = fault_free
        own[0] = min(max(own[0], fault_free - 0.5 * value), fault_free + 0.5 * value)
        found = own[0]
    elif kind == BIT and math.isfinite(fault_free):
        half = int(faults.values[j, 2])
        code = min(max(int(np.rint(fault_free / more)), -half), half - 1)
        found = (((code + half) ^ (1 << int(value))) - half) * more
    return found if first <= step < faults.numbers[j, _LAST] else fault_free
