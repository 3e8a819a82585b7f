"""Displacement, force and acceleration over time against the exact response, and near peaks."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
from bokeh.models import Range1d
from seft_msgs_py.wire.topics import RIG_STATE

from seft_ros.analysis.reference import COMPARED, quantity
from seft_ros.analysis.shown import UNITS, number
from seft_ros.analysis.table import percent
from seft_ros.drawing.style import FIRST, REFERENCE
from seft_ros.page.content import Block, Plot, Section, Table, Text
from seft_ros.page.plots import line, mark, plot, time_range
from seft_ros.report.numbers import Findings

Floats = npt.NDArray[np.floating[Any]]

_MODEL = (
    "The exact response is that of the linear model that reference_force was told: how the "
    "specimen differs from it is in these numbers, too."
)
WINDOW = 1.0
"""Length of a zoom window, s."""


def agreement_section(findings: Findings) -> Section:
    """Table of peaks, errors and delays."""
    summary = findings.summary
    rows = []
    for axis, part in summary["axes"].items():
        prefix = f"{axis} " if len(summary["axes"]) > 1 else ""
        for name, (unit, scale) in UNITS.items():
            row = part[name]
            rows.append(
                (
                    f"{prefix}{name}",
                    number(row["peak"], scale, unit),
                    number(row["reference_peak"], scale, unit),
                    percent(row["nrmse"]),
                    percent(row["nrmse_aligned"]),
                    number(row["delay_s"], 1e3, "ms"),
                )
            )
    headings = ("", "peak", "exact peak", "NRMSE", "aligned", "delay")
    blocks: list[Block] = [Table(headings, rows)]
    if summary["reference_specimen"] == "model":
        blocks.insert(0, Text(_MODEL))
    return Section("Agreement with the exact response", blocks)


def history_sections(findings: Findings, column: int, title: str) -> Iterator[Section]:
    """One section for each quantity of an axis: the whole test, and windows at peaks."""
    states = findings.record.series[RIG_STATE.name]
    if not len(states.steps):
        return
    dt = findings.record.experiment.timebase.dt
    time = states.steps * dt
    shared = time_range(np.array([0.0, time[-1]]))
    for name, (unit, scale) in UNITS.items():
        row = dict(COMPARED)[name]
        y = states.values[:, row, column] * scale
        exact = None
        if findings.reference is not None:
            exact = quantity(findings.reference, name)[:, column] * scale
        label = f"{name} / {unit}"
        whole = plot("time / s", label, x_range=shared)
        _draw(whole, time, y, exact, dt)
        if findings.record.trip is not None:
            mark(whole, findings.record.trip.time_s)
        caption = "Whole test; the three quantities zoom together."
        blocks = [Plot(whole, caption, wide=True)]
        for centre, what in _places(y, exact, states.steps, dt):
            blocks.append(Plot(_window(time, y, exact, dt, centre * dt, label), what))
        yield Section(f"{name.capitalize()}{title}", blocks)


def _places(
    y: Floats, exact: Floats | None, steps: npt.NDArray[np.int64], dt: float
) -> list[tuple[int, str]]:
    """Choose steps to look at more closely, and say why."""
    if exact is None:
        return [(int(steps[np.nanargmax(np.abs(y))]), "At the peak.")]
    peak = int(np.abs(exact).argmax())
    error = np.nan_to_num(np.abs(y - exact[steps]))
    error[np.abs(steps - peak) < WINDOW / 2 / dt] = 0.0
    return [
        (peak, "At the peak of the exact response."),
        (int(steps[error.argmax()]), "Where else the test is most wrong."),
    ]


def _window(
    time: Floats, y: Floats, exact: Floats | None, dt: float, centre: float, label: str
) -> Plot:
    low, high = centre - WINDOW / 2, centre + WINDOW / 2
    panel = plot("time / s", label, x_range=Range1d(low, high))
    inside = slice(*np.searchsorted(time, (low, high)))
    part = None
    first = 0
    if exact is not None:
        first, last = max(0, int(np.floor(low / dt))), int(np.ceil(high / dt)) + 1
        part = exact[first:last]
    _draw(panel, time[inside], y[inside], part, dt, first)
    return panel


def _draw(
    panel: Plot, time: Floats, y: Floats, exact: Floats | None, dt: float, first: int = 0
) -> None:
    if exact is not None:
        at = (first + np.arange(len(exact))) * dt
        line(panel, at, exact, "exact response", color=REFERENCE, width=3.0)
    line(panel, time, y, "test", color=FIRST)
