"""Sections of a report on the responses: histories, tracking, specimen, spectra, ground motion."""

from collections.abc import Iterator

import numpy as np
from bokeh.models import Range1d
from seft_msgs_py.arrays import Ints
from seft_msgs_py.errors import InputError
from seft_plant_sim.whole_structure import tested_specimen

from seft_ros.analysis.equivalent_motion import BAND_MARGIN, Tracked
from seft_ros.analysis.report_numbers import Report
from seft_ros.analysis.summary import COMPARED, strong_part
from seft_ros.bags.recording import Recording
from seft_ros.drawing import page, style
from seft_ros.drawing.page import Block, PageSection, Plot, Text, against, line, plot
from seft_ros.drawing.style import Number, TextTable, axis_label, percent, rows_of
from seft_ros.reference_force.reference_force_parameters import OF_MODEL

_WINDOW = 1.0
"""Length of a zoom window, s."""

_FEW = 4  # natural frequencies that are listed
_INTENDED = {
    False: "The intended force is the reference force of the same step.",
    True: "The compensation method sends the reference force ahead of time, so the intended force "
    "is derived from measurements: -M_e a_g + S r, with r = f - M_e a the restoring force.",
}
_TESTED = (
    "The measured test is the exact one for one ground motion: that which, with the measured force "
    "and acceleration, satisfies the whole structure's equation of motion. This needs no model of "
    "the specimen and no reference response. A test is as right as that motion is the one asked "
    "for. Errors of the sensors themselves are not seen."
)
_UNKNOWN = "Not known: samples, ground motion, or the structure's description are missing."
_STRONG = (
    "The strong part of the ground motion, 5 to 95 % of its Arias intensity; zoom out with the "
    "wheel for the whole test. The three quantities zoom together."
)
_TRACKING = (
    Number("delay", "delay_s", "ms", 1e3),
    Number("NRMSE", "nrmse", form=percent),
    Number("peak error over the peak", "peak_error", form=percent),
)
_LINES = (
    "Dashed: natural frequencies of the whole structure. Shaded: from "
    f"1/{BAND_MARGIN:g} of the lowest to {BAND_MARGIN:g} times the highest; there both must agree."
)
_GROUND_MOTION = (
    Number("response of the linear whole structure differs by", "response_nrmse", form=percent),
    Number("its natural frequencies", "modes"),
    Number("with the law that the specimen had", "specimen_response_nrmse", form=percent),
    Number("largest deviation of the spectrum in the band", "spectrum_deviation", form=percent,
           at="spectrum_deviation_frequency_hz"),
)  # fmt: skip
_TARGET = (
    Number("displacement off its target, over its RMS", "nrmse", form=percent),
    Number("RMS of that", "rms", "mm", 1e3),
    Number("at most", "peak", "mm", 1e3),
)


def ground_motion(report: Report) -> Iterator[Block]:
    """Numbers of a test's own ground motion, and its response spectrum for each axis."""
    difference, axes = report.difference, report.recording.experiment.axes
    if difference is None:
        yield Text(_UNKNOWN)
        return
    numbers, target = (report.summary[key] for key in ("equivalent_motion", "tracking_error"))
    pairs = zip(difference.natural_hz, difference.damping, strict=True)
    modes = [f"{hz:.3g} Hz ({percent(ratio)} damping)" for hz, ratio in pairs]
    some = ", ".join(modes[:_FEW] + ["..."] * (len(modes) > _FEW))
    rows = rows_of(_GROUND_MOTION, numbers | {"modes": some})
    yield Text(_TESTED)
    rows += rows_of(_TARGET, target) if target is not None else []
    yield TextTable((), rows, numbers=False)
    frequency = difference.frequency_hz
    for axis, asked, tested in zip(axes, difference.asked.T, difference.tested.T, strict=True):
        panel = plot("frequency / Hz", "pseudo-acceleration / (m/s²)", log_x=True)
        against(panel, (frequency, asked), (frequency, tested), ("asked for", "tested"))
        page.band(panel, *difference.band_hz, color=style.REFERENCE)
        for natural in difference.natural_hz:
            page.mark(panel, natural)
        of = f" of {axis}" if len(axes) > 1 else ""
        yield Plot(panel, f"Response spectrum (5 % damping){of}. {_LINES}")


def history_sections(report: Report, column: int, title: str) -> Iterator[PageSection]:
    """One section for each quantity of an axis: the whole test, and windows at peaks."""
    recording = report.recording
    states, dt = recording.states, recording.experiment.timebase.dt
    if not len(states.steps):
        return
    time = states.steps * dt
    shared = page.time_range([0.0, time[-1]])
    shared.start, shared.end = strong_part(recording)
    for name in style.RESPONSES:
        _, scale = style.DISPLAY_UNITS[name]
        y, exact = states.values[:, COMPARED[name], column] * scale, None
        if report.reference is not None:
            exact = getattr(report.reference, name)[:, column] * scale
        windows = [(shared, _STRONG)]
        for step, caption in _places(y, exact, states.steps, dt):
            windows.append((Range1d(step * dt - _WINDOW / 2, step * dt + _WINDOW / 2), caption))
        blocks = []
        for x_range, caption in windows:
            panel = plot("time / s", axis_label(name), x_range=x_range)
            ends = x_range.bounds or (x_range.start, x_range.end)
            known = None if exact is None else _within(ends, dt * np.arange(len(exact)), exact)
            against(panel, known, _within(ends, time, y))
            if x_range is shared and recording.last_step is not None:
                page.mark(panel, recording.last_step * dt)
            blocks.append(Plot(panel, caption, wide=x_range is shared))
        yield PageSection(f"{name.capitalize()}{title}", blocks)


def _within(
    ends: tuple[float, float], x: style.AnyFloats, y: style.AnyFloats
) -> tuple[style.AnyFloats, style.AnyFloats]:
    first, last = np.searchsorted(x, ends[0]), np.searchsorted(x, ends[1], side="right")
    return x[first:last], y[first:last]


def _places(
    y: style.AnyFloats, exact: style.AnyFloats | None, steps: Ints, dt: float
) -> list[tuple[int, str]]:
    """Choose steps to look at more closely, and say why."""
    if exact is None:
        return [(int(steps[np.nanargmax(np.abs(y))]), "At the peak.")]
    peak = int(np.abs(exact).argmax())
    error = np.nan_to_num(np.abs(y - exact[steps]))
    error[np.abs(steps - peak) < _WINDOW / 2 / dt] = 0.0
    return [
        (peak, "At the peak of the reference response."),
        (int(steps[error.argmax()]), "At the largest error elsewhere."),
    ]


def tracking(report: Report, signals: Tracked, column: int) -> Iterator[Block]:
    """Tracking of an axis: numbers, and time history."""
    experiment = report.recording.experiment
    yield Text(_INTENDED[signals.derived])
    yield TextTable((), rows_of(_TRACKING, report.summary["tracking"][experiment.axes[column]]))
    if len(signals.steps) < 2:
        return
    command, force = signals.command[:, column], signals.force[:, column]
    panel = plot("time / s", "force / N")
    time = signals.steps * experiment.timebase.dt
    against(panel, (time, command), (time, force), ("intended force", "measured force"))
    yield Plot(panel, "The intended force, and the force that the load cell measured.")


def hysteresis(report: Report, column: int) -> Iterator[Block]:
    """Restoring force over displacement of an axis, test and reference."""
    states, exact = report.recording.states, report.reference
    try:
        mass = tested_specimen(report.recording.experiment).mass
    except (InputError, KeyError):
        yield Text("The specimen's mass is not known.")
        return
    if not len(states.steps):
        yield Text("There are no samples.")
        return

    panel = plot("displacement / mm", "restoring force / N", height=380)
    reference = None
    if exact is not None:
        force = (exact.force - exact.acceleration @ mass.T)[:, column]
        reference = exact.displacement[:, column] * 1e3, force
    x, _, a, f = np.moveaxis(states.values, 1, 0)
    against(panel, reference, (x[:, column] * 1e3, (f - a @ mass.T)[:, column]), loop=True)
    caption = "Restoring force f - m a: its width is what damping and yielding dissipate."
    yield Plot(panel, caption, wide=True)


def computed_model(recording: Recording) -> Iterator[Block]:
    """Give what a computed model recorded: its hysteresis, and all that it tells over time."""
    found, axes = recording.estimates, recording.experiment.axes
    if found is None:
        return
    time = found.steps * recording.experiment.timebase.dt
    for name in (name for name in found.names if name.startswith(OF_MODEL)):
        values = found.values[:, found.names.index(name)]
        shared = bool((values == values[:, :1]).all())  # of no axis, or the only one
        for column, axis in enumerate(axes[:1] if shared else axes):
            label = name if shared else f"{name}, {axis}"
            force = name.replace(f"{OF_MODEL}displacement", f"{OF_MODEL}force")
            if force != name:
                panel = plot(f"{label} / mm", f"{force} / N", height=380)
                y = found.values[:, found.names.index(force), column]
                against(panel, None, (values[:, column] * 1e3, y), loop=True)
                yield Plot(panel, "Force of the model over its displacement.", wide=True)
            elif not name.startswith(f"{OF_MODEL}force"):
                panel = plot("time / s", label, height=200)
                against(panel, None, (time, values[:, column]))
                yield Plot(panel)


def spectra(report: Report, column: int) -> Iterator[Block]:
    """Amplitude spectral densities of an axis, test against reference response."""
    limits = report.summary["instability_band_hz"]
    note = f"Band where instability would start: {report.band_note}."
    if limits is not None:
        note = (
            "Shaded: where instability would start, {:.3g} to {:.3g} Hz. Vibration beyond the "
            "reference response there grows first when a test loses its margins.".format(*limits)
        )
    for name, by_axis in report.spectra.items():
        test, exact = by_axis[column]
        if len(test.frequency_hz) < 2:
            yield Text("The recording is too short for spectra.")
            return
        unit, scale = style.DISPLAY_UNITS[name]
        panel = plot("frequency / Hz", f"{name} / ({unit}/√Hz)", log_x=True, log_y=True)
        if limits is not None:
            page.band(panel, *limits)
        reference = None
        if exact is not None:
            reference = exact.frequency_hz[1:], exact.amplitude[1:] * scale
        against(panel, reference, (test.frequency_hz[1:], test.amplitude[1:] * scale))
        yield Plot(panel, f"Amplitude spectral density of the {name}. {note}")


def energy(report: Report) -> Iterator[Block]:
    """Energy balance of the specimen."""
    if not report.energies:
        yield Text("No energy balance: the specimen is unknown, or samples are missing.")
        return
    panel, dt = plot("time / s", "energy / J"), report.recording.experiment.timebase.dt
    for (name, (steps, part)), color in zip(report.energies.items(), style.OTHERS, strict=False):
        line(panel, steps * dt, part, name, color=color)
    closure = report.summary["energy"]["closure"]
    left = "" if closure is None else f" At most {percent(closure)} of the input is unexplained."
    yield Plot(panel, f"Work of the actuators' force, and where it went.{left}")
