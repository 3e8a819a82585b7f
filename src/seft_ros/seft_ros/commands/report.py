"""``seft report``: how a recorded test went."""

from pathlib import Path
from typing import Annotated

import typer

from seft_ros.commands.options import JsonOption
from seft_ros.commands.results import present


def report(
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="Folder of a recorded test.")],
    json: JsonOption = False,
) -> int:
    """Show how a recorded test went, against the exact response of the whole structure.

    The bag holds all that is needed: samples, configuration, versions. A figure is drawn into
    its folder. A bag whose recorder was cut off is read after seft recover BAG.

    Examples:

        seft report bags/half

        seft report bags/half --json
    """
    from seft_ros.recording.bag_reader import read_bag

    record = read_bag(bag)
    summary = present(record, bag, as_json=json)
    return 0 if summary["stable"] and summary["complete"] else 1
