"""Proposal of a controller for a wished crossover, shaped as in the paper (sec. 3.2)."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

from seft_ros.design.closed_loop import force_loop
from seft_ros.design.controller import Controller, Root
from seft_ros.design.loop_design import loop_frequencies
from seft_ros.design.loop_margins import loop_margins
from seft_ros.design.plant import Plant, SampledPlant

Complexes = npt.NDArray[np.complex128]

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
    search = _Search(plant.axis(0), dt, gain_margin_db)
    if (controller := search.simplest(crossover_hz)) is not None:
        return controller
    wish = (
        f"a crossover of {crossover_hz:g} Hz can't be had with phase and gain margins of "
        f"{PHASE_MARGIN_DEG:g} deg and {gain_margin_db:g} dB"
    )
    highest = search.highest_crossover(crossover_hz)
    if highest is None:
        raise InputError(f"{wish}, nor can a lower one; give gain, poles and zeros by hand")
    raise InputError(f"{wish}; the highest that can is {highest:g} Hz")


class _Search:
    """Search for a controller of a plant, whose response is computed once."""

    def __init__(self, plant: Plant, dt: float, gain_margin_db: float) -> None:
        zero = plant.antiresonance()
        if zero is None or zero.hz >= 0.5 / dt:
            raise InputError(
                "the plant has no lightly damped zeros below half the rate to put the controller's "
                "poles on; give gain, poles and zeros by hand"
            )
        self._plant, self._dt, self._gain_margin_db = plant, dt, gain_margin_db
        self._zero, self._oil_column = zero, plant.oil_column()
        self._sampled = SampledPlant.of(plant, dt)
        self._f = loop_frequencies(plant, dt, _POINTS)
        self._response = self._sampled.response(self._f)

    def simplest(self, crossover_hz: float) -> Controller | None:
        """First candidate with enough margins; None if there is none."""
        at, dt = np.array([crossover_hz]), self._dt
        plant_at = self._sampled.response(at)
        # minus if the plant pulls when the command is to push
        sign = 1.0 if -45 <= -float(np.angle(self._response[0], deg=True)) <= 135 else -1.0
        for candidate in self._candidates(crossover_hz):
            unscaled = candidate.sampled_response(at, dt) * plant_at
            controller = candidate.scaled(sign / float(abs(unscaled[0])))
            loop = controller.sampled_response(self._f, dt) * self._response
            phase = np.angle(-np.sign(controller.gain) * unscaled[0], deg=True)
            if phase < PHASE_MARGIN_DEG or self._lacks_gain_margin(loop, crossover_hz):
                continue
            margins = loop_margins(self._f, loop)
            gain_margin = margins.gain_margin_db
            if (
                (gain_margin is None or gain_margin >= self._gain_margin_db)
                and (margins.phase_margin_deg or 0.0) >= PHASE_MARGIN_DEG
                and abs(force_loop(self._plant, controller, dt).dominant()) < 1
            ):
                return controller
        return None

    def _lacks_gain_margin(self, loop: Complexes, crossover_hz: float) -> bool:
        """Whether |L| crosses 1 again, or is too large at -180 degrees: a quick, coarse test."""
        above = np.abs(loop[self._f > 1.02 * crossover_hz])
        turned = (np.diff(np.sign(loop.imag)) != 0) & (loop.real[1:] < 0)
        most = 1.2 * 10 ** (-self._gain_margin_db / 20)
        return bool(np.any(above >= 1) or np.any(np.abs(loop[1:][turned]) > most))

    def _candidates(self, crossover_hz: float) -> Iterator[Controller]:
        """Yield controllers of gain 1, the simplest first, roll-offs from the highest down."""
        zero = Root(self._zero.hz, max(self._zero.damping or 0.0, _LEAST_DAMPING))
        poles = [self._prewarped(zero)]
        yield Controller.from_roots(1.0, [], poles)
        roll_offs = np.geomspace(0.45 / self._dt, crossover_hz, _ROLL_OFFS, endpoint=False).tolist()
        for damping in (None, _ROLL_OFF_DAMPING):
            for hz in roll_offs:
                yield Controller.from_roots(1.0, [], [*poles, Root(hz, damping)])
        oil = self._oil_column
        if oil is None or oil.hz >= 0.45 / self._dt:
            return
        notch = self._prewarped(oil)
        poles.append(Root(notch.hz, _NOTCH_DAMPING))
        yield Controller.from_roots(1.0, [notch], poles)
        for hz in roll_offs:
            yield Controller.from_roots(1.0, [notch], [*poles, Root(hz)])

    def highest_crossover(self, wish_hz: float) -> float | None:
        """Highest possible crossover below a wish, to three digits."""
        high = low = _rounded(wish_hz)
        for _ in range(_MOST_LOWER):
            high, low = low, _rounded(_LOWER * low)
            if self.simplest(low) is not None:
                break
        else:
            return None
        while (middle := _rounded((low + high) / 2)) not in (low, high):
            if self.simplest(middle) is not None:
                low = middle
            else:
                high = middle
        return low

    def _prewarped(self, root: Root) -> Root:
        """Root in s that the bilinear transform brings onto this frequency."""
        hz = np.tan(np.pi * root.hz * self._dt) / (np.pi * self._dt)
        return Root(float(hz), root.damping)


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")
