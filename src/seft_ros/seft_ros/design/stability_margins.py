"""How far a planned test is from instability."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, takewhile
from typing import Any

import numpy as np
from scipy.optimize import brentq
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.parameter_table import symmetric_matrix
from seft_msgs_py.errors import InputError

from seft_ros.design.planned_tests import NEUTRAL, PlannedTest
from seft_ros.design.plant import MAX_DELAY_STEPS

Progress = Callable[[str, int, int], None]

HIGHEST_MASS_RATIO = 50.0
_LONGEST_DELAY = 0.1
"""Longest dead time that is tried, s: several times that of any test rig."""
_FACTORS: Floats = np.geomspace(1.0, 10.0, 17)
"""Factors on the gain that are tried, and their inverses."""
STIFFEST = 3.0
"""Largest ratio of local to assumed stiffness that is tried: a specimen that sticks or hardens."""
HALF_WIDTH = math.sqrt(2.0)
"""Factor between frequencies of instability and the edges of their band: half an octave."""


@dataclass(frozen=True)
class Critical:
    """Where stability ends, and the frequency of the oscillation there, Hz."""

    value: float
    hz: float


@dataclass(frozen=True)
class Range:
    """Range of a quantity about its planned value in which a test is stable.

    Attributes
    ----------
    planned : float
        As planned.
    lowest, highest : Critical or None
        Ends; None if none was found.
    searched : tuple of float
        Lowest and highest value that were tried.
    """

    planned: float
    lowest: Critical | None
    highest: Critical | None
    searched: tuple[float, float]

    def ends(self) -> list[Critical]:
        """Give the ends that were found."""
        return [end for end in (self.lowest, self.highest) if end is not None]


@dataclass(frozen=True)
class Margins:
    """Margins of a test, each with all else as planned; of an unstable test only the first two.

    Attributes
    ----------
    mass_ratio : Critical or None
        Smallest mass ratio above 0 at which it is unstable; 0 if it is unstable at any. The
        method is made anew for each.
    dead_time : Critical or None
        Dead time of the rig's drive, s, at which it is unstable, while the method assumes the
        planned one: larger than planned if the planned test is stable, else smaller (0: unstable at
        any).
    gain : Range or None
        Factor on the drive.
    sure_dead_time : Critical or None
        Dead time up to which the test is stable whatever a controller that adapts to the valves
        assumes within its bounds. None if it does not adapt, or no end was found.
    robust_gain : Range or None
        Likewise.
    stiffness : Range or None
        Local stiffness of the specimen over the assumed one. None if the plant was identified as
        a whole, or one of them is 0.
    followed : Range or None
        Likewise, when the method has adapted to it. None if it does not adapt.
    delay_error : Range or None
        Assumed delay less the planned one, s. None if the method uses no delay.
    """

    mass_ratio: Critical | None
    dead_time: Critical | None
    gain: Range | None = None
    sure_dead_time: Critical | None = None
    robust_gain: Range | None = None
    stiffness: Range | None = None
    followed: Range | None = None
    delay_error: Range | None = None


def find_margins(test: PlannedTest, progress: Progress | None = None) -> Margins:
    """Find the margins of a planned test by bracketing and Brent's method on exact eigenvalues.

    ``progress`` is called with what is searched, how many margins are known, and how many there
    are. An InputError says if the method can't be made for the planned test.
    """
    searches: dict[str, Callable[[], Any]] = {
        "mass_ratio": partial(critical_mass_ratio, test),
        "dead_time": partial(critical_dead_time, test),
    }
    if test.is_stable():
        gain = partial(_range, test, "gain", 1.0, _FACTORS, 1.0 / _FACTORS)
        searches["gain"] = gain
        if test.follows_valves:
            searches["sure_dead_time"] = partial(_sure_dead_time, test)
            searches["robust_gain"] = partial(gain, any_valve=True)
        own = local_stiffness(test)
        if own is not None:
            up, down = np.linspace(own, max(STIFFEST, own), 17), np.linspace(own, 0.0, 17)
            stiffness = partial(_range, test, "stiffness", own, up, down, own)
            searches["stiffness"] = stiffness
            if test.follows:
                searches["followed"] = partial(stiffness, followed=True)
        searches["delay_error"] = partial(_delay_error, test)
    found: dict[str, Any] = {}
    for name, search in searches.items():
        found[name] = search()
        if progress is not None:
            progress("margins", len(found), len(searches))
    return Margins(**found)


def critical_mass_ratio(test: PlannedTest) -> Critical | None:
    """Find the smallest mass ratio above 0 at which the test is unstable, see `Margins`."""
    tried = np.geomspace(0.01, HIGHEST_MASS_RATIO, 36)
    own = test.mass_ratio * np.array([1.0, 1.1, 1.2])
    points = np.union1d(tried, own[(own > tried[0]) & (own < tried[-1])])
    if not test.is_stable(mass_ratio=points[0]):
        return Critical(0.0, test.hz(mass_ratio=points[0]))
    return _end(test, "mass_ratio", points)


def critical_dead_time(test: PlannedTest) -> Critical | None:
    """Find the dead time at which the test turns unstable, or stable again, see `Margins`."""
    if test.is_stable():
        return _end(test, "dead_time", test.dead_time + added_delays(test))
    less = np.linspace(test.dead_time, 0.0, 1 + max(8, int(2 * test.dead_time / test.dt)))
    return _end(test, "dead_time", less) or Critical(0.0, test.hz(dead_time=0.0))


def instability_band(test: PlannedTest) -> tuple[float, float] | None:
    """Find the band of the oscillations of a loop that loses its margins, Hz.

    It spans the frequencies at which the loop turns unstable with more gain and with more dead
    time, and of an unstable test that of its fastest growing oscillation, and half an octave on
    either side, up to Nyquist's. None: no instability was found, or it does not oscillate.
    """
    stable = test.is_stable()
    ends = [_end(test, "gain", _FACTORS)] if stable else []
    found = [end.hz for end in (*ends, critical_dead_time(test)) if end is not None]
    if not stable:
        found.append(test.hz())
    oscillating = [hz for hz in found if hz > 0]
    if not oscillating:
        return None
    nyquist = 0.5 / test.dt
    return min(oscillating) / HALF_WIDTH, min(max(oscillating) * HALF_WIDTH, nyquist)


def local_stiffness(test: PlannedTest) -> float | None:
    """Stiffness of the specimen over the assumed one, with several axes the ratio of the traces.

    None if one of them is 0.
    """
    model = symmetric_matrix(
        test.section["specimen.stiffness"], test.axes, "/**: specimen.stiffness"
    )
    own, assumed = float(np.trace(test.rig.specimen.stiffness)), float(np.trace(model))
    return own / assumed if own and assumed else None


def added_delays(test: PlannedTest) -> Floats:
    """Delays to be added to the planned ones, from 0 up, s."""
    longest = min(_LONGEST_DELAY, MAX_DELAY_STEPS * test.dt - test.dead_time)
    if longest <= 0:
        return np.zeros(1)
    return np.concatenate([[0.0], np.geomspace(min(test.dt / 8, longest / 2), longest, 28)])


def stability_change(growth: Callable[[float], float], points: Sequence[float]) -> float | None:
    """First value along some points at which a loop turns from stable to unstable, or back.

    ``growth`` gives the growth rate of the loop in 1/s; the points ascend or descend. Two
    neighbours bracket the change, Brent's method narrows it: two changes between neighbours are
    missed. None: nothing changes up to the last point.
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


def _sure_dead_time(test: PlannedTest) -> Critical | None:
    if not test.is_stable(any_valve=True):
        return Critical(test.dead_time, test.hz(any_valve=True))
    return _end(test, "dead_time", test.dead_time + added_delays(test), any_valve=True)


def _delay_error(test: PlannedTest) -> Range | None:
    """Range of the error in the assumed delay, as far as the method can be made; None: unused."""

    def matrix(error: float) -> Floats | None:
        """Matrix of the method with this error; None: it can't be made."""
        try:
            return test.compensation(delay_error=error).matrix()
        except InputError:
            return None

    planned = test.compensation().matrix()
    tried = [matrix(error) for error in (0.1 * test.dt, -0.1 * test.dt)]
    if all(found is None or np.array_equal(found, planned) for found in tried):
        return None
    less = np.linspace(0.0, -test.assumed_delay, 17)[:-1]
    up, down = (
        np.array(list(takewhile(lambda error: matrix(error) is not None, part.tolist())))
        for part in (added_delays(test), less)
    )
    return _range(test, "delay_error", 0.0, up, down)


def _range(
    test: PlannedTest,
    name: str,
    planned: float,
    up: Floats,
    down: Floats,
    unit: float = 1.0,
    **fixed: Any,
) -> Range:
    low, high = (_end(test, name, points, unit, **fixed) for points in (down, up))
    return Range(planned, low, high, (float(down[-1]), float(up[-1])))


def _end(
    test: PlannedTest, name: str, points: Floats, unit: float = 1.0, **fixed: Any
) -> Critical | None:
    """First end of stability along some values; ``unit`` is the one at which ``name`` is 1."""

    def growth(value: float) -> float:
        return test.growth_rate(**{name: value / unit}, **fixed)

    value = stability_change(growth, points.tolist())
    return None if value is None else Critical(value, test.hz(**{name: value / unit}, **fixed))
