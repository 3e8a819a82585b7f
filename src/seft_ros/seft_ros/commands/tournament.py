"""``seft tournament``: all compensation methods on the same motion and rigs."""

from pathlib import Path
from typing import Annotated, Optional

from seft_ros.commands.options import Config, Files, Json, Params, load_experiment, option
from seft_ros.commands.output import show, step_progress


def tournament(
    config: Config,
    method: Annotated[
        Optional[list[str]],
        option("Compensation method; may be given many times; default all.", "NAME"),
    ] = None,
    mass_ratio: Annotated[
        Optional[list[float]],
        option("Mass ratio; may be given many times; default CONFIG's.", "ALPHA"),
    ] = None,
    rigs: Annotated[int, option("Number of rigs, CONFIG's own included.", min=1)] = 8,
    spread: Annotated[
        float,
        option(
            "How far the other rigs are from CONFIG's: 0.2 is up to 20 % in stiffness and "
            "up to twice or half the damping.",
            min=0.0,
            max=1.0,
        ),
    ] = 0.1,
    seed: Annotated[int, option("Of what is drawn for them.", min=0)] = 1,
    workers: Annotated[
        Optional[int],
        option("Threads, and processes, that calculate; default one for each core.", min=1),
    ] = None,
    figure: Annotated[Optional[Path], option("Draw the errors of all tests.", "FILE")] = None,
    param: Params = None,
    params_file: Files = None,
    json: Json = False,
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
    from seft_ros.tournament.entries import make_tournament
    from seft_ros.tournament.runs import count_calculations, run_all, step_cost
    from seft_ros.tournament.standings import (
        notes,
        standings,
        standings_table,
        summarise_tournament,
        tournament_figure,
    )
    from seft_ros.tournament.workers import free_cores

    path = check_figure(figure) if figure is not None else None
    experiment = load_experiment(config, param, params_file)
    plan = make_tournament(
        experiment, method or (), mass_ratio or (), rigs=rigs, seed=seed, spread=spread
    )
    total = count_calculations(plan)
    with step_progress(total, "there is no result") as tell:
        runs = run_all(plan, workers or free_cores(), tell)
        tell("cost of a step", total)
        costs = {key: step_cost(plan, *key) for key in plan.pairs()}
    ranked = standings(plan, runs, costs)
    section = experiment["ground_motion"]
    motion = Path(section["file"]).name or "synthetic motion"
    if section["peak_force"]:
        motion += f" at {section['peak_force']:g} N"
    title = f"{config}: {rigs} rigs, spread {100 * spread:g} %, {motion}"
    if path is not None:
        save_figure(tournament_figure(ranked, runs, title), path)
    summary = summarise_tournament(plan, runs, ranked)
    summary |= {"seed": seed, "spread": spread, "figure": None if path is None else str(path)}
    by_ratio = {
        row.mass_ratio: [one for one in ranked if one.mass_ratio == row.mass_ratio]
        for row in ranked
    }
    tables = [
        standings_table(own, f"{title}, mass ratio {ratio:g}") for ratio, own in by_ratio.items()
    ]
    show(summary, json, [*tables, *notes(ranked, runs)], "figure")
    return 0
