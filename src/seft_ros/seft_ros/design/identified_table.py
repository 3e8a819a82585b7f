"""An identified rig: a table for the terminal, and JSON values."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from seft_ros.design.actuator_fit import ActuatorFit
from seft_ros.design.identified import ClosedLoop, Identified
from seft_ros.design.loop_design import plant_numbers, tracking_numbers
from seft_ros.design.measured_test import Measurement
from seft_ros.drawing.tables import Number, json_safe, look_up, make_table

LISTED_HZ = (1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0)
"""Frequencies of the table of delays."""
ANY_SPECIMEN = (
    "actuator.* is of the actuators alone: another specimen needs no new identification (plant.* "
    "and tracking.* are with this specimen)"
)

_MATRICES = ("mass", "damping", "stiffness")
_MARGINS = ("crossover_hz", "phase_margin_deg", "gain_margin_db", "sensitivity_peak")
_TABLE = (  # of an axis, by section
    (
        Number("actuator: flow gain", "actuator.flow_gain_m_per_s_per_v", "mm/s/V", 1e3),
        Number("  oil stiffness", "actuator.oil_stiffness_n_per_m", "kN/m", 1e-3),
        Number("  leakage", "actuator.leakage_per_s", "1/s"),
        Number("  force capacity", "actuator.force_capacity_n", "kN", 1e-3),
        Number("  valve", "actuator.valve_frequency_hz", "Hz"),
        Number("    damping", "actuator.valve_damping", "%", 100.0),
        Number("  dead time", "actuator.dead_time_s", "ms", 1e3),
        Number("  flow explained", "actuator.flow_explained", "% of its variance", 100.0),
        Number("    that is", "actuator.verdict"),
    ),
    (
        Number("zero (specimen)", "plant_zero_hz", "Hz"),
        Number("  damping", "plant_zero_damping", "%", 100.0),
        Number("oil column", "plant_pole_hz", "Hz"),
        Number("  damping", "plant_pole_damping", "%", 100.0),
        Number("model's error", "fit_error", "%", 100.0),
        Number("crossover", "crossover_hz", "Hz"),
        Number("phase margin", "phase_margin_deg", "deg"),
        Number("gain margin", "gain_margin_db", "dB"),
    ),
    (
        Number("closed loop flat to", "closed_loop_flat_to_hz", "Hz (±1 dB)"),
        Number("bandwidth", "bandwidth_hz", "Hz (-3 dB)"),
        Number("delay", "delay_s", "ms", 1e3),
        Number("deepest dip", "dip_db", "dB"),
        Number("  at", "dip_hz", "Hz"),
    ),
    (
        Number("specimen's mass", "specimen.mass", "kg"),
        Number("specimen's damping", "specimen.damping", "N s/m"),
        Number("specimen's stiffness", "specimen.stiffness", "N/m"),
    ),
    (
        Number("coherence, open loop", "coherence.open_loop.mean", "mean"),
        Number("coherence, closed loop", "coherence.closed_loop.mean", "mean"),
    ),
)
_ALWAYS = ("specimen", "coherence")
"""Keys whose rows are always there."""


def identified_table(title: str, axes: tuple[str, ...], summary: Mapping[str, Any]) -> Table:
    """Tabulate the result of `summarise_identified`, one column for each axis; notes below."""
    matrices = {name: np.atleast_2d(summary["specimen"][name]) for name in _MATRICES}
    by_axis = [
        {**axis, "specimen": {name: matrix[index, index] for name, matrix in matrices.items()}}
        for index, axis in enumerate(summary.get("axes", [summary]))
    ]
    rows: list[list[str] | None] = []
    for section in _TABLE:
        for number in section:
            known = any(look_up(axis, number.key) is not None for axis in by_axis)
            if known or number.key.startswith(_ALWAYS):
                cells = (number.plain(axis) for axis in by_axis)
                rows.append([number.label, *cells, number.unit])
        rows.append(None)
    headings = ["", *(axis if len(axes) > 1 else "" for axis in axes), ""]
    caption = Text("\n".join(summary["notes"]))
    return make_table(
        headings, rows, left=(0, len(headings) - 1), wrap=True, title=Text(title), caption=caption
    )


def summarise_identified(identified: Identified) -> dict[str, Any]:
    """Summarise what was identified: ``seft identify --json``.

    Returns
    -------
    dict
        Of the first axis ``actuator``, the plant that it makes with the specimen, margins of the
        digital loop, the measured closed loop with its ``delay_by_frequency``, and ``coherence``
        of both tests; ``axes`` has these for each axis where there are several. ``specimen`` has
        mass, damping and stiffness (numbers, of several axes matrices), natural frequencies and
        dampings; ``notes`` says what could not be identified. What was not measured is null.
    """
    by_axis = [_of_axis(identified, index) for index in range(len(identified.axes))]
    several = len(by_axis) > 1
    named = [{"axis": name, **one} for name, one in zip(identified.axes, by_axis, strict=True)]
    specimen = identified.specimen
    roots = specimen.roots()
    matrices = {name: getattr(specimen, name) for name in _MATRICES}
    summary = {
        **by_axis[0],
        "specimen": {
            **{k: (m.tolist() if several else float(m[0, 0])) for k, m in matrices.items()},
            "frequencies_hz": [root.hz for root in roots],
            "dampings": [root.damping for root in roots],
            "fit_error": specimen.error,
        },
        **({"axes": named} if several else {}),
        "notes": notes(identified),
    }
    return {key: json_safe(value) for key, value in summary.items()}


def notes(identified: Identified) -> list[str]:
    """List what a reader must know about the numbers, one line each."""
    found = [*identified.unusable, *identified.faults]
    if identified.valves:
        found.append(ANY_SPECIMEN)
    else:
        found.append("without a good test of a valve, actuators and margins are not known")
    for axis, valve in zip(identified.axes, identified.valves, strict=False):
        actuator = valve.actuator
        if actuator.unsure:
            found.append(f"axis {axis}: the test shows poorly: {', '.join(actuator.unsure)}")
        if not actuator.force_capacity:
            found.append(
                f"axis {axis}: forces to {actuator.largest_force:.3g} N are too small to show the "
                "force capacity, which stays as configured (0: no effect); raise --amplitude for it"
            )
        if valve.controller_known and not valve.loop.stable:
            found.append(f"axis {axis}: by this model the loop is unstable with its controller")
    if identified.valves and not identified.valves[0].controller_known:
        found.append("margins are known of one transfer function for all axes alone")
    if not identified.closed_loops:
        found.append("no good closed-loop test: tracking.*, which other methods need, is not known")
    if len(identified.axes) > 1:
        found.append("margins are of each axis by itself, the valves of the others closed")
    return found


def _of_axis(identified: Identified, index: int) -> dict[str, Any]:
    valve = identified.valves[index] if identified.valves else None
    closed = identified.closed_loops[index] if identified.closed_loops else None
    margins = valve.loop.margins if valve and valve.controller_known else None
    return {
        "actuator": valve and _of_actuator(valve.actuator),
        **plant_numbers(valve.loop.plant if valve else None),
        "fit_error": valve and valve.error,
        **{key: margins and getattr(margins, key) for key in _MARGINS},
        **tracking_numbers(closed.tracking if closed else None),
        "tracking_fit_error": closed and closed.fit.error,
        "delay_by_frequency": closed and _delays(closed),
        "coherence": {
            "open_loop": valve and _coherence(valve.measured),
            "closed_loop": closed and _coherence(closed.measured),
        },
    }


def _of_actuator(actuator: ActuatorFit) -> dict[str, Any]:
    return {
        "flow_gain_m_per_s_per_v": actuator.flow_gain,
        "oil_stiffness_n_per_m": actuator.oil_stiffness,
        "leakage_per_s": actuator.leakage,
        "force_capacity_n": actuator.force_capacity or None,
        "valve_frequency_hz": actuator.valve_frequency,
        "valve_damping": actuator.valve_damping,
        "dead_time_s": actuator.dead_time,
        "flow_explained": actuator.explained,
        "verdict": actuator.verdict,
        "largest_force_n": actuator.largest_force,
    }


def _delays(closed: ClosedLoop) -> list[dict[str, float]]:
    measured = closed.measured
    f = measured.frequencies_hz
    columns = {
        "delay_s": closed.tracking.delay_by_frequency,
        "magnitude_db": 20 * np.log10(np.abs(measured.response)),
        "coherence": measured.coherence,
    }
    return [
        {"hz": hz, **{name: float(np.interp(hz, f, y)) for name, y in columns.items()}}
        for hz in LISTED_HZ
        if f[0] <= hz <= f[-1]
    ]


def _coherence(measured: Measurement) -> dict[str, float]:
    lowest = int(measured.coherence.argmin())
    return {
        "mean": float(measured.coherence.mean()),
        "lowest": float(measured.coherence[lowest]),
        "lowest_hz": float(measured.frequencies_hz[lowest]),
    }
