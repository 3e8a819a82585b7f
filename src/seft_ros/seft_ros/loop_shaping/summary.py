"""Numbers of a shaped force loop, as `seft design --json` prints them."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from seft_ros.loop_shaping.controller import Controller
from seft_ros.loop_shaping.design import LoopDesign
from seft_ros.loop_shaping.margins import LoopMargins

_COMPARED = ("crossover_hz", "phase_margin_deg", "gain_margin_db", "sensitivity_peak")


def summarise(design: LoopDesign) -> dict[str, Any]:
    """Plant, margins and tracking of one axis; frequencies in Hz, delays in s.

    All but ``discretisation: continuous`` is of the sampled loop. What does not exist is None.
    """
    zero, oil_column = design.plant.antiresonance(), design.plant.oil_column()
    tracking = design.tracking
    return {
        "plant_source": design.plant.source,
        "plant_zero_hz": zero.hz if zero else None,
        "plant_zero_damping": zero.damping if zero else None,
        "plant_pole_hz": oil_column.hz if oil_column else None,
        "plant_pole_damping": oil_column.damping if oil_column else None,
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
