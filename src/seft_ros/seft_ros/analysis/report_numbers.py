"""All numbers of a test, as run, simulate and report print them as JSON, and arrays to draw."""

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.fft import rfft, rfftfreq
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import command_unit
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import GROUND_MOTION, REFERENCE_FORCE, VALVE_COMMAND
from seft_plant_sim.simulated.specimen import EnergyBalance
from seft_plant_sim.whole_structure import ReferenceResponse, is_simulated

from seft_ros.analysis import summary as numbers
from seft_ros.analysis.assessment import BY_TRUTH, IN_LABORATORY, Assessment, assess_test
from seft_ros.analysis.equivalent_motion import MotionDifference, motion_difference
from seft_ros.analysis.metrics import common_steps
from seft_ros.bags.recording import Recording, Series, every_step
from seft_ros.design.planned_tests import PlannedTest
from seft_ros.design.stability_margins import instability_band
from seft_ros.drawing.style import json_safe, thinned

SEGMENT = 4.0
"""Length of the segments from which spectra are averaged, s; its inverse is their resolution."""


@dataclass(frozen=True)
class Spectrum:
    """One-sided power spectral density of a signal.

    Attributes
    ----------
    frequency_hz : ndarray
        Shape (F,), from 0 to Nyquist's.
    power : ndarray
        Shape (F,), square of the signal's unit per Hz.
    """

    frequency_hz: Floats
    power: Floats

    @property
    def amplitude(self) -> Floats:
        """Amplitude spectral density, shape (F,), the signal's unit per root Hz."""
        return np.sqrt(self.power)

    def rms(self, low: float = 0.0, high: float = np.inf) -> float:
        """RMS of what lies in a band of frequencies, Hz, in the signal's unit."""
        inside = (self.frequency_hz >= low) & (self.frequency_hz <= high)
        width = self.frequency_hz[1] if len(self.frequency_hz) > 1 else 0.0
        return float(np.sqrt(self.power[inside].sum() * width))


def spectrum_of(y: Floats, dt: float) -> Spectrum:
    """Estimate a power spectral density from averaged segments (Welch 1967).

    Hann windows that overlap by half, and no mean; a recording shorter than a segment is one. What
    is not finite makes a spectrum of NaN.

    Parameters
    ----------
    y : ndarray
        Shape (N,).
    dt : float
        Sampling period, s.
    """
    size = min(len(y), max(2, round(SEGMENT / dt)))
    if size < 2:
        return Spectrum(np.empty(0), np.empty(0))
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(size) / size)
    with np.errstate(all="ignore"):
        parts = np.lib.stride_tricks.sliding_window_view(y, size)[:: size - size // 2]
        # scipy.signal takes longer to import than all numbers of a report
        each = [np.abs(rfft((part - part.mean()) * window)) ** 2 for part in parts]
        density = np.mean(each, axis=0) * dt / (window @ window)
        density[1 : (size + 1) // 2] *= 2.0  # of the frequencies below 0, too
        return Spectrum(rfftfreq(size, dt), density)


def vibration(
    measured: Spectrum, exact: Spectrum | None, band: tuple[float, float] | None
) -> float:
    """RMS that a signal has in a band (Hz) beyond its reference, over the whole reference's RMS.

    0 where it has no more than the reference; NaN where that is zero throughout, or where
    reference or band are not known.
    """
    if exact is None or band is None:
        return float("nan")
    beyond = measured.rms(*band) ** 2 - exact.rms(*band) ** 2
    whole = exact.rms()
    if not whole > 0 or np.isnan(beyond):
        return float("nan")
    return float(np.sqrt(max(beyond, 0.0)) / whole)


_Spectra = list[tuple[Spectrum, Spectrum | None]]


@dataclass(frozen=True)
class Report:
    """The numbers of a report, and what its figures draw; what is not known is None.

    Attributes
    ----------
    recording : Recording
        The test.
    reference : ReferenceResponse or None
        Reference response, by step from 0.
    energies : dict
        Part of the energy balance -> steps and J, thinned to be drawn; of parts that are not
        zero throughout. Empty if there is no balance.
    spectra : dict
        ``force`` and ``acceleration`` -> for each axis the spectra of test and reference.
    band_note : str
        Why there is no instability band; empty if there is.
    difference : MotionDifference or None
        The equivalent ground motion against the one asked for.
    assessment : Assessment
        Verdict; on a simulated test, by the truth of the simulation.
    laboratory : Assessment or None
        Verdict on a simulated test as a laboratory would see it, which knows nothing of the truth.
    summary : dict
        All numbers, JSON values: what `summarise` gives and ``instability_band_hz`` (two numbers
        or null), ``vibration`` (``ratio``, the largest of all axes, and ``axes``: see
        `vibration`), ``uncompensated_delay_s`` (how far the force lags
        in a test that does nothing about it, else null), ``events``, ``verdict`` and
        ``laboratory_verdict`` (null of a real rig, of which it is the verdict).
    """

    recording: Recording
    reference: ReferenceResponse | None
    energies: dict[str, tuple[Ints, Floats]]
    spectra: dict[str, _Spectra]
    band_note: str
    difference: MotionDifference | None
    assessment: Assessment
    laboratory: Assessment | None
    summary: dict[str, Any]


def report_numbers(recording: Recording) -> Report:
    """Analyse a test; an InputError is that of `reference_of`."""
    reference = numbers.reference_of(recording)
    assessed, exact = numbers.assessed_part(recording, reference)
    balance, difference = numbers.balance_of(assessed), motion_difference(assessed)
    summary = numbers.summarise(recording, reference, balance, difference)
    energies = _thinned(balance)
    del balance  # as long as the recording, and drawn from a few points
    spectra = {name: _spectra(assessed, exact, name) for name in ("force", "acceleration")}
    in_band, note = _in_band(recording.experiment, spectra["acceleration"])
    summary |= in_band | {
        "uncompensated_delay_s": _uncompensated_delay(recording, summary),
        "events": [asdict(event) for event in recording.events],
    }
    laboratory = None
    if is_simulated(recording.experiment):
        laboratory = assess_test(summary | _seen(assessed, summary), IN_LABORATORY)
    assessment = assess_test(summary, BY_TRUTH if laboratory else "This")
    both = {"verdict": assessment, "laboratory_verdict": laboratory}
    verdicts = {name: found and asdict(found) for name, found in both.items()}
    summary = json_safe(summary | verdicts)
    found = difference, assessment, laboratory
    return Report(recording, reference, energies, spectra, note, *found, summary)


def _in_band(experiment: Experiment, accelerations: _Spectra) -> tuple[dict[str, Any], str]:
    """Give the instability band of a test and its vibration there, and why there is no band."""
    band, note = None, "none: the loop stays stable as far as was looked"
    try:
        band = instability_band(PlannedTest(experiment))
    except (InputError, KeyError) as error:
        note = f"not known: {error}"
    ratios = json_safe([vibration(*pair, band) for pair in accelerations])
    of_axes = {
        "ratio": max((ratio for ratio in ratios if ratio is not None), default=None),
        "axes": dict(zip(experiment.axes, ratios, strict=True)),
    }
    found = {"instability_band_hz": band and list(band), "vibration": of_axes}
    return found, "" if band else note


def _seen(recording: Recording, summary: dict[str, Any]) -> dict[str, Any]:
    """Give what a laboratory's summary of a simulated test has instead: of the assumed specimen."""
    seen: dict[str, Any] = {"reference_specimen": "model"}
    if summary["tracking_error"] is not None:
        return seen  # vibration beyond the model's does not count
    sections = dict(recording.experiment.sections)
    known = ("rate", "axes", "calibration.")
    sections["rig"] = {name: own for name, own in sections["rig"].items() if name.startswith(known)}
    as_seen = replace(recording, experiment=Experiment(sections))
    accelerations = _spectra(as_seen, numbers.reference_of(as_seen), "acceleration")
    return seen | _in_band(as_seen.experiment, accelerations)[0]


def _thinned(balance: EnergyBalance | None) -> dict[str, tuple[Ints, Floats]]:
    parts = () if balance is None else numbers.ENERGIES
    energies = {name: getattr(balance, name) for name in parts}
    places = {name: thinned(energy) for name, energy in energies.items() if np.any(energy)}
    return {name: (at, energies[name][at]) for name, at in places.items()}


def _spectra(recording: Recording, reference: ReferenceResponse | None, name: str) -> _Spectra:
    states, dt = recording.states, recording.experiment.timebase.dt
    every = np.arange(states.steps[-1] + 1) if len(states.steps) else states.steps
    measured = every_step(states, every)[:, numbers.COMPARED[name]]
    exact = None if reference is None else getattr(reference, name)
    return [
        (spectrum_of(y, dt), None if exact is None else spectrum_of(exact[:, column], dt))
        for column, y in enumerate(measured.T)
    ]


def _uncompensated_delay(recording: Recording, summary: dict[str, Any]) -> float | None:
    section = recording.experiment.sections.get("reference_force", {})
    fed_back = section.get("method") == "seft" and section.get("mass_ratio", 0.0) > 0
    if not fed_back or section.get("compensation.method") != "none":
        return None
    delays = [row["delay_s"] for row in summary["tracking"].values()]
    return max((abs(delay) for delay in delays if delay is not None), default=None)


_STATE = ("displacement (m)", "velocity (m/s)", "acceleration (m/s^2)", "force (N)")
_EXACT = {"displacement": "m", "acceleration": "m/s^2", "force": "N"}


def histories(
    recording: Recording, reference: ReferenceResponse | None
) -> tuple[list[str], Floats]:
    """Give the histories of a test: a row for each step of the rig, a column for each quantity.

    Parameters
    ----------
    recording : Recording
        Of the test.
    reference : ReferenceResponse or None
        Its exact response, from step 0; None: unknown.

    Returns
    -------
    names : list of str
        ``time (s)``, then for each axis ground acceleration, displacement, velocity,
        acceleration, force, reference force, valve command, and the exact displacement,
        acceleration and force; with the axis in front where there are several.
    table : ndarray
        Shape (N, c); NaN where a sample was lost.
    """
    steps, series = recording.states.steps, recording.series
    unit = command_unit(recording.experiment.sections.get("rig", {}).get("actuator.kind", ""))
    of_target = (series[REFERENCE_FORCE.name].values.shape[1] - 1) * ("",)  # its motion
    parts = [
        (("ground acceleration (m/s^2)",), series[GROUND_MOTION.name]),
        (_STATE, recording.states),
        ((*of_target, "reference force (N)"), series[REFERENCE_FORCE.name]),
        ((f"valve command ({unit})",), series[VALVE_COMMAND.name]),
    ]
    if reference is not None:
        exact = np.stack([getattr(reference, name) for name in _EXACT], axis=1)
        labels = tuple(f"exact {name} ({unit})" for name, unit in _EXACT.items())
        parts.append((labels, Series(np.arange(len(exact)), exact)))
    names, columns = ["time (s)"], [steps * recording.experiment.timebase.dt]
    axes = recording.experiment.axes
    for axis, labels, one in ((axis, *part) for axis in range(len(axes)) for part in parts):
        known = np.full((len(steps), len(labels)), np.nan)
        _, here, there = common_steps(steps, one.steps)
        known[here] = one.values[there, : len(labels), axis]
        for label, column in zip(labels, known.T, strict=True):
            if label:
                names.append(f"{axes[axis]} {label}" if len(axes) > 1 else label)
                columns.append(column)
    return names, np.stack(columns, axis=1)
