"""How the measured force followed the one that was meant."""

import numpy as np

from seft_ros.analysis.delay_by_frequency import delay_by_frequency
from seft_ros.analysis.shown import number
from seft_ros.analysis.table import percent
from seft_ros.analysis.tracked import Tracked, tracked_of
from seft_ros.drawing.style import FIRST, REFERENCE
from seft_ros.page.content import Block, Plot, Section, Table, Text
from seft_ros.page.plots import level, line, path, plot
from seft_ros.report.numbers import Findings

COHERENT = 0.9
"""Coherence below which amplitude and delay mean little, and are not drawn."""

_SENT = (
    "The force that was meant is the reference force of the same step, so even an ideal actuator "
    "is one period late."
)
_DERIVED = (
    "The compensation method sends the reference force ahead of time, so the force that was meant "
    "is derived from what was measured: -M_e a_g + S r, with r = f - M_e a the specimen's "
    "restoring force."
)


def tracking_section(findings: Findings, column: int, title: str) -> Section:
    """Tracking of an axis: numbers, time history, synchronisation plot, delay by frequency."""
    record = findings.record
    signals = tracked_of(record)
    note = _DERIVED if signals.derived else _SENT
    blocks: list[Block] = [Text(note), _table(findings, record.experiment.axes[column])]
    if len(signals.steps) > 1:
        dt = record.experiment.timebase.dt
        blocks += [
            *_over_time(signals, column, dt),
            _synchronisation(signals, column),
            *_by_frequency(signals, column, dt),
        ]
    return Section(f"Force tracking{title}", blocks)


def _table(findings: Findings, axis: str) -> Table:
    row = findings.summary["tracking"][axis]
    criteria = row["J"]
    rows = [
        ("delay (J1)", number(criteria["J1"], 1.0, "ms")),
        ("normalised error (J2)", number(criteria["J2"], 1.0, "%")),
        ("peak error (J3)", number(criteria["J3"], 1.0, "%")),
        ("amplitude (FEI)", number(row["fei_amplitude"], 1.0, "")),
        ("delay (FEI)", number(row["fei_delay_s"], 1e3, "ms")),
        ("frequency it belongs to (FEI)", number(row["fei_frequency_hz"], 1.0, "Hz")),
        ("tracking indicator at the end", number(row["tracking_indicator_end"], 1.0, "")),
        ("energy error over the input", percent(row["energy_error"])),
    ]
    rows += [
        (f"{name}, of the structure", number(value, 1.0, "%"))
        for name, value in criteria.items()
        if name not in ("J1", "J2", "J3")
    ]
    return Table((), rows)


def _over_time(signals: Tracked, column: int, dt: float) -> list[Block]:
    panel = plot("time / s", "force / N")
    time = signals.steps * dt
    line(
        panel, time, signals.command[:, column], "force that was meant", color=REFERENCE, width=3.0
    )
    line(panel, time, signals.force[:, column], "measured force", color=FIRST)
    return [Plot(panel, "What was meant, and what the load cell measured.")]


def _synchronisation(signals: Tracked, column: int) -> Plot:
    panel = plot("force that was meant / N", "measured force / N", height=380)
    command, force = signals.command[:, column], signals.force[:, column]
    ends = np.array([command.min(), command.max()])
    line(panel, ends, ends, "", color=REFERENCE, width=2.0)
    path(panel, command, force, "test", color=FIRST)
    caption = (
        "Synchronisation: on the diagonal the force is right; a loop that opens is delay, a slope "
        "off the diagonal is amplitude."
    )
    return Plot(panel, caption)


def _by_frequency(signals: Tracked, column: int, dt: float) -> list[Block]:
    found = delay_by_frequency(signals.command[:, column], signals.force[:, column], dt)
    means = np.nan_to_num(found.coherence) >= COHERENT
    if not means.any():
        return [Text("No frequency at which the force that was meant explains the measured force.")]
    delay = plot("frequency / Hz", "delay / ms", log_x=True)
    amplitude = plot("frequency / Hz", "amplitude", log_x=True, x_range=delay.x_range)
    x = found.frequency_hz
    line(delay, x, np.where(means, found.delay_s * 1e3, np.nan), "delay", color=FIRST)
    line(amplitude, x, np.where(means, found.amplitude, np.nan), "amplitude", color=FIRST)
    level(delay, 0.0)
    level(amplitude, 1.0)
    note = f"where the coherence is {COHERENT:g} or more."
    return [
        Plot(delay, f"Delay of the measured force by frequency, {note}"),
        Plot(amplitude, f"Measured over meant force by frequency, {note}"),
    ]
