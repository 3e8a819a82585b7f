"""Commands on recorded tests: ``seft report``, ``seft recover`` and ``seft compare``."""

from pathlib import Path
from string import ascii_lowercase
from typing import Annotated, Optional

import typer
from seft_msgs_py.errors import InputError

from seft_ros.commands.options import Bag, Json, option
from seft_ros.commands.output import show

_COLOURS = {"good": "green", "doubt": "yellow", "bad": "red", "none": "default"}


def report(
    bag: Bag,
    out: Annotated[Optional[Path], option("The page; default report.html in BAG.", "FILE")] = None,
    json: Json = False,
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
    from rich.text import Text

    from seft_ros.analysis.summary_text import summary_table
    from seft_ros.bags.bag_reader import read_bag
    from seft_ros.page.content import check_page
    from seft_ros.report.numbers import report_numbers
    from seft_ros.report.report_page import write_report

    beside = bag.with_suffix(".html") if bag.is_file() else bag / "report.html"
    page = beside if out is None else check_page(out)
    findings = report_numbers(read_bag(bag))
    write_report(findings, bag.resolve().name, page)
    summary = findings.summary | {"bag": str(bag), "page": str(page)}
    verdict = summary["verdict"]
    lines = [
        Text(verdict["text"], style=f"bold {_COLOURS[verdict['verdict']]}"),
        *(Text(f"  {one['text']}", style=_COLOURS[one["verdict"]]) for one in verdict["findings"]),
    ]
    show(summary, json, [summary_table(findings.record, summary), *lines], "page")
    return 0 if summary["stable"] and summary["complete"] else 1


def recover(
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="Folder of a recorded test.")],
) -> int:
    """Make a bag readable whose recorder was killed: every complete message is kept.

    The cut-off file stays beside it, named .cut. An intact bag is left as it is.

    Example:

        seft recover bags/half
    """
    from seft_ros.bags.bag_files import recover as recover_bag

    print(recover_bag(bag))
    return 0


def compare(
    bags: Annotated[
        list[Path],
        typer.Argument(
            metavar="BAG BAG...", help="Folders of recorded tests; the first is held against each."
        ),
    ],
    figure: Annotated[Optional[Path], option("Draw the tests on one another.", "FILE")] = None,
    json: Json = False,
) -> int:
    """Compare recorded tests with the first of them, sample by sample, bit for bit.

    Samples are aligned by the step in their stamps, whatever time it took and whoever
    recorded them. At different rates, those at times both have are compared. Tests of
    different length or axes are compared in what is common; the rest is told.

    Bags are mcap or sqlite3, also of ros2 bag record: compressed, split into files, with any
    other topics. One that lacks experiment/description is compared without its configuration.

    Exit status 0 if all samples on the loop's topics are identical, 1 if not.

    Examples:

        seft simulate config/jhu.yaml --out bags/simulated

        seft run config/jhu.yaml -p rig:pace:=lockstep --out bags/lockstep

        seft compare bags/simulated bags/lockstep

    Realtime and hardware against the simulation, as a picture:

        seft compare bags/simulated bags/realtime bags/hardware --figure tests.png

    What the stock recorder wrote, for a script; first_difference names topic, step and field:

        ros2 bag record --all --output bags/stock

        seft compare bags/simulated bags/stock --json
    """
    from seft_ros.analysis.comparison import compare_all
    from seft_ros.analysis.comparison_text import (
        comparison_table,
        comparisons_table,
        describe_bag,
        legend,
    )
    from seft_ros.analysis.figures import comparison_figure
    from seft_ros.bags.bag_reader import read_bag
    from seft_ros.drawing.style import check_figure, save_figure

    if not 2 <= len(bags) <= len(ascii_lowercase):
        raise InputError(f"compare takes 2 to {len(ascii_lowercase)} bags, but got {len(bags)}")
    path = check_figure(figure) if figure is not None else None
    names, labels = [str(bag) for bag in bags], list(ascii_lowercase[: len(bags)])
    records = [read_bag(bag, described=False) for bag in bags]
    result = compare_all(names, records)
    result["bags"] = list(map(describe_bag, names, records))
    several = result.get("comparisons")
    if path is not None:
        titles = [f"{label}: {Path(name).name}" for label, name in zip(labels, names, strict=True)]
        save_figure(comparison_figure(records, several or [result], titles), path)
        result["figure"] = str(path)
    table = comparisons_table(several, labels) if several else comparison_table(result)
    show(result, json, [*map(legend, labels, result["bags"]), table], "figure")
    return 0 if result["identical"] else 1
