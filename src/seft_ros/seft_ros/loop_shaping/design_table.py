"""A shaped force loop: tables of it in continuous time and as it runs, and JSON values."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

from rich.table import Table

from seft_ros.drawing.tables import CENTRED, Number, make_table, rows_of
from seft_ros.loop_shaping.controller import Controller
from seft_ros.loop_shaping.design import LoopDesign
from seft_ros.loop_shaping.margins import LoopMargins
from seft_ros.loop_shaping.plant import Plant

_COMPARED = ("crossover_hz", "phase_margin_deg", "gain_margin_db", "sensitivity_peak")


def _number(label: str, key: str, unit: str, at: str = "", scale: float = 1.0) -> Number:
    return Number(label, key, unit, scale, ".3g", "none", at)


_MARGINS = (
    _number("crossover", "crossover_hz", "Hz"),
    _number("phase margin", "phase_margin_deg", "deg"),
    _number("gain margin", "gain_margin_db", "dB", "phase_crossover_hz"),
)
_LOOP = (
    *_MARGINS,
    _number("sensitivity peak", "sensitivity_peak", "", "sensitivity_peak_hz"),
    _number("flat within 1 dB to", "flat_to_hz", "Hz"),
    _number("bandwidth (-3 dB)", "bandwidth_hz", "Hz"),
    _number("delay", "delay_s", "ms", scale=1e3),
    _number("dip within 25 Hz", "dip_db", "dB", "dip_hz"),
)


def design_table(design: LoopDesign, title: str) -> Table:
    """Tabulate the force loop of one axis under a title."""
    plant, controller, cost = design.plant, design.controller, design.phase_cost
    zero = plant.antiresonance()
    rows: list[list[str] | None] = [
        ["plant zero (specimen)", "", str(zero or "none")],
        ["plant pole (oil column)", "", str(plant.oil_column() or "none")],
        None,
        ["controller gain", "", f"{controller.gain:.4g}"],
        *(["controller zero", "", str(root)] for root in controller.zeros),
        *(["controller pole", "", str(root)] for root in controller.poles),
        None,
        *rows_of(
            _LOOP,
            vars(design.continuous_margins) | vars(design.continuous_tracking),
            vars(design.margins) | vars(design.tracking),
        ),
    ]
    if zero is not None:
        rows.append(["delay at the zero", "", f"{1e3 * design.delay_at(zero.hz):.3g} ms"])
    caption = cost and (
        f"phase lost at crossover: {cost.total:.3g} deg (hold {cost.hold:.2g}, "
        f"latency {cost.latency:.2g}, dead time {cost.dead_time:.2g}, bilinear {cost.bilinear:.2g})"
    )
    headings = ("", "continuous", "as it runs")
    return make_table(headings, rows, title=title, caption=caption, **CENTRED)


def axes_table(axes: list[dict[str, Any]]) -> Table:
    """Tabulate the margins of several axes, as `summarise_axes` gives them."""
    columns = [replace(number, at="") for number in _MARGINS]
    return make_table(
        ("axis", *(column.label for column in columns), ""),
        [
            [
                axis["axis"],
                *(column.text(axis) for column in columns),
                "stable" if axis["stable"] else "unstable",
            ]
            for axis in axes
        ],
        wrap=True,
        left=(4,),
        title="axes, each with the valves of the others closed",
        **CENTRED,
    )


def summarise(design: LoopDesign) -> dict[str, Any]:
    """Plant, margins and tracking of one axis: ``seft design --json``; in Hz and s.

    All but ``discretisation: continuous`` is of the sampled loop. What does not exist is None.
    """
    zero, tracking = design.plant.antiresonance(), design.tracking
    return {
        "plant_source": design.plant.source,
        **plant_numbers(design.plant),
        **_margins(design.margins),
        "closed_loop_flat_to_hz": tracking.flat_to_hz,
        "bandwidth_hz": tracking.bandwidth_hz,
        "delay_s": tracking.delay_s,
        "delay_at_zero_s": design.delay_at(zero.hz) if zero else None,
        "dip_db": tracking.dip_db,
        "dip_hz": tracking.dip_hz,
        "controller": _controller(design.controller),
        "discretisation": _discretisation(design),
    }


def plant_numbers(plant: Plant | None) -> dict[str, float | None]:
    """Zero (of the specimen) and pole (the oil column) of a plant; None where it has none."""
    zero, pole = (plant.antiresonance(), plant.oil_column()) if plant else (None, None)
    return {
        f"plant_{name}_{key}": getattr(root, key) if root else None
        for name, root in (("zero", zero), ("pole", pole))
        for key in ("hz", "damping")
    }


def summarise_axes(axes: Sequence[str], designs: Sequence[LoopDesign]) -> list[dict[str, Any]]:
    """Name, margins and stability of every axis, each with the valves of the others closed."""
    return [
        {"axis": axis, **_margins(design.margins), "stable": design.stable}
        for axis, design in zip(axes, designs, strict=True)
    ]


def _margins(margins: LoopMargins) -> dict[str, Any]:
    values = asdict(margins)
    del values["stable"]  # the eigenvalues say it exactly
    return {**values, "crossovers_hz": list(margins.crossovers_hz)}


def _controller(controller: Controller) -> dict[str, Any]:
    return {
        "numerator": list(controller.numerator),
        "denominator": list(controller.denominator),
        "gain": controller.gain,
        "poles": [asdict(root) for root in controller.poles],
        "zeros": [asdict(root) for root in controller.zeros],
    }


def _discretisation(design: LoopDesign) -> dict[str, Any]:
    cost = design.phase_cost
    return {
        "continuous": {name: getattr(design.continuous_margins, name) for name in _COMPARED},
        "sampled": {name: getattr(design.margins, name) for name in _COMPARED},
        "phase_cost_deg": None if cost is None else {**asdict(cost), "total": cost.total},
    }
