"""What moved and how right it was: responses, force tracking, specimen, spectra, ground motion."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from bokeh.models import Range1d
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RIG_STATE
from seft_plant_sim.whole_structure import tested_specimen

from seft_ros.analysis.equivalent_motion import MARGIN
from seft_ros.analysis.spectra import delay_by_frequency
from seft_ros.analysis.summary import COMPARED
from seft_ros.analysis.summary_text import agreement_rows
from seft_ros.analysis.tracking import Tracked, tracked_of
from seft_ros.analysis.tracking_metrics import energy_error
from seft_ros.drawing.style import FIRST, MARK, OTHERS, REFERENCE
from seft_ros.drawing.tables import (
    DISPLAY_UNITS,
    RESPONSES,
    Number,
    axis_label,
    number,
    percent,
    rows_of,
)
from seft_ros.page.content import Block, Plot, Section, Table, Text
from seft_ros.page.plots import band, level, line, mark, path, plot, time_range
from seft_ros.report.numbers import Findings

Floats = npt.NDArray[np.floating[Any]]

COHERENT = 0.9
"""Coherence below which amplitude and delay mean little, and are not drawn."""
WINDOW = 1.0
"""Length of a zoom window, s."""

_FEW = 4  # natural frequencies that are told
_MODEL = (
    "The exact response is that of the linear model that reference_force was told: how the "
    "specimen differs from it is in these numbers, too."
)
_SENT = (
    "The force that was meant is the reference force of the same step, so even an ideal actuator "
    "is one period late."
)
_DERIVED = (
    "The compensation method sends the reference force ahead of time, so the force that was meant "
    "is derived from what was measured: -M_e a_g + S r, with r = f - M_e a the specimen's "
    "restoring force."
)
_TESTED = (
    "What was measured is the exact test for one ground motion: that which, with the measured "
    "force and acceleration, satisfies the whole structure's equation of motion. No model of the "
    "specimen and no exact response is needed for it. A test is as right as that motion is the one "
    "asked for. What the sensors themselves get wrong is not seen."
)
_TRACKING = (
    Number("delay (J1)", "J.J1", "ms"),
    Number("normalised error (J2)", "J.J2", "%"),
    Number("peak error (J3)", "J.J3", "%"),
    Number("amplitude (FEI)", "fei_amplitude"),
    Number("delay (FEI)", "fei_delay_s", "ms", 1e3),
    Number("frequency it belongs to (FEI)", "fei_frequency_hz", "Hz"),
    Number("tracking indicator at the end", "tracking_indicator_end"),
    Number("energy error over the input", "energy_error", form=percent),
)
_TARGET = (
    Number("displacement off its target, over its RMS", "nrmse", form=percent),
    Number("RMS of that", "rms", "mm", 1e3),
    Number("at most", "peak", "mm", 1e3),
)


def agreement_section(findings: Findings) -> Section:
    """Table of peaks, errors and delays."""
    summary = findings.summary
    several = len(summary["axes"]) > 1
    rows = []
    for axis, part in summary["axes"].items():
        rows += agreement_rows(part, f"{axis} " if several else "", ".4g")
    headings = ("", "peak", "exact peak", "NRMSE", "aligned", "delay")
    blocks: list[Block] = [Table(headings, rows)]
    if summary["reference_specimen"] == "model":
        blocks.insert(0, Text(_MODEL))
    return Section("Agreement with the exact response", blocks)


def ground_motion_section(findings: Findings) -> Section:
    """Numbers of a test's own ground motion, and its response spectrum for each axis."""
    title, difference = "The ground motion that was tested", findings.difference
    if difference is None:
        text = "Not known: the record lacks samples, ground motion, or the structure's description."
        return Section(title, [Text(text)])
    blocks: list[Block] = [Text(_TESTED), _ground_motion_table(findings.summary)]
    axes = findings.record.experiment.axes
    for column, axis in enumerate(axes):
        panel = plot("frequency / Hz", "pseudo-acceleration / (m/s²)", log_x=True, log_y=True)
        frequency = difference.frequency_hz
        asked, tested = (spectra[:, column] for spectra in (difference.asked, difference.tested))
        line(panel, frequency, asked, "asked for", color=REFERENCE, width=3.0)
        line(panel, frequency, tested, "tested", color=FIRST)
        band(panel, *difference.band_hz, color=REFERENCE)
        for natural in difference.natural_hz:
            mark(panel, natural, color=MARK)
        caption = (
            f"Response spectrum (5 % damping){f' of {axis}' if len(axes) > 1 else ''}. Dashed: "
            f"natural frequencies of the whole structure. Shaded: from 1/{MARGIN:g} of the "
            f"smallest to {MARGIN:g} times the largest secant stiffness of the specimen in this "
            "test; there both must agree."
        )
        blocks.append(Plot(panel, caption))
    return Section(title, blocks)


def _ground_motion_table(summary: dict[str, Any]) -> Table:
    numbers, tracking = summary["equivalent_motion"], summary["tracking_error"]
    structure = numbers["structure"]
    frequencies, (low, high) = structure["frequency_hz"], structure["stiffness_factors"]
    few = zip(frequencies[:_FEW], structure["damping_ratio"], strict=False)
    modes = ", ".join(f"{hz:.3g} Hz ({percent(ratio)} damping)" for hz, ratio in few)
    worst, deviation = (
        f"{percent(numbers[value])}, at {number(numbers[hz], unit='Hz')}"
        for value, hz in (
            ("worst_response_nrmse", "worst_frequency_hz"),
            ("spectrum_deviation", "spectrum_deviation_frequency_hz"),
        )
    )
    rows = [
        ["response of the linear whole structure differs by", percent(numbers["response_nrmse"])],
        ["its natural frequencies", modes + ", ..." * (len(frequencies) > _FEW)],
        [f"worst of structures with {low:.2g} to {high:.2g} times the specimen's stiffness", worst],
        ["largest deviation of the spectrum in their band", deviation],
    ]
    return Table((), rows + (rows_of(_TARGET, tracking) if tracking is not None else []))


def history_sections(findings: Findings, column: int, title: str) -> Iterator[Section]:
    """One section for each quantity of an axis: the whole test, and windows at peaks."""
    states = findings.record.series[RIG_STATE.name]
    if not len(states.steps):
        return
    dt = findings.record.experiment.timebase.dt
    time = states.steps * dt
    shared = time_range(np.array([0.0, time[-1]]))
    for name in RESPONSES:
        _, scale = DISPLAY_UNITS[name]
        y = states.values[:, COMPARED[name], column] * scale
        exact = None
        if findings.reference is not None:
            exact = getattr(findings.reference, name)[:, column] * scale
        whole = plot("time / s", axis_label(name), x_range=shared)
        _draw_history(whole, time, y, exact, dt)
        if findings.record.trip is not None:
            mark(whole, findings.record.trip.time_s)
        blocks = [Plot(whole, "Whole test; the three quantities zoom together.", wide=True)]
        for step, caption in _places(y, exact, states.steps, dt):
            low, high = step * dt - WINDOW / 2, step * dt + WINDOW / 2
            panel = plot("time / s", axis_label(name), x_range=Range1d(low, high))
            inside = slice(*np.searchsorted(time, (low, high)))
            first, last = max(0, int(np.floor(low / dt))), int(np.ceil(high / dt)) + 1
            part = None if exact is None else exact[first:last]
            _draw_history(panel, time[inside], y[inside], part, dt, first)
            blocks.append(Plot(panel, caption))
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


def _draw_history(
    panel: Any, time: Floats, y: Floats, exact: Floats | None, dt: float, first: int = 0
) -> None:
    if exact is not None:
        at = (first + np.arange(len(exact))) * dt
        line(panel, at, exact, "exact response", color=REFERENCE, width=3.0)
    line(panel, time, y, "test", color=FIRST)


def tracking_section(findings: Findings, column: int, title: str) -> Section:
    """Tracking of an axis: numbers, time history, synchronisation plot, delay by frequency."""
    record = findings.record
    signals, dt = tracked_of(record), record.experiment.timebase.dt
    row = findings.summary["tracking"][record.experiment.axes[column]]
    of_structure = [
        Number(f"{name}, of the structure", f"J.{name}", "%")
        for name in row["J"]
        if name not in ("J1", "J2", "J3")
    ]
    table = Table((), rows_of((*_TRACKING, *of_structure), row))
    blocks: list[Block] = [Text(_DERIVED if signals.derived else _SENT), table]
    if len(signals.steps) > 1:
        blocks += _tracking_plots(signals, column, dt)
    return Section(f"Force tracking{title}", blocks)


def _tracking_plots(signals: Tracked, column: int, dt: float) -> Iterator[Block]:
    command, force = signals.command[:, column], signals.force[:, column]
    panel = plot("time / s", "force / N")
    time = signals.steps * dt
    line(panel, time, command, "force that was meant", color=REFERENCE, width=3.0)
    line(panel, time, force, "measured force", color=FIRST)
    yield Plot(panel, "What was meant, and what the load cell measured.")

    panel = plot("force that was meant / N", "measured force / N", height=380)
    ends = np.array([command.min(), command.max()])
    line(panel, ends, ends, "", color=REFERENCE, width=2.0)
    path(panel, command, force, "test", color=FIRST)
    caption = (
        "Synchronisation: on the diagonal the force is right; a loop that opens is delay, a slope "
        "off the diagonal is amplitude."
    )
    yield Plot(panel, caption)

    found = delay_by_frequency(command, force, dt)
    means = np.nan_to_num(found.coherence) >= COHERENT
    if not means.any():
        yield Text("No frequency at which the force that was meant explains the measured force.")
        return
    delay = plot("frequency / Hz", "delay / ms", log_x=True)
    amplitude = plot("frequency / Hz", "amplitude", log_x=True, x_range=delay.x_range)
    note = f"by frequency, where the coherence is {COHERENT:g} or more."
    for panel, y, label, right, caption in (
        (delay, found.delay_s * 1e3, "delay", 0.0, "Delay of the measured force"),
        (amplitude, found.amplitude, "amplitude", 1.0, "Measured over meant force"),
    ):
        line(panel, found.frequency_hz, np.where(means, y, np.nan), label, color=FIRST)
        level(panel, right)
        yield Plot(panel, f"{caption} {note}")


def hysteresis_section(findings: Findings, column: int, title: str) -> Section:
    """Restoring force over displacement of an axis, test and exact."""
    states = findings.record.series[RIG_STATE.name]
    heading = f"Hysteresis{title}"
    try:
        mass = tested_specimen(findings.record.experiment).mass
    except (InputError, KeyError):
        return Section(heading, [Text("The specimen's mass is not known.")])
    if not len(states.steps):
        return Section(heading, [Text("There are no samples.")])
    panel = plot("displacement / mm", "restoring force / N", height=380)
    exact = findings.reference
    if exact is not None:
        force = (exact.force - exact.acceleration @ mass.T)[:, column]
        displacement = exact.displacement[:, column]
        path(panel, displacement * 1e3, force, "exact response", color=REFERENCE, width=3.0)
    x, _, a, f = np.moveaxis(states.values, 1, 0)
    path(panel, x[:, column] * 1e3, (f - a @ mass.T)[:, column], "test", color=FIRST)
    caption = "Restoring force f - m a: its width is what damping and yielding dissipate."
    return Section(heading, [Plot(panel, caption, wide=True)])


def spectra_section(findings: Findings, column: int, title: str) -> Section:
    """Amplitude spectral densities of an axis, test against exact response."""
    note = f"Band where instability would start: {findings.band_note}."
    if findings.band is not None:
        low, high = findings.band
        note = (
            f"Shaded: where instability would start, {low:.3g} to {high:.3g} Hz. Vibration beyond "
            "the exact response there grows first when a test loses its margins."
        )
    blocks: list[Block] = []
    for name, by_axis in findings.spectra.items():
        test, exact = by_axis[column]
        if len(test.frequency_hz) < 2:
            continue
        unit, scale = DISPLAY_UNITS[name]
        panel = plot("frequency / Hz", f"{name} / ({unit}/√Hz)", log_x=True, log_y=True)
        if findings.band is not None:
            band(panel, *findings.band)
        if exact is not None:
            x, y = exact.frequency_hz[1:], exact.amplitude[1:] * scale
            line(panel, x, y, "exact response", color=REFERENCE, width=3.0)
        line(panel, test.frequency_hz[1:], test.amplitude[1:] * scale, "test", color=FIRST)
        blocks.append(Plot(panel, f"Amplitude spectral density of the {name}. {note}"))
    return Section(f"Spectra{title}", blocks or [Text("The record is too short for spectra.")])


def energy_section(findings: Findings) -> Section:
    """Energy balance of the specimen, and what the actuators' force error adds to it."""
    record = findings.record
    signals, dt, axes = tracked_of(record), record.experiment.timebase.dt, record.experiment.axes
    blocks: list[Block] = []
    if findings.energies:
        panel = plot("time / s", "energy / J")
        for (name, (steps, energy)), color in zip(findings.energies.items(), OTHERS, strict=False):
            line(panel, steps * dt, energy, name, color=color)
        closure = findings.summary["energy"]["closure"]
        left = (
            "" if closure is None else f" At most {closure:.2%} of the input is left unexplained."
        )
        blocks.append(Plot(panel, f"Work of the actuators' force, and where it went.{left}"))
    else:
        text = "No energy balance: the specimen is not known, or samples are missing."
        blocks.append(Text(text))
    if len(signals.steps) > 1:
        panel = plot("time / s", "energy error / J")
        work = energy_error(signals.force - signals.command, signals.velocity, dt)
        labels: Sequence[str] = axes if len(axes) > 1 else ("force loop",)
        for label, y, color in zip(labels, work.T, OTHERS, strict=False):
            line(panel, signals.steps * dt, y, label, color=color)
        level(panel, 0.0)
        caption = (
            "Work of measured less meant force: where it grows, the force loop's error adds "
            "energy (as damping taken away); where it falls, it takes energy out."
        )
        blocks.append(Plot(panel, caption))
    return Section("Energy", blocks)
