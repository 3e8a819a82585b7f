"""``seft tournament``: all compensation methods on the same motion and rigs."""

import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError

from seft_ros.commands.options import (
    ConfigArgument,
    JsonOption,
    OverrideOption,
    ParamsFileOption,
    load_experiment,
    print_json,
)
from seft_ros.commands.progress import step_progress

if TYPE_CHECKING:  # scipy and all: other commands start without
    from seft_ros.tournament.runs import Run
    from seft_ros.tournament.standings import Standing


def tournament(
    config: ConfigArgument,
    method: Annotated[
        Optional[list[str]],
        typer.Option(
            "--method",
            metavar="NAME",
            help="Compensation method; may be given many times; default all.",
        ),
    ] = None,
    mass_ratio: Annotated[
        Optional[list[float]],
        typer.Option(
            "--mass-ratio",
            metavar="ALPHA",
            help="Mass ratio; may be given many times; default CONFIG's.",
        ),
    ] = None,
    rigs: Annotated[
        int, typer.Option("--rigs", min=1, help="Number of rigs, CONFIG's own included.")
    ] = 8,
    spread: Annotated[
        float,
        typer.Option(
            "--spread",
            min=0.0,
            max=1.0,
            help="How far the other rigs are from CONFIG's: 0.2 is up to 20 % in stiffness and "
            "up to twice or half the damping.",
        ),
    ] = 0.1,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of what is drawn for them.")] = 1,
    workers: Annotated[
        Optional[int],
        typer.Option(
            "--workers",
            min=1,
            help="Threads, and processes, that calculate; default one for each core.",
        ),
    ] = None,
    figure: Annotated[
        Optional[Path],
        typer.Option("--figure", metavar="FILE", help="Draw the errors of all tests."),
    ] = None,
    param: OverrideOption = None,
    params_file: ParamsFileOption = None,
    json: JsonOption = False,
) -> int:
    """Run all compensation methods on the same motion and rigs, and rank them.

    The first rig is CONFIG's own. The others differ from it at random in what an experimenter
    does not know exactly: specimen, oil column, valve, dead time, friction, and the noise of the
    sensors. The methods see the same rigs and go on believing CONFIG's model, tracking and delay.
    Errors are those of the displacement against the exact response of each rig's own structure,
    without any shift, as in seft simulate. Results do not depend on the number of workers.

    Tests run in the compiled loop of seft simulate; those of methods that adapt in Python run in
    its plain loop, many times slower. --json has the engine of each, and a note under the tables
    says which they are.

    Methods that need a delay or a model of the force loop find it in what seft identify writes;
    those that lack something are named, and the others go on.

    Examples:

        seft tournament config/jhu.yaml --mass-ratio 0.5 --mass-ratio 1.5

        seft tournament config/jhu.yaml --figure tournament.png

        seft tournament config/jhu.yaml --rigs 30 --spread 0.2 --json

        seft tournament config/jhu.yaml --params-file identified/model.yaml

        seft tournament config/jhu.yaml --method none -p rig:seed:=7
    """
    from seft_ros.drawing.style import check_figure, save_figure
    from seft_ros.tournament.cost import step_cost
    from seft_ros.tournament.entries import make_tournament
    from seft_ros.tournament.figure import tournament_figure
    from seft_ros.tournament.ranking_table import summarise_tournament
    from seft_ros.tournament.runs import count_calculations, run_all
    from seft_ros.tournament.standings import standings
    from seft_ros.tournament.workers import free_cores

    path = check_figure(figure) if figure is not None else None
    experiment = load_experiment(config, param, params_file)
    plan = make_tournament(
        experiment, method or (), mass_ratio or (), rigs=rigs, seed=seed, spread=spread
    )
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: end the workers
    total = count_calculations(plan)
    try:
        with step_progress(total) as show:
            runs = run_all(plan, workers or free_cores(), show)
            show("cost of a step", total)
            costs = {key: step_cost(plan, *key) for key in plan.pairs()}
    except KeyboardInterrupt:
        raise ExperimentError("interrupted; there is no result") from None
    ranked = standings(plan, runs, costs)
    title = f"{config}: {rigs} rigs, spread {100 * spread:g} %, {_motion(experiment)}"
    summary = summarise_tournament(plan, runs, ranked)
    summary |= {"seed": seed, "spread": spread, "figure": None if path is None else str(path)}
    if json:
        print_json(summary)
    else:
        _show(ranked, runs, title)
    if path is not None:
        save_figure(tournament_figure(ranked, runs, title), path)
        if not json:
            print(f"figure: {path}")
    return 0


def _motion(experiment: Experiment) -> str:
    section = experiment["ground_motion"]
    name = Path(section["file"]).name if section["file"] else "synthetic motion"
    return f"{name} at {section['peak_force']:g} N" if section["peak_force"] else name


def _show(standings: list["Standing"], runs: list["Run"], title: str) -> None:
    from rich.console import Console

    from seft_ros.tournament.ranking_table import plain_runs, reasons, standings_table

    console = Console()
    for ratio in dict.fromkeys(row.mass_ratio for row in standings):
        own = [row for row in standings if row.mass_ratio == ratio]
        console.print(standings_table(own, f"{title}, mass ratio {ratio:g}"))
    for reason in [*reasons(standings), *plain_runs(runs)]:
        console.print(reason, soft_wrap=True, highlight=False, markup=False)
