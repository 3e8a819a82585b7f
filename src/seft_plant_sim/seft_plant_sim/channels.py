"""The measured channels of a rig: their parameters, and a velocity that is derived."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.facts import CHANNELS, place_of
from seft_msgs_py.config.parameter_table import as_matrix, per_axis
from seft_msgs_py.errors import InputError

from seft_plant_sim.compiled import compiled

DISPLACEMENT, VELOCITY, ACCELERATION, FORCE = range(len(CHANNELS))
"""Rows of `CHANNELS` in a sample."""


def per_channel(section: Mapping[str, Any], axes: Sequence[str], form: str) -> Floats:
    """Give the values of a parameter of each channel, shape (4, n).

    Parameters
    ----------
    section, axes
        The section of the rig or of a node that knows it, and the names of the n axes.
    form : str
        Of the names, ``{}`` for the channel.

    Raises
    ------
    InputError
        If sizes do not fit the axes.
    """
    names = [form.format(channel) for channel in CHANNELS]
    where = [f"{place_of(name, 'rig')}: {name}" for name in names]
    rows = zip(names, where, strict=True)
    return np.array([per_axis(section[name], axes, at) for name, at in rows])


def tilt_of(
    section: Mapping[str, Any], axes: Sequence[str], places: Sequence[int], name: str
) -> Floats:
    """Give what accelerometers show of the acceleration of each axis, shape (n, n).

    Parameters
    ----------
    section, axes
        The rig's section, and the names of all axes.
    places : sequence of int
        Of the n axes of this rig.
    name : str
        Of the parameter; if it is 0, each accelerometer shows its own axis alone.

    Raises
    ------
    InputError
        If the size does not fit the axes, or it mixes axes of different rigs.
    """
    own, where = list(places), f"{place_of(name, 'rig')}: {name}"
    if not np.any(section[name]):
        return np.eye(len(own))
    tilt = as_matrix(section[name], axes, where)
    if np.delete(tilt[own], own, axis=1).any():
        mixes = "mixes axes of different rigs, which have their own accelerometers"
        raise InputError(f"{where} {tilt.tolist()} {mixes}")
    return np.ascontiguousarray(tilt[np.ix_(own, own)])


def velocity_is_derived(section: Mapping[str, Any]) -> bool:
    """Say whether the velocity is derived from the displacement: no sensor measures it."""
    return bool(section["sensors.velocity"] == "derived")


def acceleration_is_derived(section: Mapping[str, Any]) -> bool:
    """Say whether no sensor measures the acceleration, see `servo_model`."""
    return bool(section["sensors.acceleration"] == "derived")


MIN_NOISE = np.array([1e-6, 1e-4, 5e-3, 0.3])
"""Least assumed noise of the sensors: displacement (m), velocity, acceleration, force (N). Without
noise the filters would follow everything that is not modelled."""


def least_noise(section: Mapping[str, Any], axes: Sequence[str]) -> Floats:
    """RMS noise of each sensor, at least `MIN_NOISE`, shape (4, n)."""
    return np.maximum(per_channel(section, axes, "sensors.{}_noise"), MIN_NOISE[:, np.newaxis])


def converters(
    section: Mapping[str, Any], axes: Sequence[str], places: Sequence[int], bits_name: str
) -> tuple[Floats, Floats]:
    """Give range and resolution of the channels of the axes at some places, shape (4, n) each.

    Parameters
    ----------
    section, axes
        The rig's section, and the names of all axes.
    places : sequence of int
        Of the n axes of this rig.
    bits_name : str
        Parameter with the bits of the converters over each range; 0: the resolution is 0.

    Raises
    ------
    InputError
        If a converter has bits but no range.
    """
    ranges, bits = per_channel(section, axes, "sensors.{}_range"), section[bits_name]
    if velocity_is_derived(section):
        ranges[VELOCITY] = np.inf
    if acceleration_is_derived(section):
        ranges[ACCELERATION] = np.inf
    for channel, row in zip(CHANNELS, ranges, strict=True):
        if bits and not row.all():
            what = f"{place_of(bits_name, 'rig')}: {bits_name} is {bits}, but {channel}_range is 0"
            mend = f"give /**: sensors.{channel}_range"
            raise InputError(f"{what}: a converter needs a range; {mend}")
    ranges[ranges == 0.0] = np.inf
    ranges = np.ascontiguousarray(ranges[:, list(places)])
    step = 2.0 * ranges / 2.0**bits
    return ranges, np.where(np.isfinite(step) & (bits > 0), step, 0.0)


class Derivation(NamedTuple):
    """Filter that derives the velocity v from the displacement x; both 0 if nothing does.

    It is measured then, or the acceleration is derived, too, see `servo_model`.

    v = s / (1 + s / w_c) x by the bilinear transform: v[k] = pole v[k-1] + gain (x[k] - x[k-1]).
    """

    gain: float
    pole: float

    @classmethod
    def from_parameters(cls, section: Mapping[str, Any], dt: float) -> "Derivation":
        """Make it from the rig's section, for a sampling period in s."""
        if not velocity_is_derived(section) or acceleration_is_derived(section):
            return cls(0.0, 0.0)
        cutoff = float(section["sensors.velocity_cutoff"])
        half = np.pi * cutoff * dt
        return cls(2 * np.pi * cutoff / (1 + half), (1 - half) / (1 + half))


@compiled
def derived(gain: float, pole: float, velocity: float, moved: float) -> float:
    """Give the velocity of a `Derivation` after the last one, and the motion since."""
    return pole * velocity + gain * moved


@compiled
def derive_velocity(derivation: Derivation, step: int, last: Floats, measured: Floats) -> None:
    """Derive the velocity of a sample from the last sample, both (4, n), if it is not measured.

    At step 0 it is in the steady state.
    """
    if derivation.gain:
        for i in range(measured.shape[1]):
            moved = measured[0, i] - last[0, i]
            v = derived(derivation.gain, derivation.pole, last[1, i], moved)
            measured[1, i] = v if step else 0.0
