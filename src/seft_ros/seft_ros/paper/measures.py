"""The measures by which claims are judged: findings in, one number or a few out."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from seft_ros.loop_shaping.margins import BAND_HZ
from seft_ros.paper.findings import COMPUTED, Findings
from seft_ros.paper.outcome import explained, magnitude_and_phase

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

LOW_HZ, HIGH_HZ = 1.0, 50.0
"""Where the gain of the force loop is high, and from where on it is low, Hz."""

_OUTLIERS = 5  # points of the running median over a measured magnitude
_ZERO_HZ = (2.0, 40.0)  # where the zero of a plant like the paper's is looked for
_SMOOTHED = 9


def configured(found: Findings, node: str, parameter: str, factor: float = 1.0) -> float:
    """Look up a parameter of the first axis, in another unit."""
    return factor * float(np.ravel(found.experiment[node][parameter])[0])


def total_mass(found: Findings) -> float:
    """Specimen as identified, and the computed mass at alpha = 1, kg."""
    specimen = float(found.identified.specimen.mass[0, 0])
    return specimen + configured(found, "reference_force", "model.mass")


def controller(found: Findings) -> tuple[str, str, Floats, Floats]:
    """Numerator and denominator of the force controller, as text and as they are."""
    own = found.experiment["force_controller"]
    parts = [np.atleast_1d(own[name]) for name in ("numerator", "denominator")]
    return _polynomial(parts[0]), _polynomial(parts[1]), parts[0], parts[1]


def least_response(found: Findings) -> tuple[float, float]:
    """Frequency at which force answers the valve least, and the specimen's own, Hz."""
    f = found.valve.measured.frequencies_hz
    near = (f >= _ZERO_HZ[0]) & (f <= _ZERO_HZ[1])
    power = np.convolve(np.abs(found.valve.measured.response) ** 2, np.ones(_SMOOTHED), "same")
    return float(f[near][power[near].argmin()]), found.natural_hz


def loop_gains(found: Findings) -> tuple[float, float]:
    """|L| of the model at `LOW_HZ`, and the largest from `HIGH_HZ` on, dB."""
    f, gain = found.valve.loop.frequencies_hz, decibels(found.valve.loop.sampled.loop)
    return float(np.interp(LOW_HZ, f, gain)), float(gain[f >= HIGH_HZ].max())


def loop_rise(found: Findings) -> float:
    """How far |L| of the model rises above where it has been, between the two, dB."""
    f, gain = found.valve.loop.frequencies_hz, decibels(found.valve.loop.sampled.loop)
    gain = gain[(f >= LOW_HZ) & (f <= HIGH_HZ)]
    return float((gain - np.minimum.accumulate(gain)).max())


def unevenness(found: Findings) -> float:
    """Largest departure of the measured |T| from 1 within the controlled band, dB."""
    within = found.closed.measured.frequencies_hz <= BAND_HZ
    return float(np.abs(_median(decibels(found.closed.measured.response))[within]).max())


def dip(found: Findings) -> tuple[float, float, float] | None:
    """Depth (dB) and frequency (Hz) of the dip in |T|, and the specimen's frequency (Hz)."""
    hz, depth = found.closed.tracking.dip_hz, found.closed.tracking.dip_db
    return None if hz is None or depth is None else (-depth, hz, found.natural_hz)


def mismatch(found: Findings, quantity: str) -> float:
    """Largest difference of T, measured and model, within the band: dB, or phase in degrees."""
    within = found.closed.measured.frequencies_hz <= BAND_HZ
    f, own = found.closed.measured.frequencies_hz[within], found.valve.loop.frequencies_hz
    modelled = found.valve.loop.sampled.tracking
    expected = np.interp(f, own, modelled.real) + 1j * np.interp(f, own, modelled.imag)
    ratio = found.closed.measured.response[within] / expected
    difference = decibels(ratio) if quantity == "magnitude" else np.angle(ratio, deg=True)
    return float(np.abs(_median(difference)).max())


def error(
    found: Findings,
    kind: str,
    ratio: float,
    name: str,
    *,
    aligned: bool = False,
    controlled: bool = False,
    to_rig: bool = False,
) -> float:
    """NRMSE of a quantity of a test.

    ``aligned``: after the best-fit delay; ``controlled``: below the vibration; ``to_rig``: against
    the test on the rig instead of the exact response.
    """
    reference = found.tests["rig", ratio] if to_rig else None
    agreement = found.tests[kind, ratio].agreement(name, reference, controlled=controlled)
    return agreement.nrmse_aligned if aligned else agreement.nrmse


def error_if_stable(found: Findings, kind: str, ratio: float, name: str) -> float | None:
    """NRMSE against the rig; None where the simulation is unstable."""
    stable = found.tests[kind, ratio].stable
    return error(found, kind, ratio, name, to_rig=True) if stable else None


def error_explained(found: Findings, kind: str, ratio: float) -> float:
    """Share of the rig's error energy that a simulation has too."""
    return explained(found.tests[kind, ratio], found.tests["rig", ratio])


def by_ratio(found: Findings, measure: Callable[..., float], name: str) -> tuple[float, ...]:
    """Take a measure of the tests on the rig at every mass ratio."""
    return tuple(measure(found, "rig", ratio, name) for ratio in (0.0, *COMPUTED))


def difference_from_eft(found: Findings, names: tuple[str, ...]) -> float:
    """Largest difference of the test at alpha = 0 from conventional EFT, over the peak."""
    test, eft = (found.tests[kind, 0.0].measured for kind in ("rig", "eft"))
    return max(float(np.abs(test[y] - eft[y]).max() / np.abs(eft[y]).max()) for y in names)


def peak_ratio(found: Findings, ratio: float, name: str) -> float | None:
    """Peak on the rig over that of the reference; None where that has none."""
    peaks = found.tests["rig", ratio].agreement(name)
    return peaks.peak / peaks.reference_peak if peaks.reference_peak > 0 else None


def resonance(found: Findings) -> tuple[float, float, float]:
    """Magnitude, phase in degrees without the loop's delay, and frequency (Hz), at alpha = 1."""
    test, natural = found.tests["rig", 1.0], found.natural_hz / np.sqrt(2.0)
    y, exact = test.measured["displacement"], test.exact["displacement"]
    magnitude, phase = magnitude_and_phase(y, exact, 1 / test.dt, natural, found.own_delay)
    return magnitude, phase, natural


def vibration_share(
    found: Findings, kind: str, ratio: float, name: str
) -> tuple[float, float, float, bool]:
    """Share of vibration, the reference's, its frequency in Hz, and whether the test is stable."""
    test = found.tests[kind, ratio]
    ours, exact = test.vibrations(name)
    return ours.share, exact.share, ours.peak_hz, test.stable


def vibration_ratio(found: Findings, kind: str, ratio: float, name: str) -> float:
    """Level of the vibration over that of the exact response; NaN where that has none."""
    ours, exact = found.tests[kind, ratio].vibrations(name)
    return ours.rms / exact.rms if exact.rms > 0 else float("nan")


def vibration_levels(found: Findings, kind: str, ratio: float) -> tuple[float, float, bool]:
    """Levels of a simulation and of the rig, m/s^2, and whether the simulation is stable."""
    test, rig = found.tests[kind, ratio], found.tests["rig", ratio]
    ours, theirs = (part.vibrations("acceleration")[0].rms for part in (test, rig))
    return ours, theirs, test.stable


def vibration_and_growth(found: Findings) -> tuple[float, float]:
    """Frequencies of the vibration at alpha = 1 and of what grows at alpha = 1.5, Hz."""
    measured, _ = found.tests["rig", 1.0].vibrations("acceleration")
    return measured.peak_hz, found.growths["rig", 1.5].hz


def end_of_test(found: Findings, kind: str, ratio: float) -> tuple[str, bool]:
    """How a test ended, and whether it was stable."""
    test = found.tests[kind, ratio]
    told = "runs to its end" if test.trip is None else f"trips at {test.trip.time_s:.2f} s"
    return told, test.stable


def eigenvalue(found: Findings, kind: str, ratio: float) -> tuple[str, float, float]:
    """Whether the loop's dominant motion grows or decays, its time in s and frequency in Hz."""
    growth = found.growths[kind, ratio]
    return "grows" if growth.rate > 0 else "decays", 1 / abs(growth.rate), growth.hz


def decibels(response: Complexes) -> Floats:
    """Magnitude, dB."""
    return np.asarray(20 * np.log10(np.abs(response)))


def _median(values: Floats) -> Floats:
    return np.asarray(median_filter(values, _OUTLIERS, mode="nearest"))


def _polynomial(coefficients: Floats) -> str:
    terms = []
    for power, value in zip(reversed(range(len(coefficients))), coefficients, strict=True):
        s = {0: "", 1: "s"}.get(power, f"s^{power}")
        terms.append(s if s and value == 1 else f"{value:g} {s}".strip())
    return " + ".join(terms)
