"""How far a planned test is from instability."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import symmetric_matrix
from seft_msgs_py.errors import InputError

from seft_ros.loop_shaping.sampling import MAX_DELAY_STEPS
from seft_ros.preflight.plan import Plan
from seft_ros.preflight.search import NEUTRAL, stability_change
from seft_ros.preflight.spreading import spread, time_of_one

Floats = npt.NDArray[np.float64]
Progress = Callable[[str, int, int], None]

HIGHEST_MASS_RATIO = 50.0
LONGEST_DELAY = 0.1
"""Dead time up to which more of it is tried, s: several times that of any test rig."""
GROWTHS = 50
"""About as many growth rates does a margin take."""
FACTORS: Floats = np.geomspace(1.0, 10.0, 17)
"""Factors by which stiffness and gain are tried, either way."""


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
    stiffness : Range or None
        Stiffness that the method is told over the true one. None where the plan is unstable, or
        the method does not use it; likewise:
    told_delay : Range or None
        Delay that the method is told, less the planned one, s.
    """

    mass_ratio: Critical | None
    dead_time: Critical | None
    gain: Range | None
    stiffness: Range | None
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
    stable = plan.loop().growth_rate() <= NEUTRAL
    names = [name for name, (_, of_unstable) in _SEARCHES.items() if stable or of_unstable]
    expected = GROWTHS * len(names) * time_of_one(plan)
    found: dict[str, Any] = dict.fromkeys(_SEARCHES)
    for done, margin in enumerate(spread(plan, _margin, names, expected)):
        found[names[done]] = margin
        if progress is not None:
            progress("margins", done + 1, len(names))
    return Margins(**found)


def _margin(plan: Plan, name: str) -> Critical | Range | None:
    search, _ = _SEARCHES[name]
    return search(plan)


def critical_mass_ratio(plan: Plan) -> Critical | None:
    """Find the smallest mass ratio above 0 at which the test is unstable, see `Margins`."""
    tried = np.geomspace(0.01, HIGHEST_MASS_RATIO, 36)
    own = plan.mass_ratio * np.array([1.0, 1.1, 1.2])
    points = np.union1d(tried, own[(own > tried[0]) & (own < tried[-1])])
    if plan.loop(mass_ratio=points[0]).growth_rate() > NEUTRAL:
        return _critical(plan, "mass_ratio", points[0], 0.0)
    return _end(plan, "mass_ratio", points)


def critical_dead_time(plan: Plan) -> Critical | None:
    """Find the dead time at which the test turns unstable, or stable again, see `Margins`."""
    if plan.loop().growth_rate() <= NEUTRAL:
        return _end(plan, "dead_time", plan.dead_time + added_delays(plan))
    less = np.linspace(plan.dead_time, 0.0, 1 + max(8, int(2 * plan.dead_time / plan.dt)))
    return _end(plan, "dead_time", less) or _critical(plan, "dead_time", 0.0, 0.0)


def highest_gain(plan: Plan) -> Critical | None:
    """Find the factor on the drive above 1 at which a stable test turns unstable."""
    return _end(plan, "gain", FACTORS)


def gain_range(plan: Plan) -> Range:
    """Find the factor on the drive within which the test is stable."""
    return _range(plan, "gain", 1.0, FACTORS, 1.0 / FACTORS)


def stiffness_range(plan: Plan) -> Range | None:
    """Find the model stiffness over the true one within which the test is stable."""
    if not _uses(plan, "stiffness", (1.1,)):
        return None
    found = _range(plan, "stiffness", 1.0, FACTORS, 1.0 / FACTORS)
    return found.scaled(planned_stiffness(plan))


def told_delay_range(plan: Plan) -> Range | None:
    """Find the error of the delays that the method is told within which the test is stable."""
    if not _uses(plan, "told_delay", (0.1 * plan.dt, -0.1 * plan.dt)):
        return None
    told = max(plan.section["compensation.delay"], plan.section["tracking.dead_time"])
    less = np.linspace(0.0, -told, 17)[:-1]
    return _range(plan, "told_delay", 0.0, added_delays(plan), less)


_SEARCHES: dict[str, tuple[Callable[[Plan], Critical | Range | None], bool]] = {
    "mass_ratio": (critical_mass_ratio, True),
    "dead_time": (critical_dead_time, True),
    "gain": (gain_range, False),
    "stiffness": (stiffness_range, False),
    "told_delay": (told_delay_range, False),
}
"""How each margin is found, and whether an unstable plan has it, too."""


def planned_stiffness(plan: Plan) -> float:
    """Give the model's stiffness over the true one; over several axes the mean of the diagonal."""
    model = symmetric_matrix(
        plan.section["model.stiffness"], plan.axes, "reference_force: model.stiffness"
    )
    return float(np.trace(model) / np.trace(plan.rig.specimen.stiffness))


def added_delays(plan: Plan) -> Floats:
    """Delays to be added to the planned ones, from 0 up, s."""
    longest = min(LONGEST_DELAY, MAX_DELAY_STEPS * plan.dt - plan.dead_time)
    if longest <= 0:
        return np.zeros(1)
    return np.concatenate([[0.0], np.geomspace(min(plan.dt / 8, longest / 2), longest, 28)])


def _uses(plan: Plan, name: str, values: Sequence[float]) -> bool:
    """Tell whether the filter changes with what a method is told."""
    before = plan.compensation()
    return any(
        not np.array_equal(getattr(before, part), getattr(plan.compensation(**{name: value}), part))
        for value in _possible(plan, name, values)
        for part in ("a", "b", "c", "d")
    )


def _possible(plan: Plan, name: str, values: Sequence[float]) -> list[float]:
    """Leave out, from the first on, what the method refuses to be told."""
    made = []
    for value in values:
        try:
            plan.compensation(**{name: value})
        except InputError:
            break
        made.append(value)
    return made


def _range(plan: Plan, name: str, planned: float, up: Floats, down: Floats) -> Range:
    if name in ("stiffness", "told_delay"):
        up, down = (np.array(_possible(plan, name, part.tolist())) for part in (up, down))
    searched = float(down[-1]), float(up[-1])
    return Range(planned, _end(plan, name, down), _end(plan, name, up), searched)


def _end(plan: Plan, name: str, points: Floats) -> Critical | None:
    value = stability_change(lambda x: plan.loop(**{name: x}).growth_rate(), points.tolist())
    return None if value is None else _critical(plan, name, value, value)


def _critical(plan: Plan, name: str, place: float, value: float) -> Critical:
    z = plan.loop(**{name: place}).dominant()
    return Critical(float(value), float(np.angle(z)) / (2 * np.pi * plan.dt))
