"""What was identified, as a dict of JSON values: the ``--json`` of ``seft identify``."""

from typing import Any

import numpy as np

from seft_ros.analysis.summary import json_safe
from seft_ros.identification.actuator_fit import ActuatorFit
from seft_ros.identification.identified import ClosedLoop, Identified, ValveResponse
from seft_ros.identification.spectral import Measurement

LISTED_HZ = (1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0)
"""Frequencies of the table of delays."""
ANY_SPECIMEN = (
    "actuator.* is of the actuators alone: another specimen needs no new identification (plant.* "
    "and tracking.* are with this specimen)"
)

_VALVE_KEYS = (
    *("actuator", "plant_zero_hz", "plant_zero_damping", "plant_pole_hz", "plant_pole_damping"),
    *("fit_error", "crossover_hz", "phase_margin_deg", "gain_margin_db", "sensitivity_peak"),
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
        Of the first axis ``actuator`` (flow_gain_m_per_s_per_v, oil_stiffness_n_per_m,
        leakage_per_s, force_capacity_n, null where the test does not show it,
        valve_frequency_hz, valve_damping, dead_time_s; flow_explained, the share of the flow's
        variance that the oil's balance explains, with a verdict; largest_force_n);
        of the plant that it makes with the specimen ``plant_zero_hz``, ``plant_zero_damping``,
        ``plant_pole_hz``, ``plant_pole_damping`` (oil column), ``fit_error``, and in the digital
        loop ``crossover_hz``, ``phase_margin_deg``, ``gain_margin_db``, ``sensitivity_peak``;
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
                "force capacity, which stays as configured (0: not felt); raise --amplitude for it"
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


def _axis(identified: Identified, index: int) -> dict[str, Any]:
    valves, closed_loops = identified.valves, identified.closed_loops
    valve = valves[index] if valves else None
    closed = closed_loops[index] if closed_loops else None
    measured = {"open_loop": valve, "closed_loop": closed}
    return {
        "axis": identified.axes[index],
        **(_of_valve(valve) if valve else dict.fromkeys(_VALVE_KEYS)),
        **(_of_closed_loop(closed) if closed else dict.fromkeys(_CLOSED_LOOP_KEYS)),
        "coherence": {k: _coherence(v.measured) if v else None for k, v in measured.items()},
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


def _of_valve(valve: ValveResponse) -> dict[str, Any]:
    margins = valve.loop.margins if valve.controller_known else None
    zero, pole = valve.loop.plant.antiresonance(), valve.loop.plant.oil_column()
    values = (
        *(_of_actuator(valve.actuator), zero and zero.hz, zero and zero.damping),
        *(pole and pole.hz, pole and pole.damping, valve.error),
        *(getattr(margins, key) if margins else None for key in _VALVE_KEYS[6:]),
    )
    return dict(zip(_VALVE_KEYS, values, strict=True))


def _of_closed_loop(closed: ClosedLoop) -> dict[str, Any]:
    tracking = closed.tracking
    values = (
        *(tracking.flat_to_hz, tracking.bandwidth_hz, tracking.delay_s),
        *(tracking.dip_db, tracking.dip_hz, closed.fit.error, _delays(closed)),
    )
    return dict(zip(_CLOSED_LOOP_KEYS, values, strict=True))


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
