"""``seft identify``: what rig is this? Tests of it, and the models fitted to them."""

import math
from datetime import datetime
from pathlib import Path
from typing import Any, Optional

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError

from seft_ros.bags.record import Record
from seft_ros.cli.options import (
    FIGURE,
    Config,
    External,
    Files,
    Json,
    Params,
    check_out,
    complain,
    dds_test,
    load_experiment,
    offline_test,
    option,
    show,
)

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
    """Identify a rig: its actuators, and the force loop that they make with the specimen.

    Ordinary tests, with all limits and bags. Open loop, the excitation drives the valves
    (force_controller's feedback is off), before it a short pilot at a low level that finds the
    amplitude. It shows the actuators: what velocity_feedforward needs, whatever the specimen is,
    so that another specimen needs no new identification. Closed loop, where the force controller
    follows a force, the excitation is the reference force. It shows that loop with this specimen:
    what the other methods of compensation need.

    The folder then holds the excitation, the bags, a figure, and model.yaml: a parameter file for
    reference_force and force_controller, to be given as --params-file.

    Rigs without a valve (actuator.kind ideal or delay) have the closed loop only.

    Examples:

        seft identify config/jhu.yaml --out identified

        seft simulate config/jhu.yaml --params-file identified/model.yaml

        seft identify config/jhu.yaml --over-dds -p rig:pace:=lockstep --json

        seft identify config/lab.yaml --external rig --duration 300
    """
    from seft_ros.design.controller import Controller
    from seft_ros.design.identified import identify as identify_rig
    from seft_ros.design.identified import write_model
    from seft_ros.design.identified_table import identified_table, summarise_identified
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
        raise InputError("--external: only the rig may be, the other nodes are set up here")
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
        tables = [identified_table(f"{config} as identified", identified.axes, summary)]
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
