"""A force loop as shaped: its responses in continuous time and sampled, and what they say."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from seft_ros.loop_shaping.controller import Controller
from seft_ros.loop_shaping.margins import LoopMargins, Tracking, loop_margins, tracking_measures
from seft_ros.loop_shaping.plant import Plant
from seft_ros.loop_shaping.roots import lightly_damped
from seft_ros.loop_shaping.sampling import SampledPlant, dominant_pole

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

LOWEST_HZ = 0.1


@dataclass(frozen=True)
class Responses:
    """Frequency responses of plant (N/V) and controller (V/N), shape (N,) each."""

    plant: Complexes
    controller: Complexes

    @property
    def loop(self) -> Complexes:
        """L = C_f H_fu."""
        return self.controller * self.plant

    @property
    def tracking(self) -> Complexes:
        """T = L / (1 + L), from reference force to measured force."""
        return self.loop / (1 + self.loop)


@dataclass(frozen=True)
class PhaseCost:
    """Phase that a loop loses at its crossover, against one in continuous time; degrees.

    It goes to the zero-order hold (and what that folds back from above half the rate), to the step
    from a sample to the command that answers it, and to the controller's discretisation.
    """

    hold: float
    latency: float
    dead_time: float
    bilinear: float

    @property
    def total(self) -> float:
        """All together."""
        return self.hold + self.latency + self.dead_time + self.bilinear


@dataclass(frozen=True)
class LoopDesign:
    """The force loop of one axis.

    Attributes
    ----------
    plant : Plant
        Of that axis alone.
    controller : Controller
        What closes the loop.
    frequencies_hz : ndarray
        Shape (N,), up to half the sampling rate, Hz.
    continuous, sampled : Responses
        As if it ran in continuous time and without dead time; and as it runs.
    continuous_margins, margins : LoopMargins
        Of both.
    continuous_tracking, tracking : Tracking
        Of both.
    phase_cost : PhaseCost or None
        Where `margins` lost phase; None without a crossover.
    stable : bool
        Whether the sampled loop is stable, judged by its eigenvalues.
    """

    plant: Plant
    controller: Controller
    frequencies_hz: Floats
    continuous: Responses
    sampled: Responses
    continuous_margins: LoopMargins
    margins: LoopMargins
    continuous_tracking: Tracking
    tracking: Tracking
    phase_cost: PhaseCost | None
    stable: bool

    def delay_at(self, frequency_hz: float) -> float:
        """Delay of the measured force at one frequency, s."""
        delays = self.tracking.delay_by_frequency
        known = np.isfinite(delays)
        return float(np.interp(frequency_hz, self.frequencies_hz[known], delays[known]))


def shape_loop(plant: Plant, controller: Controller, dt: float) -> LoopDesign:
    """Close the force loop of a plant's first axis with a sampling period of ``dt`` s.

    An InputError says if controller or plant can't be discretised.
    """
    plant = plant.axis(0)
    sampled_plant = SampledPlant.of(plant, dt)
    f = loop_frequencies(plant, dt)
    continuous = Responses(replace(plant, delay=0.0).response(f), controller.response(f))
    sampled = Responses(sampled_plant.response(f), controller.sampled_response(f, dt))
    margins = loop_margins(f, sampled.loop)
    return LoopDesign(
        plant=plant,
        controller=controller,
        frequencies_hz=f,
        continuous=continuous,
        sampled=sampled,
        continuous_margins=loop_margins(f, continuous.loop),
        margins=margins,
        continuous_tracking=tracking_measures(f, continuous.tracking),
        tracking=tracking_measures(f, sampled.tracking),
        phase_cost=_phase_cost(plant, sampled_plant, controller, margins.crossover_hz, dt),
        stable=abs(dominant_pole(plant, controller, dt)) < 1,
    )


def loop_frequencies(plant: Plant, dt: float, count: int = 1500) -> Floats:
    """Frequencies that show all of a loop, ascending, Hz.

    ``count`` of them are spaced evenly on a logarithmic scale, more lie about the lightly damped
    roots of the plant's first axis. Half the rate itself, where controllers are zero, is left out.
    """
    highest = 0.499 / dt
    roots = lightly_damped([*plant.zeros(), *plant.poles()])
    lowest = min([LOWEST_HZ, highest / 100, *(root.hz / 100 for root in roots[:1])])
    spread = np.linspace(-5.0, 5.0, 41)
    near = [root.hz * (1 + max(root.damping or 0.0, 1e-4) * spread) for root in roots]
    f = np.concatenate([np.geomspace(lowest, highest, count), *near])
    return np.unique(f[(f >= lowest) & (f <= highest)])


def _phase_cost(
    plant: Plant,
    sampled: SampledPlant,
    controller: Controller,
    crossover_hz: float | None,
    dt: float,
) -> PhaseCost | None:
    if crossover_hz is None:
        return None
    f = np.array([crossover_hz])
    latency = 360.0 * crossover_hz * dt

    def lag(before: Complexes, after: Complexes) -> float:
        return float(np.angle(before / after, deg=True)[0])

    hold = lag(plant.response(f), sampled.response(f)) - latency
    return PhaseCost(
        hold=(hold + 180.0) % 360.0 - 180.0,
        latency=latency,
        dead_time=360.0 * crossover_hz * plant.delay,
        bilinear=lag(controller.response(f), controller.sampled_response(f, dt)),
    )
