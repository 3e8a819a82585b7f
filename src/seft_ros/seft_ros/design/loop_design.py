"""A force loop as designed: responses, margins, tables; the proposal of its controller."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from rich.table import Table
from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import InputError

from seft_ros.design.closed_loop import force_loop
from seft_ros.design.controller import Controller, Root, lightly_damped
from seft_ros.design.loop_margins import Responses, delay_by_frequency, loop_margins
from seft_ros.design.plant import Plant
from seft_ros.drawing.style import CENTRED, Number, make_table, rows_of

LOWEST_HZ = 0.1


@dataclass(frozen=True)
class LoopDesign:
    """The force loop of one axis.

    Attributes
    ----------
    plant : Plant
        Of that axis alone.
    controller : Controller
        That closes the loop.
    frequencies_hz : ndarray
        Shape (N,), up to half the sampling rate, Hz.
    continuous, sampled : Responses
        In continuous time and without dead time; and as it runs.
    stable : bool
        Whether the sampled loop is stable, by its eigenvalues.
    """

    plant: Plant
    controller: Controller
    frequencies_hz: Floats
    continuous: Responses
    sampled: Responses
    stable: bool

    def delay_at(self, frequency_hz: float) -> float:
        """Delay of the measured force at one frequency, s."""
        delays = delay_by_frequency(self.frequencies_hz, self.sampled.tracking)
        known = np.isfinite(delays)
        return float(np.interp(frequency_hz, self.frequencies_hz[known], delays[known]))


def shape_loop(plant: Plant, controller: Controller, dt: float) -> LoopDesign:
    """Close the force loop of a plant's first axis with a sampling period of ``dt`` s.

    An InputError says if controller or plant can't be discretised.
    """
    plant = plant.axis(0)
    f = loop_frequencies(plant, dt)
    at_once = replace(plant, delay=0.0).response(f)
    continuous = Responses.of(f, at_once, controller.response(f))
    as_it_runs = plant.sampled_response(f, dt), controller.sampled_response(f, dt)
    sampled = Responses.of(f, *as_it_runs)
    stable = abs(force_loop(plant, controller, dt).dominant()) < 1
    return LoopDesign(plant, controller, f, continuous, sampled, stable)


def loop_frequencies(plant: Plant, dt: float, count: int = 1500) -> Floats:
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


def _number(label: str, key: str, unit: str, at: str = "", scale: float = 1.0) -> Number:
    return Number(label, key, unit, scale, ".3g", "none", at)


MARGINS = (
    _number("crossover", "crossover_hz", "Hz"),
    _number("phase margin", "phase_margin_deg", "deg"),
    _number("gain margin", "gain_margin_db", "dB", "phase_crossover_hz"),
)
TRACKING = (
    _number("flat within 1 dB to", "closed_loop_flat_to_hz", "Hz"),
    _number("bandwidth (-3 dB)", "bandwidth_hz", "Hz"),
    _number("delay", "delay_s", "ms", scale=1e3),
    _number("dip within 25 Hz", "dip_db", "dB", "dip_hz"),
)
_SENSITIVITY = _number("sensitivity peak", "sensitivity_peak", "", "sensitivity_peak_hz")


def design_table(design: LoopDesign, title: str) -> Table:
    """Tabulate the force loop of one axis under a title."""
    plant, controller = design.plant, design.controller
    zero = plant.antiresonance()
    loops = (
        asdict(responses.margins) | asdict(responses.measures)
        for responses in (design.continuous, design.sampled)
    )
    rows: list[list[str] | None] = [
        ["plant zero (specimen)", "", str(zero or "none")],
        ["plant pole (oil column)", "", str(plant.oil_column() or "none")],
        None,
        ["controller gain", "", f"{controller.gain:.4g}"],
        *(["controller zero", "", str(root)] for root in controller.zeros),
        *(["controller pole", "", str(root)] for root in controller.poles),
        None,
        *rows_of((*MARGINS, _SENSITIVITY, *TRACKING), *loops),
    ]
    if zero is not None:
        rows.append(["delay at the zero", "", f"{1e3 * design.delay_at(zero.hz):.3g} ms"])
    headings = ("", "continuous", "as it runs")
    return make_table(headings, rows, title=title, **CENTRED)


def axes_table(axes: list[dict[str, Any]]) -> Table:
    """Tabulate the margins of several axes, as `summarise_axes` gives them."""
    stable = Number("", "stable", form=lambda is_stable: "stable" if is_stable else "unstable")
    columns = (Number("axis", "axis"), *MARGINS, stable)
    rows = [[column.text(axis) for column in columns] for axis in axes]
    headings = [column.label for column in columns]
    title = "axes, each with the valves of the others closed"
    return make_table(headings, rows, wrap=True, left=(4,), title=title, **CENTRED)


def summarise(design: LoopDesign) -> dict[str, Any]:
    """Plant, margins and tracking of one axis: ``seft design --json``; in Hz and s.

    All but ``discretisation: continuous`` is of the sampled loop. What does not exist is None.
    """
    zero, controller = design.plant.antiresonance(), design.controller
    return {
        "plant_source": design.plant.source,
        **plant_numbers(design.plant),
        **asdict(design.sampled.margins),
        **asdict(design.sampled.measures),
        "delay_at_zero_s": design.delay_at(zero.hz) if zero else None,
        "controller": {
            "numerator": list(controller.numerator),
            "denominator": list(controller.denominator),
            "gain": controller.gain,
            "poles": [asdict(root) for root in controller.poles],
            "zeros": [asdict(root) for root in controller.zeros],
        },
        "discretisation": {
            "continuous": asdict(design.continuous.margins),
            "sampled": asdict(design.sampled.margins),
        },
    }


def plant_numbers(plant: Plant | None) -> dict[str, float | None]:
    """Zero (of the specimen) and pole (the oil column) of a plant; None where it has none."""
    zero, pole = (plant.antiresonance(), plant.oil_column()) if plant else (None, None)
    return {
        f"plant_{name}_{key}": getattr(root, key) if root else None
        for name, root in (("zero", zero), ("pole", pole))
        for key in ("hz", "damping")
    }


def summarise_axes(axes: Sequence[str], designs: Sequence[LoopDesign]) -> list[dict[str, Any]]:
    """Name, margins and stability of every axis, each with the valves of the others closed."""
    return [
        {"axis": axis, **asdict(design.sampled.margins), "stable": design.stable}
        for axis, design in zip(axes, designs, strict=True)
    ]


PHASE_MARGIN_DEG = 45.0
"""Least phase margin of a proposal."""

GAIN_MARGIN_DB, MOST_GAIN_MARGIN_DB = 6.0, 40.0
"""Least gain margin of a proposal, unless another is wished; and the largest wish."""

_NOTCH_DAMPING = 0.7  # of the poles under a notch: as wide as an oil column's frequency may vary
_ROLL_OFF_DAMPING = 0.7
_LEAST_DAMPING = 1e-3  # of poles: an undamped mode that is cancelled would ring for ever
_ROLL_OFFS = 12  # frequencies tried
_POINTS = 300  # frequencies at which a candidate is evaluated
_LOWER, _MOST_LOWER = 0.85, 30  # how the highest crossover is searched for


def propose_controller(
    plant: Plant, crossover_hz: float, dt: float, gain_margin_db: float = GAIN_MARGIN_DB
) -> Controller:
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
        degrees and that gain margin; names the highest crossover that is possible.
    """
    if not 0 < crossover_hz < 0.5 / dt:
        raise InputError(
            f"--crossover {crossover_hz:g}: must lie between 0 and half the rate, {0.5 / dt:g} Hz"
        )
    if not 0 <= gain_margin_db <= MOST_GAIN_MARGIN_DB:
        raise InputError(
            f"--gain-margin {gain_margin_db:g}: must lie between 0 and {MOST_GAIN_MARGIN_DB:g} dB"
        )
    plant = plant.axis(0)
    zero = plant.antiresonance()
    if zero is None or zero.hz >= 0.5 / dt:
        raise InputError(
            "the plant has no lightly damped zeros below half the rate to put the controller's "
            "poles on; give --numerator and --denominator"
        )
    simplest = partial(_simplest, plant, zero, dt, gain_margin_db)
    if (controller := simplest(crossover_hz)) is not None:
        return controller
    wish = (
        f"a crossover of {crossover_hz:g} Hz can't be had with phase and gain margins of "
        f"{PHASE_MARGIN_DEG:g} deg and {gain_margin_db:g} dB"
    )
    highest = _highest_crossover(simplest, crossover_hz)
    if highest is None:
        raise InputError(f"{wish}, nor can a lower one; give --numerator and --denominator")
    raise InputError(f"{wish}; the highest that can is {highest:g} Hz")


def _simplest(
    plant: Plant, zero: Root, dt: float, gain_margin_db: float, crossover_hz: float
) -> Controller | None:
    """First candidate with enough margins; None if there is none."""
    f, at = loop_frequencies(plant, dt, _POINTS), np.array([crossover_hz])
    response, plant_at = plant.sampled_response(f, dt), plant.sampled_response(at, dt)
    # minus if the plant pulls when the command is to push
    sign = 1.0 if -45 <= -float(np.angle(response[0], deg=True)) <= 135 else -1.0
    for candidate in _candidates(zero, plant.oil_column(), dt, crossover_hz):
        unscaled = candidate.sampled_response(at, dt) * plant_at
        controller = candidate.scaled(sign / float(abs(unscaled[0])))
        loop = controller.sampled_response(f, dt) * response
        if np.angle(-sign * unscaled[0], deg=True) < PHASE_MARGIN_DEG:
            continue
        # a quick, coarse test: whether |L| crosses 1 again, or is too large at -180 degrees
        turned = (np.diff(np.sign(loop.imag)) != 0) & (loop.real[1:] < 0)
        most = 1.2 * 10 ** (-gain_margin_db / 20)
        above = np.abs(loop[f > 1.02 * crossover_hz])
        if np.any(above >= 1) or np.any(np.abs(loop[1:][turned]) > most):
            continue
        margins = loop_margins(f, loop)
        if (
            (margins.gain_margin_db is None or margins.gain_margin_db >= gain_margin_db)
            and (margins.phase_margin_deg or 0.0) >= PHASE_MARGIN_DEG
            and abs(force_loop(plant, controller, dt).dominant()) < 1
        ):
            return controller
    return None


def _candidates(
    zero: Root, oil_column: Root | None, dt: float, crossover_hz: float
) -> Iterator[Controller]:
    """Yield controllers of gain 1, the simplest first, roll-offs from the highest down."""

    def prewarped(hz: float, damping: float) -> Root:
        """Root in s that the bilinear transform brings onto this frequency."""
        return Root(float(np.tan(np.pi * hz * dt) / (np.pi * dt)), damping)

    hz = np.geomspace(0.45 / dt, crossover_hz, _ROLL_OFFS, endpoint=False).tolist()
    single, double = ([[Root(f, zeta)] for f in hz] for zeta in (None, _ROLL_OFF_DAMPING))
    poles = [prewarped(zero.hz, max(zero.damping or 0.0, _LEAST_DAMPING))]
    for roll_off in ([], *single, *double):
        yield Controller.from_roots([], [*poles, *roll_off])
    if oil_column is None or oil_column.hz >= 0.45 / dt:
        return
    notch = prewarped(oil_column.hz, oil_column.damping or 0.0)
    poles.append(Root(notch.hz, _NOTCH_DAMPING))
    for roll_off in ([], *single):
        yield Controller.from_roots([notch], [*poles, *roll_off])


def _highest_crossover(
    simplest: Callable[[float], Controller | None], wish_hz: float
) -> float | None:
    """Highest possible crossover below a wish, to three digits."""
    high = low = _rounded(wish_hz)
    for _ in range(_MOST_LOWER):
        high, low = low, _rounded(_LOWER * low)
        if simplest(low) is not None:
            break
    else:
        return None
    while (middle := _rounded((low + high) / 2)) not in (low, high):
        if simplest(middle) is not None:
            low = middle
        else:
            high = middle
    return low


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")
