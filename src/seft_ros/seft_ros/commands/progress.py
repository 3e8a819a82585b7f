"""Progress bars of the commands, on stderr."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from seft_ros.commands.options import stderr_console


@contextmanager
def step_progress(total: int) -> Iterator[Callable[[str, int], None]]:
    """Show the steps of a test as a bar.

    Parameters
    ----------
    total : int
        Steps of the test.

    Yields
    ------
    callable
        To be called with a few words on what goes on and the steps done.
    """
    columns = (
        TextColumn("{task.description:40.40}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=stderr_console()) as bar:
        task = bar.add_task("", total=total)

        def show(description: str, done: int) -> None:
            bar.update(task, description=description, completed=min(done, total))

        yield show
