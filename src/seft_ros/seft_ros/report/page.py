"""The report of a test as a page."""

from collections.abc import Iterator
from pathlib import Path

from seft_ros.analysis.title import title_of
from seft_ros.page.content import Section, Verdict
from seft_ros.page.write import write_page
from seft_ros.report.force_tracking import tracking_section
from seft_ros.report.ground_motion import ground_motion_section
from seft_ros.report.histories import agreement_section, history_sections
from seft_ros.report.numbers import Findings
from seft_ros.report.running import estimates_section, events_section, timing_section
from seft_ros.report.specimen import energy_section, hysteresis_section
from seft_ros.report.spectra import spectra_section
from seft_ros.report.tested import parameters_section, tested_section


def write_report(findings: Findings, name: str, path: Path) -> None:
    """Write the page of a test.

    Parameters
    ----------
    findings : Findings
        As `seft_ros.report.numbers.report_numbers` gives them.
    name : str
        What the test is called.
    path : Path
        File to be written.

    Raises
    ------
    InputError
        If it can't be written.
    """
    write_page(path, f"Test {name}", title_of(findings.record), list(_sections(findings)))


def _sections(findings: Findings) -> Iterator[Section]:
    judgement, axes = findings.judgement, findings.record.experiment.axes
    cells = [finding.cell() for finding in judgement.findings]
    yield Section("Verdict", [Verdict(judgement.mark, judgement.text, cells)])
    yield tested_section(findings)
    yield agreement_section(findings)
    yield ground_motion_section(findings)
    for column, axis in enumerate(axes):
        title = f" of {axis}" if len(axes) > 1 else ""
        yield from history_sections(findings, column, title)
        yield tracking_section(findings, column, title)
        yield hysteresis_section(findings, column, title)
        yield spectra_section(findings, column, title)
    yield energy_section(findings)
    yield timing_section(findings)
    yield estimates_section(findings)
    yield events_section(findings)
    yield parameters_section(findings.record)
