"""What a small motion shows of a rig: signs, units and lags of its channels, dead time, stop."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from seft_msgs_py.arrays import Complexes, Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS, POSITION_SERVO
from seft_msgs_py.config.parameter_table import group, per_axis
from seft_msgs_py.wire.topics import VALVE_COMMAND, RigAxes
from seft_plant_sim.channels import FORCE, acceleration_is_derived, per_channel, velocity_is_derived
from seft_plant_sim.hardware.hosted import HardwareError
from seft_plant_sim.judge.known_rig import command_limit, known_responses
from seft_plant_sim.lti import TransferFunction
from seft_plant_sim.rig_parameters import common_lag
from seft_plant_sim.simulated.specimen import Specimen

from seft_ros.check.rig_mover import LEAD, RigMover
from seft_ros.identification.multisine_estimates import aligned, regressed

_BELL, _PAUSE, _FREQUENCIES = 4.0, 0.3, (3.0, 6.0, 12.0)  # s, s, Hz
_OMEGA = 2 * np.pi * np.arange(2.0, 14.01, 0.5)  # rad/s, at which signals are correlated
_FIRST_PART = 0.125  # of the amplitude: with so small a motion a rig is looked at first
_SEEN, _STILL = 5.0, 6.0  # times the noise: a motion, of the best line; a change at rest
_TOLERANCE, _LATE, _ERRORS = 0.2, 1e-3, 3.0
"""Allowed are so large a part of a factor, such a lag (s), and these standard errors more."""
_UNLIKE = 0.25  # of a channel's power does not follow from the displacement: it is another channel
_GOING, _ANSWERS, _WATCHED, _EDGE, _GOES_ON = 0.2, 0.05, 0.3, 0.02, 0.5
"""Times, s: of the motion before safe(); of valve and oil; after that; of a mean. Part of it."""
_UNITS = (1e3, 1e-3, 1 / 9.80665, 9.80665, 1e2, 1e-2, 1 / 0.0254, 4.448, 1 / 4.448, 1.0)
"""Factors of mm, kN, g and others, which are known exactly."""
_OTHER = "is another channel or axis at its place in read()?"
_ACTUATOR = "dead_time", "delay", "valve_frequency", "valve_damping", "oil_stiffness", "leakage"


class Finding(NamedTuple):
    """One check: its name, whether all is well, and what to do about it if not."""

    name: str
    ok: bool
    text: str


def _found(name: str, ok: object, text: str, remedy: str) -> Finding:
    return Finding(name, bool(ok), text if ok else f"{text}: {remedy}")


class RigCheck:
    """Checks one rig of an experiment, by commands of at most ``amplitude``, V, m or N."""

    def __init__(
        self, mover: RigMover, experiment: Experiment, of: RigAxes, amplitude: float | None
    ) -> None:
        section, axes, own = experiment["rig"], experiment.axes, list(of.places)
        self._mover, self._section, self._axes = mover, section, of.axes
        self._has_valve = mover.rig.drive == VALVE_COMMAND.name
        self._servos: list[TransferFunction] = []
        default, limit = 50.0, section["limits.force"]
        if self._has_valve:
            default, limit = 0.2, command_limit(section)
        if section["actuator.kind"] == POSITION_SERVO:
            default, self._servos = 5e-4, known_responses(section, axes, own)
        self._amplitude = min(amplitude or default, limit)
        where, known = "/**: specimen", "/**: actuator.*"
        specimen = Specimen.from_parameters(group(section, "specimen"), axes, where)
        self._specimen = specimen.part(of, where)
        every = {each: per_axis(section[f"actuator.{each}"], axes, known) for each in _ACTUATOR}
        self._actuator = {each: values[own] for each, values in every.items()}
        self._factor = "per_volt" if mover.hosted else "scale"
        forms = (f"calibration.{{}}_{what}" for what in (self._factor, "lag"))
        self._factors, self._lags = (per_channel(section, axes, form)[:, own] for form in forms)
        measured = not velocity_is_derived(section), not acceleration_is_derived(section)
        self._used = np.array([True, *measured, True])

    def findings(self) -> Iterator[Finding]:
        """Give the findings one by one; what needs a failed check to be good is not checked."""
        try:
            for check in (self._rests, self._calls):  # before it moves
                yield (found := check())
                if not found.ok:
                    return
            for place in range(self._mover.n):
                yield from self._moves(place)
                if self._mover.fault:
                    return
            yield self._stops()
        except HardwareError as error:
            yield Finding("calls", False, str(error))

    def _rests(self) -> Finding:
        """Look at the rig at rest, and take its biases from that."""
        mover, zeroing = self._mover, self._section["calibration.zeroing"]
        samples = mover.play(np.zeros((mover.step_at(max(zeroing, LEAD)), mover.n)))
        if mover.fault:
            return self._limit("rest")
        if zeroing:
            mover.rig.zero(mover.raw)
        self._noise = np.maximum(samples.std(axis=0), 1e-12)
        x, third = samples[:, 0], max(1, len(samples) // 3)
        drift = np.abs(x[-third:].mean(axis=0) - x[:third].mean(axis=0))
        noise = np.diff(x, axis=0).std(axis=0) / np.sqrt(2)  # without the drift
        ok = (drift <= np.maximum(_STILL * noise, 1e-6)).all()
        text = f"moves by {1e3 * drift.max():.3g} mm in {len(x) * mover.dt:.2g} s at rest"
        return _found("rest", ok, text, "give the valve's null as rig: safe.valve_command")

    def _moves(self, place: int) -> Iterator[Finding]:
        """Move one axis, first a little; give what its channels show."""
        mover, begin = self._mover, self._mover.step_at(LEAD)
        time = np.arange(mover.step_at(LEAD + _BELL + _PAUSE)) * mover.dt - LEAD
        waves = np.mean([np.sin(2 * np.pi * f * time) for f in _FREQUENCIES], axis=0)
        bell = np.where((time >= 0) & (time < _BELL), np.sin(np.pi * time / _BELL) ** 2, 0.0)
        for part in (_FIRST_PART, 1.0):
            commands = np.zeros((len(time), mover.n))
            commands[:, place] = part * self._amplitude * waves * bell
            samples = mover.play(commands)
            moved = samples[begin:] - samples[:begin].mean(axis=0)
            found = [self._limit("limits")] if mover.fault else []
            if len(moved) >= begin:  # a motion that had to end may do
                applied = commands[begin - 1 : len(samples) - 1, place]
                looked = self._look(place, applied, moved, is_whole=part == 1.0)
                found += [each for each in looked if not (mover.fault and each.ok)]
            if part == 1.0 or not all(each.ok for each in found):
                break
        prefix = f"{self._axes[place]}: " if mover.n > 1 else ""
        yield from (Finding(prefix + each.name, each.ok, each.text) for each in found)

    def _look(self, at: int, applied: Floats, moved: Floats, *, is_whole: bool) -> list[Finding]:
        """Find signs, factors and lags of the channels of the axis that was moved."""
        dt, s = self._mover.dt, self._specimen
        noise = self._noise * np.sqrt(3 / 8 * len(moved)) * dt
        y, change = (_correlate(moved, dt, order) for order in (0, 1))
        seen = np.abs(y).max(axis=0) / noise
        if is_whole and (why := self._unseen(at, seen[0], seen[self._used, at].max())):
            return [Finding("motion", False, why)]
        x0, x1, x2 = y[:, 0], change[:, 0], _correlate(moved[:, 0], dt, 2)
        elastic = x0 @ s.stiffness[at] + x2 @ s.mass[at]
        expected = [x1[:, at]], [x2[:, at]], [elastic, x1[:, at]]
        fits = np.array([[1.0, 0.0, 0.0, 0.0, 0.0], *[[np.nan] * 5] * 3])
        rows = np.flatnonzero(self._used & (seen[:, at] >= (_SEEN if is_whole else 4 * _SEEN)))
        if len(rows) < 3 and not is_whole:
            return []
        for row in rows[rows > 0]:
            fits[row] = fit_to(y[:, row, at], expected[row - 1], dt)
        force, oil = fits[FORCE, 0], self._actuator["oil_stiffness"][at]
        drives = x1[:, at] if self._has_valve else elastic  # what obeys the command
        if self._servos:
            drives = y[:, 0, at]
        elif np.isfinite(force) and not self._has_valve:
            drives = y[:, FORCE, at] / force
        elif np.isfinite(force) and oil:  # the flow also fills the oil
            leak = self._actuator["leakage"][at]
            drives = drives + (change[:, FORCE, at] + leak * y[:, FORCE, at]) / (force * oil)
        driven = fit_to(drives, [_correlate(applied, dt)], dt)
        found = self._channels(at, fits, np.sign(driven[0]))
        if is_whole:
            text = "shows no motion: look at its cable, and at its place in read()"
            unseen = np.flatnonzero(self._used & (seen[:, at] < _SEEN))
            found += [Finding(CHANNELS[row], False, text) for row in unseen]
            found.append(self._dead_time(at, driven[1], driven[3]))
        return found

    def _unseen(self, at: int, seen: Floats, best: float) -> str:
        """Say why no channel can be looked at, by how displacements are seen; empty if they can."""
        other = int(seen.argmax())
        if other != at and seen[other] > max(_SEEN, 3 * seen[at]):
            pair = f"{self._axes[at]} moves {self._axes[other]}"
            return f"a command of {pair}: exchange their valves in write(), or sensors in read()"
        if max(seen[at], best) < _SEEN:
            return "nothing moves: is the pressure on, the valve connected? Then raise --amplitude"
        text = "displacement shows no motion, others do: look at its cable, and at read()"
        return text if seen[at] < _SEEN else ""

    def _channels(self, at: int, fits: Floats, driven: float) -> list[Finding]:
        """Judge the channels of an axis by `fit_to`, and the sign of its command.

        What most of them say is right; of signs, the valve has a say as well.
        """
        factor, lag, *errors, unlike = fits.T
        strange, known = unlike > _UNLIKE, np.isfinite(factor)
        if strange.sum() >= max(2, known.sum() - 1):
            return [Finding(CHANNELS[0], False, f"others do not follow from it: {_OTHER}")]
        fine = known & ~strange
        most = 1.0 if 1.0 + driven * np.sign(factor[fine]).sum() >= 0 else -1.0
        by = factor * driven * most / np.median(np.abs(factor[fine]))
        late = lag - np.median(lag[fine])
        errors[0] = errors[0] / np.abs(factor)
        error, lag_error = (np.hypot(each, np.nanmean(each)) for each in errors)  # to the others
        close = np.abs(np.log(np.abs(by))) <= np.log1p(_TOLERANCE) + _ERRORS * error
        in_time = np.abs(late) <= _LATE + _ERRORS * lag_error
        text = f"a positive command {'extends' if most > 0 else 'retracts'} the actuator"
        found = [_found("direction", most > 0, text, "reverse the sign in write(), or the valve's")]
        for row in np.flatnonzero(known):
            name, old = CHANNELS[row], self._factors[row, at]
            if strange[row]:
                found.append(Finding(name, False, f"does not follow from displacement: {_OTHER}"))
                continue
            size, text = float(np.abs(by[row])), f"{by[row]:.3g} of what the others say"
            exact = (each for each in _UNITS if abs(size / each - 1) <= _TOLERANCE)
            unit = np.copysign(next(exact, size), by[row])
            new = old / unit if self._mover.hosted else old * unit
            sign = f"make it {'negative' if new < 0 else 'positive'}, " if unit < 0 else ""
            remedy = f"/**: calibration.{name}_{self._factor}: {sign}{new:.3g} in place of {old:g}"
            found.append(_found(name, close[row] and unit > 0, text, remedy))
            old, text = self._lags[row, at], f"{1e3 * late[row]:.2f} ms behind the others"
            remedy = f"/**: calibration.{name}_lag: {old + late[row]:.3g} in place of {old:g}"
            if old + late[row] < 0:
                remedy = f"raise /**: calibration.*_lag of the others by {-late[row]:.3g}"
            found.append(_found(f"{name} lag", in_time[row], text, remedy))
        return found

    def _dead_time(self, at: int, lag: float, error: float) -> Finding:
        """Compare the time from command to motion, s, with what is known of it."""
        known, name = self._actuator, "dead_time" if self._has_valve else "delay"
        old = known[name][at]
        if self._servos:
            name, old = "response.dead_time", self._servos[at].dead_time
        due = self._mover.dt / 2 + common_lag(self._section) + old  # held for a period
        if self._servos:
            middle = np.array(_FREQUENCIES[1:2])
            without = replace(self._servos[at], dead_time=0.0).response(middle)
            due -= float(np.angle(without)[0] / (2 * np.pi * middle[0]))
        elif self._has_valve and known["valve_frequency"][at]:
            due += known["valve_damping"][at] / (np.pi * known["valve_frequency"][at])
        ok = abs(lag - due) <= max(self._mover.dt, 2 * _LATE) + _ERRORS * error
        text = f"{1e3 * lag:.1f} ms from command to motion, {1e3 * due:.1f} ms are known"
        new = max(0.0, old + lag - due)
        return _found("dead time", ok, text, f"/**: actuator.{name}: {new:.3g} in place of {old:g}")

    def _stops(self) -> Finding:
        """Call safe() in the middle of a motion: see that it stops the piston."""
        mover, at = self._mover, self._mover.step_at
        begin, safe, edge = at(LEAD), at(LEAD + _GOING), max(1, at(_EDGE))
        rests = safe + at(self._section["safe.close_time"] + _ANSWERS)
        commands = np.zeros((rests + at(_WATCHED), mover.n))
        commands[begin:] = self._amplitude / 4
        samples = mover.play(commands, safe_at=safe)
        if mover.fault:
            return self._limit("safe()")
        row = 0 if self._has_valve else FORCE
        ends = begin, safe, rests + edge, len(samples)
        first, then, later, last = (samples[e - edge : e, row].mean(axis=0) for e in ends)
        before, on = then - first, (last - later) * _GOING / _WATCHED
        after = on if self._has_valve else last - first
        if not (np.abs(before) > _STILL * self._noise[row] / np.sqrt(edge)).all():
            return Finding("safe()", False, "its motion is too small to see: raise --amplitude")
        left = float(np.abs(after / before).max())
        text = f"{100 * left:.0f} % of the motion is left after it"
        remedy = "rig: hardware: its safe() must close the valve, whatever write() did before"
        return _found("safe()", left < _GOES_ON, text, remedy)

    def _calls(self) -> Finding:
        """Compare the time of the calls with a period, of which the answer needs the other half."""
        mover, dt = self._mover, self._mover.dt
        times = np.array(mover.times)
        used = times[:, 1] if mover.rig.hardware.is_clock else times.sum(axis=1)
        read, write = 1e3 * times.max(axis=0)
        text = f"read() {read:.2g} ms, write() {write:.2g} ms at most, a period {1e3 * dt:g} ms"
        if np.quantile(used, 0.9) > dt / 2:
            remedy = "half of it is for the answer: read in a thread, or lower /**: rate"
            return Finding("calls", False, f"{text}; {remedy}")
        remedy = f"{mover.late} of {len(times)} samples came late: other programs, or its calls"
        return _found("calls", mover.late <= 0.02 * len(times), text, remedy)

    def _limit(self, name: str) -> Finding:
        """Say that a motion, or a rest, had to end, and which parameter may be wrong."""
        fault = self._mover.fault
        channel = next((each for each in CHANNELS if fault.startswith(each)), "*")
        text = f"{fault}: if it was not so, /**: calibration.{channel}_{self._factor} is wrong"
        return Finding(name, False, f"{text}; else choose a smaller --amplitude")


def _correlate(signal: Floats, dt: float, order: int = 0) -> Complexes:
    """Correlate a signal's derivative, shape (N, ...), with waves, shape (lines, ...).

    The waves are zero at both ends, as their slopes are, so integration by parts moves the
    derivatives from the signal to them (modulating functions, Shinbrot 1957).
    """
    time, turn = np.arange(len(signal)) * dt, 2 * np.pi / (max(len(signal) - 1, 1) * dt)
    bell, slope = np.sin(turn * time / 2) ** 2, turn / 2 * np.sin(turn * time)
    bend, s = turn**2 * (0.5 - bell), 1j * _OMEGA[:, np.newaxis]
    shape = (bell + 0 * s, s * bell - slope, s**2 * bell - 2 * s * slope + bend)[order]
    return np.asarray(np.tensordot(shape * np.exp(-s * time), signal, 1) * dt, np.complex128)


def fit_to(measured: Complexes, expected: Sequence[Complexes], dt: float) -> tuple[float, ...]:
    """Find factor and lag of a signal by least squares, all of shape (lines,).

    It is the first of the expected signals times a factor, and the others times any; all is late by
    a lag. Every one from -20 to 100 ms is tried, the best one refined. Gives the factor, the lag
    (s), their standard errors, and the part of the power that is not explained.
    """
    within = _OMEGA * dt < np.pi / 2
    omega, y = _OMEGA[within], measured[within]
    columns = np.stack([one[within] for one in expected], axis=1)
    noise = np.full(len(y), 1e-9 * np.abs(y).max() + 1e-300)  # what is left tells the errors
    late = np.asarray(-1j * omega[:, np.newaxis], np.complex128)

    def left(lag: float) -> float:
        return regressed(columns, y * np.exp(1j * omega * lag), noise).left

    tried = np.arange(-0.02, 0.1, 0.005).tolist()
    fit, _ = aligned(y, columns, noise, late, np.array([min(tried, key=left)]))
    power, whole = fit.left * noise[0] ** 2, float(np.square(np.abs(y)).sum())
    value, error = fit.value.tolist(), fit.error.tolist()
    return value[0], value[-1], error[0], error[-1], power / max(whole, 1e-300)
