"""``seft compare``: the same test twice."""

from pathlib import Path
from typing import Annotated

import typer

from seft_ros.commands.options import JsonOption, print_json


def compare(
    bag_a: Annotated[Path, typer.Argument(metavar="BAG_A", help="Folder of a recorded test.")],
    bag_b: Annotated[Path, typer.Argument(metavar="BAG_B", help="Folder of another.")],
    json: JsonOption = False,
) -> int:
    """Compare two recorded tests sample by sample, aligned by step, bit for bit.

    Exit status 0 if all samples on the loop's topics are identical, 1 if not.

    Examples:

        seft simulate config/jhu.yaml --out bags/simulated

        seft run config/jhu.yaml -p rig:pace:=lockstep --out bags/lockstep

        seft compare bags/simulated bags/lockstep
    """
    from rich.console import Console

    from seft_ros.analysis.compare import compare as compare_records
    from seft_ros.analysis.table import comparison_table
    from seft_ros.recording.bag_reader import read_bag

    result = compare_records(read_bag(bag_a), read_bag(bag_b))
    if json:
        print_json(result)
    else:
        Console().print(comparison_table(result))
    return 0 if result["identical"] else 1
