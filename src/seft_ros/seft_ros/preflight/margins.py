"""How far a planned test is from instability."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.arrays import symmetric_matrix
from seft_msgs_py.errors import InputError

from seft_ros.loop_shaping.sampling import MAX_DELAY_STEPS
from seft_ros.preflight.plan import Plan
from seft_ros.preflight.search import NEUTRAL, stability_change

Floats = npt.NDArray[np.float64]
Progress = Callable[[str, int, int], None]

HIGHEST_MASS_RATIO = 50.0
LONGEST_DELAY = 0.1
"""Dead time up to which more of it is tried, s: several times that of any test rig."""
FACTORS: Floats = np.geomspace(1.0, 10.0, 17)
"""Factors by which the gain is tried, either way."""
STIFFEST = 3.0
"""Local stiffness over the told one up to which it is tried: a specimen that sticks or hardens."""


@dataclass(frozen=True)
class Critical:
    """Where stability ends.

    Attributes
    ----------
    value : float
        There.
    hz : float
        Frequency of the oscillation that sets in, Hz: angle of the critical eigenvalue.
    """

    value: float
    hz: float


@dataclass(frozen=True)
class Range:
    """Where a test stays stable about its plan; None where no end was found.

    Attributes
    ----------
    planned : float
        As planned.
    lowest, highest : Critical or None
        Ends.
    searched : tuple of float
        How far they were looked for.
    """

    planned: float
    lowest: Critical | None
    highest: Critical | None
    searched: tuple[float, float]

    def scaled(self, factor: float) -> "Range":
        """Multiply all values."""
        low, high = (
            end and Critical(factor * end.value, end.hz) for end in (self.lowest, self.highest)
        )
        searched = factor * self.searched[0], factor * self.searched[1]
        return Range(factor * self.planned, low, high, searched)

    def ends(self) -> list[Critical]:
        """Those that were found."""
        return [end for end in (self.lowest, self.highest) if end is not None]


@dataclass(frozen=True)
class Margins:
    """Margins of a test, each with all else as planned.

    Attributes
    ----------
    mass_ratio : Critical or None
        Smallest mass ratio above 0 at which it is unstable; 0 where any is. The method is made
        anew for each.
    dead_time : Critical or None
        Dead time of the rig's drive, s, at which it is unstable, the method not being told: from
        the plan up where the plan is stable, else from the plan down (0: unstable with none).
    gain : Range or None
        Factor on what the drive does; None where the plan is unstable.
    sure_dead_time : Critical or None
        Dead time up to which the test is stable whatever a controller that follows the valves
        takes them for, within its bounds. None where it does not, or no end was found.
    sure_gain : Range or None
        Likewise.
    stiffness : Range or None
        Local stiffness of the specimen over the one that the method is told. None where the plan
        is unstable, or the plant is identified as a whole.
    followed : Range or None
        Likewise, if the method has followed it. None where it does not; likewise:
    told_delay : Range or None
        Delay that the method is told, less the planned one, s.
    """

    mass_ratio: Critical | None
    dead_time: Critical | None
    gain: Range | None
    sure_dead_time: Critical | None
    sure_gain: Range | None
    stiffness: Range | None
    followed: Range | None
    told_delay: Range | None


def find_margins(plan: Plan, progress: Progress | None = None) -> Margins:
    """Find the margins of a plan by bracketing and Brent's method on exact eigenvalues.

    Parameters
    ----------
    plan : Plan
        The test.
    progress : callable, optional
        Called with what goes on, how many margins are known, and how many there are.

    Raises
    ------
    InputError
        If the method can't be made for the plan.
    """
    searches: dict[str, Callable[[Plan], Any]] = {
        "mass_ratio": critical_mass_ratio,
        "dead_time": critical_dead_time,
    }
    ranges: dict[str, Callable[[Plan], Any]] = {
        "gain": gain_range,
        "sure_dead_time": sure_dead_time,
        "sure_gain": sure_gain,
        "stiffness": stiffness_range,
        "followed": followed_range,
        "told_delay": told_delay_range,
    }
    found: dict[str, Any] = dict.fromkeys(ranges)
    if plan.growth_rate() <= NEUTRAL:
        searches |= ranges
    for done, (name, search) in enumerate(searches.items()):
        found[name] = search(plan)
        if progress is not None:
            progress("margins", done + 1, len(searches))
    return Margins(**found)


def critical_mass_ratio(plan: Plan) -> Critical | None:
    """Find the smallest mass ratio above 0 at which the test is unstable, see `Margins`."""
    tried = np.geomspace(0.01, HIGHEST_MASS_RATIO, 36)
    own = plan.mass_ratio * np.array([1.0, 1.1, 1.2])
    points = np.union1d(tried, own[(own > tried[0]) & (own < tried[-1])])
    if plan.growth_rate(mass_ratio=points[0]) > NEUTRAL:
        return _critical(plan, "mass_ratio", points[0], 0.0)
    return _end(plan, "mass_ratio", points)


def critical_dead_time(plan: Plan) -> Critical | None:
    """Find the dead time at which the test turns unstable, or stable again, see `Margins`."""
    if plan.growth_rate() <= NEUTRAL:
        return _end(plan, "dead_time", plan.dead_time + added_delays(plan))
    less = np.linspace(plan.dead_time, 0.0, 1 + max(8, int(2 * plan.dead_time / plan.dt)))
    return _end(plan, "dead_time", less) or _critical(plan, "dead_time", 0.0, 0.0)


def highest_gain(plan: Plan) -> Critical | None:
    """Find the factor on the drive above 1 at which a stable test turns unstable."""
    return _end(plan, "gain", FACTORS)


def gain_range(plan: Plan) -> Range:
    """Find the factor on the drive within which the test is stable."""
    return _range(plan, "gain", 1.0, FACTORS, 1.0 / FACTORS)


def sure_dead_time(plan: Plan) -> Critical | None:
    """Find the dead time up to which it is stable with all that is believed of the valves."""
    if not plan.follows_valves:
        return None
    if plan.growth_rate(any_valve=True) > NEUTRAL:
        return _critical(plan, "dead_time", plan.dead_time, plan.dead_time, any_valve=True)
    return _end(plan, "dead_time", plan.dead_time + added_delays(plan), any_valve=True)


def sure_gain(plan: Plan) -> Range | None:
    """Find the factor on the drive within which it is, likewise."""
    if not plan.follows_valves:
        return None
    return _range(plan, "gain", 1.0, FACTORS, 1.0 / FACTORS, any_valve=True)


def stiffness_range(plan: Plan) -> Range | None:
    """Find the local stiffness over the told one within which the test is stable."""
    return _local_stiffness(plan, followed=False)


def followed_range(plan: Plan) -> Range | None:
    """Find the same for a method that has followed the local stiffness."""
    return _local_stiffness(plan, followed=True) if plan.follows else None


def told_delay_range(plan: Plan) -> Range | None:
    """Find the error of the delay that the method is told within which the test is stable."""
    if not _uses_delay(plan):
        return None
    less = np.linspace(0.0, -plan.section["compensation.delay"], 17)[:-1]
    up, down = (_possible(plan, part.tolist()) for part in (added_delays(plan), less))
    return _range(plan, "told_delay", 0.0, np.array(up), np.array(down))


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


def _local_stiffness(plan: Plan, followed: bool) -> Range | None:
    """Sweep it from 0 to `STIFFEST` times the told one."""
    if not plan.rig.swept:
        return None
    own = local_stiffness(plan)
    up, down = np.linspace(own, max(STIFFEST, own), 17), np.linspace(own, 0.0, 17)
    found = _range(plan, "stiffness", 1.0, up / own, down / own, followed=followed)
    return found.scaled(own)


def _uses_delay(plan: Plan) -> bool:
    """Tell whether the filter changes with the delay that a method is told."""
    before = plan.compensation()
    return any(
        not np.array_equal(getattr(before, part), getattr(plan.compensation(told_delay=v), part))
        for v in _possible(plan, (0.1 * plan.dt, -0.1 * plan.dt))
        for part in ("a", "b", "c", "d")
    )


def _possible(plan: Plan, delays: Sequence[float]) -> list[float]:
    """Leave out, from the first on, what the method refuses to be told."""
    made = []
    for delay in delays:
        try:
            plan.compensation(told_delay=delay)
        except InputError:
            break
        made.append(delay)
    return made


def _range(plan: Plan, name: str, planned: float, up: Floats, down: Floats, **fixed: Any) -> Range:
    searched = float(down[-1]), float(up[-1])
    low, high = (_end(plan, name, points, **fixed) for points in (down, up))
    return Range(planned, low, high, searched)


def _end(plan: Plan, name: str, points: Floats, **fixed: Any) -> Critical | None:
    value = stability_change(
        lambda x: plan.growth_rate(**{name: float(x)}, **fixed), points.tolist()
    )
    return None if value is None else _critical(plan, name, value, value, **fixed)


def _critical(plan: Plan, name: str, place: float, value: float, **fixed: Any) -> Critical:
    z = plan.worst(**{name: float(place)}, **fixed)
    return Critical(float(value), float(np.angle(z)) / (2 * np.pi * plan.dt))
