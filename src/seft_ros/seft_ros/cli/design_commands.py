"""``seft preflight``: stability and delay margins before anything moves; ``seft study``."""

import os
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Optional

from seft_msgs_py.errors import InputError
from seft_plant_sim.rig_parameters import as_simulated

from seft_ros.cli import shared
from seft_ros.cli.shared import option


def preflight(
    config: shared.Config,
    param: shared.Params = None,
    params_file: shared.Files = None,
    external: shared.External = None,
    figure: Optional[Path] = option(None, "Draw where the test would be stable.", "FILE"),
    write: Optional[Path] = option(None, "Write limits that fit, for --params-file.", "FILE"),
    json: shared.Json = False,
) -> int:
    """Check whether a planned test is stable, and with which margins; nothing moves.

    Takes the eigenvalues of the sampled closed loop of rig, compensation and force controller:
    critical mass ratio, critical delay, margins against a wrong gain and a wrong delay, and the
    false damping that the test will show; and sweeps the specimen's local stiffness from 0 to 3
    times the assumed one. Exact where the loop is linear; the table says what that excludes.
    --figure draws where the test would be stable: mass ratio against dead time, and against the
    specimen's local stiffness; and writes the margins below, with a mark where they decide.

    If a method or controller of your own has no linear(), the planned test is simulated instead.

    The exact response of the planned test gives the peaks to expect, and limits that fit them.
    It warns where a peak is beyond a limit, the stroke, the force capacity or the flow of the valve
    under load, which seft run refuses, and where the assumed mass does not fit. A specimen whose
    stiffness or mass seems to be in another unit is refused.

    A computed model enters the loop with its tangent at rest. Its steps are timed along the
    motion of the planned test.

    Exit status 1: the planned test is unstable, uses too little or too much of a sensor's range, or
    its computed model is too slow.

    Examples:

        seft preflight config/demo.yaml -p reference_force:mass_ratio:=3.0

        seft preflight config/demo.yaml --figure preflight.png

        seft preflight config/jhu.yaml --write limits.yaml

        seft preflight config/jhu.yaml --params-file identified/model.yaml
    """
    # beyond 60 lines: its options and its help; what it shows follows in order
    from seft_ros.design import plausibility, preflight_tables, stability_map, stability_verdict
    from seft_ros.design.planned_tests import PlannedTest
    from seft_ros.drawing.style import check_figure, json_safe, save_figure
    from seft_ros.reference_force.compensator import NotLinearError
    from seft_ros.study.unforeseen import yielding_error

    path = check_figure(figure) if figure is not None else None
    experiment = shared.load_experiment(config, param, params_file, external)
    motion = preflight_tables.planned_motion(experiment)
    response = plausibility.expected_response(experiment, motion)
    by_axis = plausibility.peaks_of(response)
    if wrong := plausibility.unit_refusal(experiment, motion, by_axis):
        raise InputError(wrong)
    unfit = [*filter(None, [plausibility.range_refusal(experiment, by_axis)])]
    beyond = plausibility.excesses(experiment, response)
    warnings = [plausibility.excess_text([excess]) for excess in beyond]
    peaks = preflight_tables.expected_peaks(by_axis)
    highest = plausibility.highest_limits(experiment, by_axis)
    limits = preflight_tables.proposed_limits(peaks, highest)
    try:
        test = PlannedTest(experiment)
        with shared.step_progress(passing=True) as progress:
            found = stability_verdict.check_stability(test, progress)
    except NotLinearError as error:
        if figure is not None:
            raise InputError(f"{error}; --figure can't draw them") from None
        if write is not None:
            preflight_tables.write_limits(write, limits)
        recording = shared.simulated_instead(experiment, error)
        stable = recording is None or shared.show_test(recording, None, as_json=json, figure=False)
        _say(warnings, unfit)
        return 0 if stable and not unfit else 1
    with shared.step_progress(passing=True) as progress:
        summary = preflight_tables.summarise_preflight(test, found)
        summary |= {"expected_peaks": peaks, "proposed_limits": limits}
        timed = preflight_tables.model_time(experiment, motion)
        if timed is not None:
            summary["model"] = asdict(timed)
            unfit += [timed.refusal()] if timed.refusal() else []
        summary["unfit"] = unfit
        if fast := stability_verdict.folded(test):
            warnings.append(fast)
        yielding = None if beyond else yielding_error(experiment, response)
        summary["yielding_error"] = yielding and json_safe(asdict(yielding))
        if yielding is not None and (slow := yielding.warning()):
            warnings.append(slow)
        summary["warnings"] = warnings
        if write is not None:
            preflight_tables.write_limits(write, limits)
            shared.stands(f"{write} is written")
        if path is not None:
            maps = stability_map.stability_maps(test, found.margins, progress)
            save_figure(stability_map.preflight_figure(test, found, maps), path)
            summary["figure"] = str(path)
    lines = ["", *(timed.texts() if timed else [])]
    if yielding is not None and not yielding.warning():
        lines.append(str(yielding))
    texts = preflight_tables.preflight_texts(found, f"preflight of {config}")
    limits_table = preflight_tables.limits_table(experiment, peaks, limits)
    shared.show(summary, json, [*texts, limits_table, *lines], "figure")
    _say(warnings, [*(f"{found.verdict}: {reason}" for reason in found.reasons), *unfit])
    return 1 if found.verdict == "unstable" or unfit else 0


def _say(warnings: Iterable[str], reasons: Iterable[str]) -> None:
    for warning in warnings:
        shared.warn(warning)
    for reason in reasons:
        shared.complain(reason)


_CORES = len(os.sched_getaffinity(0))
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
    spread: float = option(0.1, "Largest deviation from CONFIG.", min=0.0, max=1.0),
    motion: Optional[list[Path]] = option(
        None, "Ground motion; may be repeated; default CONFIG's.", "FILE"
    ),
    seed: int = option(1, "Seed of the draws.", min=0),
    out: Path = option(Path("study.html"), "The page.", "HTML"),
    workers: int = option(_CORES, "Processes that calculate.", min=1),
    scheduler: str = option("", "Calculate on this Dask cluster, as tcp://host:8786.", "ADDRESS"),
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
    # beyond 60 lines: its options and its help
    from seft_ros.drawing.page import check_page
    from seft_ros.study import study_page as page
    from seft_ros.study.drawn_tests import design_study, draw_tests
    from seft_ros.study.study_results import summarise_study, worst_folder, write_worst_tests
    from seft_ros.study.study_runs import FinishedTests, run_study

    path = check_page(out)
    folder = worst_folder(path)
    experiment = as_simulated(shared.load_experiment(config, param, params_file))
    files = [os.path.realpath(file) for file in motion or ()]
    drawn = draw_tests(experiment, tests, seed=seed, spread=spread, motions=files)
    design = design_study(experiment, drawn, method or (), mass_ratio or ())
    finished = FinishedTests(design, Path())
    with shared.step_progress(len(design.tests()), _LOST) as progress:
        runs = run_study(design, progress, workers=workers, scheduler=scheduler, finished=finished)
    summary = summarise_study(design, runs)
    write_worst_tests(design, summary, folder)
    title = f"{tests} tests, spread {100 * spread:g} %, seed {seed}"
    page.write_study(summary, f"Study of {config.name}", title, path)
    finished.remove()
    texts = page.study_texts(summary, f"{config}: {title}")
    shared.show(summary | {"page": str(path)}, json, texts, "page")
    return 0
