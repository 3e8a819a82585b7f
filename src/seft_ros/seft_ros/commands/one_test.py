"""One test that a command makes, alone or of several, offline or over DDS: its bag, its numbers."""

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, InputError

from seft_ros.bags.record import Record
from seft_ros.commands.output import show, step_progress

if TYPE_CHECKING:
    from seft_ros.test_run.process_layout import ProcessLayout

FIGURE = "figure.png"


def check_out(out: Path) -> None:
    """Refuse a folder that exists already."""
    if out.exists():
        raise InputError(f"{out}: exists already; name another folder with --out")


def offline_test(experiment: Experiment, bag: Path | None, label: str = "") -> Record:
    """Run a test in one process, with a progress bar, and write its bag, if it shall have one.

    Raises
    ------
    InputError
        If a parameter makes no sense together with the others.
    """
    from seft_ros.bags.record_bag import write_record
    from seft_ros.test_run.blocks import build_blocks
    from seft_ros.test_run.offline import simulate

    blocks = build_blocks(experiment)
    motion = blocks.ground_motion
    with step_progress(motion.steps) as tell:
        record = simulate(experiment, blocks, lambda done: tell(f"{label}simulating", done))
        tell(f"{label}writing the bag" if label else "done", len(record.series["rig/state"].steps))
        if bag is not None:
            chunks = [motion.chunk(index) for index in range(motion.chunks)]
            write_record(record, bag, record.experiment["recorder"]["storage"], chunks)
    return record


def dds_test(
    experiment: Experiment,
    bag: Path,
    steps: int,
    external: Collection[str] = (),
    *,
    layout: "ProcessLayout | None" = None,
    label: str = "",
) -> tuple[Record, Path]:
    """Run a test as separate nodes over DDS, with a progress bar, and read its bag.

    Beside the record is the bag's folder: another, where the place for it was lost. The label
    stands before what is told of the test, where there are several.

    Raises
    ------
    InputError
        If the nodes do not become ready.
    ExperimentError
        If the run broke; what was recorded is kept.
    """
    from seft_ros.bags.bag_reader import read_bag
    from seft_ros.test_run.run import Interruption, run_experiment

    with step_progress(steps) as show_steps, Interruption() as interruption:

        def tell(what: str, done: int) -> None:
            interruption.check()
            show_steps(f"{label}{what}", done)

        try:
            fault, bag = run_experiment(experiment, bag, tell, layout, external)
        except KeyboardInterrupt:
            kept = f"; what was recorded is in {bag}" if bag.exists() else ""
            raise ExperimentError(f"{label}interrupted{kept}") from None
    if fault:
        raise ExperimentError(f"{label}{fault}; what was recorded is in {bag}")
    return read_bag(bag), bag


def show_test(record: Record, bag: Path | None, *, as_json: bool, figure: bool) -> bool:
    """Show how a test went; draw its figure into the bag's folder, if there is one.

    Returns
    -------
    bool
        Whether it was stable.
    """
    from seft_ros.analysis.summary import reference_of, summarise
    from seft_ros.analysis.summary_text import summary_table

    reference = reference_of(record)
    summary = summarise(record, reference)
    if bag is not None:
        summary["bag"] = str(bag)
        if figure:
            from seft_ros.analysis.figures import test_figure
            from seft_ros.drawing.style import save_figure

            save_figure(test_figure(record, reference), bag / FIGURE)
            summary["figure"] = str(bag / FIGURE)
    show(summary, as_json, [summary_table(record, summary)], "bag", "figure")
    return bool(summary["stable"])
