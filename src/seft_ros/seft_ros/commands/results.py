"""Results of a test, as the commands show and keep them."""

from pathlib import Path
from typing import Any

from rich.console import Console
from seft_msgs_py.errors import InputError

from seft_ros.commands.options import print_json
from seft_ros.experiment.blocks import Blocks
from seft_ros.recording.record import Record

FIGURE = "figure.png"


def check_out(out: Path) -> None:
    """Refuse a folder that exists already."""
    if out.exists():
        raise InputError(f"{out}: exists already; name another folder with --out")


def save(record: Record, blocks: Blocks, out: Path) -> Path:
    """Write a record of the offline loop as a bag."""
    from seft_ros.recording.record_bag import write_record

    motion = blocks.ground_motion
    chunks = [motion.chunk(index) for index in range(motion.chunks)]
    write_record(record, out, record.experiment["recorder"]["storage"], chunks)
    return out


def present(
    record: Record, bag: Path | None, *, as_json: bool, figure: bool = True
) -> dict[str, Any]:
    """Show how a test went; draw its figure into the bag's folder, if there is one.

    Returns
    -------
    dict
        The numbers, as `--json` prints them.
    """
    from seft_ros.analysis.summary import reference_of, summarise

    reference = reference_of(record)
    summary = summarise(record, reference)
    drawn = bag / FIGURE if bag is not None and figure else None
    if bag is not None:
        summary["bag"] = str(bag)
    if drawn is not None:
        from seft_ros.analysis.figures import test_figure
        from seft_ros.drawing.style import save_figure

        save_figure(test_figure(record, reference), drawn)
        summary["figure"] = str(drawn)
    if as_json:
        print_json(summary)
        return summary
    from seft_ros.analysis.summary_text import summary_table

    console = Console()
    console.print(summary_table(record, summary))
    if bag is not None:
        console.print(f"bag:    {bag}", soft_wrap=True, highlight=False)
    if drawn is not None:
        console.print(f"figure: {drawn}", soft_wrap=True, highlight=False)
    return summary
