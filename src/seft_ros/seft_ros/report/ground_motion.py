"""The ground motion of which the test is the exact one, against the one that was asked for."""

from seft_ros.analysis.motion_difference import MARGIN
from seft_ros.analysis.shown import number
from seft_ros.analysis.table import percent
from seft_ros.drawing.style import FIRST, MARK, REFERENCE
from seft_ros.page.content import Block, Plot, Section, Table, Text
from seft_ros.page.plots import band, line, mark, plot
from seft_ros.report.numbers import Findings

_TITLE = "The ground motion that was tested"
_NOTE = (
    "What was measured is the exact test for one ground motion: that which, with the measured "
    "force and acceleration, satisfies the whole structure's equation of motion. No model of the "
    "specimen and no exact response is needed for it. A test is as right as that motion is the one "
    "asked for. What the sensors themselves get wrong is not seen."
)
_FEW = 4  # natural frequencies that are told


def ground_motion_section(findings: Findings) -> Section:
    """Numbers of a test's own ground motion, and its response spectrum for each axis."""
    difference, axes = findings.difference, findings.record.experiment.axes
    if difference is None:
        text = "Not known: the record lacks samples, ground motion, or the structure's description."
        return Section(_TITLE, [Text(text)])
    blocks: list[Block] = [Text(_NOTE), _table(findings)]
    for column, axis in enumerate(axes):
        panel = plot("frequency / Hz", "pseudo-acceleration / (m/s²)", log_x=True, log_y=True)
        frequency = difference.frequency_hz
        asked, tested = (spectra[:, column] for spectra in (difference.asked, difference.tested))
        line(panel, frequency, asked, "asked for", color=REFERENCE, width=3.0)
        line(panel, frequency, tested, "tested", color=FIRST)
        band(panel, *difference.band_hz, color=REFERENCE)
        for natural in difference.natural_hz:
            mark(panel, natural, color=MARK)
        blocks.append(Plot(panel, _caption(axis if len(axes) > 1 else "")))
    return Section(_TITLE, blocks)


def _table(findings: Findings) -> Table:
    numbers, tracking = findings.summary["equivalent_motion"], findings.summary["tracking_error"]
    structure = numbers["structure"]
    few = zip(structure["frequency_hz"][:_FEW], structure["damping_ratio"], strict=False)
    modes = ", ".join(f"{hz:.3g} Hz ({percent(ratio)} damping)" for hz, ratio in few)
    low, high = structure["stiffness_factors"]
    rows = [
        ("response of the linear whole structure differs by", percent(numbers["response_nrmse"])),
        ("its natural frequencies", modes + ", ..." * (len(structure["frequency_hz"]) > _FEW)),
        (
            f"worst of structures with {low:.2g} to {high:.2g} times the specimen's stiffness",
            _at(numbers["worst_response_nrmse"], numbers["worst_frequency_hz"]),
        ),
        (
            "largest deviation of the spectrum in their band",
            _at(numbers["spectrum_deviation"], numbers["spectrum_deviation_frequency_hz"]),
        ),
    ]
    if tracking is not None:
        rows += [
            ("displacement off its target, over its RMS", percent(tracking["nrmse"])),
            ("RMS of that", number(tracking["rms"], 1e3, "mm")),
            ("at most", number(tracking["peak"], 1e3, "mm")),
        ]
    return Table((), rows)


def _at(value: float | None, frequency: float | None) -> str:
    return f"{percent(value)}, at {number(frequency, 1.0, 'Hz')}"


def _caption(axis: str) -> str:
    return (
        f"Response spectrum (5 % damping){f' of {axis}' if axis else ''}. Dashed: natural "
        f"frequencies of the whole structure. Shaded: from 1/{MARGIN:g} of the smallest to "
        f"{MARGIN:g} times the largest secant stiffness of the specimen in this test; there both "
        "must agree."
    )
