"""Responses of a loop: margins of L, and how well T = L / (1 + L) follows its reference."""

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
class LoopMargins:
    """Margins of a loop; None if it has none at its frequencies.

    Attributes
    ----------
    crossover_hz : float or None
        First frequency at which |L| falls below 1: up to there the loop has gain.
    crossovers_hz : tuple of float
        All frequencies at which |L| crosses 1, ascending.
    phase_margin_deg : float or None
        Phase left above -180 degrees; of the crossover where that is least, either way.
    gain_margin_db : float or None
        Gain left below 1 at a phase of -180 degrees, where that is least, either way.
    phase_crossover_hz : float or None
        Frequency of the gain margin.
    sensitivity_peak : float or None
        Largest |S| = 1 / |1 + L|.
    sensitivity_peak_hz : float or None
        Where.
    """

    crossover_hz: float | None = None
    crossovers_hz: tuple[float, ...] = ()
    phase_margin_deg: float | None = None
    gain_margin_db: float | None = None
    phase_crossover_hz: float | None = None
    sensitivity_peak: float | None = None
    sensitivity_peak_hz: float | None = None


def loop_margins(frequencies_hz: Floats, loop: Complexes) -> LoopMargins:
    """Margins of a loop L known at some frequencies, ascending, in Hz; shape (N,) both.

    Between them cubic splines interpolate it. Points that are not finite are left out.
    """
    import control  # here: it takes a second, and nodes import this package's neighbours

    known = np.isfinite(loop)
    omega, loop = 2 * np.pi * frequencies_hz[known], loop[known]
    if len(omega) < 4:
        return LoopMargins()
    gains, phases, _, phase_omegas, omegas, _ = control.stability_margins(
        control.frd(loop, omega, smooth=True), returnall=True
    )
    crossovers = sorted({float(f"{w / (2 * np.pi):.9g}") for w in omegas})
    falls = 0 if abs(loop[0]) > 1 else 1  # the first of them at which |L| falls
    gain_margin = phase_crossover = None
    if len(gains):
        margins_db = 20 * np.log10(gains)
        least = int(np.abs(margins_db).argmin())
        gain_margin = float(margins_db[least])
        phase_crossover = float(phase_omegas[least] / (2 * np.pi))
    sensitivity = 1 / np.maximum(np.abs(1 + loop), 1e-9)
    peak = int(sensitivity.argmax())
    return LoopMargins(
        crossover_hz=crossovers[falls] if len(crossovers) > falls else None,
        crossovers_hz=tuple(crossovers),
        phase_margin_deg=float(phases[np.abs(phases).argmin()]) if len(phases) else None,
        gain_margin_db=gain_margin,
        phase_crossover_hz=phase_crossover,
        sensitivity_peak=float(sensitivity[peak]),
        sensitivity_peak_hz=float(omega[peak] / (2 * np.pi)),
    )


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


def delay_by_frequency(frequencies_hz: Floats, tracking: Complexes) -> Floats:
    """Delay -phase / (2 pi f) of a closed loop T in s; NaN where T is not known; shape (N,) all."""
    known = np.isfinite(tracking) & (tracking != 0)
    delays = np.full(len(frequencies_hz), np.nan)
    delays[known] = -np.unwrap(np.angle(tracking[known])) / (2 * np.pi * frequencies_hz[known])
    return delays


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


@dataclass(frozen=True)
class Responses:
    """Frequency responses of a loop at N frequencies, and its numbers.

    Attributes
    ----------
    plant, controller : ndarray
        H_fu, N/V, and C_f, V/N, shape (N,).
    loop, tracking : ndarray
        L = C_f H_fu, and T = L / (1 + L), from reference force to measured force, shape (N,).
    margins : LoopMargins
        Of L.
    measures : Tracking
        Of T.
    """

    plant: Complexes
    controller: Complexes
    loop: Complexes
    tracking: Complexes
    margins: LoopMargins
    measures: Tracking

    @classmethod
    def of(cls, f: Floats, plant: Complexes, controller: Complexes) -> "Responses":
        """Close the loop of plant and controller at frequencies in Hz."""
        loop = controller * plant
        tracking = loop / (1 + loop)
        margins, measures = loop_margins(f, loop), tracking_measures(f, tracking)
        return cls(plant, controller, loop, tracking, margins, measures)
