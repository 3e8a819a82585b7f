"""What is known of the measured channels, taken out of a sample before it is published.

A channel with known scale s, bias b and lag measures y; its value is (y - b) / s. The accelerations
are T^-1 times those of the accelerometers, which show T a where they are tilted. All channels are
aligned to the latest one: the others wait, in whole samples and by a first-order all-pass of Thiran
(1971), which is maximally flat: its gain is 1, its delay d at low frequency::

    H(q) = (c + q^-1) / (1 + c q^-1),  c = (1 - d) / (1 + d)                               (1)

The fraction d is between 0.2 and 1.2 samples, where its delay is flattest: at 0.18 times the rate
it is then off by 0.05 samples at most. A shorter wait is all fraction.
The result has the steps of the channel's converter, so that what repeats still does.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.errors import InputError

from seft_plant_sim.channels import ACCELERATION, VELOCITY, per_channel, tilt_of
from seft_plant_sim.compiled import compiled
from seft_plant_sim.simulated.continuous_model import ContinuousModel, Sensed

AT_ONCE = -1
"""Value of `Calibration.whole` of a channel that does not wait."""
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
        Step of the converter, in the channel's unit; 0: finer than the noise.
    whole : ndarray
        Whole samples of a channel's wait; `AT_ONCE`: it does not wait.
    factor : ndarray
        c of Eq. (1) for the fraction.
    straight : ndarray
        T^-1, shape (n, n), or (0, 0) for accelerometers that are not tilted.
    """

    bias: Floats
    scale: Floats
    range: Floats
    resolution: Floats
    whole: Ints
    factor: Floats
    straight: Floats


class CalibrationState(NamedTuple):
    """State of a calibration.

    Attributes
    ----------
    measured : ndarray
        The last samples as measured, a ring buffer by step, shape (m, 4, n).
    aligned : ndarray
        The last result of Eq. (1), shape (4, n).
    tilted : ndarray
        The last accelerations that were known, as tilted accelerometers show them, and 1 where
        they are of this sample, shape (2, n).
    """

    measured: Floats
    aligned: Floats
    tilted: Floats


@compiled
def calibrate(
    calibration: Calibration,
    state: CalibrationState,
    step: int,
    measured: Floats,
    sample: Floats,
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
    c, last, places = calibration, state.aligned, len(state.measured)
    for row in range(4):
        for i in range(measured.shape[1]):
            bias, scale, whole = c.bias[row, i], c.scale[row, i], c.whole[row, i]
            for place in range(places if step == 0 else 1):
                state.measured[(step + place) % places, row, i] = measured[row, i]
            if step == 0:
                first = (measured[row, i] - bias) / scale
                last[row, i] = first if np.isfinite(first) else 0.0
            shown = state.measured[(step - max(whole, 0)) % places, row, i]
            value = (shown - bias) / scale
            if whole >= 0 and np.isfinite(value):
                before = (state.measured[(step - whole - 1) % places, row, i] - bias) / scale
                if not np.isfinite(before):
                    before = last[row, i]
                value = c.factor[row, i] * (value - last[row, i]) + before
                last[row, i] = value
                if c.factor[row, i] != 0.0 and c.resolution[row, i] > 0.0:
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
NOTHING_KNOWN = {"bias": 0.0, "scale": 1.0, "lag": 0.0}
"""What ``calibration.*`` says of a channel of which nothing is known."""


def known_channels(section: Mapping[str, Any], axes: Sequence[str]) -> dict[str, Floats]:
    """Give ``calibration.*`` of a section, by the keys of `NOTHING_KNOWN`, shape (4, n) each."""
    return {what: per_channel(section, axes, f"calibration.{{}}_{what}") for what in NOTHING_KNOWN}


def calibration_of(
    section: Mapping[str, Any],
    axes: Sequence[str],
    places: Sequence[int],
    dt: float,
    ranges: Floats | None = None,
    resolution: Floats | None = None,
    velocity_is_derived: bool = False,
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
    velocity_is_derived : bool
        Whether the velocity is derived from the calibrated displacement, and needs none itself.

    Raises
    ------
    InputError
        If sizes do not fit the axes, a scale is 0, something is known of a velocity that is
        derived, or a tilt mixes axes of different rigs or can not be inverted.
    """
    own, known = list(places), known_channels(section, axes)
    bias, scale, lag = known["bias"], known["scale"], known["lag"]
    if not scale.all():
        row = int(np.argmin(np.abs(scale).min(axis=1)))
        raise InputError(
            f"/**: calibration.{CHANNELS[row]}_scale is 0, but it is measured over true value; "
            "give 1 if it is not known"
        )
    if velocity_is_derived:
        for what, nothing in NOTHING_KNOWN.items():
            if (known[what][VELOCITY] != nothing).any():
                raise InputError(
                    f"/**: calibration.velocity_{what} is given, but sensors.velocity is derived: "
                    "it follows the displacement's calibration; leave it out"
                )
        lag[VELOCITY] = lag[0]
    n = len(own)
    wait = (lag.max() - lag) / dt
    wait[wait < SHORTEST_WAIT] = 0.0
    wait, bias, scale = (np.ascontiguousarray(one[:, own]) for one in (wait, bias, scale))
    tilt = tilt_of(section, axes, own, TILT)
    if np.linalg.cond(tilt) > _ALIKE:
        raise InputError(
            f"/**: {TILT} {tilt.tolist()} says that accelerometers show the same; give a row for "
            "each, about 1 in its own place"
        )
    is_straight = (tilt == np.eye(n)).all()
    if not bias.any() and (scale == 1.0).all() and not wait.any() and is_straight:
        return nothing_known(n)
    whole = np.floor(np.maximum(wait - LEAST_FRACTION, 0.0)).astype(np.int64)
    fraction = wait - whole
    fraction[abs(fraction - 1.0) < SHORTEST_WAIT] = 1.0  # whole samples: nothing is filtered
    whole[wait == 0.0] = AT_ONCE
    calibration = Calibration(
        bias,
        scale,
        np.full((4, n), np.inf) if ranges is None else ranges,
        np.zeros((4, n)) if resolution is None else resolution,
        whole,
        (1.0 - fraction) / (1.0 + fraction),
        np.zeros((0, 0)) if is_straight else np.linalg.inv(tilt),
    )
    periods = 2 + max(int(whole.max()), 0)
    state = CalibrationState(np.zeros((periods, 4, n)), np.zeros((4, n)), np.zeros((2, n)))
    return calibration, state


SIGNIFICANT = 4.0
"""Standard errors up to which a mean at rest is noise, which a bias would add to the samples."""


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
    own, bias = list(places), known_channels(section, axes)["bias"]
    known = bias[:, own]
    shown = samples.mean(axis=0) - known
    error = samples.std(axis=0) / np.sqrt(len(samples))
    shown[~(np.abs(shown) > SIGNIFICANT * error)] = 0.0
    subtracted = np.where(known == 0.0, shown, 0.0)
    left = shown - subtracted
    bias[:, own] += subtracted
    changed = {f"calibration.{name}_bias": bias[row].tolist() for row, name in enumerate(CHANNELS)}
    by_channel = {
        "subtracted": dict(zip(CHANNELS, subtracted.tolist(), strict=True)),
        "left": dict(zip(CHANNELS, left.tolist(), strict=True)),
    }
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
    none = np.zeros((0, n))
    wait, straight = np.zeros((0, n), dtype=np.int64), np.zeros((0, 0))
    calibration = Calibration(none, none, none, none, wait, none, straight)
    return calibration, CalibrationState(np.zeros((0, 4, n)), none, none)


def as_published(model: ContinuousModel, calibration: Calibration, dt: float) -> ContinuousModel:
    """Put a calibration behind a model with its sensors, for what is linear: biases do not count.

    What waits is late by its wait at all frequencies.
    """
    if not len(calibration.scale):
        return model
    shown = model.shown
    fraction = (1.0 - calibration.factor) / (1.0 + calibration.factor)
    wait = np.where(calibration.whole == AT_ONCE, 0.0, calibration.whole + fraction) * dt
    by, n = np.diag(1.0 / calibration.scale.ravel()), calibration.scale.shape[1]
    if len(calibration.straight):
        rows = slice(ACCELERATION * n, (ACCELERATION + 1) * n)
        by[rows, rows] = calibration.straight @ by[rows, rows]
    late = shown.late + wait.ravel()
    return replace(model, sensed=Sensed(by @ shown.c, by @ shown.d, by @ shown.outputs, late))
