"""What the commands share: options, the experiment that they name, its test, and how to print."""

import json
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer
from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from seft_msgs_py.config.experiment import Experiment, parse_override
from seft_msgs_py.config.parameter_table import nearest
from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.printing import escaped
from seft_msgs_py.wire.outcome import ZEROED
from seft_msgs_py.wire.topics import GROUND_MOTION, NODES, with_rigs
from seft_plant_sim.rig_parameters import as_simulated

from seft_ros.bags.recording import Recording
from seft_ros.drawing.style import Cell, TextTable
from seft_ros.test_run.parameter_tables import TABLES

if TYPE_CHECKING:
    from seft_ros.test_run.processes import ProcessLayout


def option(default: Any, text: str, named: str | None = None, **more: Any) -> Any:
    """Make an option with a help text, and the name of its value, or its own such as ``--json``."""
    names, metavar = ([named], None) if named and named.startswith("--") else ([], named)
    return typer.Option(default, *names, help=text, metavar=metavar, **more)


_OVERRIDE = "Override a parameter, as in ROS 2; may be repeated."
_FILES = "Another parameter file, whose values win over CONFIG's; may be repeated."
_EXTERNAL = "A node that runs already, such as a lab's driver as rig; may be repeated."
_JSON = "Print one JSON object on stdout, and nothing else there."
Config = Annotated[Path, typer.Argument(metavar="CONFIG", help="Experiment: ROS 2 parameter file.")]
_BAG = "Folder (or file) of a recorded test."
BagArgument = Annotated[Path, typer.Argument(metavar="BAG", help=_BAG)]
_PARAM = typer.Option("-p", "--param", metavar="NODE:PARAMETER:=VALUE", help=_OVERRIDE)
Params = Annotated[Optional[list[str]], _PARAM]
Files = Annotated[Optional[list[Path]], typer.Option(metavar="FILE", help=_FILES)]
External = Annotated[Optional[list[str]], typer.Option(metavar="NODE", help=_EXTERNAL)]
Json = Annotated[bool, typer.Option("--json", help=_JSON)]


def load_experiment(
    config: Path,
    overrides: list[str] | None,
    params_files: Sequence[Path] | None = None,
    external: Sequence[str] | None = None,
) -> Experiment:
    """Read an experiment of a command line; nodes that are external have no section in it."""
    external = external or ()
    experiment = Experiment.load(
        [table for table in TABLES if table.node not in external],
        [config, *(params_files or ())],
        [parse_override(text) for text in overrides or ()],
    )
    possible = [node for node in NODES if node not in ("supervisor", "recorder")]
    possible = list(dict.fromkeys([*possible, *with_rigs(possible, experiment.rigs)]))
    for node in external:
        if node not in possible:
            listed = f"{', '.join(possible)}{nearest(node, possible)}"
            raise InputError(f"--external {node}: must be one of {listed}")
    return experiment


FIGURE = "figure.png"


def show(
    summary: dict[str, Any], as_json: bool, texts: Iterable[RenderableType], *files: str
) -> None:
    """Print a summary as JSON, or tables, lines of text, and the files that it names."""
    if as_json:
        print(json.dumps(summary, indent=2, allow_nan=False))
        return
    console, width = Console(), max(map(len, files), default=0) + 2
    written = (f"{n + ':':{width}}{summary[n]}" for n in files if summary.get(n) is not None)
    for text in (*texts, *written):
        if isinstance(text, str):
            print(escaped(text))
        else:
            is_line = isinstance(text, Cell) or (isinstance(text, TextTable) and not text.headings)
            console.print(text, soft_wrap=is_line)


def complain(text: str) -> None:
    """Print one line on stderr."""
    print(escaped(f"seft: {text}"), file=sys.stderr, flush=True)


STANDS: list[str] = []
"""What a command has done so far that stays, if it is interrupted."""


def stands(what: str) -> None:
    """Note something that stays, if the command is interrupted."""
    STANDS.append(what)


def announce_compilation() -> None:
    """Say on a terminal, once, that this command compiles steps, which it does not do again."""
    if sys.stderr.isatty():
        from seft_plant_sim.compiled import tell_of_compilation

        text = "compiling the steps of this kind of test, once: some seconds"
        tell_of_compilation(lambda: complain(text))


def warn(text: str) -> None:
    """Print a warning on stderr: it is no reason for the end of a command."""
    print(escaped(f"warning: {text}"), file=sys.stderr, flush=True)


@contextmanager
def step_progress(
    total: int = 1, lost: str = "", passing: bool = False
) -> Iterator[Callable[..., None]]:
    """Show a bar of ``total`` steps; gives the function that takes a few words and the steps done.

    A third argument changes how many there are. An interruption becomes an `ExperimentError` where
    ``lost`` says what it costs. A ``passing`` bar vanishes at its end, and is for a terminal alone.
    """
    console, text = Console(stderr=True), TextColumn("{task.description:40.40}", markup=False)
    columns = (text, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console.quiet = passing and not console.is_terminal
    try:
        with Progress(*columns, console=console, transient=passing) as bar:
            task = bar.add_task("", total=total)
            yield lambda what, done, of=total: bar.update(
                task, description=escaped(what), completed=min(done, of), total=of
            )
    except KeyboardInterrupt:
        if not lost:
            raise
        raise ExperimentError(f"interrupted; {lost}") from None


def check_out(out: Path) -> None:
    """Refuse a folder that exists already."""
    if out.exists():
        raise InputError(f"{out}: exists already; name another folder with --out")


def offline_test(experiment: Experiment, bag: Path | None, label: str = "") -> Recording:
    """Run a test in one process, with a progress bar, and write its bag, if one is given.

    Raises `InputError` if parameters contradict each other.
    """
    from seft_ros.ground_motion.ground_motion_block import MOTION
    from seft_ros.test_run.blocks import build_blocks
    from seft_ros.test_run.offline import simulate_test

    experiment = as_simulated(experiment)
    blocks = build_blocks(experiment)
    motion = blocks.ground_motion
    with step_progress(motion.steps) as progress:
        recording = simulate_test(experiment, blocks, partial(progress, f"{label}simulating"))
        facts = {GROUND_MOTION.name: {MOTION: motion.facts}}
        if blocks.rig.zeroed is not None:
            facts["rig"] = {ZEROED: blocks.rig.zeroed}
        recording = replace(recording, facts=facts)
        progress(f"{label}done", len(recording.series["rig/state"].steps))
        if bag is not None:
            from seft_ros.bags.recording_bag import write_recording

            write_recording(recording, bag, motion.chunks)
            stands(f"{bag} is whole")
    return recording


def simulated_instead(experiment: Experiment, why: InputError) -> Recording | None:
    """Simulate a test whose stability can't be computed.

    None, with a warning, where no simulated rig belongs to it.
    """
    if "rig" not in experiment.sections:
        complain(f"{why}, and there is no simulated rig to test its stability")
        return None
    complain(f"{why}; the test is simulated instead")
    # the planned test is assessed, on a fault-free rig
    return offline_test(experiment.changed({"rig": {"faults": ""}}), None)


def dds_test(
    experiment: Experiment,
    bag: Path,
    steps: int,
    external: Collection[str] = (),
    *,
    layout: "ProcessLayout | None" = None,
    label: str = "",
) -> tuple[Recording, Path]:
    """Run a test as separate nodes over DDS, with a progress bar, and read its bag.

    Gives the recording and the bag's folder, which is another if the first was lost. The label
    precedes the messages about one of several tests.

    Raises
    ------
    InputError
        If the nodes do not become ready.
    ExperimentError
        If the run broke; what was recorded is kept.
    """
    from seft_ros.bags.recording_bag import read_bag
    from seft_ros.test_run.run import Interruption, run_experiment

    with step_progress(steps) as show_steps, Interruption() as interruption:

        def progress(what: str, done: int) -> None:
            interruption.check()
            show_steps(f"{label}{what}", done)

        try:
            fault, bag = run_experiment(experiment, bag, progress, layout, external)
        except KeyboardInterrupt:
            kept = f"what was recorded is in {bag}" if bag.exists() else "nothing was recorded"
            raise ExperimentError(f"{label}interrupted; {kept}") from None
    if fault:
        raise ExperimentError(f"{label}{fault}; what was recorded is in {bag}")
    stands(f"{bag} is whole")
    return read_bag(bag), bag


def show_test(recording: Recording, bag: Path | None, *, as_json: bool, figure: bool) -> bool:
    """Show how a test went, draw its figure into its bag; return whether it was stable."""
    from seft_ros.analysis.report_numbers import report_numbers
    from seft_ros.analysis.result_text import summary_texts

    found = report_numbers(recording)
    summary, is_there = found.summary, bag is not None and bag.is_dir()
    if bag is not None and is_there:
        summary["bag"] = str(bag)
        if figure:
            from seft_ros.analysis.figures import test_figure
            from seft_ros.drawing.style import save_figure

            save_figure(test_figure(recording, found.reference), bag / FIGURE)
            summary["figure"] = str(bag / FIGURE)
    show(summary, as_json, summary_texts(found), "bag", "figure")
    if bag is not None and not is_there:
        raise ExperimentError(f"{bag}: the bag was deleted when it was whole")
    return bool(summary["stable"])
