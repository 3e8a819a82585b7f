"""What a preflight found: tables, JSON values, expected peaks, limits, a computed model's time."""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment, write_parameter_file
from seft_msgs_py.config.facts import EVERY_NODE
from seft_msgs_py.config.parameter_table import Section, group, mass_matrix, symmetric_matrix
from seft_msgs_py.errors import InputError
from seft_plant_sim.rig_parameters import LIMIT_UNITS
from seft_plant_sim.whole_structure import model_times, whole_structure

from seft_ros.design.planned_tests import PlannedTest
from seft_ros.design.plausibility import FACTORS
from seft_ros.design.stability_margins import HEADINGS, Range, end_texts, meanings
from seft_ros.design.stability_verdict import Preflight
from seft_ros.drawing.style import Cell, Mark, Number, Texts, TextTable
from seft_ros.ground_motion.ground_motion_block import GroundMotion
from seft_ros.reference_force.reference_force_parameters import LONGEST_MODEL_STEP

SHARE = 0.6
"""Of a period, for the model: the loop's nodes need the remainder."""
LOOKS = 4
"""At a model that seems too slow. Of each step the shortest time counts: what takes long in all of
them is the model, the remainder is the host."""
_FIRST = 2
"""Steps in which a model may still load what it needs; the node takes many before a test."""
_STEPS = 5000
"""Of the test, at most, from its beginning on."""
RATES = (2000, 1000, 500, 400, 250, 200, 125, 100, 50, 25, 20, 10, 5, 2, 1)  # Hz
MAX_APART = 50
"""Largest division that a parameter file may give."""


@dataclass(frozen=True)
class ModelTime:
    """Time that a step of a model takes along the motion of the planned test.

    Attributes
    ----------
    median_s, p999_s, longest_s : float
        99.9 % of the steps take no longer than the second.
    longest_at_s : float
        When in the test the longest step is.
    budget_s : float
        Time that a step may take.
    longest_allowed_s : float
        Time that a single step may take: the watchdog's for commands, `LONGEST_MODEL_STEP` at most.
    rate_hz : float
        Rate of the test.
    fits : bool
        Whether it is fast enough.
    fitting_every, fitting_rate_hz : int or None
        Division of the steps, and rate, at which it would be; None: there is none.
    """

    median_s: float
    p999_s: float
    longest_s: float
    longest_at_s: float
    budget_s: float
    longest_allowed_s: float
    rate_hz: float
    fits: bool
    fitting_every: int | None
    fitting_rate_hz: int | None

    def refusal(self) -> str:
        """Say that it is too slow, and what would do; empty if it is not."""
        if self.fits:
            return ""
        if self.median_s <= self.budget_s and self.longest_s > self.longest_allowed_s:
            return (
                f"reference_force: computed.model takes {self.longest_s:.3g} s for the step at "
                f"{self.longest_at_s:.6g} s, at which the test would trip: a watchdog allows "
                f"{self.longest_allowed_s:g} s (rig: watchdog.command_timeout, at most "
                f"{LONGEST_MODEL_STEP:g}); make this step of the model faster"
            )
        every, rate = self.fitting_every, self.fitting_rate_hz
        ways = [f"reference_force: computed.every {every}"] if every else []
        ways += [f"a rate of {rate} Hz"] if rate else []
        return (
            f"reference_force: computed.model takes {1e3 * self.median_s:.2g} ms for a step "
            f"({1e3 * self.p999_s:.2g} ms for one of 1000), but has {1e3 * self.budget_s:.2g} ms "
            f"at {self.rate_hz:g} Hz: {' or '.join([*ways, 'a smaller model'])} fits"
        )

    def texts(self) -> list[str]:
        """Say how long its steps take, and which of them the margins know."""
        times = self.median_s, self.p999_s, self.longest_s, self.budget_s
        median, p999, longest, budget = (f"{1e3 * time:.2g} ms" for time in times)
        said = f"{median} for a step, {p999} for one of 1000, {longest} for the longest"
        tangent = "the margins above take its tangent at rest"
        return [f"computed model: {said}, of {budget}", tangent]


_OF_SPECIMEN = {"mass": mass_matrix, "damping": symmetric_matrix, "stiffness": symmetric_matrix}


def planned_motion(experiment: Experiment) -> GroundMotion | None:
    """Make the ground motion of an experiment; None if it comes from elsewhere.

    What is known of the specimen is checked first: the simulated one is the same by default.
    """
    known = experiment.sections.get("reference_force", {})
    for name, check in _OF_SPECIMEN.items():
        if (given := f"specimen.{name}") in known:
            check(known[given], experiment.axes, f"{EVERY_NODE}: {given}")
    if section := experiment.sections.get("ground_motion"):
        return GroundMotion(section, experiment.axes, experiment.timebase)
    return None


def model_time(experiment: Experiment, planned: GroundMotion | None) -> ModelTime | None:
    """Measure the computed model of an experiment; None if it has none, or no ground motion here.

    Raises
    ------
    InputError
        If the model fails along the way.
    """
    if planned is None or "reference_force" not in experiment.sections:
        return None
    whole = whole_structure(experiment)
    model, dt = whole.computed.model, experiment.timebase.dt
    if model is None:
        return None
    motion = planned.samples[: _STEPS * model.every : model.every]
    share = SHARE * dt * model.every
    watchdog = experiment.sections.get("rig", {}).get("watchdog.command_timeout", np.inf)
    allowed = min(float(watchdog), LONGEST_MODEL_STEP)
    times = np.full(len(motion), np.inf)
    for _ in range(LOOKS):
        times = np.minimum(times, model_times(whole, motion, model.every * dt))
        median, p999 = np.percentile(times, [50.0, 99.9]).tolist()
        slowest = _FIRST + int(times[_FIRST:].argmax()) if len(times) > _FIRST else 0
        longest, fits = float(times[slowest]), p999 <= share
        fits = fits and longest <= allowed
        if fits or median > share:  # half of the steps: no stalls of the host
            break
    every = math.ceil(p999 / (SHARE * dt))
    rate = next((rate for rate in RATES if p999 * rate <= SHARE * model.every), None)
    return ModelTime(
        median_s=median,
        p999_s=p999,
        longest_s=longest,
        longest_at_s=slowest * model.every * dt,
        budget_s=share,
        longest_allowed_s=allowed,
        rate_hz=1 / dt,
        fits=fits,
        fitting_every=every if every <= MAX_APART else None,
        fitting_rate_hz=rate,
    )


FAR = 4.0
"""Limit over the expected peak from which on it protects little."""

_MARKS = {"stable": Mark.GOOD, "marginal": Mark.DOUBT, "unstable": Mark.BAD}
_MODE = (  # of the exact mode, of that in the test, and their difference
    (
        Number("natural frequency", "exact_hz", "Hz"),
        Number("", "hz", "Hz"),
        Number("", "frequency_error", "%", 100, "+.2g"),
    ),
    (
        Number("damping ratio", "exact_damping", "%", 100, ".3g"),
        Number("", "damping", "%", 100, ".3g"),
        Number("", "false_damping", "% of critical", 100, "+.2g"),
    ),
)


def preflight_texts(found: Preflight, title: str) -> Texts:
    """Show a preflight: verdict and margins, and the modes in the test if it is stable."""
    mark = _MARKS[found.verdict]
    rows = [
        [Cell(text, mark if end.decides else Mark.NONE) for text in texts]
        for end, texts in zip(found.ends, end_texts(found.ends), strict=True)
    ]
    shown: Texts = [
        Cell(f"{title}: {found.verdict}", mark),
        TextTable(HEADINGS, rows),
        *meanings(found.ends),
        found.promise,
    ]
    if found.verdict == "unstable":
        return shown
    modes = [
        [row[0].label, *(number.text(mode) for number in row)]
        for mode in map(asdict, found.modes)
        for row in _MODE
    ]
    none = [["no oscillating mode", "", "", ""]]
    headings = ("mode", "exact", "in the test", "error")
    return [*shown, "modes of the whole structure", TextTable(headings, modes or none)]


def limits_table(
    experiment: Experiment, peaks: Mapping[str, float], proposed: Mapping[str, float]
) -> TextTable:
    """Tabulate expected peaks, the limits of the test, and limits that fit."""
    limits = group(experiment["supervisor"], "limits")
    rows: list[list[str | Cell]] = []
    for (name, limit), unit in zip(proposed.items(), LIMIT_UNITS, strict=False):
        now, peak = limits[name], peaks[name]
        shown = Cell(f"{now:g}", Mark.BAD if peak > now else Mark.NONE)
        rows.append([name, unit, f"{peak:.3g}", shown, f"{limit:g}"])
    return TextTable(("limit of", "unit", "expected peak", "limit", "proposed limit"), rows)


def summarise_preflight(test: PlannedTest, found: Preflight) -> dict[str, Any]:
    """Verdict, margins, predicted errors: ``seft preflight --json``; in Hz and s.

    ``critical_delay_s`` is the whole dead time of the actuator at which the planned test turns
    unstable: of an actuator of kind `delay` the delay itself, of a valve that of the valve.
    ``critical_added_delay_s`` is this less the planned one. None: no end was found within
    ``searched``, or, of a whole range, the method does not use the quantity or the planned test is
    unstable. ``local_stiffness`` is that of the specimen over the assumed one,
    ``local_stiffness_followed`` the same once the method has adapted to it. ``sure_delay_s`` and
    ``robust_gain`` hold for all errors that the controller may assume of the valves.
    """
    margins = found.margins
    critical, dead_time = margins.mass_ratio, margins.dead_time
    modes = [asdict(mode) for mode in found.modes]
    first = modes[0] if modes else {}
    return {
        "verdict": found.verdict,
        "reasons": found.reasons,
        "basis": "exact",
        "promise": found.promise,
        "plant": test.rig.plant.source,
        "compensation": test.section["compensation.method"],
        "mass_ratio": test.mass_ratio,
        "critical_mass_ratio": critical and critical.value,
        "crossing_hz": critical and critical.hz,
        "dead_time_s": test.dead_time,
        "critical_delay_s": dead_time and dead_time.value,
        "critical_added_delay_s": dead_time and dead_time.value - test.dead_time,
        "delay_crossing_hz": dead_time and dead_time.hz,
        "gain": _range(margins.gain),
        "sure_delay_s": margins.sure_dead_time and margins.sure_dead_time.value,
        "robust_gain": _range(margins.robust_gain),
        "local_stiffness": _range(margins.stiffness),
        "local_stiffness_followed": _range(margins.followed),
        "assumed_delay_error_s": _range(margins.delay_error),
        "false_damping_ratio": first.get("false_damping"),
        "frequency_error": first.get("frequency_error"),
        "modes": modes,
        "spectral_radius": abs(test.worst()),
        "growth_rate": test.growth_rate(),
        "dominant_hz": test.hz(),
        "states": sum(len(loop.matrix) for loop in test.loops()),
    }


def _range(found: Range | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "planned": found.planned,
        "lowest": found.lowest and found.lowest.value,
        "highest": found.highest and found.highest.value,
        "searched": list(found.searched),
    }


def expected_peaks(by_axis: Mapping[str, Floats]) -> dict[str, float]:
    """Largest of the `peaks_by_axis` on any axis: of each quantity, or none."""
    return {name: float(peaks.max()) for name, peaks in by_axis.items()}


def proposed_limits(
    peaks: Mapping[str, float], highest: Mapping[str, float] | None = None
) -> dict[str, float]:
    """Limits that fit expected peaks, rounded up to two digits, or down where `highest_limits`."""
    limits = {}
    for name, peak in peaks.items():
        limit, most = FACTORS[name] * peak, (highest or {}).get(name, np.inf)
        up = _two_digits(limit, np.ceil) if limit > 0.0 else 0.0
        limits[name] = up if up <= most else _two_digits(most, np.floor)
    return limits


def _two_digits(value: float, towards: Callable[[float], float]) -> float:
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    nearly = -1e-9 if towards is np.ceil else 1e-9  # what is round stays as it is
    return float(f"{towards(value / unit + nearly) * unit:.6g}")


def far_limits(experiment: Experiment, peaks: Mapping[str, float]) -> str:
    """Name the limits that the expected peaks stay far below; empty if there are none."""
    limits = group(experiment["supervisor"], "limits")
    far = [
        f"{name} {limits[name]:g} {unit} (expected: {peak:.3g})"
        for (name, peak), unit in zip(peaks.items(), LIMIT_UNITS, strict=False)
        if limits[name] > FAR * peak > 0
    ]
    if not far:
        return ""
    mend = "seft preflight CONFIG --write limits.yaml proposes others"
    return f"limits are more than {FAR:g} times the expected peaks: {', '.join(far)}; {mend}"


def write_limits(file: Path, limits: dict[str, float]) -> None:
    """Write limits as a parameter file.

    Raises
    ------
    InputError
        If it can't be written, or there are none.
    """
    if not limits:
        raise InputError(f"{file}: no limits to write: a node of the test runs elsewhere")
    section: Section = {f"limits.{name}": value for name, value in limits.items()}
    comments = [
        "by seft preflight: 1.5 times the expected peaks of displacement and force, 2 times",
        "those of velocity and acceleration, as far as stroke and force capacity allow",
    ]
    write_parameter_file(file, {EVERY_NODE: section}, comments, replace=True)
