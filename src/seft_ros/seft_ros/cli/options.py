"""What the commands share: options, the experiment that they name, and how they print."""

import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Optional

import typer
from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_file import parse_override
from seft_msgs_py.config.parameter_table import nearest
from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.wire.rigs import with_rigs
from seft_msgs_py.wire.topics import NODES

from seft_ros.experiment.tables import TABLES
from seft_ros.loop_shaping import Source


def option(text: str, named: str | None = None, **more: Any) -> Any:
    """Make an option with a help text, and the name of its value, or its own such as ``--json``."""
    names, metavar = ([named], None) if named and named.startswith("--") else ([], named)
    return typer.Option(*names, help=text, metavar=metavar, **more)


_OVERRIDE = "Override a parameter, as in ROS 2; may be given many times."
_FILES = "Another parameter file, whose values win over CONFIG's; may be given many times."
Config = Annotated[Path, typer.Argument(metavar="CONFIG", help="Experiment: ROS 2 parameter file.")]
Bag = Annotated[Path, typer.Argument(metavar="BAG", help="Folder (or file) of a recorded test.")]
Params = Annotated[
    Optional[list[str]],
    typer.Option("-p", "--param", metavar="NODE:PARAMETER:=VALUE", help=_OVERRIDE),
]
Files = Annotated[Optional[list[Path]], option(_FILES, "FILE")]
Plant = Annotated[
    Source,
    option(
        "rig: the simulated rig's linear model; identified: plant.* of force_controller; "
        "auto: the identified one where it is given."
    ),
]
External = Annotated[
    Optional[list[str]],
    option(
        "This node runs already with parameters of its own, such as a lab's hardware driver as "
        "rig. May be given many times.",
        "NODE",
    ),
]
Json = Annotated[bool, option("Print one JSON object on stdout, and nothing else there.", "--json")]


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
            raise InputError(
                f"--external {node}: must be one of {', '.join(possible)}{nearest(node, possible)}"
            )
    return experiment


PATIENCE = 1.0  # s without a word


def show(
    summary: dict[str, Any], as_json: bool, tables: Iterable[RenderableType], *files: str
) -> None:
    """Print a summary as JSON, or tables, lines of text, and the files that it names."""
    if as_json:
        print(json.dumps(summary, indent=2, allow_nan=False))
        return
    console = Console()
    for table in tables:
        if isinstance(table, str):
            print(table)
        else:
            console.print(table)
    width = max(map(len, files), default=0) + 2
    for name in files:
        if summary.get(name) is not None:
            print(f"{name + ':':{width}}{summary[name]}")


def complain(text: str) -> None:
    """Print one line on stderr."""
    print(f"seft: {text}", file=sys.stderr, flush=True)


def warn(text: str) -> None:
    """Print a warning on stderr."""
    print(f"warning: {text}", file=sys.stderr, flush=True)


def stderr_console() -> Console:
    """Console for progress: stderr, so that stdout holds results alone."""
    return Console(stderr=True)


@contextmanager
def step_progress(total: int, lost: str = "") -> Iterator[Callable[[str, int], None]]:
    """Show a bar of ``total`` steps; gives the function that takes a few words and the steps done.

    An interruption becomes an `ExperimentError` where ``lost`` says what it costs.
    """
    text = TextColumn("{task.description:40.40}")
    columns = (text, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    try:
        with Progress(*columns, console=stderr_console()) as bar:
            task = bar.add_task("", total=total)
            yield lambda description, done: bar.update(
                task, description=description, completed=min(done, total)
            )
    except KeyboardInterrupt:
        if not lost:
            raise
        raise ExperimentError(f"interrupted; {lost}") from None


@contextmanager
def late_progress() -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar on a terminal once it takes longer."""
    console, start = stderr_console(), time.perf_counter()
    bar = Progress(console=console, transient=True, disable=not console.is_terminal)
    task = bar.add_task("")

    def show(what: str, done: int, total: int) -> None:
        if time.perf_counter() - start > PATIENCE:
            bar.start()
        bar.update(task, description=what, completed=done, total=total)

    try:
        yield show
    finally:
        if bar.live.is_started:
            bar.stop()
