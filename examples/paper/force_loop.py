"""Shape a force loop with python-control: its margins, its figure, a controller for a crossover.

    .venv/bin/python examples/paper/force_loop.py config/jhu.yaml --figure loop.png
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
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import control
import numpy as np
from seft_msgs_py.arrays import Complexes, Floats
from seft_msgs_py.config.experiment import Experiment, parse_override, write_parameter_file
from seft_msgs_py.errors import InputError, SeftError
from seft_plant_sim.lti import bilinear
from seft_ros.design import PlantSource
from seft_ros.design.closed_loop import closed_loop
from seft_ros.design.force_tracking import Tracking, tracking_measures
from seft_ros.design.plant import Plant, choose_plant
from seft_ros.design.roots import Root, lightly_damped, polynomial_of
from seft_ros.drawing.style import check_figure, save_figure
from seft_ros.force_controller.force_control import ForceController
from seft_ros.force_controller.force_controller_parameters import TRANSFER_FUNCTION, one_controller
from seft_ros.reference_force.linear_filter import LinearFilter
from seft_ros.test_run.parameter_tables import TABLES

PHASE_MARGIN_DEG = 45.0
"""Least phase margin of a proposal."""
GAIN_MARGIN_DB = 6.0
"""Least gain margin of a proposal, unless another is wished."""
LOWEST_HZ = 0.1
_NOTCH_DAMPING = 0.7  # of the poles under a notch: as wide as an oil column's frequency may vary
_ROLL_OFF_DAMPING = 0.7
_MIN_DAMPING = 1e-3  # of poles: an undamped mode that is cancelled would ring for ever
_ROLL_OFFS = 12  # frequencies tried
_POINTS, _CANDIDATE_POINTS = 1500, 300  # frequencies of a loop, and of a candidate


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


def loop_frequencies(plant: Plant, dt: float, count: int = _POINTS) -> Floats:
    """Frequencies that show all of a loop, ascending, Hz.

    ``count`` of them are spaced evenly on a logarithmic scale, more lie about the lightly damped
    roots of the plant's first axis. Half the rate itself, where controllers are zero, is left out.
    """
    highest = 0.499 / dt
    poles, zeros = plant.roots
    roots = lightly_damped([*zeros, *poles])
    lowest = min([LOWEST_HZ, highest / 100, *(root.hz / 100 for root in roots[:1])])
    spread = np.linspace(-5.0, 5.0, 41)
    near = [root.hz * (1 + max(root.damping or 0.0, 1e-4) * spread) for root in roots]
    f = np.concatenate([np.geomspace(lowest, highest, count), *near])
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


def propose_controller(
    plant: Plant, crossover_hz: float, dt: float, gain_margin_db: float = GAIN_MARGIN_DB
) -> Any:
    """Propose the simplest controller that gives the sampled loop a wished crossover.

    Its poles lie on the plant's lightly damped zeros, which compensates control-structure
    interaction and leaves the integrator-like slope of the oil column; its gain makes |L| = 1
    at the crossover. Only if that leaves less than the gain margin, a roll-off of one or two
    poles or a notch on the oil-column resonance is added, at the highest frequency that will do.

    Of the plant the first axis counts; crossover in Hz, sampling period in s, gain margin in dB.

    Raises
    ------
    InputError
        If the plant has no such zeros, or no controller has the crossover, a phase margin of 45
        degrees and that gain margin.
    """
    if not 0 < crossover_hz < 0.5 / dt:
        raise InputError(
            f"--crossover {crossover_hz:g}: must lie between 0 and half the rate, {0.5 / dt:g} Hz"
        )
    plant = plant.axis(0)
    zero, oil_column = plant.antiresonance(), plant.oil_column()
    if zero is None or zero.hz >= 0.5 / dt:
        raise InputError("the plant has no lightly damped zeros below half the rate to cancel")
    f = loop_frequencies(plant, dt, _CANDIDATE_POINTS)
    response, at = plant.sampled_response(f, dt), np.array([crossover_hz])
    # minus if the plant pulls when the command is to push
    sign = 1.0 if -45 <= -float(np.angle(response[0], deg=True)) <= 135 else -1.0
    for candidate in _candidates(zero, oil_column, dt, crossover_hz):
        drive = sampled(candidate, dt)
        unscaled = abs(drive(np.exp(2j * np.pi * at * dt)) * plant.sampled_response(at, dt))
        controller = candidate * (sign / float(np.ravel(unscaled)[0]))
        loop = sampled(controller, dt)(np.exp(2j * np.pi * f * dt)) * response
        if np.any(np.abs(loop[f > 1.02 * crossover_hz]) >= 1):
            continue  # |L| crosses 1 again, as at the oil column
        margins = loop_margins(f, loop)
        enough = margins.gain_margin_db is None or margins.gain_margin_db >= gain_margin_db
        enough &= (margins.phase_margin_deg or 0.0) >= PHASE_MARGIN_DEG
        if enough and is_stable(plant, controller, dt):
            return controller
    raise InputError(
        f"a crossover of {crossover_hz:g} Hz can't be had with phase and gain margins of "
        f"{PHASE_MARGIN_DEG:g} deg and {gain_margin_db:g} dB; choose a lower one"
    )


def _candidates(
    zero: Root, oil_column: Root | None, dt: float, crossover_hz: float
) -> Iterator[Any]:
    """Yield controllers of gain 1, the simplest first, roll-offs from the highest down."""

    def prewarped(hz: float, damping: float) -> Root:
        """Root in s that the bilinear transform brings onto this frequency."""
        return Root(float(np.tan(np.pi * hz * dt) / (np.pi * dt)), damping)

    hz = np.geomspace(0.45 / dt, crossover_hz, _ROLL_OFFS, endpoint=False).tolist()
    single, double = ([[Root(f, zeta)] for f in hz] for zeta in (None, _ROLL_OFF_DAMPING))
    poles = [prewarped(zero.hz, max(zero.damping or 0.0, _MIN_DAMPING))]
    for roll_off in ([], *single, *double):
        yield control.tf([1.0], polynomial_of([*poles, *roll_off]))
    if oil_column is not None and oil_column.hz < 0.45 / dt:
        notch = prewarped(oil_column.hz, oil_column.damping or 0.0)
        poles.append(Root(notch.hz, _NOTCH_DAMPING))
        for roll_off in ([], *single):
            yield control.tf(polynomial_of([notch]), polynomial_of([*poles, *roll_off]))


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


def save_bode_plot(loop: ForceLoop, path: Path) -> None:
    """Draw plant, controller, loop and closed loop over frequency; an InputError says why not."""
    shown = {
        "plant, N/V": loop.valve_to_force,
        "controller, V/N": loop.drive,
        "loop": loop.loop,
        "closed loop": loop.tracking,
    }
    omega = 2 * np.pi * loop.frequencies_hz
    responses = [control.frd(values, omega, name=name) for name, values in shown.items()]
    drawn = control.bode_plot(responses, Hz=True, dB=True, wrap_phase=False)
    save_figure(drawn.figure, path)


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
    add(
        "--plant",
        choices=list(PlantSource),
        default=PlantSource.AUTO,
        help="simulated rig, or identified",
    )
    add("--crossover", type=float, help="propose a controller for this crossover, Hz")
    add("--gain-margin", type=float, default=GAIN_MARGIN_DB, help="least one of a proposal, dB")
    add("--out", type=Path, help="write the controller to a new parameter file")
    add("--figure", type=Path, help="draw plant, controller, loop and closed loop to a file")
    words = parser.parse_args(arguments)
    try:
        overrides = [parse_override(text) for text in words.param]
        experiment = Experiment.load(TABLES, [words.config, *words.params_file], overrides)
        dt, plant = experiment.timebase.dt, choose_plant(experiment, words.plant)
        if words.crossover is None:
            controller = controller_of(experiment)
        else:
            controller = propose_controller(plant, words.crossover, dt, words.gain_margin)
        loop, stable = close_loop(plant, controller, dt), is_stable(plant, controller, dt)
        if words.out and stable:
            section = one_controller(*coefficients(controller))
            write_parameter_file(words.out, {"force_controller": section})
        if words.figure:
            save_bode_plot(loop, check_figure(words.figure))
    except SeftError as error:
        print(f"force_loop: {error}", file=sys.stderr)
        return error.exit_status
    print(json.dumps(summarise(loop) | {"stable": stable}, indent=2))
    if not stable:
        print("force_loop: unstable: with this controller the force grows", file=sys.stderr)
    return 0 if stable else 1


if __name__ == "__main__":
    sys.exit(main())
