"""``seft identify``: actuators and force loop of a rig; by a multisine test mass and channels."""

import math
from datetime import datetime
from pathlib import Path
from typing import Optional

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import EVERY_NODE
from seft_msgs_py.errors import InputError
from seft_plant_sim.rig_parameters import as_simulated, truth

from seft_ros.cli import shared
from seft_ros.cli.shared import option

_NOT_GIVEN = (math.nan, math.nan)
_OVER_DDS = "Run nodes over DDS, or simulate in one process; default by rig: hardware."
_BAND = "Band of the excitation in Hz; default by the rate."
_HUNG = "Load that was hung on the load cell, and what this showed then beyond rest."


def identify(
    config: shared.Config,
    param: shared.Params = None,
    params_file: shared.Files = None,
    over_dds: Optional[bool] = option(None, _OVER_DDS, "--over-dds/--offline", show_default=False),
    external: shared.External = None,
    seed: int = option(1, "Seed of the excitation, Gaussian noise.", min=0),
    band: tuple[float, float] = option(_NOT_GIVEN, _BAND, "LO HI", show_default=False),
    duration: float = option(120.0, "Duration of each test in s.", "S"),
    amplitude: Optional[float] = option(None, "RMS of the valve drive, open loop.", "V"),
    force: Optional[float] = option(None, "RMS of the reference force, closed loop.", "N"),
    out: Optional[Path] = option(
        None, "Folder of the results, new or to continue; default by the time.", "DIR"
    ),
    specimen: bool = option(False, "Multisine test: mass and channels, too.", "--specimen"),
    travel: Optional[float] = option(
        None, "Displacement of the multisine test; default by the sensors' noise.", "M"
    ),
    known_mass: Optional[list[float]] = option(
        None, "Weighed mass of the specimen; for several axes once for each.", "KG"
    ),
    known_force: tuple[float, float] = option(_NOT_GIVEN, _HUNG, "N N", show_default=False),
    max_displacement: float = option(
        math.inf, "Largest displacement; default by the limits.", "M", show_default=False
    ),
    json: shared.Json = False,
) -> int:
    """Identify a rig: its actuators, and its force loop with this specimen.

    Runs ordinary tests, with all limits, and records each. The band of the excitation is 0.3 Hz to
    0.45 times the rate, 200 Hz at most, unless --band names another.

    Open loop: the excitation drives the valves, and force_controller's feedback is off. A short
    pilot test at a low level finds the amplitude, so that the rig uses up to a fifth of its
    limits; --amplitude gives it instead. The result describes the actuators, which
    velocity_feedforward needs. It holds for any specimen.

    Multisine test, with --specimen: six sines of the same displacement, some 0.2 mm, on each axis
    for 20 s, after a pilot of 4 s. What it will reach is shown before anything moves, within half
    of all limits. It finds the mass, and scale, lag and bias of each channel, with standard errors.
    They correct the open loop's test. No motion tells a wrong scale of the force from a wrong
    mass: the result says what 1 % of it costs. --known-mass or --known-force tells it.

    Closed loop: the excitation is the reference force, where the force controller follows one. Its
    RMS is 5 m/s^2 times the mass, at most a 20th of the force limit, and peaks and changes are
    within half of the limits, unless --force gives another. The result describes the force loop
    with this specimen, which the other methods need. Rigs without a valve (actuator.kind ideal or
    delay) have this test only.

    With --max-displacement every test is planned for half of it at most, by what is known of rig
    and specimen, and by the pilots. It is the limit of the displacement, too, which ends a test
    that goes farther. The result says how far all tests moved the specimen.

    After a trip or an interruption the same command with the same --out continues: it uses the
    tests again that ran to their end, which must be of the same configuration. A tripped test
    stays, too, and model.yaml has what was found before. Smaller --force, --travel or --amplitude
    may continue after the trip of the test that they are for.

    The folder then holds the excitation, the bags, a figure, and model.yaml: what was found, as
    facts under /**, for --params-file of every command and node. With --specimen they include
    mass, damping and stiffness of the specimen, the mass's standard error, and calibration.*.

    Examples:

        seft identify config/jhu.yaml --out identified

        seft simulate config/jhu.yaml --params-file identified/model.yaml

        seft identify config/jhu.yaml --specimen --max-displacement 0.001

        seft identify config/jhu.yaml --over-dds -p rig:pace:=lockstep --json

        seft identify config/lab.yaml --external rig --duration 300
    """
    # beyond 60 lines: half are its options, half its help
    from seft_ros.cli.identification_run import Identification, IdentificationTests, kept_excitation
    from seft_ros.identification import rig_tests
    from seft_ros.identification.multisine import plan_multisine

    if set(external or ()) - {"rig"}:
        raise InputError("--external: only the rig may be external; other nodes are set up here")
    has_hung = not all(map(math.isnan, known_force))
    given = {"--known-mass": known_mass, "--known-force": has_hung, "--travel": travel is not None}
    if not specimen and any(given.values()):
        one = next(name for name, is_given in given.items() if is_given)
        raise InputError(f"{one} is that of the multisine test: give --specimen, too")
    experiment = shared.load_experiment(config, param, params_file, external)
    if known_mass and (len(known_mass) != len(experiment.axes) or not min(known_mass) > 0.0):
        need = f"must be positive, once for each of the axes {', '.join(experiment.axes)}"
        raise InputError(f"--known-mass is {known_mass}, but {need}")
    if has_hung:
        experiment = _with_force(experiment, *known_force)
    if max_displacement != math.inf:
        experiment, max_displacement = _capped(experiment, max_displacement)
    if all(map(math.isnan, band)):
        highest = 100.0 if rig_tests.obeys_displacement(experiment) else 200.0
        band = (0.3, min(0.45 * experiment.timebase.rate, highest))
    motions = rig_tests.Motions(experiment, band, seed, max_displacement)
    motions.check(duration)
    largest = motions.largest_levels(duration)
    levels = rig_tests.Levels(
        rig_tests.pilot_voltage(experiment, largest) if amplitude is None else amplitude,
        rig_tests.default_force(experiment, largest) if force is None else force,
    )
    largest.check(levels)
    folder = out or Path(datetime.now().strftime("identify_%Y-%m-%d_%H-%M-%S"))
    plan = None
    if specimen and rig_tests.has_valve(experiment):
        plan = plan_multisine(experiment, travel, max_displacement)
        shared.complain(plan.text())
    motion = folder / "excitation.csv"
    if not motion.exists():
        shared.check_out(folder)
    kept_excitation(motion, experiment, excitation := motions.unit(duration))
    shared.stands(f"the same command with --out {folder} continues, {folder} has the excitation")
    if over_dds is None:
        over_dds = as_simulated(experiment) is not experiment
    tests = IdentificationTests(experiment, folder, over_dds, external or (), excitation)
    run = Identification(tests, motions, levels, plan, motion, duration, known_mass or ())
    run.drive_valves(by_pilot=amplitude is None)
    run.close_loop(by_default=force is None)
    return run.show(str(config), specimen, as_json=json)


def _with_force(experiment: Experiment, load: float, shown: float) -> Experiment:
    """Correct the scale of the load cell by a load that hangs on it, and what it shows of that."""
    if len(experiment.axes) > 1:
        mend = "for several axes give /**: calibration.force_scale, what each shows over the load"
        raise InputError(f"--known-force is for one load cell; {mend}")
    ratio = shown / load if load else math.nan
    if not 0.0 < ratio < math.inf:
        raise InputError(
            f"--known-force is {load:g} {shown:g}, but the load cell must show a load of the same "
            "sign; give calibration.force_scale: -1 if it shows a pull as a push"
        )
    from seft_plant_sim.channels import FORCE, least_noise

    section, name = experiment["reference_force"], "calibration.force_scale"
    error = least_noise(section, experiment.axes)[FORCE] / abs(shown)  # of one reading
    scale = ratio * np.atleast_1d(section[name])
    told = {name: scale.tolist(), f"{name}_error": error.tolist()}
    return experiment.changed({EVERY_NODE: told, "rig": truth(experiment["rig"])})


def _capped(experiment: Experiment, cap: float) -> tuple[Experiment, float]:
    """Lower the limit of the displacement to a cap, m; give the smaller of both, too."""
    if not cap > 0:
        raise InputError(f"--max-displacement is {cap:g} m, but must be positive")
    cap = min(cap, experiment["supervisor"]["limits.displacement"])
    return experiment.changed({EVERY_NODE: {"limits.displacement": cap}}), cap
