"""What is known of the measured channels, taken out of a sample before it is published.

A channel with known scale s, bias b, lag tau and filter F measures y; its value is (y - b) / s. The
accelerations are T^-1 times those of the accelerometers, which show T a where they are tilted. A
filter is a low-pass of second order::

    F(s) = 1 / (1 + p s + q s^2),   p = 2 zeta / w,  q = 1 / w^2                           (1)

All channels get one response, with the slowest filter and the largest lag of all, so that force and
acceleration still agree where the oil column rings. Each is passed through what it lacks, (1 + p s
+ q s^2) / (1 + P s + Q s^2) and a wait: whole samples, and for the fraction d a first-order
all-pass of Thiran (1971)::

    (c + z) / (1 + c z),  c = (1 - d) / (1 + d),  z = exp(-s dt)                           (2)
    (b_0 + b_1 z + b_2 z^2) / ((1 - z exp(s_1 dt)) (1 - z exp(s_2 dt)))                    (3)

s_1 and s_2 are the poles of the slowest filter; b are such that (3) and the ratio of the filters
agree up to s^2. So all is maximally flat: gain and delay are exact at low frequency, and at 0.18
times the rate they are off by 2 % (a filter of 0.12 to 0.2 times the rate) and by 0.05 samples at
most. For that, d is between 0.2 and 1.2 samples; a shorter wait is all fraction.
The result of (2) alone has the steps of the channel's converter, so that what repeats still does.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.errors import InputError

from seft_plant_sim.channels import ACCELERATION, DISPLACEMENT, VELOCITY, per_channel, tilt_of
from seft_plant_sim.compiled import compiled
from seft_plant_sim.rig_parameters import LIMIT_UNITS, common_filter, filter_of
from seft_plant_sim.simulated.continuous_model import ContinuousModel, Sensed
from seft_plant_sim.simulated.sensors import filtered

ALIGNING_ORDER = 3
"""Of Eq. (2) and (3) together."""
LEAST_FRACTION = 0.2
"""Samples: fractions from here up to one more have the flattest delay."""
SHORTEST_WAIT = 1e-6
"""Of a sample: a shorter one is rounding."""


class Calibration(NamedTuple):
    """What is known of the channels of n axes; arrays of shape (4, n), or (0, n) for nothing.

    Attributes
    ----------
    bias, scale : ndarray
        Measured value at a true one of 0, in the channel's unit; measured over true.
    range : ndarray
        Largest magnitude that a sensor can measure, which remains as it is measured: what is
        beyond it is not known.
    resolution : ndarray
        Step of the converter to which the result is rounded, in the channel's unit; 0: it is not.
    whole : ndarray
        Whole samples of a channel's wait.
    taps : ndarray
        Numerator and denominator of what it lacks beside, Eq. (2) times (3), lowest power of z
        first, shape (2, 1 + `ALIGNING_ORDER`, 4, n).
    straight : ndarray
        T^-1, shape (n, n), or (0, 0) for accelerometers that are not tilted.
    """

    bias: Floats
    scale: Floats
    range: Floats
    resolution: Floats
    whole: Ints
    taps: Floats
    straight: Floats


class CalibrationState(NamedTuple):
    """State of a calibration.

    Attributes
    ----------
    measured : ndarray
        The last samples as measured, a ring buffer by step, shape (m, 4, n).
    passed : ndarray
        The last values before and after `Calibration.taps`, the newest first, shape
        (2, 1 + `ALIGNING_ORDER`, 4, n).
    tilted : ndarray
        The last accelerations that were known, as tilted accelerometers show them, and 1 where
        they are of this sample, shape (2, n).
    """

    measured: Floats
    passed: Floats
    tilted: Floats


@compiled
def calibrate(
    calibration: Calibration, state: CalibrationState, step: int, measured: Floats, sample: Floats
) -> None:
    """Correct and align a sample.

    Parameters
    ----------
    calibration, state
        The state is updated. Step 0 begins a test, as if its values had lasted for long.
    step : int
        Of the sample; samples follow one another.
    measured, sample : ndarray
        As measured, and the result; shape (4, n). They may be the same array. A value that is no
        number, or is at the end of its sensor's range, is corrected and waits, no more; for
        the other axes of a tilted accelerometer its last one stands.
    """
    c, passed, places = calibration, state.passed, len(state.measured)
    for row in range(4):
        for i in range(measured.shape[1]):
            bias, scale = c.bias[row, i], c.scale[row, i]
            for place in range(places if step == 0 else 1):
                state.measured[(step + place) % places, row, i] = measured[row, i]
            shown = state.measured[(step - c.whole[row, i]) % places, row, i]
            value = (shown - bias) / scale
            if step == 0:
                passed[:, :, row, i] = value if np.isfinite(value) else 0.0
            for age in range(ALIGNING_ORDER, 0, -1):
                passed[0, age, row, i] = passed[0, age - 1, row, i]
                passed[1, age, row, i] = passed[1, age - 1, row, i]
            if np.isfinite(value):
                passed[0, 0, row, i] = value
            value = c.taps[0, 0, row, i] * passed[0, 0, row, i]
            for age in range(1, 1 + ALIGNING_ORDER):
                value += c.taps[0, age, row, i] * passed[0, age, row, i]
                value -= c.taps[1, age, row, i] * passed[1, age, row, i]
            passed[1, 0, row, i] = value
            if c.resolution[row, i] > 0.0:
                part = c.resolution[row, i] / scale
                value = np.rint(value / part) * part
            is_known = abs(shown) < c.range[row, i] and np.isfinite(shown)
            sample[row, i] = value if is_known else (shown - bias) / scale
            if row == ACCELERATION:
                state.tilted[1, i] = 1.0 if is_known else 0.0
                if is_known or step == 0:
                    state.tilted[0, i] = value if is_known else 0.0
    for i in range(len(c.straight)):
        if state.tilted[1, i]:
            value = 0.0
            for j in range(len(c.straight)):
                value += c.straight[i, j] * state.tilted[0, j]
            sample[ACCELERATION, i] = value


@compiled
def calibrate_all(calibration: Calibration, state: CalibrationState, samples: Floats) -> None:
    """Correct and align all samples of a test in place, shape (N, 4, n), from its step 0 on."""
    for step in range(len(samples)):
        calibrate(calibration, state, step, samples[step], samples[step])


TILT = "calibration.tilt"
_ALIKE = 1e6  # condition number of a tilt that can not be inverted
BUTTERWORTH = 0.7071
"""Damping ratio of a filter whose gain is maximally flat."""
NOTHING_KNOWN = {
    **{"bias": 0.0, "scale": 1.0, "lag": 0.0},
    **{"filter": 0.0, "filter_damping": BUTTERWORTH},
}
"""What ``calibration.*`` says of a channel of which nothing is known."""


def known_channels(
    section: Mapping[str, Any], axes: Sequence[str], facts: Iterable[str] = NOTHING_KNOWN
) -> dict[str, Floats]:
    """Give ``calibration.*`` of a section, by the keys of `NOTHING_KNOWN`, shape (4, n) each."""
    return {what: per_channel(section, axes, f"calibration.{{}}_{what}") for what in facts}


class Alignment(NamedTuple):
    """What is known of the channels of n axes, and what they lack of the response of all.

    Attributes
    ----------
    bias, scale : ndarray
        See `Calibration`.
    wait : ndarray
        Time by which each is earlier than the latest one, shape (4, n), s.
    filters, common : ndarray
        p (s) and q (s^2) of Eq. (1) of the channels, shape (2, 4, n), and of all, shape (2,).
    lacks : ndarray
        Whether these differ, shape (4, n).
    """

    bias: Floats
    scale: Floats
    wait: Floats
    filters: Floats
    common: Floats
    lacks: NDArray[np.bool_]


def aligned_to(section: Mapping[str, Any], axes: Sequence[str], places: Sequence[int]) -> Alignment:
    """Say what the channels of a rig lack of the response of all; see `calibration_of`."""
    own, known = list(places), known_channels(section, axes)
    if not known["scale"].all():
        row = int(np.argmin(np.abs(known["scale"]).min(axis=1)))
        why = "it is measured over true value; give 1 if it is not known"
        raise InputError(f"/**: calibration.{CHANNELS[row]}_scale is 0, but {why}")
    if section.get("sensors.velocity") == "derived":  # from the calibrated displacement
        for what, nothing in NOTHING_KNOWN.items():
            if (known[what][VELOCITY] != nothing).any():
                why = "derived: it follows the displacement's calibration; leave it out"
                given = f"/**: calibration.velocity_{what} is given"
                raise InputError(f"{given}, but sensors.velocity is {why}")
            if what not in ("bias", "scale"):
                known[what][VELOCITY] = known[what][DISPLACEMENT]
    lag, common = known["lag"], np.array(common_filter(section))
    filters = np.array(filter_of(known["filter"], known["filter_damping"]))[:, :, own]
    every = known["bias"], known["scale"], lag.max() - lag
    bias, scale, wait = (np.ascontiguousarray(each[:, own]) for each in every)
    lacks = (filters != common[:, np.newaxis, np.newaxis]).any(axis=0)
    return Alignment(bias, scale, wait, filters, common, lacks)


def calibration_of(
    section: Mapping[str, Any],
    axes: Sequence[str],
    places: Sequence[int],
    dt: float,
    ranges: Floats | None = None,
    resolution: Floats | None = None,
) -> tuple[Calibration, CalibrationState]:
    """Put ``calibration.*`` of a section, which is for all axes, into arrays.

    Parameters
    ----------
    section, axes
        The section, and the names of all axes.
    places : sequence of int
        Of the axes of this rig; all rigs are aligned to the latest channel of all axes.
    dt : float
        Sampling period, s.
    ranges, resolution : ndarray, optional
        See `Calibration`; default none.

    Raises
    ------
    InputError
        If sizes do not fit the axes, a scale is 0, something is known of a velocity that is
        derived, or a tilt mixes axes of different rigs or can not be inverted.
    """
    own, n = list(places), len(places)
    bias, scale, wait, filters, common, lacks = aligned_to(section, axes, own)
    wait = wait / dt
    wait[wait < SHORTEST_WAIT] = 0.0
    tilt = tilt_of(section, axes, own, TILT)
    if np.linalg.cond(tilt) > _ALIKE:
        same = (
            "says that accelerometers show the same; give a row for each, about 1 in its own place"
        )
        raise InputError(f"/**: {TILT} {tilt.tolist()} {same}")
    is_straight = (tilt == np.eye(n)).all()
    is_aligned = not (wait.any() or lacks.any())
    if not bias.any() and (scale == 1.0).all() and is_aligned and is_straight:
        return nothing_known(n)
    whole = np.floor(np.maximum(wait - LEAST_FRACTION, 0.0)).astype(np.int64)
    fraction = wait - whole
    complete = abs(fraction - 1.0) < SHORTEST_WAIT
    whole[complete], fraction[complete] = whole[complete] + 1, 0.0
    taps = np.zeros((2, 1 + ALIGNING_ORDER, 4, n))
    for row, i in np.ndindex(4, n):
        alone = all_pass(float(fraction[row, i]))
        other = lacking(filters[:, row, i], common, dt) if lacks[row, i] else ONE
        for part in range(2):
            product = np.convolve(alone[part], other[part])
            taps[part, : len(product), row, i] = product
    steps = np.zeros((4, n)) if resolution is None else resolution
    ranges = np.full((4, n), np.inf) if ranges is None else ranges
    rounded = np.where((fraction > 0.0) & ~lacks, steps, 0.0)
    straight = np.zeros((0, 0)) if is_straight else np.linalg.inv(tilt)
    calibration = Calibration(bias, scale, ranges, rounded, whole, taps, straight)
    measured = np.zeros((1 + int(whole.max()), 4, n))
    state = CalibrationState(measured, np.zeros((2, 1 + ALIGNING_ORDER, 4, n)), np.zeros((2, n)))
    return calibration, state


ONE = np.ones(1), np.ones(1)
"""Numerator and denominator of what changes nothing."""


def all_pass(fraction: float) -> tuple[Floats, Floats]:
    """Numerator and denominator of Eq. (2), lowest power of z first, for a fraction of a sample."""
    if fraction == 0.0:
        return ONE
    factor = (1.0 - fraction) / (1.0 + fraction)
    return np.array([factor, 1.0]), np.array([1.0, factor])


def lacking(own: Floats, common: Floats, dt: float) -> tuple[Floats, Floats]:
    """Numerator and denominator of Eq. (3), likewise.

    Parameters
    ----------
    own, common : ndarray
        p and q of the channel's filter, and of the one that it is to have, shape (2,), s and s^2.
    dt : float
        Sampling period, s.
    """
    (p, q), (of_p, of_q) = (each / [dt, dt * dt] for each in (own, common))
    denominator: Floats = np.asarray(np.poly(np.exp(np.roots([of_q, of_p, 1.0]))).real, np.float64)
    ratio = np.array([1.0, p - of_p, q - of_q - of_p * (p - of_p)])  # its series in s dt
    powers = np.arange(3.0)
    series = np.array([np.ones(3), -powers, powers**2 / 2.0])  # those of 1, z, z^2
    numerator: Floats = np.linalg.solve(series, np.convolve(series @ denominator, ratio)[:3])
    return numerator, denominator


SIGNIFICANT = 4.0
"""Standard errors up to which a deviation is none. Of 340 estimates on fault-free tests the worst
was 3.7 away: no law is described exactly, and tails are longer than a normal distribution's."""


def significant(value: Floats, error: Floats) -> Floats:
    """Give what is beyond its standard errors, and 0 for the rest."""
    return np.where(np.abs(value) > SIGNIFICANT * error, value, 0.0)


def zeroed_at_rest(
    section: Mapping[str, Any], axes: Sequence[str], places: Sequence[int], samples: Floats
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Take biases that nobody knows from samples at rest.

    Parameters
    ----------
    section, axes, places
        See `calibration_of`.
    samples : ndarray
        Of the rig's n axes at rest, as measured, shape (N, 4, n).

    Returns
    -------
    section : dict
        With ``calibration.*_bias`` as measured, where they are not known.
    facts : dict
        ``samples`` N; ``subtracted``: these biases; ``left``: what a channel shows beside a known
        bias; both by channel, a list over the rig's axes, in the channel's unit. What is no more
        than noise is 0. JSON values.
    """
    own, bias = list(places), known_channels(section, axes, ["bias"])["bias"]
    known = bias[:, own]
    error = samples.std(axis=0) / np.sqrt(len(samples))
    shown = significant(samples.mean(axis=0) - known, error)
    subtracted = np.where(known == 0.0, shown, 0.0)
    left = shown - subtracted
    bias[:, own] += subtracted
    changed = {f"calibration.{name}_bias": bias[row].tolist() for row, name in enumerate(CHANNELS)}
    rows = (("subtracted", subtracted), ("left", left))
    by_channel = {what: dict(zip(CHANNELS, each.tolist(), strict=True)) for what, each in rows}
    return {**section, **changed}, {"samples": len(samples), **by_channel}


def biases_of_all(
    axes: int, parts: Iterable[tuple[Sequence[int], Mapping[str, Any]]]
) -> dict[str, Any]:
    """Put what several rigs have measured at rest together, over all axes of a test.

    ``parts`` are the places of the axes of each rig, and its facts of `zeroed_at_rest`. A rig that
    tells them otherwise is a KeyError, TypeError, ValueError or IndexError.
    """
    whole: dict[str, Any] = {
        what: {name: [0.0] * axes for name in CHANNELS} for what in ("subtracted", "left")
    }
    for places, found in parts:
        for what, rows in whole.items():
            for name, row in rows.items():
                for at, place in enumerate(places):
                    row[place] = float(found[what][name][at])
    return whole


def nothing_known(n: int) -> tuple[Calibration, CalibrationState]:
    """Make the arrays where the samples of n axes are published as they are measured."""
    none, taps = np.zeros((0, n)), np.zeros((2, 0, 0, n))
    wait, straight = np.zeros((0, n), dtype=np.int64), np.zeros((0, 0))
    calibration = Calibration(none, none, none, none, wait, taps, straight)
    return calibration, CalibrationState(np.zeros((0, 4, n)), taps, none)


def as_published(
    model: ContinuousModel, section: Mapping[str, Any], axes: Sequence[str]
) -> ContinuousModel:
    """Put a calibration behind a model with its sensors, for what is linear: biases do not count.

    What is known is told as for `calibration_of`. Filters and waits are exact at all frequencies.
    """
    known = aligned_to(section, axes, range(len(axes)))
    tilt = tilt_of(section, axes, range(len(axes)), TILT)
    rows = np.flatnonzero(known.lacks)
    lacked = known.filters.reshape(2, -1)[:, rows]
    model = filtered(model, rows, lacked, known.common[:, np.newaxis])
    shown, n = model.shown, len(axes)
    by = np.diag(1.0 / known.scale.ravel())
    of = slice(ACCELERATION * n, (ACCELERATION + 1) * n)
    by[of, of] = np.linalg.solve(tilt, by[of, of])
    late = shown.late + known.wait.ravel()
    return replace(model, sensed=Sensed(by @ shown.c, by @ shown.d, by @ shown.outputs, late))


MAX_BIAS = 0.1
"""Of a channel's limit, for its bias. The limits count from it, so it moves them by as much;
limits that fit a test are 1.5 times its peaks and more, and bear that."""
SHOWN_BY_SENSOR = 1e-3
"""Of the limit of force, which a load cell of accuracy class 0.1 may show without a force."""


class CheckedBiases(NamedTuple):
    """Why biases are refused, and what they may hide; empty if there is nothing."""

    refusal: str = ""
    warning: str = ""


def check_biases(zeroed: Mapping[str, Any] | None, limits: Mapping[str, float]) -> CheckedBiases:
    """Check what a rig has measured at rest.

    Parameters
    ----------
    zeroed : mapping or None
        As of `seft_plant_sim.calibration.zeroed_at_rest`; None: it measured nothing.
    limits : mapping
        Of displacement (m), velocity (m/s), acceleration (m/s^2) and force (N).
    """
    if zeroed is None:
        return CheckedBiases()
    try:
        subtracted, left = (
            {name: float(np.abs(zeroed[what][name]).max()) for name in CHANNELS}
            for what in ("subtracted", "left")
        )
    except (KeyError, TypeError, ValueError):
        return CheckedBiases("the rig reports biases that can't be read; see docs/hardware.md")
    for name, unit in zip(CHANNELS, LIMIT_UNITS, strict=False):
        if not subtracted[name] <= MAX_BIAS * limits[name]:
            most = f"more than a tenth of its limit of {limits[name]:g} {unit}"
            shown = f"{name} is {subtracted[name]:.3g} {unit} at rest, {most}"
            mend = f"adjust the sensor's amplifier, or give its bias (/**: calibration.{name}_bias)"
            return CheckedBiases(f"{shown}; unload the rig, {mend}")
    may_hold = SHOWN_BY_SENSOR * limits["force"]
    if left["force"] > may_hold:
        why = "a static load holds it, or the bias has changed since (seft identify --specimen)"
        shown = f"the force at rest is {left['force']:.3g} N beside its known bias"
        return CheckedBiases(warning=f"{shown}: friction or {why}")
    if subtracted["force"] > may_hold:
        why = "holds it, it is real; a multisine test shows it (seft identify --specimen)"
        shown = f"a force of {subtracted['force']:.3g} N at rest was zeroed"
        return CheckedBiases(warning=f"{shown}: if friction or a static load {why}")
    return CheckedBiases()
