"""``seft paper``: the paper's figures and claims, reproduced.

``seft tournament``: all compensation methods on the same motion and rigs.

``seft uncertainty``: one test on drawn rigs and motions.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Optional

import typer
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError

from seft_ros.cli.options import (
    Config,
    Files,
    Json,
    Params,
    Scheduler,
    Seed,
    Spread,
    Workers,
    load_experiment,
    option,
    show,
    step_progress,
)

if TYPE_CHECKING:
    from seft_ros.ensemble.runs import Place

_LOST = "no result yet; the same command in this folder continues"


def paper(
    config: Optional[Path] = typer.Argument(
        None,
        metavar="[CONFIG]",
        help="Experiment: a ROS 2 parameter file; default the paper's rig, config/jhu.yaml, as "
        "installed.",
        show_default=False,
    ),
    file: Optional[Path] = option(
        None,
        "Record: PEER AT2, columns or csv. The paper's is Kobe 1995, JMA N-S. Default: "
        "CONFIG's motion, which is synthetic.",
        "MOTION",
    ),
    unit: Optional[str] = option(None, "g, m/s2 or cm/s2, if the file does not say."),
    dt: Optional[float] = option(None, "Sampling period in s, if the file has none."),
    column: Optional[int] = option(
        None, "Column of the file, from 0; default the first that is not the time."
    ),
    out: Path = option(Path("paper.html"), "The page.", "HTML"),
    workers: Workers = None,
    param: Params = None,
    params_file: Files = None,
    json: Json = False,
) -> int:
    """Reproduce the figures and claims of the paper (Nakata & Combs 2012) on one page.

    Identifies the simulated rig, runs the paper's tests and simulations, and judges every number
    and statement by a criterion that the page shows. Results do not depend on the number of
    workers.

    Exit status 0: the page was made. A claim that does not agree is a finding, not a failure; it
    is shown as such. 1: interrupted, or the rig can't be identified. 2: wrong input.

    Examples:

        seft paper

        seft paper --file kobe.txt --unit cm/s2 --dt 0.005 --out kobe.html

        seft paper --json -p rig:actuator.valve_frequency:=50.0
    """
    from seft_ros.drawing.page import check_page
    from seft_ros.ensemble.workers import free_cores
    from seft_ros.paper.claims import (
        claims_table,
        judge_claims,
        summarise_paper,
    )
    from seft_ros.paper.findings import CALCULATIONS, find
    from seft_ros.paper.paper_page import write_paper
    from seft_ros.paper.paper_tests import (
        check_rig,
        default_config,
    )

    path = check_page(out)
    given = {"unit": unit, "dt": dt, "column": column}
    experiment = load_experiment(config or default_config(), param, params_file)
    experiment = _with_motion(experiment, file, given)
    check_rig(experiment)
    with step_progress(CALCULATIONS, "there is no page") as progress:
        found = find(experiment, workers or free_cores(), progress)
    claims = judge_claims(found)
    name = "the paper's rig" if config is None else str(config)
    write_paper(found, claims, name, path)
    summary = summarise_paper(found, claims, path)
    agreed = f"{summary['agree']} of {len(claims)} claims agree"
    table = claims_table(claims, f"{name} under {Path(found.source).name}: {agreed}")
    show(summary, json, [table], "page")
    return 0


def _with_motion(experiment: Experiment, file: Path | None, given: dict[str, Any]) -> Experiment:
    """Put the record of the command line in the place of the experiment's own."""
    from seft_ros.ground_motion.ground_motion_block import TABLE
    from seft_ros.paper.paper_tests import changed

    words = {name: value for name, value in given.items() if value is not None}
    if file is None:
        if words and not experiment["ground_motion"]["file"]:
            raise InputError(f"--{next(iter(words))}: needs a record; name one by --file")
        section = words
    else:
        own = {name: TABLE.rows[name].default for name in given}
        section = {"file": str(file), **own, **words}
    return changed(experiment, {"ground_motion": TABLE.check(section, "seft paper")})


def tournament(
    config: Config,
    method: Optional[list[str]] = option(
        None, "Compensation method; may be given many times; default all.", "NAME"
    ),
    mass_ratio: Optional[list[float]] = option(
        None, "Mass ratio; may be given many times; default CONFIG's.", "ALPHA"
    ),
    rigs: int = option(8, "Number of rigs, CONFIG's own included.", min=1),
    spread: Spread = 0.1,
    seed: Seed = 1,
    workers: Workers = None,
    scheduler: Scheduler = "",
    figure: Optional[Path] = option(None, "Draw the errors of all tests.", "FILE"),
    param: Params = None,
    params_file: Files = None,
    json: Json = False,
) -> int:
    """Run all compensation methods on the same motion and rigs, and rank them.

    The first rig is CONFIG's own. The others differ from it at random in what an experimenter does
    not know exactly: specimen, oil column, valve, dead time, friction, and the noise of the
    sensors. The methods meet the same rigs, and assume CONFIG's model, tracking and delay. Errors
    are those of the displacement against the exact response of each rig's own structure, without
    any shift, as in seft simulate. Results do not depend on the number or kind of workers. After an
    interruption the same command in the same folder continues.

    Tests run in the compiled loop of seft simulate; those of methods that adapt in Python run in
    its plain loop, many times slower. A note under the tables names them; --json has the engine of
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
    from seft_ros.ensemble.entries import make_tournament
    from seft_ros.ensemble.runs import run_tests
    from seft_ros.ensemble.standings import (
        notes,
        standings,
        standings_table,
        summarise_tournament,
        tournament_figure,
    )

    path = check_figure(figure) if figure is not None else None
    experiment = load_experiment(config, param, params_file)
    plan = make_tournament(
        experiment, method or (), mass_ratio or (), rigs=rigs, seed=seed, spread=spread
    )
    with step_progress(len(plan.entries()), _LOST) as progress:
        runs = run_tests(plan.tests(), _place(workers, scheduler), progress, "tournament")
    ranked = standings(plan, runs)
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


def uncertainty(
    config: Config,
    tests: int = option(200, "Number of drawn tests.", min=2),
    spread: Spread = 0.1,
    motion: Optional[list[Path]] = option(
        None,
        "Ground motion; may be given many times: each test takes one at random. Default CONFIG's; "
        "a synthetic one is another in each test.",
        "FILE",
    ),
    seed: Seed = 1,
    out: Path = option(Path("uncertainty.html"), "The page.", "HTML"),
    workers: Workers = None,
    scheduler: Scheduler = "",
    param: Params = None,
    params_file: Files = None,
    json: Json = False,
) -> int:
    """Show how large the error of a planned test may be, and what it depends on.

    Simulates the test on rigs, specimens and ground motions that differ at random from CONFIG's, as
    the rigs of seft tournament do, while methods and controller assume CONFIG. Errors are
    against the exact response of each rig's own structure, without any shift.

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
    from seft_ros.ensemble.runs import run_tests
    from seft_ros.ensemble.uncertainty import (
        draw_tests,
        headline,
        summarise_uncertainty,
        uncertainty_tables,
        write_uncertainty,
    )

    path = check_page(out)
    experiment = load_experiment(config, param, params_file)
    files = [str(file.resolve()) for file in motion or ()]
    plan = draw_tests(experiment, tests, seed=seed, spread=spread, motions=files)
    with step_progress(1 + tests, _LOST) as progress:
        runs = run_tests(plan.tests(), _place(workers, scheduler), progress, "uncertainty")
    summary = summarise_uncertainty(plan, runs)
    title = f"{tests} tests, spread {100 * spread:g} %, seed {seed}"
    write_uncertainty(summary, plan, runs, config.name, title, path)
    summary |= {"seed": seed, "spread": spread, "page": str(path)}
    tables = uncertainty_tables(summary, f"{config}: {title}")
    show(summary, json, [*tables, f"{headline(summary)}.", ""], "page")
    return 0


def _place(workers: int | None, scheduler: str) -> "Place":
    """Where tests are run; those that are finished are kept in the current folder."""
    from seft_ros.ensemble.runs import Place
    from seft_ros.ensemble.workers import free_cores

    return Place(workers or free_cores(), scheduler, Path())
