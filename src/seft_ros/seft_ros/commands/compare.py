"""``seft compare``: the same test twice, or more often."""

from collections.abc import Sequence
from pathlib import Path
from string import ascii_lowercase
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer
from seft_msgs_py.errors import InputError

from seft_ros.commands.options import JsonOption, print_json

if TYPE_CHECKING:
    from seft_ros.recording.record import Record


def compare(
    bags: Annotated[
        list[Path],
        typer.Argument(
            metavar="BAG BAG...", help="Folders of recorded tests; the first is held against each."
        ),
    ],
    figure: Annotated[
        Optional[Path],
        typer.Option("--figure", metavar="FILE", help="Draw the tests on one another."),
    ] = None,
    json: JsonOption = False,
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
    from seft_ros.analysis.comparison_text import describe_bag
    from seft_ros.drawing.style import check_figure
    from seft_ros.recording.bag_reader import read_bag

    if not 2 <= len(bags) <= len(ascii_lowercase):
        raise InputError(f"compare takes 2 to {len(ascii_lowercase)} bags, but got {len(bags)}")
    path = check_figure(figure) if figure is not None else None
    names = [str(bag) for bag in bags]
    records = [read_bag(bag, described=False) for bag in bags]
    result = compare_all(names, records)
    result["bags"] = [
        describe_bag(name, record) for name, record in zip(names, records, strict=True)
    ]
    if path is not None:
        _draw(result, records, path)
        result["figure"] = str(path)
    if json:
        print_json(result)
    else:
        _show(result, path)
    return 0 if result["identical"] else 1


def _comparisons(result: dict[str, Any]) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = result.get("comparisons", [result])
    return found


def _draw(result: dict[str, Any], records: Sequence["Record"], path: Path) -> None:
    from seft_ros.analysis.figures import comparison_figure
    from seft_ros.drawing.style import save_figure

    names = [
        f"{label}: {Path(bag['bag']).name}"
        for label, bag in zip(ascii_lowercase, result["bags"], strict=False)
    ]
    save_figure(comparison_figure(records, _comparisons(result), names), path)


def _show(result: dict[str, Any], figure: Path | None) -> None:
    from rich.console import Console

    from seft_ros.analysis.comparison_text import comparison_table, comparisons_table, legend

    console = Console()
    labels = list(ascii_lowercase[: len(result["bags"])])
    for label, bag in zip(labels, result["bags"], strict=True):
        console.print(legend(label, bag), soft_wrap=True, highlight=False, markup=False)
    if "comparisons" in result:
        console.print(comparisons_table(result["comparisons"], labels))
    else:
        console.print(comparison_table(result))
    if figure is not None:
        console.print(f"figure: {figure}", soft_wrap=True, highlight=False, markup=False)
