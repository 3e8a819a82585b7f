"""Whether a computed model is fast enough for a test in real time, measured before it."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_plant_sim.whole_structure import model_times, whole_structure

from seft_ros.ground_motion.ground_motion_block import GroundMotion

SHARE = 0.6
"""Of a period, for the model: the loop's nodes need the rest."""
LOOKS = 4
"""At a model that seems too slow. Of each step the shortest time counts: what takes long in all of
them is the model, the rest is the host."""
STEPS = 5000
"""Of the test, at most, from its beginning on."""
RATES = (2000, 1000, 500, 400, 250, 200, 125, 100, 50, 25, 20, 10, 5, 2, 1)  # Hz
MOST_APART = 50
"""Largest division that a parameter file may give."""


@dataclass(frozen=True)
class ModelTime:
    """Time that a step of a model takes along the motion of the planned test.

    Attributes
    ----------
    median, p999 : float
        s; 99.9 % of the steps take no longer than the second.
    budget : float
        Time that a step may take, s.
    period : float
        Sampling period, s.
    every : int
        Samples from one step to the next.
    is_apart : bool
        Whether the model computes while the loop goes on.
    """

    median: float
    p999: float
    budget: float
    period: float
    every: int
    is_apart: bool

    @property
    def fits(self) -> bool:
        """Whether it is fast enough."""
        return self.p999 <= self.budget

    @property
    def enough(self) -> tuple[int | None, int | None]:
        """Division of the steps, and rate in Hz, at which it would be; None: there is none."""
        every = math.ceil(self.p999 / (SHARE * self.period))
        rates = [rate for rate in RATES if self.p999 * rate <= SHARE * self.every]
        can_divide = self.is_apart and every <= MOST_APART
        return every if can_divide else None, rates[0] if rates else None

    def refusal(self) -> str:
        """Say that it is too slow, and what would do; empty if it is not."""
        if self.fits:
            return ""
        every, rate = self.enough
        ways = [f"reference_force: computed.every {every}"] if every else []
        ways += [f"a rate of {rate} Hz"] if rate else []
        return (
            f"reference_force: computed.model takes {1e3 * self.median:.2g} ms for a step "
            f"({1e3 * self.p999:.2g} ms for one of 1000), but has {1e3 * self.budget:.2g} ms at "
            f"{1 / self.period:g} Hz: {' or '.join([*ways, 'a smaller model'])} fits"
        )

    def numbers(self) -> dict[str, Any]:
        """Give all of it as JSON values."""
        every, rate = self.enough
        found = {"median_s": self.median, "p999_s": self.p999, "budget_s": self.budget}
        return found | {"fits": self.fits, "fitting_every": every, "fitting_rate_hz": rate}


def model_time(experiment: Experiment) -> ModelTime | None:
    """Measure the computed model of an experiment; None if it has none, or no ground motion here.

    Raises
    ------
    InputError
        If the model fails along the way.
    """
    if not {"ground_motion", "reference_force"} <= set(experiment.sections):
        return None
    whole = whole_structure(experiment)
    model, dt = whole.computed.model, experiment.timebase.dt
    if model is None:
        return None
    motion = GroundMotion.from_parameters(
        experiment["ground_motion"], experiment.axes, experiment.timebase
    ).samples[: STEPS * model.every : model.every]
    share = SHARE * dt * (model.every if model.is_apart else 1)
    times = np.full(len(motion), np.inf)
    for _ in range(LOOKS):
        times = np.minimum(times, model_times(whole, motion, model.every * dt))
        median, p999 = np.percentile(times, [50.0, 99.9]).tolist()
        found = ModelTime(median, p999, share, dt, model.every, model.is_apart)
        if found.fits or median > share:  # half of the steps: no stalls of the host
            break
    return found
