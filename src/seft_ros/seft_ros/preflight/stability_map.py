"""Growth of a test over mass ratio and delay, and over mass ratio and model error."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import batched, groupby

import numpy as np
import numpy.typing as npt

from seft_ros.preflight.filter_grid import filters_over
from seft_ros.preflight.growth_rates import growth_rates
from seft_ros.preflight.margins import (
    Margins,
    Progress,
    added_delays,
    planned_stiffness,
)
from seft_ros.preflight.plan import Plan

Floats = npt.NDArray[np.float64]

PATIENCE = 60.0
"""Time of a processor that the maps may take, s; they get coarser where a loop is large."""
FINEST, COARSEST = 100, 15
ROWS = 20
"""Of a map that are calculated together: more of them take more memory."""


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
        Called with what goes on, rows done and rows in all.

    Returns
    -------
    tuple of StabilityMap
        Over the dead time of the actuator's path in s, and over the model's stiffness over the
        true one.
    """
    longest = _longest_dead_time(plan, margins)
    size = _size(plan, longest)
    mass_ratios = np.linspace(0.0, _highest_mass_ratio(plan, margins), size)
    dead_times = np.linspace(0.0, longest, size)
    true = planned_stiffness(plan)
    factors = np.geomspace(min(0.5, true / 2), max(2.0, 2 * true), size)

    def told(rows: int) -> None:
        if progress is not None:
            progress("map", rows, 2 * size)

    by_dead_time = over_dead_time(plan, mass_ratios, dead_times, told)
    by_stiffness = over_stiffness(plan, mass_ratios, factors / true)
    told(2 * size)
    return (
        StabilityMap(mass_ratios, dead_times, by_dead_time, (plan.mass_ratio, plan.dead_time)),
        StabilityMap(mass_ratios, factors, by_stiffness, (plan.mass_ratio, true)),
    )


def _highest_mass_ratio(plan: Plan, margins: Margins) -> float:
    critical = margins.mass_ratio.value if margins.mass_ratio else 0.0
    shown = 2.0 * max(plan.mass_ratio, 0.5)
    return max(shown, 1.5 * critical if critical < 4 * shown else 0.0)


def _longest_dead_time(plan: Plan, margins: Margins) -> float:
    end = margins.dead_time
    longest = max(2 * plan.dead_time, 10 * plan.dt, 1.5 * end.value if end else 0.0)
    return min(longest, plan.dead_time + float(added_delays(plan)[-1]))


def over_dead_time(
    plan: Plan, mass_ratios: Floats, dead_times: Floats, told: Callable[[int], None] | None = None
) -> Floats:
    """Growth rates in 1/s over mass ratio and dead time of the rig's drive, shape (q, p).

    ``told`` is called with the number of rows that are done.
    """
    filters = filters_over(plan, mass_ratios, np.ones(1))
    rows: list[Floats] = []
    # every sampling period more of dead time adds a state: rows of one size go together
    loops = (plan.loop_matrices(filters, float(dead_time))[0] for dead_time in dead_times)
    for _, alike in groupby(loops, lambda matrices: matrices.shape):
        for together in batched(alike, ROWS):
            rows.extend(growth_rates(np.array(together), plan.dt))
            if told is not None:
                told(len(rows))
    return np.array(rows)


def over_stiffness(plan: Plan, mass_ratios: Floats, factors: Floats) -> Floats:
    """Growth rates in 1/s over mass ratio and factor on the model's stiffness, shape (q, p)."""
    ends = filters_over(plan, mass_ratios[-1:], factors[[0, -1]])
    if all(np.array_equal(*part) for part in ends):  # the method does not use the stiffness
        filters = filters_over(plan, mass_ratios, np.ones(1))
        row = growth_rates(plan.loop_matrices(filters), plan.dt)
        return np.repeat(row, len(factors), axis=0)
    filters = filters_over(plan, mass_ratios, factors)
    return growth_rates(plan.loop_matrices(filters), plan.dt)


def _size(plan: Plan, longest: float) -> int:
    """Points along a side of each map: fewer where the loop is large."""
    loop = plan.loop(dead_time=longest)
    start = time.perf_counter()
    loop.growth_rate()
    each = time.perf_counter() - start
    return int(np.clip(np.sqrt(PATIENCE / 2 / each), COARSEST, FINEST))
