"""How well a closed force loop T = L / (1 + L) follows its reference: band, delay, dip."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import find_peaks
from seft_msgs_py.arrays import Complexes, Floats

FLATNESS_DB = 1.0
BANDWIDTH_DB = -3.0
BAND_HZ = 25.0
"""Upper end of the band in which force is to be controlled (paper sec. 3.2), Hz."""

_OUTLIERS = 5  # points of the running median over |T|: two wild ones in a row change nothing
_DIP_DB = 0.2  # smallest dip that is distinguished from noise


@dataclass(frozen=True)
class Tracking:
    """How the measured force follows the reference force; None if the data do not show it.

    Attributes
    ----------
    closed_loop_flat_to_hz : float or None
        First frequency at which |T| leaves +-1 dB; 0 where it is outside from the start, None
        where it never leaves.
    bandwidth_hz : float or None
        First frequency at which |T| falls below -3 dB; likewise.
    delay_s : float or None
        Pure delay whose phase fits that of T best, over the band in which T is flat.
    dip_db, dip_hz : float or None
        |T| at the bottom of its deepest dip within the band, and where: it is higher on either
        side, as at a zero of the specimen that is not fully compensated.
    """

    closed_loop_flat_to_hz: float | None = None
    bandwidth_hz: float | None = None
    delay_s: float | None = None
    dip_db: float | None = None
    dip_hz: float | None = None


def tracking_measures(frequencies_hz: Floats, tracking: Complexes) -> Tracking:
    """Measure a closed loop T known at some frequencies, ascending, in Hz; shape (N,) both.

    Delay and dip are those of the band up to `BAND_HZ`. Against noise: magnitudes pass a
    running median of five points, dips below 0.2 dB do not count, and the delay is a
    least-squares fit. Phase is unwrapped from the lowest frequency up, so that noise beyond the
    band reaches nothing within it.
    """
    known = np.isfinite(tracking) & (tracking != 0)
    f, t = frequencies_hz[known], tracking[known]
    if not len(f):
        return Tracking()
    decibels = median_filter(20 * np.log10(np.abs(t)), _OUTLIERS, mode="nearest")
    phase = np.unwrap(np.angle(t))
    flat_to = _first_above(f, np.abs(decibels), FLATNESS_DB)
    dip_db, dip_hz = _deepest_dip(f, decibels)
    return Tracking(
        closed_loop_flat_to_hz=flat_to,
        bandwidth_hz=_first_above(f, -decibels, -BANDWIDTH_DB),
        delay_s=_fitted_delay(f, phase, BAND_HZ if flat_to is None else min(flat_to, BAND_HZ)),
        dip_db=dip_db,
        dip_hz=dip_hz,
    )


def _first_above(f: Floats, values: Floats, limit: float) -> float | None:
    """First frequency at which values pass a limit, interpolated; 0 if the first does."""
    above = values > limit
    if not above.any():
        return None
    i = int(above.argmax())
    if i == 0:
        return 0.0
    return float(np.interp(limit, values[i - 1 : i + 1], f[i - 1 : i + 1]))


def _fitted_delay(f: Floats, phase: Floats, to_hz: float) -> float | None:
    """Least squares of phase = -2 pi f tau through the origin, every Hz counting the same."""
    band = f <= to_hz
    if band.sum() < 2:
        return None
    omega = 2 * np.pi * f[band]
    weight = np.gradient(omega) * omega  # how densely the points lie must not matter
    return float(-(weight @ phase[band]) / (weight @ omega))


def _deepest_dip(f: Floats, decibels: Floats) -> tuple[float | None, float | None]:
    dips, _ = find_peaks(-decibels, prominence=_DIP_DB)
    dips = dips[f[dips] <= BAND_HZ]
    if not len(dips):
        return None, None
    deepest = dips[decibels[dips].argmin()]
    return float(decibels[deepest]), float(f[deepest])
