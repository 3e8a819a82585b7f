"""A shaped force loop for people: one table of the loop in continuous time and as it runs."""

from typing import Any

from rich.table import Table

from seft_ros.loop_shaping.design import LoopDesign
from seft_ros.loop_shaping.margins import LoopMargins, Tracking
from seft_ros.loop_shaping.roots import Root


def design_table(design: LoopDesign, title: str) -> Table:
    """Tabulate one axis.

    Parameters
    ----------
    design : LoopDesign
        Its force loop.
    title : str
        Heading.
    """
    table = Table(title=title, caption=_caption(design), caption_justify="left")
    for heading in ("", "continuous", "as it runs"):
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    plant, controller = design.plant, design.controller
    zero = plant.antiresonance()
    table.add_row("plant zero (specimen)", "", _root(zero))
    table.add_row("plant pole (oil column)", "", _root(plant.oil_column()))
    table.add_section()
    table.add_row("controller gain", "", f"{controller.gain:.4g}")
    for name, roots in (("zero", controller.zeros), ("pole", controller.poles)):
        for root in roots:
            table.add_row(f"controller {name}", "", str(root))
    table.add_section()
    pairs = zip(
        [*_margin_rows(design.continuous_margins), *_tracking_rows(design.continuous_tracking)],
        [*_margin_rows(design.margins), *_tracking_rows(design.tracking)],
        strict=True,
    )
    for (label, continuous), (_, sampled) in pairs:
        table.add_row(label, continuous, sampled)
    if zero is not None:
        table.add_row("delay at the zero", "", f"{1e3 * design.delay_at(zero.hz):.3g} ms")
    return table


def axes_table(axes: list[dict[str, Any]]) -> Table:
    """Tabulate the margins of several axes, as `seft_ros.loop_shaping.summary` gives them."""
    table = Table(title="axes, each with the valves of the others closed")
    for heading in ("axis", "crossover", "phase margin", "gain margin", ""):
        table.add_column(heading, justify="right" if heading else "left")
    for axis in axes:
        table.add_row(
            axis["axis"],
            _number(axis["crossover_hz"], "Hz"),
            _number(axis["phase_margin_deg"], "deg"),
            _number(axis["gain_margin_db"], "dB"),
            "stable" if axis["stable"] else "unstable",
        )
    return table


def _margin_rows(margins: LoopMargins) -> list[tuple[str, str]]:
    return [
        ("crossover", _number(margins.crossover_hz, "Hz")),
        ("phase margin", _number(margins.phase_margin_deg, "deg")),
        ("gain margin", _number(margins.gain_margin_db, "dB", margins.phase_crossover_hz)),
        (
            "sensitivity peak",
            _number(margins.sensitivity_peak, "", margins.sensitivity_peak_hz),
        ),
    ]


def _tracking_rows(tracking: Tracking) -> list[tuple[str, str]]:
    delay = None if tracking.delay_s is None else 1e3 * tracking.delay_s
    return [
        ("flat within 1 dB to", _number(tracking.flat_to_hz, "Hz")),
        ("bandwidth (-3 dB)", _number(tracking.bandwidth_hz, "Hz")),
        ("delay", _number(delay, "ms")),
        ("dip within 25 Hz", _number(tracking.dip_db, "dB", tracking.dip_hz)),
    ]


def _caption(design: LoopDesign) -> str | None:
    cost = design.phase_cost
    if cost is None:
        return None
    return (
        f"phase lost at crossover: {cost.total:.3g} deg (hold {cost.hold:.2g}, "
        f"latency {cost.latency:.2g}, dead time {cost.dead_time:.2g}, bilinear {cost.bilinear:.2g})"
    )


def _number(value: float | None, unit: str, at_hz: float | None = None) -> str:
    if value is None:
        return "none"
    text = f"{value:.3g} {unit}".rstrip()
    return text if at_hz is None else f"{text} at {at_hz:.3g} Hz"


def _root(root: Root | None) -> str:
    return "none" if root is None else str(root)
