"""Every number of a report, as ``seft report --json`` prints them."""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RIG_STATE
from seft_plant_sim.reference.whole_structure import ReferenceResponse
from seft_plant_sim.specimen.energy_balance import EnergyBalance

from seft_ros.analysis.alignment import every_step
from seft_ros.analysis.equivalent_motion import MotionDifference, motion_difference
from seft_ros.analysis.spectra import Spectrum, spectrum_of, vibration
from seft_ros.analysis.summary import (
    COMPARED,
    ENERGIES,
    balance_of,
    json_safe,
    reference_of,
    summarise,
)
from seft_ros.analysis.timing import Timing, timing_of
from seft_ros.bags.record import Record
from seft_ros.design.plan import Plan
from seft_ros.design.stability_margins import instability_band
from seft_ros.drawing.style import thinned
from seft_ros.report.judgement import Judgement, judge

Floats = npt.NDArray[np.float64]
Steps = npt.NDArray[np.int64]
Band = tuple[float, float]
_SPECTRA = ("force", "acceleration")


@dataclass(frozen=True)
class Findings:
    """What a report is made of; what is not known is None.

    Attributes
    ----------
    record : Record
        The test.
    reference : ReferenceResponse or None
        Exact response, by step from 0.
    energies : dict
        Part of the energy balance -> steps and J, thinned to be drawn; of parts that are not
        zero throughout. Empty if there is no balance.
    spectra : dict
        ``force`` and ``acceleration`` -> for each axis the spectra of test and exact response.
    band : tuple of float or None
        Where instability would start, Hz.
    band_note : str
        Why there is no band; empty if there is.
    difference : MotionDifference or None
        The ground motion that was tested against the one asked for.
    timing : Timing or None
        None of a test that was not recorded message by message.
    judgement : Judgement
        Verdict.
    summary : dict
        All numbers, JSON values: what `summarise` gives and ``instability_band_hz`` (two numbers
        or null), ``vibration`` (``ratio``, the largest of all axes, and ``axes``: see
        `seft_ros.analysis.spectra.vibration`), ``uncompensated_delay_s`` (how far the force lags
        in a test that does nothing about it, else null), ``events`` and ``verdict``.
    """

    record: Record
    reference: ReferenceResponse | None
    energies: dict[str, tuple[Steps, Floats]]
    spectra: dict[str, list[tuple[Spectrum, Spectrum | None]]]
    band: Band | None
    band_note: str
    difference: MotionDifference | None
    timing: Timing | None
    judgement: Judgement
    summary: dict[str, Any]


def report_numbers(record: Record) -> Findings:
    """Analyse a test; an InputError is that of `reference_of`."""
    reference, balance = reference_of(record), balance_of(record)
    difference = motion_difference(record)
    summary = summarise(record, reference, balance, difference)
    energies = _thinned(balance)
    del balance  # as long as the record, and drawn from a few points
    spectra = {name: _spectra(record, reference, name) for name in _SPECTRA}
    band, note = _band(record)
    summary |= {
        "instability_band_hz": band and list(band),
        "vibration": _vibration(record, spectra["acceleration"], band),
        "uncompensated_delay_s": _uncompensated_delay(record, summary),
        "events": [asdict(event) for event in record.events],
    }
    judgement, timing = judge(summary), timing_of(record)
    summary = json_safe(summary | {"verdict": asdict(judgement)})
    made = (reference, energies, spectra, band, note, difference, timing, judgement, summary)
    return Findings(record, *made)


def _thinned(balance: EnergyBalance | None) -> dict[str, tuple[Steps, Floats]]:
    if balance is None:
        return {}
    courses = {name: getattr(balance, name) for name in ENERGIES}
    places = {name: thinned(course) for name, course in courses.items() if np.any(course)}
    return {name: (at, courses[name][at]) for name, at in places.items()}


def _spectra(
    record: Record, reference: ReferenceResponse | None, name: str
) -> list[tuple[Spectrum, Spectrum | None]]:
    states, dt = record.series[RIG_STATE.name], record.experiment.timebase.dt
    every = np.arange(states.steps[-1] + 1) if len(states.steps) else states.steps
    measured = every_step(states, every)[:, COMPARED[name]]
    exact = None if reference is None else getattr(reference, name)
    return [
        (spectrum_of(y, dt), None if exact is None else spectrum_of(exact[:, column], dt))
        for column, y in enumerate(measured.T)
    ]


def _band(record: Record) -> tuple[Band | None, str]:
    try:
        band = instability_band(Plan(record.experiment))
    except (InputError, KeyError) as error:
        return None, f"not known: {error}"
    return band, "" if band else "none: the loop stays stable as far as was looked"


def _vibration(
    record: Record, spectra: list[tuple[Spectrum, Spectrum | None]], band: Band | None
) -> dict[str, Any]:
    ratios = [
        vibration(test, exact, band) if band and exact else math.nan for test, exact in spectra
    ]
    known = [ratio for ratio in ratios if not math.isnan(ratio)]
    by_axis = dict(zip(record.experiment.axes, json_safe(ratios), strict=True))
    return {"ratio": max(known) if known else None, "axes": by_axis}


def _uncompensated_delay(record: Record, summary: dict[str, Any]) -> float | None:
    section = record.experiment.sections.get("reference_force", {})
    fed_back = section.get("method") == "seft" and section.get("mass_ratio", 0.0) > 0
    if not fed_back or section.get("compensation.method") != "none":
        return None
    delays = [row["J"]["J1"] for row in summary["tracking"].values()]
    known = [abs(delay) for delay in delays if delay is not None]
    return max(known) * 1e-3 if known else None
