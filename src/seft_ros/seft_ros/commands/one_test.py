"""One test that a command makes, alone or of several, offline or over DDS, and its bag."""

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError

from seft_ros.commands.progress import step_progress
from seft_ros.commands.results import save
from seft_ros.recording.record import Record

if TYPE_CHECKING:
    from seft_ros.running.arrangement import Arrangement


def offline_test(experiment: Experiment, bag: Path) -> Record:
    """Run a test in one process, with a progress bar, and write its bag.

    Raises
    ------
    InputError
        If a parameter makes no sense together with the others.
    """
    from seft_ros.experiment.blocks import build_blocks
    from seft_ros.experiment.offline import simulate

    blocks = build_blocks(experiment)
    with step_progress(blocks.ground_motion.steps) as show:
        record = simulate(experiment, blocks, lambda done: show(f"{bag.name}: simulating", done))
        show(f"{bag.name}: writing the bag", len(record.series["rig/state"].steps))
        save(record, blocks, bag)
    return record


def dds_test(
    experiment: Experiment,
    bag: Path,
    steps: int,
    external: Collection[str] = (),
    *,
    arrangement: "Arrangement | None" = None,
    label: str = "",
) -> Record:
    """Run a test as separate nodes over DDS, with a progress bar, and read its bag.

    The label stands before what is told of the test, where there are several.

    Raises
    ------
    InputError
        If the nodes do not become ready.
    ExperimentError
        If the run broke; what was recorded is kept.
    """
    from seft_ros.recording.bag_reader import read_bag
    from seft_ros.running.interruption import Interruption
    from seft_ros.running.run import run_experiment

    with step_progress(steps) as show, Interruption() as interruption:

        def tell(what: str, done: int) -> None:
            interruption.check()
            show(f"{label}{what}", done)

        try:
            finished = run_experiment(experiment, bag, tell, arrangement, external)
        except KeyboardInterrupt:
            kept = f"; what was recorded is in {bag}" if bag.exists() else ""
            raise ExperimentError(f"{label}interrupted{kept}") from None
    if finished.fault:
        raise ExperimentError(f"{label}{finished.fault}; what was recorded is in {bag}")
    return read_bag(finished.bag)
