"""``seft design``, ``preflight`` and ``identify``: the force loop, the test, the rig.

``seft preflight``: stability and delay margins before anything moves.
"""

import cmath
import math
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any, Optional

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import nearest
from seft_msgs_py.errors import InputError

from seft_ros.bags.record import Record
from seft_ros.cli.options import (
    FIGURE,
    Config,
    External,
    Files,
    Json,
    Params,
    Plant,
    check_out,
    complain,
    dds_test,
    is_stable_in_simulation,
    late_progress,
    load_experiment,
    offline_test,
    once_more,
    option,
    show,
)
from seft_ros.design import Source


def design(
    config: Config,
    param: Params = None,
    params_file: Files = None,
    plant: Plant = Source.AUTO,
    axis: Optional[str] = option(None, "Axis to show; default the first.", "NAME"),
    crossover: Optional[float] = option(None, "Propose a controller for this crossover.", "HZ"),
    gain_margin: float = option(6.0, "Least gain margin of a proposal in dB.", "DB"),
    numerator: Optional[str] = option(None, 'Numerator in s, highest power first: "37".'),
    denominator: Optional[str] = option(None, 'Denominator: "1 17.14 4002".'),
    out: Optional[Path] = option(None, "Write the controller to a new parameter file.", "FILE"),
    figure: Optional[Path] = option(None, "Draw plant, controller and loop to a file.", "PNG"),
    json: Json = False,
) -> int:
    """Shape the force loop: plant, controller, loop and closed loop, with margins and delay.

    The plant leads from valve to actuator force. Its zeros are the specimen's poles
    (control-structure interaction). The controller's poles cancel them, and its gain sets the
    crossover, well below the oil-column resonance. Margins are those of the loop as it runs:
    sampled, held and one step late. The table also gives those of continuous time.

    Without further options the experiment's own controller is examined.

    Exit status 1: with this controller the loop is unstable; it is not written then.

    Examples:

        seft design config/jhu.yaml

        seft design config/jhu.yaml --crossover 12 --out controller.yaml

        seft simulate config/jhu.yaml --params-file controller.yaml

        seft design config/jhu.yaml --numerator 37 --denominator "1 17.14 4002"
    """
    from seft_ros.design.closed_loop import force_loop
    from seft_ros.design.controller import Controller, given_controller, write_controller
    from seft_ros.design.loop_design import (
        axes_table,
        design_table,
        propose_controller,
        shape_loop,
        summarise,
        summarise_axes,
    )
    from seft_ros.design.loop_figures import design_figure
    from seft_ros.design.plant import choose_plant
    from seft_ros.drawing.style import check_figure, check_folder, save_figure

    path = check_figure(figure) if figure is not None else None
    if out is not None:
        check_folder(out)
    experiment = load_experiment(config, param, params_file)
    dt, axes = experiment.timebase.dt, experiment.axes
    if axis is not None and axis not in axes:
        raise InputError(f"--axis {axis}: there is no such axis{nearest(axis, axes)}")
    shown = 0 if axis is None else axes.index(axis)
    whole = choose_plant(experiment, plant)
    controller = given_controller(numerator, denominator)
    if crossover is not None:
        if controller is not None:
            raise InputError("--crossover proposes a controller: leave out what gives one")
        controller = propose_controller(whole.axis(shown), crossover, dt, gain_margin)
    elif controller is None:
        controller = Controller.from_parameters(experiment["force_controller"])
    loops = [shape_loop(whole.axis(index), controller, dt) for index in range(len(axes))]
    slowest = force_loop(whole, controller, dt).dominant()

    loop, stable = loops[shown], abs(slowest) < 1
    title = f"{config}, axis {axes[shown]}: force loop at {1 / dt:g} Hz, plant: {whole.source}"
    summary = summarise(loop)
    summary["axes"] = summarise_axes(axes, loops)
    summary |= {"stable": stable, "proposed": crossover is not None}
    if out is not None and stable:
        write_controller(controller, out)
        summary["out"] = str(out)
    if path is not None:
        save_figure(design_figure(loop, title), path)
        summary["figure"] = str(path)
    tables = [design_table(loop, title), *([axes_table(summary["axes"])] if axes[1:] else [])]
    show(summary, json, tables, "figure", "out")
    if stable:
        return 0
    complain(
        f"unstable: with this controller the force loop oscillates at "
        f"{abs(cmath.phase(slowest)) / (2 * cmath.pi * dt):.3g} Hz, "
        f"times {abs(slowest):.4g} each step"
    )
    return 1


def preflight(
    config: Config,
    param: Params = None,
    params_file: Files = None,
    external: External = None,
    plant: Plant = Source.AUTO,
    figure: Optional[Path] = option(
        None,
        "Draw where the test would be stable: mass ratio against dead time, and against "
        "the specimen's local stiffness.",
        "FILE",
    ),
    write: Optional[Path] = option(
        None, "Write limits that fit the test into a parameter file, for --params-file.", "FILE"
    ),
    json: Json = False,
) -> int:
    """Check whether a planned test is stable, and with which margins; nothing moves.

    Takes the eigenvalues of the sampled closed loop of rig, compensation and force controller:
    critical mass ratio, critical delay, margins against a wrong gain and a wrong delay, and the
    false damping that the test will show; and sweeps the specimen's local stiffness from 0 to 3
    times the assumed one. Exact where the loop is linear; the table says what that excludes.

    If a method or controller of your own has no linear(), the planned test is simulated instead.

    The exact response of the planned test gives the peaks to expect, and limits that fit them.
    Below the tables it names the problems it found, with the commands that fix them.

    A computed model enters the loop with its tangent at rest. Its steps are timed along the
    motion of the planned test.

    Exit status 1: the plan is unstable, or the computed model too slow.

    Examples:

        seft preflight config/jhu.yaml -p reference_force:mass_ratio:=1.0

        seft preflight config/demo.yaml --figure preflight.png

        seft preflight config/jhu.yaml --write limits.yaml

        seft preflight config/jhu.yaml --params-file identified/model.yaml
    """
    from seft_ros.design.plan import Plan
    from seft_ros.design.preflight_tables import (
        expected_peaks,
        limits_table,
        model_time,
        preflight_tables,
        proposed_limits,
        summarise,
        write_limits,
    )
    from seft_ros.design.stability_map import preflight_figure, stability_maps
    from seft_ros.design.stability_verdict import next_steps
    from seft_ros.design.stability_verdict import preflight as fly
    from seft_ros.drawing.style import check_figure, save_figure
    from seft_ros.reference_force.compensator import NotLinearError

    path = check_figure(figure) if figure is not None else None
    experiment = load_experiment(config, param, params_file, external)
    try:
        plan = Plan(experiment, plant)
        with late_progress() as progress:
            found = fly(plan, progress)
    except NotLinearError as error:
        if figure is not None:
            raise InputError(f"{error}; --figure can't draw them") from None
        if write is not None:
            write_limits(write, proposed_limits(expected_peaks(experiment)))
        return 0 if is_stable_in_simulation(experiment, error, as_json=json) else 1
    with late_progress() as progress:
        summary = summarise(plan, found)
        peaks = expected_peaks(experiment)
        limits = proposed_limits(peaks)
        summary |= {"expected_peaks": peaks, "proposed_limits": limits}
        timed = model_time(experiment)
        if timed is not None:
            summary["model"] = asdict(timed)
        steps = next_steps(plan, found, peaks, once_more(config, param, params_file, external))
        summary["next"] = [asdict(step) for step in steps]
        if write is not None:
            write_limits(write, limits)
        if path is not None:
            maps = stability_maps(plan, found.margins, progress)
            save_figure(preflight_figure(plan, found, maps), path)
            summary["figure"] = str(path)
    tables = preflight_tables(plan, found, f"preflight of {config}")
    lines = [line for step in steps for line in (f"{step.found}:", *_indented(step.commands))]
    if timed is not None:
        lines = [
            f"computed model: {1e3 * timed.median_s:.2g} ms for a step, "
            f"{1e3 * timed.p999_s:.2g} ms for one of 1000, of {1e3 * timed.budget_s:.2g} ms",
            "the tables above take its tangent at rest",
            *lines,
        ]
    show(summary, json, [*tables, limits_table(experiment, peaks), "", *lines], "figure")
    for reason in found.reasons:
        complain(f"{found.verdict}: {reason}")
    if too_slow := timed.refusal() if timed is not None else "":
        complain(too_slow)
    return 1 if found.verdict == "unstable" or too_slow else 0


def _indented(commands: list[str]) -> list[str]:
    return [f"    {command}" for command in commands]


PILOT, OPEN_LOOP, CLOSED_LOOP = "pilot", "open_loop", "closed_loop"
_BY_RATE = (math.nan, math.nan)


def identify(
    config: Config,
    param: Params = None,
    params_file: Files = None,
    over_dds: bool = option(
        False,
        "Run the tests as separate nodes over DDS, or in one process without ROS.",
        "--over-dds/--offline",
    ),
    external: External = None,
    signal: str = option("random", "Excitation.", "random|chirp"),
    seed: int = option(1, "Seed of the random signal.", min=0),
    band: tuple[float, float] = option(
        _BY_RATE,
        "Band of the excitation in Hz; default 0.3 to 0.45 times the rate, at most 200.",
        "LO HI",
        show_default=False,
    ),
    duration: float = option(120.0, "Duration of each test in s.", "S"),
    amplitude: Optional[float] = option(
        None,
        "RMS of the valve drive, open loop; default found by a pilot test, so that the "
        "rig uses up to a fifth of its limits.",
        "V",
    ),
    force: Optional[float] = option(
        None,
        "RMS of the reference force, closed loop; default 5 m/s^2 times the mass, at "
        "most a 20th of the force limit (chirp: 0.3 times that).",
        "N",
    ),
    out: Optional[Path] = option(None, "New folder of the results; default by the time.", "DIR"),
    specimen: bool = option(
        False,
        "Write the specimen's mass, damping and stiffness to model.yaml, too, as "
        "reference_force's model.*.",
        "--specimen",
    ),
    json: Json = False,
) -> int:
    """Identify a rig: its actuators, and its force loop with this specimen.

    Runs ordinary tests, with all limits, and records each.

    Open loop: the excitation drives the valves, and force_controller's feedback is off. A short
    pilot test at a low level finds the amplitude. The result describes the actuators, which
    velocity_feedforward needs. It holds for any specimen.

    Closed loop: the excitation is the reference force, where the force controller follows one.
    The result describes the force loop with this specimen, which the other methods need. Rigs
    without a valve (actuator.kind ideal or delay) have this test only.

    The folder then holds the excitation, the bags, a figure, and model.yaml: parameters of
    reference_force and force_controller for --params-file.

    Examples:

        seft identify config/jhu.yaml --out identified

        seft simulate config/jhu.yaml --params-file identified/model.yaml

        seft identify config/jhu.yaml --over-dds -p rig:pace:=lockstep --json

        seft identify config/lab.yaml --external rig --duration 300
    """
    from seft_ros.design.controller import Controller
    from seft_ros.design.identified import identified_table, summarise_identified, write_model
    from seft_ros.design.identified import identify as identify_rig
    from seft_ros.design.loop_figures import identified_figure
    from seft_ros.design.rig_tests import (
        PILOT_DURATION,
        Levels,
        Motions,
        check_levels,
        closed_loop,
        default_force,
        has_force_loop,
        has_valve,
        open_loop,
        pilot_voltage,
        voltage_after,
    )
    from seft_ros.drawing.style import save_figure
    from seft_ros.force_controller.parameters import is_one_controller

    if set(external or ()) - {"rig"}:
        raise InputError(
            "--external: only the rig may be external; the other nodes are set up here"
        )
    experiment = load_experiment(config, param, params_file, external)
    first = pilot_voltage(experiment) if amplitude is None else amplitude
    levels = Levels(first, default_force(experiment, signal) if force is None else force)
    check_levels(experiment, levels)
    own = experiment["force_controller"]
    controller = Controller.from_parameters(own) if is_one_controller(own) else None
    by_rate = (0.3, min(0.45 * experiment.timebase.rate, 200.0))
    used = by_rate if all(map(math.isnan, band)) else band
    folder = out or Path(datetime.now().strftime("identify_%Y-%m-%d_%H-%M-%S"))
    motions = Motions(experiment, levels.force, signal, used, seed)
    motions.check(duration)
    check_out(folder)
    record = motions.write(folder / "excitation.csv", duration)

    tests: dict[str, Record] = {}

    def done(name: str, test: Experiment, seconds: float) -> bool:
        bag, label = folder / name, f"{name}: "
        if over_dds or external:
            steps = motions.steps(seconds)
            tests[name] = dds_test(test, bag, steps, external or (), label=label)[0]
        else:
            tests[name] = offline_test(test, bag, label)
        return tests[name].trip is None and has_valve(tests[name].experiment)

    valve = has_valve(experiment)
    if valve and amplitude is None:
        seconds = min(duration, max(PILOT_DURATION, motions.shortest))
        short = motions.write(folder / f"{PILOT}.csv", seconds)
        valve = done(PILOT, open_loop(experiment, short, levels), seconds)
        if valve:
            levels = Levels(voltage_after(tests[PILOT], levels.voltage), levels.force)
    if valve:
        valve = done(OPEN_LOOP, open_loop(experiment, record, levels), duration)
    followed = has_force_loop(experiment) or not valve
    if followed and not any(test.trip for test in tests.values()):
        done(CLOSED_LOOP, closed_loop(experiment, record), duration)

    whole = {name: test for name, test in tests.items() if test.trip is None and name != PILOT}
    if not valve:
        whole.pop(OPEN_LOOP, None)  # only now an external rig has reported that it has none
    files = {"folder": folder, "excitation": record, **{name: folder / name for name in tests}}
    summary: dict[str, Any] = {}
    identified, tables = None, []
    if whole:
        identified = identify_rig(whole.get(OPEN_LOOP), whole.get(CLOSED_LOOP), used, controller)
        summary = summarise_identified(identified)
        files |= {"model": folder / "model.yaml", "figure": folder / FIGURE}
        write_model(identified, files["model"], str(config), specimen)
        save_figure(identified_figure(identified, f"seft identify {config}"), files["figure"])
    trips = {name: test.trip.reason if test.trip else None for name, test in tests.items()}
    summary |= {
        "tripped": {OPEN_LOOP: None, CLOSED_LOOP: None, **trips},
        "excitation_rms": {"voltage": levels.voltage, "force": levels.force},
        "files": {what: str(path) for what, path in files.items()},
    }
    if identified is not None:
        tables = [identified_table(f"{config} as identified", summary)]
    show(summary, json, [*tables, *(f"{what + ':':13}{path}" for what, path in files.items())])
    for name, test in tests.items():
        if test.trip is not None:
            at = f"{name.replace('_', ' ')} tripped at {test.trip.time_s:.3f} s"
            complain(f"{at}: {test.trip.reason}; its bag is in {folder / name}")
            return 1
    if identified is not None and identified.unusable:
        complain(identified.unusable[0])
        return 1
    return 0
