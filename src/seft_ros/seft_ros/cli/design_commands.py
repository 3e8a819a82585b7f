"""``seft preflight``: stability and delay margins before anything moves.

``seft identify``: the rig.
"""

import math
import os
from dataclasses import asdict, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Optional

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError

from seft_ros.bags.record import Record
from seft_ros.cli import shared
from seft_ros.cli.shared import option
from seft_ros.drawing.table import Texts


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
    specimen's local stiffness.

    If a method or controller of your own has no linear(), the planned test is simulated instead.

    The exact response of the planned test gives the peaks to expect, and limits that fit them.
    It warns where the assumed mass, or the flow of the valves, does not fit. A specimen whose
    stiffness or mass seems to be in another unit is refused.

    A computed model enters the loop with its tangent at rest. Its steps are timed along the
    motion of the planned test.

    Exit status 1: the plan is unstable, uses too little or too much of a sensor's range, or its
    computed model is too slow.

    Examples:

        seft preflight config/demo.yaml -p reference_force:mass_ratio:=3.0

        seft preflight config/demo.yaml --figure preflight.png

        seft preflight config/jhu.yaml --write limits.yaml

        seft preflight config/jhu.yaml --params-file identified/model.yaml
    """
    from seft_ros.design import plausibility, preflight_tables, stability_map, stability_verdict
    from seft_ros.design.plan import Plan
    from seft_ros.drawing.style import check_figure, save_figure
    from seft_ros.reference_force.compensator import NotLinearError

    path = check_figure(figure) if figure is not None else None
    experiment = shared.load_experiment(config, param, params_file, external)
    motion = preflight_tables.planned_motion(experiment)
    with shared.passing_progress():
        by_axis = plausibility.peaks_by_axis(experiment, motion)
        peaks = preflight_tables.expected_peaks(by_axis)
        mixed_up = plausibility.unit_refusal(experiment, motion, by_axis)
    if wrong := mixed_up or plausibility.mass_refusal(experiment):
        raise InputError(wrong)
    unfit = [*filter(None, [plausibility.range_refusal(experiment, by_axis)])]
    try:
        plan = Plan(experiment)
        with shared.passing_progress() as progress:
            found = stability_verdict.check_stability(plan, progress)
    except NotLinearError as error:
        if figure is not None:
            raise InputError(f"{error}; --figure can't draw them") from None
        if write is not None:
            preflight_tables.write_limits(write, preflight_tables.proposed_limits(peaks))
        stable = shared.is_stable_in_simulation(experiment, error, as_json=json)
        for reason in unfit:
            shared.complain(reason)
        return 0 if stable and not unfit else 1
    with shared.passing_progress() as progress:
        summary = preflight_tables.summarise_preflight(plan, found)
        limits = preflight_tables.proposed_limits(peaks)
        summary |= {"expected_peaks": peaks, "proposed_limits": limits}
        timed = preflight_tables.model_time(experiment, motion)
        if timed is not None:
            summary["model"] = asdict(timed)
            unfit += [timed.refusal()] if timed.refusal() else []
        summary["unfit"] = unfit
        warnings = list(preflight_tables.mismatches(experiment, peaks))
        summary["warnings"] = warnings
        if write is not None:
            preflight_tables.write_limits(write, limits)
            shared.stands(f"{write} is written")
        if path is not None:
            maps = stability_map.stability_maps(plan, found.margins, progress)
            save_figure(stability_map.preflight_figure(plan, found, maps), path)
            summary["figure"] = str(path)
    lines = [""]
    if timed is not None:
        lines += [
            f"computed model: {1e3 * timed.median_s:.2g} ms for a step, "
            f"{1e3 * timed.p999_s:.2g} ms for one of 1000, {1e3 * timed.longest_s:.2g} ms for the "
            f"longest, of {1e3 * timed.budget_s:.2g} ms",
            "the margins above take its tangent at rest",
        ]
    texts = preflight_tables.preflight_texts(plan, found, f"preflight of {config}")
    limits_table = preflight_tables.limits_table(experiment, peaks)
    shared.show(summary, json, [*texts, limits_table, *lines], "figure")
    for warning in warnings:
        shared.warn(warning)
    for reason in found.reasons:
        shared.complain(f"{found.verdict}: {reason}")
    for reason in unfit:
        shared.complain(reason)
    return 1 if found.verdict == "unstable" or unfit else 0


PILOT, OPEN_LOOP, CLOSED_LOOP = "pilot", "open_loop", "closed_loop"
_BY_RATE = (math.nan, math.nan)


def identify(
    config: shared.Config,
    param: shared.Params = None,
    params_file: shared.Files = None,
    over_dds: bool = option(False, "Run nodes over DDS, or one process.", "--over-dds/--offline"),
    external: shared.External = None,
    seed: int = option(1, "Seed of the excitation, Gaussian noise.", min=0),
    band: tuple[float, float] = option(
        _BY_RATE, "Band of the excitation in Hz; default by the rate.", "LO HI", show_default=False
    ),
    duration: float = option(120.0, "Duration of each test in s.", "S"),
    amplitude: Optional[float] = option(None, "RMS of the valve drive, open loop.", "V"),
    force: Optional[float] = option(None, "RMS of the reference force, closed loop.", "N"),
    out: Optional[Path] = option(None, "New folder of the results; default by the time.", "DIR"),
    specimen: bool = option(False, "Write the specimen to model.yaml, too.", "--specimen"),
    json: shared.Json = False,
) -> int:
    """Identify a rig: its actuators, and its force loop with this specimen.

    Runs ordinary tests, with all limits, and records each. The band of the excitation is 0.3 Hz to
    0.45 times the rate, 200 Hz at most, unless --band names another.

    Open loop: the excitation drives the valves, and force_controller's feedback is off. A short
    pilot test at a low level finds the amplitude, so that the rig uses up to a fifth of its
    limits; --amplitude gives it instead. The result describes the actuators, which
    velocity_feedforward needs. It holds for any specimen.

    Closed loop: the excitation is the reference force, where the force controller follows one. Its
    RMS is 5 m/s^2 times the mass, a 20th of the force limit at most, unless --force gives
    another. The result describes the force loop with this specimen, which the other
    methods need. Rigs without a valve (actuator.kind ideal or delay) have this test only.

    The folder then holds the excitation, the bags, a figure, and model.yaml: parameters of
    reference_force and force_controller for --params-file. With --specimen they include mass,
    damping and stiffness of the specimen, as reference_force's model.*.

    Examples:

        seft identify config/jhu.yaml --out identified

        seft simulate config/jhu.yaml --params-file identified/model.yaml

        seft identify config/jhu.yaml --over-dds -p rig:pace:=lockstep --json

        seft identify config/lab.yaml --external rig --duration 300
    """
    from seft_ros.design import identified, rig_tests
    from seft_ros.design.identified_figure import identified_figure
    from seft_ros.drawing.style import save_figure
    from seft_ros.reference_force.force_command import FORCE_DRIVEN

    if set(external or ()) - {"rig"}:
        raise InputError(
            "--external: only the rig may be external; the other nodes are set up here"
        )
    experiment = shared.load_experiment(config, param, params_file, external)
    levels = rig_tests.Levels(
        rig_tests.pilot_voltage(experiment) if amplitude is None else amplitude,
        rig_tests.default_force(experiment) if force is None else force,
    )
    rig_tests.check_levels(experiment, levels)
    if all(map(math.isnan, band)):
        band = (0.3, min(0.45 * experiment.timebase.rate, 200.0))
    folder = out or Path(datetime.now().strftime("identify_%Y-%m-%d_%H-%M-%S"))
    motions = rig_tests.Motions(experiment, levels.force, band, seed)
    motions.check(duration)
    shared.check_out(folder)
    record = motions.write(folder / "excitation.csv", duration)
    shared.stands(f"{folder} has the excitation")

    tests: dict[str, Record] = {}

    def done(name: str, test: Experiment, seconds: float) -> bool:
        """Run a test; say whether it drove a valve, to its end."""
        bag, label = folder / name, f"{name}: "
        if over_dds or external:
            steps = motions.steps(seconds)
            tests[name] = shared.dds_test(test, bag, steps, external or (), label=label)[0]
        else:
            tests[name] = shared.offline_test(test, bag, label)
        return tests[name].trip is None and rig_tests.has_valve(tests[name].experiment)

    valve = rig_tests.has_valve(experiment)
    if valve and amplitude is None:
        seconds = min(duration, max(rig_tests.PILOT_DURATION, motions.shortest))
        short = motions.write(folder / f"{PILOT}.csv", seconds)
        valve = done(PILOT, rig_tests.open_loop(experiment, short, levels), seconds)
        if valve:
            voltage = rig_tests.voltage_after(tests[PILOT], levels.voltage)
            levels = replace(levels, voltage=voltage)
    if valve:
        valve = done(OPEN_LOOP, rig_tests.open_loop(experiment, record, levels), duration)
    followed = rig_tests.has_force_loop(experiment) or not valve
    if followed and not any(test.trip for test in tests.values()):
        done(CLOSED_LOOP, rig_tests.closed_loop_test(experiment, record), duration)

    whole = {name: test for name, test in tests.items() if test.trip is None and name != PILOT}
    if not valve:
        whole.pop(OPEN_LOOP, None)  # only now an external rig has reported that it has none
    files = {"folder": folder, "excitation": record, **{name: folder / name for name in tests}}
    trips = {name: test.trip.reason if test.trip else None for name, test in tests.items()}
    summary: dict[str, Any] = {
        "tripped": {OPEN_LOOP: None, CLOSED_LOOP: None, **trips},
        "excitation_rms": asdict(levels),
    }
    texts: Texts = []
    unusable: list[str] = []
    if whole:
        found = identified.identify_from_records(whole.get(OPEN_LOOP), whole.get(CLOSED_LOOP), band)
        unusable = found.unusable
        summary |= identified.summarise_identified(found)
        table = identified.identified_table(summary)
        texts = [f"{config} as identified", table, *summary["notes"]]
        files |= {"model": folder / "model.yaml", "figure": folder / shared.FIGURE}
        loop = experiment["reference_force"]
        lags = loop["compensation.sensor_lag"], loop["compensation.actuator_kind"] in FORCE_DRIVEN
        identified.write_model(found, files["model"], str(config), specimen, *lags)
        save_figure(identified_figure(found, f"seft identify {config}"), files["figure"])
    summary["files"] = {what: str(path) for what, path in files.items()}
    shared.show(
        summary, json, [*texts, *(f"{what + ':':13}{path}" for what, path in files.items())]
    )
    for name, test in tests.items():
        if test.trip is not None:
            at = f"{name.replace('_', ' ')} tripped at {test.trip.time_s:.3f} s"
            shared.complain(f"{at}: {test.trip.reason}; its bag is in {folder / name}")
            return 1
    if unusable:
        shared.complain(unusable[0])
        return 1
    return 0


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
    from seft_ros.drawing.page import check_page
    from seft_ros.study import study_page as page
    from seft_ros.study.drawn_tests import draw_tests
    from seft_ros.study.study_plan import plan_study
    from seft_ros.study.study_results import summarise_study, worst_folder, write_worst_tests
    from seft_ros.study.study_runs import FinishedTests, run_study

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
