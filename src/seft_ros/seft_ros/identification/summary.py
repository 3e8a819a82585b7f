"""What was identified, as a dict of JSON values: the ``--json`` of ``seft identify``."""

from typing import Any

import numpy as np

from seft_ros.analysis.summary import json_safe
from seft_ros.identification.identified import ClosedLoop, Identified, ValveResponse
from seft_ros.identification.measurement import Measurement
from seft_ros.loop_shaping.roots import Root

LISTED_HZ = (1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0)
"""Frequencies of the table of delays."""

_PLANT = (
    ("plant_zero_hz", "plant_zero_damping"),
    ("plant_pole_hz", "plant_pole_damping"),
    ("valve_frequency_hz", "valve_damping"),
)
_VALVE_KEYS = (
    *(key for pair in _PLANT for key in pair),
    *("leakage_pole_hz", "leakage_per_s", "gain", "dead_time_s", "fit_error", "blocked_error"),
    *("crossover_hz", "phase_margin_deg", "gain_margin_db", "sensitivity_peak"),
)
_CLOSED_LOOP_KEYS = (
    *("closed_loop_flat_to_hz", "bandwidth_hz", "delay_s", "dip_db", "dip_hz"),
    *("tracking_fit_error", "delay_by_frequency"),
)


def summarise_identified(identified: Identified) -> dict[str, Any]:
    """Summarise what was identified.

    Returns
    -------
    dict
        Of the first axis ``plant_zero_hz``, ``plant_zero_damping``, ``plant_pole_hz``,
        ``plant_pole_damping`` (oil column), ``valve_frequency_hz``, ``valve_damping``,
        ``leakage_pole_hz``, ``leakage_per_s``, ``gain`` (N/s/V), ``dead_time_s``,
        ``fit_error``, ``blocked_error`` (force error over force of the loop with its piston held
        still, in s, highest power first), ``crossover_hz``, ``phase_margin_deg``,
        ``gain_margin_db``, ``sensitivity_peak`` of the model in the digital loop;
        ``closed_loop_flat_to_hz``, ``bandwidth_hz``, ``delay_s``, ``dip_db``, ``dip_hz``,
        ``tracking_fit_error``, ``delay_by_frequency`` (hz, delay_s, magnitude_db, coherence)
        of the measured closed loop; ``coherence`` of both tests. ``axes`` has these for each
        axis where there are several. ``specimen`` has mass, damping and stiffness (numbers, of
        several axes matrices), natural frequencies and dampings; ``notes`` says what could not
        be told. What was not measured is null.
    """
    by_axis = [_axis(identified, index) for index in range(len(identified.axes))]
    several = len(by_axis) > 1
    specimen = identified.specimen
    roots = specimen.roots()
    matrices = {name: getattr(specimen, name) for name in ("mass", "damping", "stiffness")}
    summary = {
        **{key: value for key, value in by_axis[0].items() if key != "axis"},
        "specimen": {
            **{k: (m.tolist() if several else float(m[0, 0])) for k, m in matrices.items()},
            "frequencies_hz": [root.hz for root in roots],
            "dampings": [root.damping for root in roots],
            "fit_error": specimen.error,
        },
        **({"axes": by_axis} if several else {}),
        "notes": notes(identified),
    }
    return {key: json_safe(value) for key, value in summary.items()}


def notes(identified: Identified) -> list[str]:
    """List what a reader must know about the numbers, one line each."""
    found = [*identified.unusable, *identified.faults]
    if not identified.valves:
        found.append("without a good open-loop test, by a valve, plant and margins are not known")
    for axis, valve in zip(identified.axes, identified.valves, strict=False):
        model = valve.fit.model
        for name, root in (("oil column", model.poles[0]), ("valve", model.valve)):
            if not _within(root, identified.band):
                found.append(
                    f"axis {axis}: the {name}'s resonance lies beyond the band of "
                    f"{identified.band[1]:g} Hz; the model covers its effect within"
                )
        if not valve.controller_known:
            found.append(
                f"axis {axis}: margins are known of one transfer function for all axes alone"
            )
        elif not valve.loop.stable:
            found.append(f"axis {axis}: by this model the loop is unstable with its controller")
    if not identified.closed_loops:
        found.append("without a good closed-loop test the tracking is not known")
    if len(identified.axes) > 1:
        found.append("margins are of each axis by itself, the valves of the others closed")
    return found


def _axis(identified: Identified, index: int) -> dict[str, Any]:
    valves, closed_loops = identified.valves, identified.closed_loops
    valve = valves[index] if valves else None
    closed = closed_loops[index] if closed_loops else None
    measured = {"open_loop": valve, "closed_loop": closed}
    return {
        "axis": identified.axes[index],
        **(_of_valve(valve, identified.band) if valve else dict.fromkeys(_VALVE_KEYS)),
        **(_of_closed_loop(closed) if closed else dict.fromkeys(_CLOSED_LOOP_KEYS)),
        "coherence": {k: _coherence(v.measured) if v else None for k, v in measured.items()},
    }


def _of_valve(valve: ValveResponse, band: tuple[float, float]) -> dict[str, Any]:
    model = valve.fit.model
    margins = valve.loop.margins if valve.controller_known else None
    values: dict[str, Any] = {}
    roots = (model.zeros[0], model.poles[0], model.valve)
    for (frequency, damping), root in zip(_PLANT, roots, strict=True):
        known = _within(root, band)
        values |= {frequency: root.hz if known else None, damping: root.damping if known else None}
    return {
        **values,
        "leakage_pole_hz": model.leakage.hz,
        "leakage_per_s": valve.fit.leakage,
        "gain": model.gain,
        "dead_time_s": model.dead_time,
        "fit_error": valve.fit.error,
        "blocked_error": list(valve.blocked_error) or None,
        "crossover_hz": margins.crossover_hz if margins else None,
        "phase_margin_deg": margins.phase_margin_deg if margins else None,
        "gain_margin_db": margins.gain_margin_db if margins else None,
        "sensitivity_peak": margins.sensitivity_peak if margins else None,
    }


def _of_closed_loop(closed: ClosedLoop) -> dict[str, Any]:
    tracking = closed.tracking
    return {
        "closed_loop_flat_to_hz": tracking.flat_to_hz,
        "bandwidth_hz": tracking.bandwidth_hz,
        "delay_s": tracking.delay_s,
        "dip_db": tracking.dip_db,
        "dip_hz": tracking.dip_hz,
        "tracking_fit_error": closed.fit.error,
        "delay_by_frequency": _delays(closed),
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


def _within(root: Root, band: tuple[float, float]) -> bool:
    return band[0] <= root.hz <= band[1]
