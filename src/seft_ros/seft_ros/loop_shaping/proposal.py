"""Proposal of a controller for a wished crossover, shaped as the paper's is (sec. 3.2)."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

from seft_ros.loop_shaping.controller import Controller
from seft_ros.loop_shaping.design import loop_frequencies
from seft_ros.loop_shaping.margins import loop_margins
from seft_ros.loop_shaping.plant import Plant
from seft_ros.loop_shaping.roots import Root
from seft_ros.loop_shaping.sampling import SampledPlant, closed_loop_poles

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

PHASE_MARGIN_DEG = 45.0
"""Least phase margin of a proposal."""

GAIN_MARGIN_DB, MOST_GAIN_MARGIN_DB = 6.0, 40.0
"""Least gain margin of a proposal, unless another is wished; and the largest wish."""

_NOTCH_DAMPING = 0.7  # of the poles under a notch: as wide as an oil column's frequency may vary
_ROLL_OFF_DAMPING = 0.7
_LEAST_DAMPING = 1e-3  # of poles: cancelled quite without damping, a mode would ring for ever
_ROLL_OFFS = 12  # frequencies tried
_POINTS = 300  # frequencies at which a candidate is looked at
_LOWER, _MOST_LOWER = 0.85, 30  # how the highest crossover is searched for


@dataclass(frozen=True)
class _Task:
    """What candidates have in common: the plant, looked at once."""

    plant: SampledPlant
    frequencies_hz: Floats
    response: Complexes
    zero: Root
    oil_column: Root | None
    gain_margin_db: float


def propose_controller(
    plant: Plant, crossover_hz: float, dt: float, gain_margin_db: float = GAIN_MARGIN_DB
) -> Controller:
    """Propose the simplest controller that gives the sampled loop a wished crossover.

    Its poles lie on the plant's lightly damped zeros, which compensates control-structure
    interaction and leaves the integrator-like slope of the oil column; its gain makes |L| = 1
    at the crossover. Only where that leaves less than the gain margin, a roll-off of one or two
    poles or a notch on the oil-column resonance is added, as far up as will do.

    Of the plant the first axis counts; crossover in Hz, sampling period in s, gain margin in dB.

    Raises
    ------
    InputError
        If the plant has no such zeros, or the crossover can't be had with a phase margin of 45
        degrees and that gain margin; names the highest that can.
    """
    if not 0 < crossover_hz < 0.5 / dt:
        raise InputError(
            f"--crossover {crossover_hz:g}: must lie between 0 and half the rate, {0.5 / dt:g} Hz"
        )
    if not 0 <= gain_margin_db <= MOST_GAIN_MARGIN_DB:
        raise InputError(
            f"--gain-margin {gain_margin_db:g}: must lie between 0 and {MOST_GAIN_MARGIN_DB:g} dB"
        )
    task = _task(plant.axis(0), dt, gain_margin_db)
    if (controller := _simplest(task, crossover_hz)) is not None:
        return controller
    wish = (
        f"a crossover of {crossover_hz:g} Hz can't be had with phase and gain margins of "
        f"{PHASE_MARGIN_DEG:g} deg and {gain_margin_db:g} dB"
    )
    highest = _highest_crossover(task, crossover_hz)
    if highest is None:
        raise InputError(f"{wish}, nor can a lower one; give gain, poles and zeros by hand")
    raise InputError(f"{wish}; the highest that can is {highest:g} Hz")


def _task(plant: Plant, dt: float, gain_margin_db: float) -> _Task:
    zero, oil_column = plant.antiresonance(), plant.oil_column()
    if zero is None or zero.hz >= 0.5 / dt:
        raise InputError(
            "the plant has no lightly damped zeros below half the rate to put the controller's "
            "poles on; give gain, poles and zeros by hand"
        )
    sampled = SampledPlant.of(plant, dt)
    f = loop_frequencies(plant, dt, _POINTS)
    return _Task(sampled, f, sampled.response(f), zero, oil_column, gain_margin_db)


def _simplest(task: _Task, crossover_hz: float) -> Controller | None:
    """First candidate with enough margins; None if there is none."""
    f, dt = task.frequencies_hz, task.plant.dt
    at = np.array([crossover_hz])
    plant_at = task.plant.response(at)
    # minus where the plant pulls when it is told to push
    sign = 1.0 if -45 <= -float(np.angle(task.response[0], deg=True)) <= 135 else -1.0
    for candidate in _candidates(task, crossover_hz):
        unscaled = candidate.sampled_response(at, dt) * plant_at
        controller = candidate.scaled(sign / float(abs(unscaled[0])))
        loop = controller.sampled_response(f, dt) * task.response
        phase = np.angle(-np.sign(controller.gain) * unscaled[0], deg=True)
        if phase < PHASE_MARGIN_DEG or _plainly_too_loud(task, loop, crossover_hz):
            continue
        margins = loop_margins(f, loop)
        gain_margin = margins.gain_margin_db
        if (
            (gain_margin is None or gain_margin >= task.gain_margin_db)
            and (margins.phase_margin_deg or 0.0) >= PHASE_MARGIN_DEG
            and np.abs(closed_loop_poles(task.plant, controller)).max() < 1
        ):
            return controller
    return None


def _plainly_too_loud(task: _Task, loop: Complexes, crossover_hz: float) -> bool:
    """Whether |L| crosses 1 again, or the gain margin is missed by far; costs next to nothing."""
    above = np.abs(loop[task.frequencies_hz > 1.02 * crossover_hz])
    turned = (np.diff(np.sign(loop.imag)) != 0) & (loop.real[1:] < 0)
    most = 1.2 * 10 ** (-task.gain_margin_db / 20)
    return bool(np.any(above >= 1) or np.any(np.abs(loop[1:][turned]) > most))


def _candidates(task: _Task, crossover_hz: float) -> Iterator[Controller]:
    """Yield controllers of gain 1, the simplest first, roll-offs from the highest down."""
    dt = task.plant.dt
    zero = Root(task.zero.hz, max(task.zero.damping or 0.0, _LEAST_DAMPING))
    poles = [_prewarped(zero, dt)]
    yield Controller.from_roots(1.0, [], poles)
    roll_offs = np.geomspace(0.45 / dt, crossover_hz, _ROLL_OFFS, endpoint=False)
    for damping in (None, _ROLL_OFF_DAMPING):
        for hz in roll_offs:
            yield Controller.from_roots(1.0, [], [*poles, Root(float(hz), damping)])
    oil = task.oil_column
    if oil is None or oil.hz >= 0.45 / dt:
        return
    notch = _prewarped(oil, dt)
    poles.append(Root(notch.hz, _NOTCH_DAMPING))
    yield Controller.from_roots(1.0, [notch], poles)
    for hz in roll_offs:
        yield Controller.from_roots(1.0, [notch], [*poles, Root(float(hz))])


def _highest_crossover(task: _Task, wish_hz: float) -> float | None:
    """Highest reachable crossover below a wish, to three digits."""
    high = low = _rounded(wish_hz)
    for _ in range(_MOST_LOWER):
        high, low = low, _rounded(_LOWER * low)
        if _simplest(task, low) is not None:
            break
    else:
        return None
    while True:
        middle = _rounded((low + high) / 2)
        if middle in (low, high):
            return low
        if _simplest(task, middle) is not None:
            low = middle
        else:
            high = middle


def _prewarped(root: Root, dt: float) -> Root:
    """Root in s that the bilinear transform brings onto this frequency."""
    return Root(float(np.tan(np.pi * root.hz * dt) / (np.pi * dt)), root.damping)


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")
