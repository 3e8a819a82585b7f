"""Growth of a test over mass ratio and dead time, and over mass ratio and local stiffness."""

import time
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from seft_ros.preflight.margins import (
    STIFFEST,
    Margins,
    Progress,
    added_delays,
    local_stiffness,
)
from seft_ros.preflight.plan import Plan

Floats = npt.NDArray[np.float64]

PATIENCE = 6.0
"""Time that the maps may take, s; they get coarser where a loop is large."""
FINEST, COARSEST = 40, 10


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
) -> list[StabilityMap]:
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
    list of StabilityMap
        Over the dead time of the actuator's path in s, and, unless the plant is identified as a
        whole, over the specimen's local stiffness over the told one, which the method believes.
    """
    longest, own = _longest_dead_time(plan, margins), local_stiffness(plan)
    swept = {"dead_time": (0.0, longest, 1.0, plan.dead_time)}
    if plan.rig.swept:
        swept["stiffness"] = (0.0, max(STIFFEST, 1.2 * own), own, own)
    size = _size(plan, longest, len(swept))
    mass_ratios = np.linspace(0.0, _highest_mass_ratio(plan, margins), size)
    maps = []
    for done, (name, (low, high, unit, planned)) in enumerate(swept.items()):
        others, rows = np.linspace(low, high, size), []
        for value in others / unit:
            rows.append(growth_rates(plan, mass_ratios, {name: float(value)}))
            if progress is not None:
                progress("map", done * size + len(rows), len(swept) * size)
        maps.append(StabilityMap(mass_ratios, others, np.array(rows), (plan.mass_ratio, planned)))
    return maps


def growth_rates(plan: Plan, mass_ratios: Floats, changes: dict[str, float]) -> Floats:
    """Growth rates at some mass ratios, see `Plan.loops`; shape (p,), 1/s."""
    return np.array([plan.growth_rate(mass_ratio=float(ratio), **changes) for ratio in mass_ratios])


def _highest_mass_ratio(plan: Plan, margins: Margins) -> float:
    critical = margins.mass_ratio.value if margins.mass_ratio else 0.0
    shown = 2.0 * max(plan.mass_ratio, 0.5)
    return max(shown, 1.5 * critical if critical < 4 * shown else 0.0)


def _longest_dead_time(plan: Plan, margins: Margins) -> float:
    end = margins.dead_time
    longest = max(2 * plan.dead_time, 10 * plan.dt, 1.5 * end.value if end else 0.0)
    return min(longest, plan.dead_time + float(added_delays(plan)[-1]))


def _size(plan: Plan, longest: float, maps: int) -> int:
    """Points along a side of each map: fewer where the loop is large."""
    plan.growth_rate(dead_time=longest)  # what is made once for a row or a column
    start = time.perf_counter()
    plan.growth_rate(dead_time=longest)
    each = time.perf_counter() - start
    return int(np.clip(np.sqrt(PATIENCE / maps / each), COARSEST, FINEST))
