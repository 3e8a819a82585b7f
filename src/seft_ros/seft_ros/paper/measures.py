"""The measures named in claims.yaml: from the findings, a number or several by name."""

from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import scipy.signal
from scipy.ndimage import median_filter
from seft_msgs_py.arrays import Complexes, Floats

from seft_ros.design.loop_margins import BAND_HZ
from seft_ros.paper.findings import Findings
from seft_ros.paper.paper_tests import DELAY, SEGMENT, VIBRATION_HZ, Outcome, whole_delay

Values = dict[str, Any]

_OUTLIERS = 5  # points of the running median over a measured magnitude
_ZERO_HZ = (2.0, 40.0)  # where the zero of a plant like the paper's is looked for
_SMOOTHED = 9
_AROUND = (0.7, 1.3)  # of a natural frequency
_MOVED = 0.05  # of the largest power in the band: below, a phase says nothing


def facts(found: Findings) -> Values:
    """Collect the numbers that texts name besides the measured ones."""
    bandwidth = found.closed.tracking.bandwidth_hz
    return {
        "source": Path(found.source).name,
        "peak_force": found.peak_force,
        "time_scale": found.experiment["ground_motion"]["time_scale"],
        "bandwidth_hz": bandwidth or 0.0,
        "band_hz": BAND_HZ,
        "vibration_hz": VIBRATION_HZ,
        "tau_ms": 1e3 * DELAY,
        "own_ms": 1e3 * (found.own_delay - found.experiment.timebase.dt),
        "whole_ms": 1e3 * whole_delay(found.experiment),
        "band_note": "" if bandwidth is None else f"-3 dB at {bandwidth:.3g} Hz",
    }


def value(found: Findings, path: str) -> float | None:
    """Look up what was found, of the first axis: attributes of `Findings`."""
    looked_up = attrgetter(path)(found)
    return None if looked_up is None else float(np.ravel(looked_up)[0])


def configured(found: Findings, node: str, parameter: str, factor: float = 1.0) -> float:
    """Look up a parameter of the first axis, in another unit."""
    return factor * float(np.ravel(found.experiment[node][parameter])[0])


def total_mass(found: Findings) -> float:
    """Specimen as identified, and the computed mass at alpha = 1, kg."""
    specimen = float(found.identified.specimen.mass[0, 0])
    return specimen + configured(found, "reference_force", "model.mass")


def controller(found: Findings, **paper: list[float]) -> Values:
    """Polynomials of the force controller as text, and how far from the paper's they are."""
    own = {name: np.atleast_1d(found.experiment["force_controller"][name]) for name in paper}
    alike = all(len(own[name]) == len(given) for name, given in paper.items())
    departures = [np.abs(own[name] / given - 1).max() for name, given in paper.items() if alike]
    polynomials = {name: _polynomial(coefficients) for name, coefficients in own.items()}
    return {"departure": max(departures, default=np.inf), **polynomials}


def least_response(found: Findings) -> Values:
    """Frequency at which force answers the valve least, the specimen's own, how they differ."""
    f = found.valve.measured.frequencies_hz
    near = (f >= _ZERO_HZ[0]) & (f <= _ZERO_HZ[1])
    power = np.convolve(np.abs(found.valve.measured.response) ** 2, np.ones(_SMOOTHED), "same")
    least, natural = float(f[near][power[near].argmin()]), found.natural_hz
    departure = abs(least - natural) / natural
    return {"least_hz": least, "natural_hz": natural, "departure": departure}


def loop_gain(found: Findings, low_hz: float, high_hz: float) -> Values:
    """|L| of the model, dB: at a low frequency, from a high one on, its rise on the way down."""
    f, gain = found.valve.loop.frequencies_hz, decibels(found.valve.loop.sampled.loop)
    between = gain[(f >= low_hz) & (f <= high_hz)]
    return {
        "low": float(np.interp(low_hz, f, gain)),
        "high": float(gain[f >= high_hz].max()),
        "rise": float((between - np.minimum.accumulate(between)).max()),
    }


def unevenness(found: Findings) -> float:
    """Largest departure of the measured |T| from 1 within the controlled band, dB."""
    within = found.closed.measured.frequencies_hz <= BAND_HZ
    return float(np.abs(_median(decibels(found.closed.measured.response))[within]).max())


def dip(found: Findings) -> Values:
    """Depth (dB) and frequency (Hz) of the dip in |T|, relative to the specimen's frequency."""
    hz, depth = found.closed.tracking.dip_hz, found.closed.tracking.dip_db
    if hz is None or depth is None:
        return {"depth": None, "departure": None}
    departure = abs(hz - found.natural_hz) / found.natural_hz
    return {"depth": -depth, "hz": hz, "departure": departure}


def mismatch(found: Findings, quantity: str) -> float:
    """Largest difference of T, measured and model, within the band: dB, or phase in degrees."""
    measured, model = found.closed.measured, found.valve.loop
    within = measured.frequencies_hz <= BAND_HZ
    f, own, modelled = measured.frequencies_hz[within], model.frequencies_hz, model.sampled.tracking
    expected = np.interp(f, own, modelled.real) + 1j * np.interp(f, own, modelled.imag)
    ratio = measured.response[within] / expected
    difference = decibels(ratio) if quantity == "magnitude" else np.angle(ratio, deg=True)
    return float(np.abs(_median(difference)).max())


def error(
    found: Findings,
    kind: str,
    ratio: float,
    name: str,
    *,
    from_rig: bool = False,
    aligned: bool = False,
    controlled: bool = False,
) -> Values:
    """NRMSE of a test against its reference, or a simulation's against the test on the rig.

    ``aligned``: after the best-fit delay, ``controlled``: no vibration. The note says why a
    simulation may depart from the rig.
    """
    rig = found.tests["rig", ratio] if from_rig else None
    note = ""
    if rig is not None and rig.saturated:
        note = f"under this motion the rig was at the end of a range ({', '.join(rig.saturated)})"
    agreement = found.tests[kind, ratio].agreement(name, rig, controlled=controlled)
    return {"value": agreement.nrmse_aligned if aligned else agreement.nrmse, "note": note}


def error_of_pure_delay(found: Findings, ratio: float) -> Values:
    """NRMSE of the displacement by Eq. 5.4; none where it is unstable, and how it grows."""
    if found.tests["delay", ratio].stable:
        return error(found, "delay", ratio, "displacement", from_rig=True)
    return {"value": None, **growth(found, "delay", ratio)}


def error_explained(found: Findings, kind: str, ratio: float) -> float:
    """Share of the rig's error energy that a simulation has too."""
    return explained(found.tests[kind, ratio], found.tests["rig", ratio])


def difference_from_eft(found: Findings) -> float:
    """Largest difference of the test at alpha = 0 from conventional EFT, over the peak."""
    test, eft = (found.tests[kind, 0.0].measured for kind in ("rig", "eft"))
    return max(float(np.abs(test[name] - y).max() / np.abs(y).max()) for name, y in eft.items())


def peak(found: Findings, ratio: float, name: str) -> Values:
    """Peak and RMS on the rig over those of the reference; no peak where that has none."""
    test = found.tests["rig", ratio]
    peaks = test.agreement(name)
    with np.errstate(divide="ignore", invalid="ignore"):
        rms = float(np.std(test.measured[name]) / np.std(test.exact[name]))
    known = peaks.reference_peak > 0
    return {"peak": peaks.peak / peaks.reference_peak if known else None, "rms": rms}


def resonance(found: Findings) -> Values:
    """Magnitude, and phase in degrees without the loop's delay, about the resonance at alpha 1."""
    test, natural = found.tests["rig", 1.0], found.natural_hz / np.sqrt(2.0)
    y, exact = test.measured["displacement"], test.exact["displacement"]
    magnitude, phase = magnitude_and_phase(y, exact, 1 / test.dt, natural, found.own_delay)
    departure = abs(magnitude - 1)
    return {"magnitude": magnitude, "departure": departure, "phase": phase, "hz": natural}


def vibration(
    found: Findings, kind: str, ratio: float, name: str = "acceleration", times: float = 0.0
) -> Values:
    """Vibration of a test, of its reference, and on the rig.

    Level over the reference's, NaN where that has none; shares, and what the test's has beyond
    some times the reference's; levels of the test and on the rig, and how much smaller that is.
    """
    test, rig = found.tests[kind, ratio], found.tests["rig", ratio]
    (ours, exact), (on_rig, _) = test.vibrations(name), rig.vibrations(name)
    return {
        "value": ours.rms / exact.rms if exact.rms > 0 else float("nan"),
        "share": ours.share,
        "exact_share": exact.share,
        "excess": ours.share - times * exact.share,
        "hz": ours.peak_hz,
        "simulated": ours.rms,
        "measured": on_rig.rms,
        "fewer": on_rig.rms - ours.rms,
        "stable": test.stable,
    }


def vibration_and_growth(found: Findings) -> Values:
    """Frequencies of the vibration at alpha = 1 and of what grows at alpha = 1.5, Hz."""
    hz = found.tests["rig", 1.0].vibrations("acceleration")[0].peak_hz
    growing = found.plans["rig", 1.5].hz()
    return {"hz": hz, "growing_hz": growing, "departure": abs(hz - growing) / growing}


def end_of_test(found: Findings, kind: str, ratio: float) -> Values:
    """How a test ended, and whether it was stable."""
    test = found.tests[kind, ratio]
    end = "runs to its end" if test.trip is None else f"trips at {test.trip.time_s:.2f} s"
    return {"end": end, "stable": test.stable}


def growth(found: Findings, kind: str, ratio: float) -> Values:
    """Rate of the loop's dominant motion in 1/s, its time in s and frequency in Hz."""
    plan = found.plans[kind, ratio]
    rate = plan.growth_rate()
    grows = "grows" if rate > 0 else "decays"
    return {"rate": rate, "grows": grows, "time": 1 / abs(rate), "hz": plan.hz()}


def magnitude_and_phase(
    y: Floats, reference: Floats, rate: float, natural_hz: float, delay: float
) -> tuple[float, float]:
    """Compare a response with its reference from 0.7 to 1.3 times a natural frequency.

    Parameters
    ----------
    y, reference : ndarray
        Shape (N,).
    rate, natural_hz : float
        Of sampling, and of the whole structure, Hz.
    delay : float
        Taken out of y first, s.

    Returns
    -------
    magnitude : float
        |y / reference| over the band.
    phase : float
        Largest phase between them in the band, either way, degrees. Both are NaN where the
        signals are too short to tell.
    """
    segment = min(len(y), int(SEGMENT * rate))
    f, cross = scipy.signal.csd(reference, y, rate, nperseg=segment)
    _, power = scipy.signal.welch(reference, rate, nperseg=segment)
    band = (f > _AROUND[0] * natural_hz) & (f < _AROUND[1] * natural_hz)
    if not band.any() or not power[band].max() > 0:  # a test that tripped at once
        return float("nan"), float("nan")
    found = cross[band] * np.exp(2j * np.pi * f[band] * delay)
    magnitude = float(abs(found.sum()) / power[band].sum())
    moved = power[band] >= _MOVED * power[band].max()
    return magnitude, float(np.abs(np.angle(found[moved], deg=True)).max())


def explained(simulation: Outcome, rig: Outcome) -> float:
    """Share of the rig's error energy in displacement that a simulation has too, at most 1."""
    count = min(len(simulation.time), len(rig.time))
    y, x, exact = (
        part["displacement"][:count] for part in (rig.measured, simulation.measured, rig.exact)
    )
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return float(1.0 - np.sum((y - x) ** 2) / np.sum((y - exact) ** 2))


def decibels(response: Complexes) -> Floats:
    """Magnitude, dB."""
    return np.asarray(20 * np.log10(np.abs(response)))


def _median(values: Floats) -> Floats:
    return np.asarray(median_filter(values, _OUTLIERS, mode="nearest"))


def _polynomial(coefficients: Floats) -> str:
    terms = []
    for power, factor in zip(reversed(range(len(coefficients))), coefficients, strict=True):
        s = {0: "", 1: "s"}.get(power, f"s^{power}")
        terms.append(s if s and factor == 1 else f"{factor:g} {s}".strip())
    return " + ".join(terms)
