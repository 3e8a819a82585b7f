"""How well the actuators followed: measures from the literature, and those of a test.

Signals are of shape (N, n) or (N,), results of shape (n,) or (). Undefined results (of a command
that is zero throughout, of too few samples, of values that are not finite) are NaN. Signals of
different shapes are a ValueError.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.fft import next_fast_len, rfft
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.wire.topics import GROUND_MOTION, REFERENCE_FORCE, RIG_STATE, TARGET
from seft_plant_sim.whole_structure import ReferenceResponse, whole_structure

from seft_ros.analysis import metrics
from seft_ros.analysis.equivalent_motion import EquivalentMotion, assumed_structure
from seft_ros.bags.record import Record

FLOORS = 3
LONG = 100_000
"""Samples from which on a record is cut to a length whose Fourier transform is fast."""


def benchmark_criteria(
    commanded: Floats,
    measured: Floats,
    reference_displacement: Floats,
    displacement: Floats,
    dt: float,
    steps: Ints | None = None,
) -> list[dict[str, float]]:
    """Evaluate a test by J1 to J9 of the RTHS benchmark (Silva et al. 2020).

    Parameters
    ----------
    commanded, measured : ndarray
        c and m, M samples: intended force and measured force of a step, N.
    reference_displacement, displacement : ndarray
        x_ref of the reference structure and x as measured, shape (L, n) or (L,), m.
    dt : float
        Sampling period, s.
    steps : ndarray of int, optional
        Steps of ``commanded`` and ``measured``, shape (M,), strictly increasing; default all. For
        J1 missing ones are interpolated; J2 and J3 count the steps there are.

    Returns
    -------
    list of dict
        Of each axis ``J1``, the tracking delay, ms, positive where the measured signal lags;
        ``J2``, RMS(m - c) / RMS(c), and ``J3``, max|m - c| / max|c|, %. The first axis also has
        ``J4``, RMS(x_ref - x) / RMS(x_ref), and ``J7``, max|x_ref - x| / max|x_ref|, %; the second
        these as J5 and J8, the third as J6 and J9.
    """
    c, m = map(metrics.columns, metrics.paired(commanded, measured))
    reference, x = map(metrics.columns, metrics.paired(reference_displacement, displacement))
    steps = np.arange(len(c)) if steps is None else steps
    found = []
    for axis, (y, command) in enumerate(zip(m.T, c.T, strict=True)):
        delay = np.nan
        if len(steps) and np.isfinite(y).all() and np.isfinite(command).all():
            every = np.arange(steps[0], steps[-1] + 1)
            filled, wanted = (np.interp(every, steps, signal) for signal in (y, command))
            delay = metrics.best_fit_delay(filled, wanted, dt)
        errors = metrics.nrmse(y, command), _peak_error(y, command)
        row = {"J1": 1e3 * delay, "J2": 100 * errors[0], "J3": 100 * errors[1]}
        if axis < FLOORS:
            floor = x[:, axis], reference[:, axis]
            rms, most = metrics.nrmse(*floor), _peak_error(*floor)
            row |= {f"J{4 + axis}": 100 * rms, f"J{7 + axis}": 100 * most}
        found.append(row)
    return found


def _peak_error(y: Floats, reference: Floats) -> float:
    with np.errstate(invalid="ignore", over="ignore"):
        error, most = metrics.peak(y - reference), metrics.peak(reference)
        ratio = error / most if most > 0 else np.nan
    return ratio if np.isfinite(ratio) else np.nan


@dataclass(frozen=True)
class FrequencyEvaluation:
    """Amplitude and delay of a measured signal, by its frequency evaluation index F.

    Attributes
    ----------
    amplitude : ndarray
        |F|: 1 is right, below 1 undershoots.
    phase_rad : ndarray
        arg F, within (-pi, pi]; negative where the measured signal lags.
    frequency_hz : ndarray
        Equivalent frequency: mean frequency of the command, weighted by its spectrum.
    delay_s : ndarray
        -phase / (2 pi frequency); positive where the measured signal lags.
    """

    amplitude: Floats
    phase_rad: Floats
    frequency_hz: Floats
    delay_s: Floats


def frequency_evaluation_index(
    commanded: Floats, measured: Floats, dt: float
) -> FrequencyEvaluation:
    """Evaluate tracking by the frequency evaluation index (FEI) of Guo et al. 2014.

    F = sum_j (Y_j / C_j) |C_j|^2 / sum_j |C_j|^2 over the discrete Fourier spectra C of the
    command and Y of the measured signal, from 0 to below Nyquist's frequency: the complex gain
    that fits best by least squares. Amplitude and delay follow from F and from the equivalent
    frequency f = sum_j f_j |C_j|^2 / sum_j |C_j|^2. The phase is that of atan2: delays are distinct
    up to half a period of f.

    The record is taken to be periodic: it should begin and end at rest. Of one longer than
    `LONG` samples the few at the end are left out that would make its transform slow. Of a
    constant command the delay is NaN.
    """
    c, m = metrics.paired(commanded, measured)
    if not len(c):
        return FrequencyEvaluation(*(np.full(c.shape[1:], np.nan) for _ in range(4)))
    if len(c) > LONG:
        kept = next(n for n in range(len(c), 0, -1) if next_fast_len(n, real=True) == n)
        c, m = c[:kept], m[:kept]
    bins = (len(c) + 1) // 2
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        most_c, most_m = _peaks(c), _peaks(m)
        command = rfft(c / most_c, axis=0)[:bins]
        answer = rfft(m / np.where(most_m == 0, 1.0, most_m), axis=0)[:bins]
        magnitude = np.abs(command)
        weight = magnitude**2 / (magnitude**2).sum(axis=0)
        ratio = np.divide(answer, command, out=np.zeros_like(answer), where=magnitude > 0)
        index = (weight * ratio).sum(axis=0)
        frequency = (np.arange(bins) / (len(c) * dt)) @ weight
        phase = np.arctan2(index.imag, index.real)
        amplitude = np.abs(index) * most_m / most_c
        delay = np.where(frequency > 0, -phase / (2 * np.pi * frequency), np.nan)
    found = (amplitude, phase, frequency, delay)
    return FrequencyEvaluation(*(np.where(np.isfinite(amplitude), y, np.nan) for y in found))


@dataclass(frozen=True)
class DelayByFrequency:
    """Tracking in each of F bands, arrays of shape (F,).

    Attributes
    ----------
    frequency_hz : ndarray
        Centres of the bands, from the first above zero to Nyquist's.
    amplitude : ndarray
        Measured over commanded, |H1|.
    delay_s : ndarray
        Phase delay; positive where the measured signal lags.
    coherence : ndarray
        Magnitude squared, 0 to 1: how far the command explains what was measured. Where it is low
        the rest means little. With one segment it is 1 and says nothing.
    """

    frequency_hz: Floats
    amplitude: Floats
    delay_s: Floats
    coherence: Floats


def delay_by_frequency(commanded: Floats, measured: Floats, dt: float) -> DelayByFrequency:
    """Estimate amplitude and delay in each band from averaged cross spectra of an axis.

    H1 = S_cm / S_cc by Welch's method (Welch 1967; Bendat & Piersol, Random Data), with Hann
    windows that overlap by half. The record's best-fit delay (`best_fit_delay`) is taken out first
    and added again, so that the phase does not wrap where a delay exceeds half a period, and both
    signals' segments hold the same. NaN where the command has nothing, or anything is not finite.

    Parameters
    ----------
    commanded, measured : ndarray
        Shape (N,), else a ValueError.
    dt : float
        Sampling period, s; segments are `SEGMENT` long.
    """
    c, m = metrics.paired(commanded, measured)
    size = metrics.segment_size(len(c), dt)
    if size < 2:
        return DelayByFrequency(*(np.empty(0) for _ in range(4)))
    best = metrics.best_fit_delay(m, c, dt)
    common = best if np.isfinite(best) else 0.0
    aligned = metrics.delayed(m, -common, dt)
    with np.errstate(all="ignore"):
        frequency, cross = metrics.cross_spectrum(c, aligned, dt, size)
        power, answer = (metrics.cross_spectrum(y, y, dt, size)[1].real for y in (c, aligned))
        response = (cross / np.where(power > 0, power, np.nan))[1:]
        coherence = np.abs(cross) ** 2 / np.where(answer > 0, power * answer, np.nan)
    frequency = frequency[1:]
    delay = common - np.angle(response) / (2 * np.pi * frequency)
    return DelayByFrequency(frequency, np.abs(response), delay, coherence[1:])


def tracking_indicator(commanded: Floats, measured: Floats) -> Floats:
    """Accumulate the tracking indicator of Mercan & Ricles 2007.

    TI = (A - TA) / 2, where from one sample to the next A grows by (c' + c) / 2 (m' - m) and TA
    by (m' + m) / 2 (c' - c). Given is TI so far at each sample, of the signals' shape, in the
    square of their unit; 0 at the first.
    """
    c, m = metrics.paired(commanded, measured)
    indicator = np.zeros_like(c)
    with np.errstate(invalid="ignore", over="ignore"):
        # A and TA have the products c' m' and c m in common, which this leaves out
        indicator[1:] = np.cumsum(0.5 * (c[:-1] * m[1:] - c[1:] * m[:-1]), axis=0)
    return indicator


def relative_tracking_indicator(commanded: Floats, measured: Floats) -> Floats:
    """TI at the end over the square of the command's peak."""
    c, m = metrics.paired(commanded, measured)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        most = _peaks(c)
        return _end(tracking_indicator(c / most, m / most))


def energy_error(force_error: Floats, velocity: Floats, dt: float) -> Floats:
    """Accumulate the work of the force error on the specimen, by the trapezoidal rule.

    Positive where force control adds energy (as damping taken away), negative where it takes
    energy out (as damping added). Of whole cycles the rule is exact for band-limited signals.

    Parameters
    ----------
    force_error : ndarray
        Measured minus reference force, N.
    velocity : ndarray
        Of the specimen, relative to the ground, m/s.

    Returns
    -------
    ndarray
        Work so far at each sample, of the signals' shape, J; 0 at the first.
    """
    error, v = metrics.paired(force_error, velocity)
    work = np.zeros_like(error)
    with np.errstate(invalid="ignore", over="ignore"):
        power = error * v
        work[1:] = np.cumsum((power[1:] + power[:-1]) * (dt / 2), axis=0)
    return work


def relative_energy_error(
    reference_force: Floats, force: Floats, velocity: Floats, dt: float
) -> Floats:
    """Energy error at the end over the largest input energy, that of the measured force."""
    reference, measured = metrics.paired(reference_force, force)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        largest = _peaks(energy_error(measured, velocity, dt))
        return _end(energy_error(measured - reference, velocity, dt) / largest)


def _end(y: Floats) -> Floats:
    """Last values, NaN of less than two or where they are not finite."""
    end = y[-1] if len(y) > 1 else np.full(y.shape[1:], np.nan)
    return np.where(np.isfinite(end), end, np.nan)


def _peaks(y: Floats) -> Floats:
    """Largest magnitude of each column; NaN of no samples, or if one is NaN."""
    return np.asarray(np.abs(y).max(axis=0)) if len(y) else np.full(y.shape[1:], np.nan)


SENT_AS_MEANT = ("none", "restoring", "target_motion")
"""Compensation methods whose reference force is that of its own step; others send it ahead."""

_DISPLACEMENT, _VELOCITY, _FORCE = (
    RIG_STATE.quantities.index(name) for name in ("positions", "velocities", "effort")
)


@dataclass(frozen=True)
class Tracked:
    """Signals at every step from the first to the last that both topics have.

    Attributes
    ----------
    steps : ndarray of int64
        Shape (N,), consecutive.
    counted : ndarray of int64
        Indices of those that both topics have, increasing.
    command, force, velocity : ndarray
        Intended and measured force (N), velocity (m/s), shape (N, n); lost samples are
        interpolated.
    derived : bool
        Whether the intended force is derived from measurements, and not the one sent.
    """

    steps: Ints
    counted: Ints
    command: Floats
    force: Floats
    velocity: Floats
    derived: bool


def tracked_of(record: Record) -> Tracked:
    """Pair the intended with the measured force.

    The intended force is the reference force of the same step; where the compensation method
    sends that ahead of time, it is f* = -M_e a_g + S r, from measurements (docs/theory.md, "The
    algebraic loop solved"). With the test's own ground motion a_eq this is
    f* = f + M_e (a_eq - a_g), whatever is computed.
    """
    commands, states, motion = (
        record.series[topic.name] for topic in (REFERENCE_FORCE, RIG_STATE, GROUND_MOTION)
    )
    steps, _, _ = metrics.common_steps(commands.steps, states.steps)
    every = np.arange(steps[0], steps[-1] + 1) if len(steps) else steps
    counted = steps - every[:1]
    measured = metrics.every_step(states, every)
    force, velocity = measured[:, _FORCE], measured[:, _VELOCITY]
    section = record.experiment.sections.get("reference_force", {})
    assumed = assumed_structure(record.experiment)
    ahead = section.get("compensation.method", "none") not in SENT_AS_MEANT
    command = metrics.every_step(commands, every)[:, -1]  # effort, with a target's motion or not
    derived = bool(ahead and assumed and len(motion.steps) and len(every))
    if derived and assumed:
        equivalent = EquivalentMotion(whole_structure(assumed), record.experiment.timebase.dt)
        with np.errstate(over="ignore", invalid="ignore"):  # of a test that went unstable
            difference = equivalent.advance(measured) - metrics.every_step(motion, every)[:, 0]
            command = force + difference @ equivalent.mass.T
    return Tracked(every, counted, command, force, velocity, derived)


def tracking_of(record: Record, reference: ReferenceResponse | None) -> dict[str, dict[str, Any]]:
    """Measure the tracking of each axis.

    The intended force is that of `tracked_of`. Where it is the reference force of the same step,
    even an ideal actuator is one period late: the rig measures at step k what commands before it
    did. Samples between the first and the last step that both topics have count; lost ones are
    left out of errors, and interpolated for spectra, areas, integrals and J1.

    Returns
    -------
    dict
        Axis -> ``fei_amplitude``, ``fei_delay_s``, ``fei_frequency_hz``,
        ``tracking_indicator_end`` (over the square of the largest intended force),
        ``energy_error`` (over the largest input energy), ``energy_error_j`` (J), and ``J``: J1
        (ms), J2, J3 and the axis's displacement criteria (%), NaN without a reference response.
    """
    signals, dt = tracked_of(record), record.experiment.timebase.dt
    command, force, velocity = signals.command, signals.force, signals.velocity
    states, counted = record.series[RIG_STATE.name], signals.counted
    displacement = states.values[:, _DISPLACEMENT]
    exact = np.full_like(displacement, np.nan)
    if reference is not None:
        exact = reference.displacement[states.steps]
    forces = command[counted], force[counted]
    criteria = benchmark_criteria(*forces, exact, displacement, dt, signals.steps[counted])
    fei = frequency_evaluation_index(command, force, dt)
    with np.errstate(invalid="ignore", over="ignore"):
        work = energy_error(force - command, velocity, dt)
    by_axis = {
        "fei_amplitude": fei.amplitude,
        "fei_delay_s": fei.delay_s,
        "fei_frequency_hz": fei.frequency_hz,
        "tracking_indicator_end": relative_tracking_indicator(command, force),
        "energy_error": relative_energy_error(command, force, velocity, dt),
        "energy_error_j": _end(work),
    }
    return {
        axis: {name: float(values[column]) for name, values in by_axis.items()}
        | {"J": criteria[column]}
        for column, axis in enumerate(record.experiment.axes)
    }


def tracking_error_of(record: Record) -> dict[str, float] | None:
    """Compare the displacement of a test with its target; None: the reference force has none.

    Returns
    -------
    dict
        ``rms`` and ``peak`` of x - x_target, m, over all axes, and ``nrmse``, that RMS over the
        RMS of x.
    """
    targets, states = record.series[REFERENCE_FORCE.name], record.series[RIG_STATE.name]
    if targets.values.shape[1] < len(TARGET.quantities):
        return None
    _, at_targets, at_states = metrics.common_steps(targets.steps, states.steps)
    wanted, x = targets.values[at_targets, 0], states.values[at_states, _DISPLACEMENT]
    with np.errstate(invalid="ignore", over="ignore"):
        error = wanted - x
        rms = float(np.sqrt(np.mean(np.square(error)))) if error.size else np.nan
    return {"rms": rms, "peak": metrics.peak(error), "nrmse": metrics.nrmse(wanted, x)}
