"""Shape a force loop with python-control: its margins, a controller for a crossover.

    .venv/bin/python examples/paper/force_loop.py config/jhu.yaml
    .venv/bin/python examples/paper/force_loop.py config/jhu.yaml --crossover 12 --out own.yaml
    .venv/bin/seft simulate config/jhu.yaml --params-file own.yaml

Prints one JSON object; Hz, s, dB and degrees, null: there is none.

The plant leads from valve to actuator force. Its zeros are the specimen's poles (control-structure
interaction, Dyke et al. 1995). The controller's poles cancel them, and its gain sets the crossover,
well below the oil-column resonance (paper, section 3). Everything is of the loop as it runs:
sampled, held and one step late. Exit status 1: the loop is unstable.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import control
import numpy as np
from seft_msgs_py.arrays import Complexes, Floats
from seft_msgs_py.config.experiment import Experiment, parse_override, write_parameter_file
from seft_msgs_py.errors import InputError, SeftError
from seft_plant_sim.lti import bilinear
from seft_ros.design.planned_tests import closed_loop
from seft_ros.design.plant import Plant, lightly_damped, rig_model
from seft_ros.force_controller.force_control import ForceController
from seft_ros.force_controller.force_controller_parameters import TRANSFER_FUNCTION, one_controller
from seft_ros.identification.response_fits import Tracking, tracking_measures
from seft_ros.reference_force.compensator import LinearFilter
from seft_ros.test_run.parameter_tables import TABLES

PHASE_MARGIN_DEG = 45.0
"""Least phase margin of a proposal."""
GAIN_MARGIN_DB = 6.0
"""Least gain margin of a proposal."""
LOWEST_HZ = 0.1
_MIN_DAMPING = 1e-3  # of poles: an undamped mode that is cancelled would ring for ever
_POINTS = 1500  # frequencies of a loop


@dataclass(frozen=True)
class Margins:
    """Margins of a loop L; None if it has none at its frequencies.

    First frequency at which |L| falls below 1, Hz; phase left above -180 degrees and gain left
    below 1, where each is least, either way, degrees and dB; frequency of the gain margin, Hz.
    """

    crossover_hz: float | None = None
    phase_margin_deg: float | None = None
    gain_margin_db: float | None = None
    phase_crossover_hz: float | None = None


@dataclass(frozen=True)
class ForceLoop:
    """The sampled force loop of one axis.

    Attributes
    ----------
    plant : Plant
        Of that axis alone.
    controller : control.TransferFunction
        C_f in s, from force error (N) to valve drive (V).
    frequencies_hz : ndarray
        Shape (N,), up to half the sampling rate, Hz.
    valve_to_force, drive, loop, tracking : ndarray
        H_fu (N/V), C_f (V/N), L = C_f H_fu and T = L / (1 + L) at these, shape (N,).
    margins : Margins
        Of L.
    measures : Tracking
        Of T.
    """

    plant: Plant
    controller: Any
    frequencies_hz: Floats
    valve_to_force: Complexes
    drive: Complexes
    loop: Complexes
    tracking: Complexes
    margins: Margins
    measures: Tracking


def controller_of(experiment: Experiment) -> Any:
    """Take the controller of an experiment as a transfer function in s.

    An InputError says if it is another package's, or not the same on all axes.
    """
    own = experiment["force_controller"]
    if own["method"] != TRANSFER_FUNCTION or own["per_axis"] or np.size(own["gain"]) > 1:
        raise InputError(
            "force_controller: method, per_axis or gain are set, but a loop is shaped with one "
            f"{TRANSFER_FUNCTION} for all axes; set that, or let --crossover propose one"
        )
    for name in ("numerator", "denominator"):
        if not np.any(own[name]):
            raise InputError(f"force_controller: {name} is zero")
    gain = float(np.ravel(own["gain"])[0])
    return gain * control.tf(np.atleast_1d(own["numerator"]), np.atleast_1d(own["denominator"]))


def sampled(controller: Any, dt: float) -> Any:
    """Sample a controller as the force controller runs it; an InputError says if it can't be."""
    return control.tf(*bilinear(*coefficients(controller), dt), dt)


def coefficients(controller: Any) -> tuple[list[float], list[float]]:
    """Numerator and denominator of a transfer function, highest power first."""
    numerator, denominator = controller.num_list[0][0], controller.den_list[0][0]
    return numerator.tolist(), denominator.tolist()


def is_stable(plant: Plant, controller: Any, dt: float) -> bool:
    """Whether the sampled loop over all axes of a plant is stable, by its eigenvalues."""
    a, b, c = plant.sampled(dt)
    n = b.shape[1]
    blocks = ForceController([coefficients(controller)] * n, np.inf, dt).linear()
    no_reference = LinearFilter.of_gains(np.zeros((n, 4 * n)), np.zeros((n, n)))
    rig = a, b, np.pad(c, ((3 * n, 0), (0, 0)))
    return abs(closed_loop(rig, no_reference, blocks).dominant()) < 1


def close_loop(plant: Plant, controller: Any, dt: float) -> ForceLoop:
    """Close the force loop of a plant's first axis with a sampling period of ``dt`` s.

    An InputError says if controller or plant can't be discretised.
    """
    plant = plant.axis(0)
    f = loop_frequencies(plant, dt)
    force = plant.sampled_response(f, dt)
    drive = sampled(controller, dt)(np.exp(2j * np.pi * f * dt))
    loop = drive * force
    tracking = loop / (1 + loop)
    margins, measures = loop_margins(f, loop), tracking_measures(f, tracking)
    return ForceLoop(plant, controller, f, force, drive, loop, tracking, margins, measures)


def loop_frequencies(plant: Plant, dt: float) -> Floats:
    """Frequencies that show all of a loop, ascending, Hz.

    Most are spaced evenly on a logarithmic scale, more lie about the lightly damped roots of the
    plant's first axis. Half the rate itself, where controllers are zero, is left out.
    """
    highest = 0.499 / dt
    poles, zeros = plant.roots
    roots = lightly_damped([*zeros, *poles])
    lowest = min([LOWEST_HZ, highest / 100, *(root.hz / 100 for root in roots[:1])])
    spread = np.linspace(-5.0, 5.0, 41)
    near = [root.hz * (1 + max(root.damping or 0.0, 1e-4) * spread) for root in roots]
    f = np.concatenate([np.geomspace(lowest, highest, _POINTS), *near])
    return np.unique(f[(f >= lowest) & (f <= highest)])


def loop_margins(frequencies_hz: Floats, loop: Complexes) -> Margins:
    """Margins of a loop L known at some frequencies, ascending, in Hz; shape (N,) both.

    Between them cubic splines interpolate it. Points that are not finite are left out.
    """
    known = np.isfinite(loop)
    omega, loop = 2 * np.pi * frequencies_hz[known], loop[known]
    if len(omega) < 4:
        return Margins()
    gains, phases, _, phase_omegas, omegas, _ = control.stability_margins(
        control.frd(loop, omega, smooth=True), returnall=True
    )
    crossovers = sorted({float(f"{w / (2 * np.pi):.9g}") for w in omegas})
    falls = 0 if abs(loop[0]) > 1 else 1  # the first of them at which |L| falls
    margins_db = 20 * np.log10(gains)
    least = int(np.abs(margins_db).argmin()) if len(gains) else None
    return Margins(
        crossovers[falls] if len(crossovers) > falls else None,
        float(phases[np.abs(phases).argmin()]) if len(phases) else None,
        None if least is None else float(margins_db[least]),
        None if least is None else float(phase_omegas[least] / (2 * np.pi)),
    )


def propose_controller(plant: Plant, crossover_hz: float, dt: float) -> Any:
    """Propose a controller that gives the sampled loop a wished crossover, as the paper's does.

    Its poles lie on the plant's lowest lightly damped zero, which compensates control-structure
    interaction and leaves the integrator-like slope of the oil column; its gain makes |L| = 1
    at the crossover.

    Of the plant the first axis counts; crossover in Hz, sampling period in s.

    Raises
    ------
    InputError
        If the plant has no such zero, or this controller does not leave a phase margin of 45
        degrees, a gain margin of 6 dB, and no other crossover above.
    """
    if not 0 < crossover_hz < 0.5 / dt:
        raise InputError(
            f"--crossover {crossover_hz:g}: must lie between 0 and half the rate, {0.5 / dt:g} Hz"
        )
    plant = plant.axis(0)
    zero = plant.antiresonance()
    if zero is None or zero.hz >= 0.5 / dt:
        raise InputError("the plant has no lightly damped zeros below half the rate to cancel")
    # the bilinear transform brings it onto the zero
    w = 2.0 * float(np.tan(np.pi * zero.hz * dt)) / dt
    unscaled = control.tf([1.0], [1.0, 2.0 * max(zero.damping or 0.0, _MIN_DAMPING) * w, w * w])
    force = complex(plant.sampled_response(np.array([LOWEST_HZ]), dt)[0])
    # minus if the plant pulls when the command is to push
    sign = 1.0 if -45 <= -float(np.angle(force, deg=True)) <= 135 else -1.0
    at = np.array([crossover_hz])
    response = sampled(unscaled, dt)(np.exp(2j * np.pi * at * dt)) * plant.sampled_response(at, dt)
    controller = unscaled * (sign / float(np.abs(np.ravel(response))[0]))
    loop = close_loop(plant, controller, dt)
    crosses_again = np.any(np.abs(loop.loop[loop.frequencies_hz > 1.02 * crossover_hz]) >= 1)
    gain_margin, phase_margin = loop.margins.gain_margin_db, loop.margins.phase_margin_deg
    enough = gain_margin is None or gain_margin >= GAIN_MARGIN_DB
    enough &= (phase_margin or 0.0) >= PHASE_MARGIN_DEG
    if crosses_again or not enough or not is_stable(plant, controller, dt):
        raise InputError(
            f"a crossover of {crossover_hz:g} Hz can't be had with phase and gain margins of "
            f"{PHASE_MARGIN_DEG:g} deg and {GAIN_MARGIN_DB:g} dB; choose a lower one"
        )
    return controller


def plant_of(experiment: Experiment) -> Plant:
    """Give the plant of an experiment, from valves to forces; InputError if it has no valve."""
    source, model = rig_model(experiment)
    if model.drive != "valve_command":
        raise InputError("/**: actuator.kind has no valve to shape a loop for; use servo_hydraulic")
    return Plant.of_model(source, model)


def summarise(loop: ForceLoop) -> dict[str, Any]:
    """Plant, controller, margins and tracking of a loop; what does not exist is None."""
    roots = {"plant_zero": loop.plant.antiresonance(), "plant_pole": loop.plant.oil_column()}
    numerator, denominator = coefficients(loop.controller)
    return {
        "plant_source": loop.plant.source,
        **{f"{name}_hz": root and root.hz for name, root in roots.items()},
        **{f"{name}_damping": root and root.damping for name, root in roots.items()},
        "controller": {"numerator": numerator, "denominator": denominator},
        **asdict(loop.margins),
        **asdict(loop.measures),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; exit status 0 stable, 1 unstable, 2 wrong input."""
    summary, _, usage = (__doc__ or "").partition("\n\n")
    parser = argparse.ArgumentParser(
        description=summary, epilog=usage, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("config", type=Path, help="experiment: ROS 2 parameter file")
    add("-p", dest="param", action="append", default=[], help="NODE:PARAMETER:=VALUE; repeatable")
    add("--params-file", action="append", default=[], help="another parameter file; repeatable")
    add("--crossover", type=float, help="propose a controller for this crossover, Hz")
    add("--out", type=Path, help="write the controller to a new parameter file")
    words = parser.parse_args(arguments)
    try:
        overrides = [parse_override(text) for text in words.param]
        experiment = Experiment.load(TABLES, [words.config, *words.params_file], overrides)
        dt, plant = experiment.timebase.dt, plant_of(experiment)
        if words.crossover is None:
            controller = controller_of(experiment)
        else:
            controller = propose_controller(plant, words.crossover, dt)
        loop, stable = close_loop(plant, controller, dt), is_stable(plant, controller, dt)
        if words.out and stable:
            section = one_controller(*coefficients(controller))
            write_parameter_file(words.out, {"force_controller": section})
    except SeftError as error:
        print(f"force_loop: {error}", file=sys.stderr)
        return error.exit_status
    print(json.dumps(summarise(loop) | {"stable": stable}, indent=2))
    if not stable:
        print("force_loop: unstable: with this controller the force grows", file=sys.stderr)
    return 0 if stable else 1


if __name__ == "__main__":
    sys.exit(main())
