"""``seft report``: how a recorded test went."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer

from seft_ros.commands.options import JsonOption, print_json

if TYPE_CHECKING:  # numpy and all: other commands start without
    from seft_ros.recording.record import Record

PAGE = "report.html"
_COLOURS = {"good": "green", "doubt": "yellow", "bad": "red", "none": "default"}


def report(
    bag: Annotated[
        Path, typer.Argument(metavar="BAG", help="Folder (or file) of a recorded test.")
    ],
    out: Annotated[
        Optional[Path],
        typer.Option("--out", metavar="FILE", help="The page; default report.html in BAG."),
    ] = None,
    json: JsonOption = False,
) -> int:
    """Show whether a recorded test can be trusted, and where it can not.

    Writes one HTML page that needs no network: verdict, what was tested, displacement, force and
    acceleration against the exact response of the whole structure with windows at the peaks,
    force tracking, hysteresis, spectra, energy, timing, estimates, events. Drag to zoom, click a
    name in a legend to hide its line. --json prints the same numbers.

    The bag holds all that is needed: samples, configuration, versions. A bag whose recorder was
    cut off is read after seft recover BAG.

    Examples:

        seft report bags/half

        seft report bags/half --json

        seft report bags/half --out half.html
    """
    from seft_ros.page.content import check_page
    from seft_ros.recording.bag_reader import read_bag
    from seft_ros.report.numbers import report_numbers
    from seft_ros.report.report_page import write_report

    page = None if out is None else check_page(out)
    findings = report_numbers(read_bag(bag))
    page = page or _beside(bag)
    write_report(findings, bag.resolve().name, page)
    summary = findings.summary | {"bag": str(bag), "page": str(page)}
    if json:
        print_json(summary)
    else:
        _show(findings.record, summary)
    return 0 if summary["stable"] and summary["complete"] else 1


def _beside(bag: Path) -> Path:
    """Place the page in the bag's folder, or beside a bag that is a single file."""
    return bag.with_suffix(".html") if bag.is_file() else bag / PAGE


def _show(record: "Record", summary: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.text import Text

    from seft_ros.analysis.summary_text import summary_table

    console = Console()
    console.print(summary_table(record, summary))
    verdict = summary["verdict"]
    console.print(Text(verdict["text"], style=f"bold {_COLOURS[verdict['verdict']]}"))
    for finding in verdict["findings"]:
        console.print(Text(f"  {finding['text']}", style=_COLOURS[finding["verdict"]]))
    console.print(f"page: {summary['page']}", soft_wrap=True, highlight=False)
