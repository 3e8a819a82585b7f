"""How far a planned test is from instability, and how far the verdict needs it to be."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, takewhile
from typing import Any

import numpy as np
from scipy.optimize import brentq
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.parameter_table import symmetric_matrix
from seft_msgs_py.errors import InputError
from seft_plant_sim.judge.valve_following import LARGEST_DELAY_ERROR, LARGEST_GAIN_ERROR

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
            stiffness = partial(_range, test, "stiffness", own, up, down, unit=own)
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
    ends = critical_dead_time(test), _end(test, "gain", _FACTORS) if stable else None
    found = [*(end.hz for end in ends if end), 0.0 if stable else test.hz()]
    oscillating = [hz for hz in found if hz > 0]
    if not oscillating:
        return None
    return min(oscillating) / HALF_WIDTH, min(max(oscillating) * HALF_WIDTH, 0.5 / test.dt)


def local_stiffness(test: PlannedTest) -> float | None:
    """Stiffness of the specimen over the assumed one, with several axes the ratio of the traces.

    None if one of them is 0.
    """
    name = "specimen.stiffness"
    model = symmetric_matrix(test.section[name], test.axes, f"/**: {name}")
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
    test: PlannedTest, name: str, planned: float, up: Floats, down: Floats, **how: Any
) -> Range:
    low, high = (_end(test, name, points, **how) for points in (down, up))
    return Range(planned, low, high, (float(down[-1]), float(up[-1])))


def _end(
    test: PlannedTest, name: str, points: Floats, unit: float = 1.0, **fixed: Any
) -> Critical | None:
    """First end of stability along some values; ``unit`` is the one at which ``name`` is 1."""

    def growth(value: float) -> float:
        return test.growth_rate(**{name: value / unit}, **fixed)

    value = stability_change(growth, points.tolist())
    return None if value is None else Critical(value, test.hz(**{name: value / unit}, **fixed))


MASS_RATIO_RESERVE = 1.2
"""Critical over planned mass ratio: load cells, accelerometers and the mass itself are known to
some percent each, and oscillations so near the end of stability take long to decay."""
GAIN_RESERVE = 1.2
"""Factor on the drive, either way: a valve's flow gain falls by a sixth if the load takes 30 % of
the supply pressure, and rises as much with a leakage or temperature that was not identified."""
DELAY_RESERVE_STEPS = 1.0
"""Added delay in samples: in pace `realtime` an answer may come a sample late."""
STIFFNESS_RESERVE = 1.1
"""Factor on the specimen's stiffness, either way: the accuracy of a quick identification. A
method that adapts to it must be stable at any stiffness that is tried."""
ASSUMED_DELAY_RESERVE_STEPS = 0.5
"""Error in the assumed delay in samples, either way: half a sample is the delay of the hold."""

ANY_VALVE = "with any assumed valve"
ANY_VALVE_MEANS = (
    f"{ANY_VALVE}: during a test the controller estimates the valve's flow gain and delay. These "
    f"rows are the worst of all that it may assume: a gain up to {100 * LARGEST_GAIN_ERROR:g} % "
    f"and a delay up to {1e3 * LARGEST_DELAY_ERROR:g} ms off, either way."
)
DECIDES = "!"
"""Mark of the ends that decide a verdict, in tables and figures."""
DECIDES_MEANS = f"{DECIDES}: not as needed, which decides the verdict."
COLUMNS_MEAN = (
    "critical: the test turns unstable there, all else as planned; < and >: not up to there; "
    "needed: what a stable verdict asks for."
)
HEADINGS = ("", "planned", "critical", "needed", "oscillates at")
MASS_RATIO, DEAD_TIME = "mass ratio", "actuator's dead time"
LOCAL_STIFFNESS = "local stiffness / assumed"


@dataclass(frozen=True)
class MarginEnd:
    """One end of a margin.

    Attributes
    ----------
    name, more : str
        What is changed, and in which case, if it is not the plain one.
    unit : str
        ``ms``, or empty.
    planned : float or None
        As planned, in SI; None: it was not searched.
    critical : Critical or None
        Where stability ends; None: nowhere up to ``searched``.
    searched : float
        How far it was searched.
    is_upper : bool
        Whether it is the upper end.
    needed : float or None
        What ``critical`` must be beyond for a stable verdict, infinite: there must be no end. None:
        it does not count.
    """

    name: str
    more: str
    unit: str
    planned: float | None = None
    critical: Critical | None = None
    searched: float = 0.0
    is_upper: bool = True
    needed: float | None = None

    @property
    def decides(self) -> bool:
        """Whether a stable verdict is missed here."""
        if self.critical is None or self.needed is None:
            return False
        value = self.critical.value
        return value <= self.needed if self.is_upper else value > self.needed

    @property
    def reason(self) -> str:
        """Say what is missed."""
        name = f"{self.name}, {self.more}" if self.more else self.name
        return f"{name}: unstable at {self._critical()}, needed {self._needed()}"

    def texts(self) -> list[str]:
        """Write it under `HEADINGS`."""
        label = f"the same, {self.more}" if self.more else self.name
        if self.planned is None:
            return [label, "", "not used", "", ""]
        mark = f"{DECIDES} " if self.decides else ""
        hz = "" if self.critical is None else f"{self.critical.hz:.3g} Hz"
        ends = f"{mark}{self._critical()}", self._needed(), hz
        return [label, self._text(self.planned, ".3g"), *ends]

    def _critical(self) -> str:
        if self.critical is not None:
            return self._text(self.critical.value, ".4g")
        return f"{'>' if self.is_upper else '<'} {self._text(self.searched, '.3g')}"

    def _needed(self) -> str:
        if self.needed is None:
            return ""
        if self.needed in (0.0, np.inf):
            return "no end"
        return f"{'>' if self.is_upper else '<'} {self._text(self.needed, '.4g')}"

    def _text(self, value: float, form: str) -> str:
        return f"{(1e3 if self.unit else 1.0) * value:{form}} {self.unit}".rstrip()


def end_texts(ends: Sequence[MarginEnd]) -> list[list[str]]:
    """Write ends under `HEADINGS`; the upper end of a margin repeats its name if it decides."""
    rows = [end.texts() for end in ends]
    repeated = [False, *(before[:2] == row[:2] for before, row in pairwise(rows))]
    return [
        ["", "", *row[2:]] if is_repeated and not end.decides else row
        for end, row, is_repeated in zip(ends, rows, repeated, strict=True)
    ]


def meanings(ends: Sequence[MarginEnd]) -> list[str]:
    """Explain the columns, the marks and the cases that occur among some ends."""
    said = {
        COLUMNS_MEAN: True,
        DECIDES_MEANS: any(end.decides for end in ends),
        ANY_VALVE_MEANS: any(end.more == ANY_VALVE for end in ends),
    }
    return [text for text, is_said in said.items() if is_said]


def margin_ends(test: PlannedTest, margins: Margins) -> Iterator[MarginEnd]:
    """Give the ends of all margins as far as they were searched, and what is not used.

    Each is needed with a reserve, all else as planned; with the worst valve that a controller may
    assume, the planned test itself must be stable.
    """
    alpha, dead_time, dt = test.mass_ratio, test.dead_time, test.dt
    own = margins.stiffness.planned if margins.stiffness else 1.0
    error, longest = ASSUMED_DELAY_RESERVE_STEPS * dt, dead_time + float(added_delays(test)[-1])

    def up_to(planned: float, end: Critical | None, searched: float) -> Range:
        return Range(planned, None, end, (planned, searched))

    of_alpha = None, MASS_RATIO_RESERVE * alpha or None
    of_time = None, dead_time + DELAY_RESERVE_STEPS * dt
    of_gain = 1 / GAIN_RESERVE, GAIN_RESERVE
    gain = "actuator's gain"
    mass_ratio = up_to(alpha, margins.mass_ratio, HIGHEST_MASS_RATIO)
    late, sure = (
        up_to(dead_time, end, longest) for end in (margins.dead_time, margins.sure_dead_time)
    )
    yield from _ends(MASS_RATIO, "", "", mass_ratio, of_alpha)
    any_valve = margins.robust_gain is not None
    yield from _ends(DEAD_TIME, "", "ms", late, of_time)
    if margins.gain is None:  # of an unstable test the others were not searched
        return
    if any_valve:
        yield from _ends(DEAD_TIME, ANY_VALVE, "ms", sure, (None, dead_time))
    yield from _ends(gain, "", "", margins.gain, of_gain)
    if any_valve:
        yield from _ends(gain, ANY_VALVE, "", margins.robust_gain, (None, None))
    of_stiffness = own / STIFFNESS_RESERVE, own * STIFFNESS_RESERVE
    yield from _ends(LOCAL_STIFFNESS, "", "", margins.stiffness, of_stiffness)
    if test.follows:
        yield from _ends(LOCAL_STIFFNESS, "once identified", "", margins.followed, (0.0, np.inf))
    yield from _ends("error in the assumed delay", "", "ms", margins.delay_error, (-error, error))


def _ends(
    name: str, more: str, unit: str, margin: Range | None, needed: tuple[float | None, float | None]
) -> Iterator[MarginEnd]:
    if margin is None:
        yield MarginEnd(name, more, unit)
        return
    planned, ends = margin.planned, (margin.lowest, margin.highest)
    for upper, (end, searched, least) in enumerate(zip(ends, margin.searched, needed, strict=True)):
        if end is not None or searched != planned:
            yield MarginEnd(name, more, unit, planned, end, searched, bool(upper), least)
