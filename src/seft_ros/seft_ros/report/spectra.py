"""Spectra of force and acceleration, with the band where instability would start."""

from seft_ros.analysis.shown import UNITS
from seft_ros.drawing.style import FIRST, REFERENCE
from seft_ros.page.content import Block, Plot, Section, Text
from seft_ros.page.plots import band, line, plot
from seft_ros.report.numbers import Findings


def spectra_section(findings: Findings, column: int, title: str) -> Section:
    """Amplitude spectral densities of an axis, test against exact response."""
    blocks: list[Block] = []
    for name, by_axis in findings.spectra.items():
        test, exact = by_axis[column]
        if len(test.frequency_hz) < 2:
            continue
        unit, scale = UNITS[name]
        panel = plot("frequency / Hz", f"{name} / ({unit}/√Hz)", log_x=True, log_y=True)
        if findings.band is not None:
            band(panel, *findings.band)
        if exact is not None:
            label = "exact response"
            x, y = exact.frequency_hz[1:], exact.amplitude[1:] * scale
            line(panel, x, y, label, color=REFERENCE, width=3.0)
        line(panel, test.frequency_hz[1:], test.amplitude[1:] * scale, "test", color=FIRST)
        blocks.append(
            Plot(panel, f"Amplitude spectral density of the {name}. {_caption(findings)}")
        )
    if not blocks:
        blocks.append(Text("The record is too short for spectra."))
    return Section(f"Spectra{title}", blocks)


def _caption(findings: Findings) -> str:
    if findings.band is None:
        return f"Band where instability would start: {findings.band_note}."
    low, high = findings.band
    return (
        f"Shaded: where instability would start, {low:.3g} to {high:.3g} Hz. Vibration beyond the "
        "exact response there grows first when a test loses its margins."
    )
