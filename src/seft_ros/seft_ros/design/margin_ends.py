"""The margins of a planned test, end by end, each beside what the verdict needs."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from seft_plant_sim.judge.valve_following import LARGEST_DELAY_ERROR, LARGEST_GAIN_ERROR

from seft_ros.design.planned_tests import PlannedTest
from seft_ros.design.stability_margins import (
    HIGHEST_MASS_RATIO,
    Critical,
    Margins,
    Range,
    added_delays,
)

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
MASS_RATIO, DEAD_TIME, LOCAL_STIFFNESS = (
    "mass ratio",
    "actuator's dead time",
    "local stiffness / assumed",
)


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
    name: str,
    more: str,
    unit: str,
    margin: Range | None,
    needed: tuple[float | None, float | None],
) -> Iterator[MarginEnd]:
    if margin is None:
        yield MarginEnd(name, more, unit)
        return
    planned, ends = margin.planned, (margin.lowest, margin.highest)
    for upper, (end, searched, least) in enumerate(zip(ends, margin.searched, needed, strict=True)):
        if end is not None or searched != planned:
            yield MarginEnd(name, more, unit, planned, end, searched, bool(upper), least)
