"""``seft study``: compensation methods on the same drawn rigs, specimens and motions."""

import os
from pathlib import Path
from typing import Optional

from seft_ros.cli import shared
from seft_ros.cli.shared import option

_LOST = "no result yet; the same command in this folder continues"


def study(
    config: shared.Config,
    method: Optional[list[str]] = option(
        None, "Compensation method; may be repeated; all: every one; default CONFIG's.", "NAME"
    ),
    mass_ratio: Optional[list[float]] = option(
        None, "Mass ratio; may be repeated; default CONFIG's.", "ALPHA"
    ),
    tests: int = option(200, "Number of drawn tests.", min=2),
    spread: shared.Spread = 0.1,
    motion: Optional[list[Path]] = option(
        None, "Ground motion; may be repeated; default CONFIG's.", "FILE"
    ),
    seed: shared.Seed = 1,
    out: Path = option(Path("study.html"), "The page.", "HTML"),
    workers: shared.Workers = shared.CORES,
    scheduler: shared.SchedulerOption = "",
    param: shared.Params = None,
    params_file: shared.Files = None,
    json: shared.Json = False,
) -> int:
    """Show how large the error of a planned test may be, with which method, and what it depends on.

    Simulates the test as configured (test 0), and on rigs, specimens and ground motions that differ
    from CONFIG's at random, while methods and controller assume CONFIG. With --spread 0.2 stiffness
    and amplitude of the ground motion differ by up to 20 %, and damping is up to twice as large, or
    half. Each test takes one of the motions at random; a synthetic one is another in each test. All
    methods and mass ratios meet the same tests. Errors are against the exact response of each rig's
    own structure, without any shift.

    The page shows the distribution of the error, the share of tests that trip, the rank correlation
    of each drawn quantity with the error, and the worst tests. A folder with the name of the page
    has their parameter files, with which seft simulate repeats them. --json has every test.

    Methods that lack something, such as a delay that seft identify finds, are named, and the others
    run. Results do not depend on the number or kind of workers. After an interruption the same
    command in the same folder continues, also with more tests or methods.

    Exit status 0: the page was made. 1: interrupted. 2: wrong input.

    Examples:

        seft study config/demo.yaml

        seft study config/demo.yaml --spread 0.2 --out wide.html

        seft study config/demo.yaml --motion kobe.AT2 --motion NIS090.AT2

        seft study config/jhu.yaml --method none --method restoring

        seft study config/jhu.yaml --method all --params-file model.yaml

        seft study config/jhu.yaml --scheduler tcp://host:8786
    """
    from seft_ros.drawing.page import check_page
    from seft_ros.study import study_page as page
    from seft_ros.study.drawn_tests import draw_tests
    from seft_ros.study.finished_tests import FinishedTests
    from seft_ros.study.study_plan import plan_study
    from seft_ros.study.study_results import summarise_study
    from seft_ros.study.study_runs import run_study
    from seft_ros.study.worst_tests import worst_folder, write_worst_tests

    path = check_page(out)
    folder = worst_folder(path)
    experiment = shared.load_experiment(config, param, params_file)
    files = [os.path.realpath(file) for file in motion or ()]
    drawn = draw_tests(experiment, tests, seed=seed, spread=spread, motions=files)
    plan = plan_study(experiment, drawn, method or (), mass_ratio or ())
    finished = FinishedTests(plan, Path())
    with shared.step_progress(len(plan.tests()), _LOST) as progress:
        runs = run_study(plan, progress, workers=workers, scheduler=scheduler, finished=finished)
    summary = summarise_study(plan, runs)
    write_worst_tests(plan, summary, folder)
    title = f"{tests} tests, spread {100 * spread:g} %, seed {seed}"
    page.write_study(summary, f"Study of {config.name}", title, path)
    finished.remove()
    texts = page.study_texts(summary, f"{config}: {title}")
    shared.show(summary | {"page": str(path)}, json, texts, "page")
    return 0
