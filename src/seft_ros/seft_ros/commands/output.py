"""What the commands print: results on stdout, complaints and progress on stderr."""

import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from seft_msgs_py.errors import ExperimentError

PATIENCE = 1.0  # s without a word


def show(
    summary: dict[str, Any], as_json: bool, tables: Iterable[RenderableType], *files: str
) -> None:
    """Print a summary as JSON; or else tables, lines of text, and the files that it names."""
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
    """Say one line on stderr."""
    print(f"seft: {text}", file=sys.stderr, flush=True)


def warn(text: str) -> None:
    """Say on stderr what does not keep a command from going on."""
    print(f"warning: {text}", file=sys.stderr, flush=True)


def stderr_console() -> Console:
    """Console for progress: stderr, so that stdout holds results alone."""
    return Console(stderr=True)


@contextmanager
def step_progress(total: int, lost: str = "") -> Iterator[Callable[[str, int], None]]:
    """Show the steps of a test as a bar.

    Parameters
    ----------
    total : int
        Steps of the test.
    lost : str
        What an interruption costs, of a calculation by several processes.

    Yields
    ------
    callable
        To be called with a few words on what goes on and the steps done.

    Raises
    ------
    ExperimentError
        If such a calculation is interrupted.
    """
    columns = (
        TextColumn("{task.description:40.40}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
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
