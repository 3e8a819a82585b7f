"""Growth of a test over mass ratio and delay, and over mass ratio and model error."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from seft_ros.preflight.margins import Margins, Progress, added_delays, planned_stiffness
from seft_ros.preflight.plan import Plan
from seft_ros.preflight.spreading import spread, time_of_one

Floats = npt.NDArray[np.float64]

PATIENCE = 60.0
"""Time of a processor that the maps may take, s; they get coarser where a loop is large."""
FINEST, COARSEST = 61, 15


@dataclass(frozen=True)
class StabilityMap:
    """Growth rate of the loop over mass ratio and something else.

    Attributes
    ----------
    mass_ratios, others : ndarray
        Shapes (p,) and (q,), ascending.
    growth : ndarray
        Shape (q, p), 1/s.
    planned : tuple of float
        Mass ratio and the other quantity as planned.
    """

    mass_ratios: Floats
    others: Floats
    growth: Floats
    planned: tuple[float, float]


def stability_maps(
    plan: Plan, margins: Margins, progress: Progress | None = None
) -> tuple[StabilityMap, StabilityMap]:
    """Map a plan's growth rate.

    Parameters
    ----------
    plan : Plan
        The test.
    margins : Margins
        Of it; they say how far the maps must reach.
    progress : callable, optional
        Called with what goes on, columns done and columns in all.

    Returns
    -------
    tuple of StabilityMap
        Over the dead time of the actuator's path in s, and over the model's stiffness over the
        true one.
    """
    each = time_of_one(plan)
    size = int(np.clip(np.sqrt(PATIENCE / 2 / each), COARSEST, FINEST))
    mass_ratios = np.linspace(0.0, _highest_mass_ratio(plan, margins), size)
    dead_times = np.linspace(0.0, _longest_dead_time(plan, margins), size)
    true = planned_stiffness(plan)
    factors = np.geomspace(min(0.5, true / 2), max(2.0, 2 * true), size)
    columns = [
        (float(ratio), name, others)
        for name, others in (("dead_time", dead_times), ("stiffness", factors / true))
        for ratio in mass_ratios
    ]
    found = []
    for growth in spread(plan, growth_column, columns, 2 * size * size * each):
        found.append(growth)
        if progress is not None:
            progress("map", len(found), len(columns))
    growth = np.column_stack(found)
    return (
        StabilityMap(mass_ratios, dead_times, growth[:, :size], (plan.mass_ratio, plan.dead_time)),
        StabilityMap(mass_ratios, factors, growth[:, size:], (plan.mass_ratio, true)),
    )


def _highest_mass_ratio(plan: Plan, margins: Margins) -> float:
    critical = margins.mass_ratio.value if margins.mass_ratio else 0.0
    shown = 2.0 * max(plan.mass_ratio, 0.5)
    return max(shown, 1.5 * critical if critical < 4 * shown else 0.0)


def _longest_dead_time(plan: Plan, margins: Margins) -> float:
    end = margins.dead_time
    longest = max(2 * plan.dead_time, 10 * plan.dt, 1.5 * end.value if end else 0.0)
    return min(longest, plan.dead_time + float(added_delays(plan)[-1]))


_Column = tuple[float, str, Floats]


def growth_column(plan: Plan, column: _Column) -> Floats:
    """Growth rates in 1/s at one mass ratio, over a quantity of `Plan.loop`; shape (q,)."""
    ratio, name, values = column
    loops = (plan.loop(mass_ratio=ratio, **{name: value}) for value in values)
    return np.array([loop.growth_rate() for loop in loops])
