"""What was identified, as a table for people."""

from collections.abc import Mapping
from typing import Any

from rich.table import Table
from rich.text import Text

_ROWS: tuple[tuple[str, str, str, float], ...] = (  # what, key, unit, scale
    ("actuator: flow gain", "flow_gain_m_per_s_per_v", "mm/s/V", 1e3),
    ("  oil stiffness", "oil_stiffness_n_per_m", "kN/m", 1e-3),
    ("  leakage", "leakage_per_s", "1/s", 1.0),
    ("  force capacity", "force_capacity_n", "kN", 1e-3),
    ("  valve", "valve_frequency_hz", "Hz", 1.0),
    ("    damping", "valve_damping", "%", 100.0),
    ("  dead time", "dead_time_s", "ms", 1e3),
    ("  flow explained", "flow_explained", "% of its variance", 100.0),
    ("    that is", "verdict", "", 1.0),
    ("", "", "", 1.0),
    ("zero (specimen)", "plant_zero_hz", "Hz", 1.0),
    ("  damping", "plant_zero_damping", "%", 100.0),
    ("oil column", "plant_pole_hz", "Hz", 1.0),
    ("  damping", "plant_pole_damping", "%", 100.0),
    ("model's error", "fit_error", "%", 100.0),
    ("crossover", "crossover_hz", "Hz", 1.0),
    ("phase margin", "phase_margin_deg", "deg", 1.0),
    ("gain margin", "gain_margin_db", "dB", 1.0),
    ("", "", "", 1.0),
    ("closed loop flat to", "closed_loop_flat_to_hz", "Hz (±1 dB)", 1.0),
    ("bandwidth", "bandwidth_hz", "Hz (-3 dB)", 1.0),
    ("delay", "delay_s", "ms", 1e3),
    ("deepest dip", "dip_db", "dB", 1.0),
    ("  at", "dip_hz", "Hz", 1.0),
)
_SPECIMEN = (("mass", "kg"), ("damping", "N s/m"), ("stiffness", "N/m"))


def identified_table(title: str, axes: tuple[str, ...], summary: Mapping[str, Any]) -> Table:
    """Tabulate a summary, one column for each axis; the caption holds its notes.

    Parameters
    ----------
    title : str
        Heading.
    axes : tuple of str
        Names of the axes.
    summary : mapping
        As `seft_ros.identification.summary.summarise_identified` gives it.
    """
    columns = [{**axis, **(axis["actuator"] or {})} for axis in summary.get("axes", [summary])]
    table = Table(
        title=Text(title),
        title_justify="left",
        title_style="",
        caption=Text("\n".join(summary["notes"])),
        caption_justify="left",
        caption_style="",
    )
    table.add_column("")
    for axis in axes:
        table.add_column(Text(axis if len(axes) > 1 else ""), justify="right")
    table.add_column("")
    for what, key, unit, scale in _ROWS:
        if not key:
            table.add_section()
            continue
        if any(column.get(key) is not None for column in columns):
            table.add_row(what, *(_number(column.get(key), scale) for column in columns), unit)
    table.add_section()
    for name, unit in _SPECIMEN:
        value = summary["specimen"][name]
        diagonal = [value] if len(axes) == 1 else [row[i] for i, row in enumerate(value)]
        table.add_row(f"specimen's {name}", *(_number(item, 1.0) for item in diagonal), unit)
    table.add_section()
    for test in ("open_loop", "closed_loop"):
        shares = [column["coherence"][test] for column in columns]
        means = [_number(share and share["mean"], 1.0) for share in shares]
        table.add_row(f"coherence, {test.replace('_', ' ')}", *means, "mean")
    return table


def _number(value: float | str | None, scale: float) -> str:
    if isinstance(value, str):
        return value
    return "-" if value is None else f"{value * scale:.4g}"
