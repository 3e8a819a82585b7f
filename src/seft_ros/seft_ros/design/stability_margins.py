"""How far a planned test is from instability."""

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq
from seft_msgs_py.config.arrays import symmetric_matrix
from seft_msgs_py.errors import InputError

from seft_ros.design.plan import NEUTRAL, Plan
from seft_ros.design.plant import MAX_DELAY_STEPS

Floats = npt.NDArray[np.float64]
Progress = Callable[[str, int, int], None]

HIGHEST_MASS_RATIO = 50.0
LONGEST_DELAY = 0.1
"""Dead time up to which more of it is tried, s: several times that of any test rig."""
FACTORS: Floats = np.geomspace(1.0, 10.0, 17)
"""Factors by which the gain is tried, either way."""
STIFFEST = 3.0
"""Local stiffness over the told one up to which it is tried: a specimen that sticks or hardens."""
HALF_WIDTH = math.sqrt(2.0)
"""Factor between frequencies of instability and the edges of their band: half an octave."""


@dataclass(frozen=True)
class Critical:
    """Where stability ends, and the frequency of the oscillation that sets in there, Hz."""

    value: float
    hz: float


@dataclass(frozen=True)
class Range:
    """Where a test stays stable about its plan.

    Attributes
    ----------
    planned : float
        As planned.
    lowest, highest : Critical or None
        Ends; None where none was found.
    searched : tuple of float
        How far they were looked for.
    """

    planned: float
    lowest: Critical | None
    highest: Critical | None
    searched: tuple[float, float]

    def ends(self) -> list[Critical]:
        """Those that were found."""
        return [end for end in (self.lowest, self.highest) if end is not None]


@dataclass(frozen=True)
class Margins:
    """Margins of a test, each with all else as planned; of an unstable plan only the first two.

    Attributes
    ----------
    mass_ratio : Critical or None
        Smallest mass ratio above 0 at which it is unstable; 0 where any is. The method is made
        anew for each.
    dead_time : Critical or None
        Dead time of the rig's drive, s, at which it is unstable, the method not being told: from
        the plan up where the plan is stable, else from the plan down (0: unstable with none).
    gain : Range or None
        Factor on what the drive does.
    sure_dead_time : Critical or None
        Dead time up to which the test is stable whatever a controller that follows the valves
        takes them for, within its bounds. None where it does not, or no end was found.
    sure_gain : Range or None
        Likewise.
    stiffness : Range or None
        Local stiffness of the specimen over the one that the method is told. None where the
        plant is identified as a whole.
    followed : Range or None
        Likewise, if the method has followed it. None where it does not.
    told_delay : Range or None
        Delay that the method is told, less the planned one, s. None where it uses none.
    """

    mass_ratio: Critical | None
    dead_time: Critical | None
    gain: Range | None = None
    sure_dead_time: Critical | None = None
    sure_gain: Range | None = None
    stiffness: Range | None = None
    followed: Range | None = None
    told_delay: Range | None = None


def find_margins(plan: Plan, progress: Progress | None = None) -> Margins:
    """Find the margins of a plan by bracketing and Brent's method on exact eigenvalues.

    ``progress`` is called with what goes on, how many margins are known, and how many there are.
    An InputError says if the method can't be made for the plan.
    """
    searches: dict[str, Callable[[], Any]] = {
        "mass_ratio": lambda: critical_mass_ratio(plan),
        "dead_time": lambda: critical_dead_time(plan),
    }
    if plan.is_stable():
        searches["gain"] = lambda: _range(plan, "gain", 1.0, FACTORS, 1.0 / FACTORS)
        if plan.follows_valves:
            searches["sure_dead_time"] = lambda: _sure_dead_time(plan)
            searches["sure_gain"] = lambda: _range(
                plan, "gain", 1.0, FACTORS, 1.0 / FACTORS, any_valve=True
            )
        if plan.rig.swept:
            searches["stiffness"] = lambda: _local_stiffness(plan, followed=False)
            if plan.follows:
                searches["followed"] = lambda: _local_stiffness(plan, followed=True)
        searches["told_delay"] = lambda: _told_delay(plan)
    found: dict[str, Any] = {}
    for name, search in searches.items():
        found[name] = search()
        if progress is not None:
            progress("margins", len(found), len(searches))
    return Margins(**found)


def critical_mass_ratio(plan: Plan) -> Critical | None:
    """Find the smallest mass ratio above 0 at which the test is unstable, see `Margins`."""
    tried = np.geomspace(0.01, HIGHEST_MASS_RATIO, 36)
    own = plan.mass_ratio * np.array([1.0, 1.1, 1.2])
    points = np.union1d(tried, own[(own > tried[0]) & (own < tried[-1])])
    if not plan.is_stable(mass_ratio=points[0]):
        return _critical(plan, "mass_ratio", points[0], 0.0)
    return _end(plan, "mass_ratio", points)


def critical_dead_time(plan: Plan) -> Critical | None:
    """Find the dead time at which the test turns unstable, or stable again, see `Margins`."""
    if plan.is_stable():
        return _end(plan, "dead_time", plan.dead_time + added_delays(plan))
    less = np.linspace(plan.dead_time, 0.0, 1 + max(8, int(2 * plan.dead_time / plan.dt)))
    return _end(plan, "dead_time", less) or _critical(plan, "dead_time", 0.0, 0.0)


def instability_band(plan: Plan) -> tuple[float, float] | None:
    """Find the band in which oscillations set in as the loop loses its margins, Hz.

    It spans the frequencies at which the loop turns unstable with more gain and with more dead
    time, and of an unstable plan that of its fastest growing oscillation, and half an octave on
    either side, up to Nyquist's. None: it stays stable as far as was looked, or what grows does
    not oscillate.
    """
    stable = plan.is_stable()
    ends = [_end(plan, "gain", FACTORS)] if stable else []
    found = [end.hz for end in (*ends, critical_dead_time(plan)) if end is not None]
    if not stable:
        found.append(abs(cmath.phase(plan.worst())) / math.tau / plan.dt)
    oscillating = [hz for hz in found if hz > 0]
    if not oscillating:
        return None
    nyquist = 0.5 / plan.dt
    return min(oscillating) / HALF_WIDTH, min(max(oscillating) * HALF_WIDTH, nyquist)


def local_stiffness(plan: Plan) -> float:
    """Give the specimen's stiffness over the told one; over several axes the diagonals' sums'."""
    model = symmetric_matrix(
        plan.section["model.stiffness"], plan.axes, "reference_force: model.stiffness"
    )
    return float(np.trace(plan.rig.specimen.stiffness) / np.trace(model))


def added_delays(plan: Plan) -> Floats:
    """Delays to be added to the planned ones, from 0 up, s."""
    longest = min(LONGEST_DELAY, MAX_DELAY_STEPS * plan.dt - plan.dead_time)
    if longest <= 0:
        return np.zeros(1)
    return np.concatenate([[0.0], np.geomspace(min(plan.dt / 8, longest / 2), longest, 28)])


def stability_change(growth: Callable[[float], float], points: Sequence[float]) -> float | None:
    """First place along some points where a loop turns from stable to unstable, or back.

    ``growth`` gives the growth rate of the loop in 1/s at a place; the points ascend or descend.
    Two neighbours bracket the change, Brent's method narrows it: what begins and ends between
    two is not seen. None: nothing changes up to the last point.
    """

    def excess(place: float) -> float:
        return growth(place) - NEUTRAL

    before = excess(points[0])
    for near, far in pairwise(points):
        after = excess(far)
        if (before > 0) != (after > 0):
            return float(brentq(excess, near, far, xtol=1e-9 + 1e-6 * abs(far - near), rtol=1e-6))
        before = after
    return None


def _sure_dead_time(plan: Plan) -> Critical | None:
    if not plan.is_stable(any_valve=True):
        return _critical(plan, "dead_time", plan.dead_time, plan.dead_time, any_valve=True)
    return _end(plan, "dead_time", plan.dead_time + added_delays(plan), any_valve=True)


def _local_stiffness(plan: Plan, followed: bool) -> Range:
    """Sweep it from 0 to `STIFFEST` times the told one."""
    own = local_stiffness(plan)
    up, down = np.linspace(own, max(STIFFEST, own), 17), np.linspace(own, 0.0, 17)
    found = _range(plan, "stiffness", 1.0, up / own, down / own, followed=followed)
    low, high = (end and Critical(own * end.value, end.hz) for end in (found.lowest, found.highest))
    searched = own * found.searched[0], own * found.searched[1]
    return Range(own * found.planned, low, high, searched)


def _told_delay(plan: Plan) -> Range | None:
    """Range of the error of the told delay, as far as the method takes it; None: it uses none."""

    def possible(delays: Sequence[float]) -> list[float]:
        made = []
        for delay in delays:
            try:
                plan.compensation(told_delay=delay)
            except InputError:
                break
            made.append(delay)
        return made

    before = plan.compensation()
    if all(
        np.array_equal(getattr(before, part), getattr(plan.compensation(told_delay=delay), part))
        for delay in possible((0.1 * plan.dt, -0.1 * plan.dt))
        for part in ("a", "b", "c", "d")
    ):
        return None
    less = np.linspace(0.0, -plan.section["compensation.delay"], 17)[:-1]
    up, down = (np.array(possible(part.tolist())) for part in (added_delays(plan), less))
    return _range(plan, "told_delay", 0.0, up, down)


def _range(plan: Plan, name: str, planned: float, up: Floats, down: Floats, **fixed: Any) -> Range:
    low, high = (_end(plan, name, points, **fixed) for points in (down, up))
    return Range(planned, low, high, (float(down[-1]), float(up[-1])))


def _end(plan: Plan, name: str, points: Floats, **fixed: Any) -> Critical | None:
    value = stability_change(
        lambda x: plan.growth_rate(**{name: float(x)}, **fixed), points.tolist()
    )
    return None if value is None else _critical(plan, name, value, value, **fixed)


def _critical(plan: Plan, name: str, place: float, value: float, **fixed: Any) -> Critical:
    z = plan.worst(**{name: float(place)}, **fixed)
    return Critical(float(value), float(np.angle(z)) / (2 * np.pi * plan.dt))
