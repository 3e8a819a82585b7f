"""``seft preflight``: stability and delay margins before anything moves."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Optional

import typer

from seft_ros.commands.options import (
    ConfigArgument,
    ExternalOption,
    JsonOption,
    OverrideOption,
    ParamsFileOption,
    PlantOption,
    complain,
    load_experiment,
    print_json,
    stderr_console,
)
from seft_ros.loop_shaping.source import Source

PATIENCE = 1.0  # s without a word


def preflight(
    config: ConfigArgument,
    param: OverrideOption = None,
    params_file: ParamsFileOption = None,
    external: ExternalOption = None,
    plant: PlantOption = Source.AUTO,
    figure: Annotated[
        Optional[Path],
        typer.Option(
            "--figure",
            metavar="FILE",
            help="Draw where the test would be stable: mass ratio against dead time, and against "
            "the specimen's local stiffness.",
        ),
    ] = None,
    json: JsonOption = False,
) -> int:
    """Tell whether a planned test is stable, and how far from its limits, without moving anything.

    Takes the eigenvalues of the sampled closed loop of rig, compensation and force controller:
    critical mass ratio, critical delay, margins against a wrong gain and a wrong delay, and the
    false damping that the test will show; and sweeps the specimen's local stiffness from 0 to 3
    times the told one. Exact where the loop is linear; the table says what that does not promise.

    Exit status 1: the plan is unstable.

    Examples:

        seft preflight config/jhu.yaml -p reference_force:mass_ratio:=1.0

        seft preflight config/demo.yaml --figure preflight.png

        seft preflight config/jhu.yaml --params-file identified/model.yaml --plant identified
    """
    from seft_ros.drawing.style import check_figure, save_figure
    from seft_ros.preflight.plan import Plan
    from seft_ros.preflight.preflight_tables import summarise
    from seft_ros.preflight.result import preflight as fly

    path = check_figure(figure) if figure is not None else None
    experiment = load_experiment(config, param, params_file, external)
    plan = Plan(experiment, plant)
    with _late_progress() as show:
        found = fly(plan, show)
        summary = summarise(plan, found)
        if path is not None:
            from seft_ros.preflight.figure import preflight_figure
            from seft_ros.preflight.stability_map import stability_maps

            maps = stability_maps(plan, found.margins, show)
            save_figure(preflight_figure(plan, found, maps), path)
            summary["figure"] = str(path)
    if json:
        print_json(summary)
    else:
        from rich.console import Console

        from seft_ros.preflight.preflight_tables import preflight_tables

        console = Console()
        for table in preflight_tables(plan, found, f"preflight of {config}"):
            console.print(table)
        if path is not None:
            console.print(f"figure: {summary['figure']}", soft_wrap=True, highlight=False)
    for reason in found.reasons:
        complain(f"{found.verdict}: {reason}")
    return 1 if found.verdict == "unstable" else 0


@contextmanager
def _late_progress() -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar on a terminal once it takes longer."""
    from rich.progress import Progress

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
