"""``seft tournament``: all compensation methods on the same motion and rigs.

``seft uncertainty``: one test on drawn rigs and motions.
"""

from itertools import groupby
from pathlib import Path
from typing import Optional

from seft_ros.cli import shared
from seft_ros.cli.shared import option

_LOST = "no result yet; the same command in this folder continues"


def tournament(
    config: shared.Config,
    method: Optional[list[str]] = option(None, "Method; may be repeated; default all.", "NAME"),
    mass_ratio: Optional[list[float]] = option(None, "Mass ratio; may be repeated.", "ALPHA"),
    rigs: int = option(8, "Number of rigs, CONFIG's own included.", min=1),
    spread: shared.Spread = 0.1,
    seed: shared.Seed = 1,
    workers: shared.Workers = shared.CORES,
    scheduler: shared.Scheduler = "",
    figure: Optional[Path] = option(None, "Draw the errors of all tests.", "FILE"),
    param: shared.Params = None,
    params_file: shared.Files = None,
    json: shared.Json = False,
) -> int:
    """Run all compensation methods on the same motion and rigs, and rank them.

    --method takes some of them, --mass-ratio replaces CONFIG's; both may be repeated. --spread is
    the largest relative deviation of a rig: 0.2 is 20 % in stiffness, and twice or half the
    damping. The workers of a cluster need the same seft.

    The first rig is CONFIG's own. The others differ from it at random in what an experimenter does
    not know exactly: specimen, oil column, valve, dead time, friction, and the noise of the
    sensors. The methods meet the same rigs, and assume CONFIG's model, tracking and delay. Errors
    are those of the displacement against the exact response of each rig's own structure, without
    any shift, as in seft simulate. Results do not depend on the number or kind of workers. After an
    interruption the same command in the same folder continues.

    Tests are simulated in compiled code; those of methods that adapt in Python are simulated
    uncompiled, many times slower. A note under the tables names them; --json has the engine of
    each.

    Methods that need a delay or a model of the force loop take it from what seft identify writes.
    Methods that lack something are named, and the others run.

    Examples:

        seft tournament config/jhu.yaml --mass-ratio 0.5 --mass-ratio 1.5

        seft tournament config/jhu.yaml --figure tournament.png

        seft tournament config/jhu.yaml --rigs 30 --spread 0.2 --json

        seft tournament config/jhu.yaml --params-file identified/model.yaml

        seft tournament config/jhu.yaml --method none -p rig:seed:=7

        seft tournament config/jhu.yaml --rigs 99 --scheduler tcp://host:8786
    """
    from seft_ros.drawing.style import check_figure, save_figure
    from seft_ros.ensemble import standings
    from seft_ros.ensemble.entries import make_tournament
    from seft_ros.ensemble.runs import Place, run_tests

    path = check_figure(figure) if figure is not None else None
    experiment = shared.load_experiment(config, param, params_file)
    plan = make_tournament(
        experiment, method or (), mass_ratio or (), rigs=rigs, seed=seed, spread=spread
    )
    with shared.step_progress(len(plan.entries()), _LOST) as progress:
        place = Place(workers, scheduler, Path())  # which keeps finished tests
        runs = run_tests(plan.tests(), place, progress, "tournament")
    ranked = standings.standings(plan, runs)
    section = experiment["ground_motion"]
    motion = Path(section["file"]).name or "synthetic motion"
    if section["peak_force"]:
        motion += f" at {section['peak_force']:g} N"
    title = f"{config}: {rigs} rigs, spread {100 * spread:g} %, {motion}"
    if path is not None:
        save_figure(standings.tournament_figure(ranked, runs, title), path)
    summary = standings.summarise_tournament(plan, runs, ranked)
    summary |= {"seed": seed, "spread": spread, "figure": None if path is None else str(path)}
    tables = [
        standings.standings_table([*rows], f"{title}, mass ratio {ratio:g}")
        for ratio, rows in groupby(ranked, key=lambda row: row.mass_ratio)
    ]
    shared.show(summary, json, [*tables, *standings.notes(ranked, runs)], "figure")
    return 0


def uncertainty(
    config: shared.Config,
    tests: int = option(200, "Number of drawn tests.", min=2),
    spread: shared.Spread = 0.1,
    motion: Optional[list[Path]] = option(None, "Ground motion; may be repeated.", "FILE"),
    seed: shared.Seed = 1,
    out: Path = option(Path("uncertainty.html"), "The page.", "HTML"),
    workers: shared.Workers = shared.CORES,
    scheduler: shared.Scheduler = "",
    param: shared.Params = None,
    params_file: shared.Files = None,
    json: shared.Json = False,
) -> int:
    """Show how large the error of a planned test may be, and what it depends on.

    Simulates the test on rigs, specimens and ground motions that differ at random from CONFIG's, as
    the rigs of seft tournament do, while methods and controller assume CONFIG. With --spread 0.2
    stiffness and amplitude of the ground motion differ by up to 20 %, and damping is up to twice as
    large, or half. Each test takes one of the motions at random; the default is CONFIG's, and a
    synthetic one is another in each test. Errors are against the exact response of each rig's own
    structure, without any shift.

    The page shows the distribution of the error, the share of tests that trip, and the rank
    correlation of each drawn quantity with the error. --json has every test.

    Results do not depend on the number or kind of workers. After an interruption the same command
    in the same folder continues.

    Exit status 0: the page was made. 1: interrupted. 2: wrong input.

    Examples:

        seft uncertainty config/demo.yaml

        seft uncertainty config/demo.yaml --spread 0.2 --out wide.html

        seft uncertainty config/demo.yaml --motion kobe.AT2 --motion NIS090.AT2

        seft uncertainty config/jhu.yaml --scheduler tcp://host:8786
    """
    from seft_ros.drawing.page import check_page
    from seft_ros.ensemble import uncertainty as drawn
    from seft_ros.ensemble.runs import Place, run_tests

    path = check_page(out)
    experiment = shared.load_experiment(config, param, params_file)
    files = [str(file.resolve()) for file in motion or ()]
    plan = drawn.draw_tests(experiment, tests, seed=seed, spread=spread, motions=files)
    with shared.step_progress(1 + tests, _LOST) as progress:
        place = Place(workers, scheduler, Path())  # which keeps finished tests
        runs = run_tests(plan.tests(), place, progress, "uncertainty")
    summary = drawn.summarise_uncertainty(plan, runs)
    title = f"{tests} tests, spread {100 * spread:g} %, seed {seed}"
    drawn.write_uncertainty(summary, plan, runs, config.name, title, path)
    summary |= {"seed": seed, "spread": spread, "page": str(path)}
    tables = drawn.uncertainty_tables(summary, f"{config}: {title}")
    shared.show(summary, json, [*tables, f"{drawn.headline(summary)}.", ""], "page")
    return 0
