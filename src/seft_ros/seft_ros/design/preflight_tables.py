"""What a preflight found: tables, JSON values, expected peaks and proposed limits."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.table import Table
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_plant_sim.reference.whole_structure import reference_response
from seft_plant_sim.rig.limits import NAMES, UNITS

from seft_ros.design.closed_loop import growth_rate
from seft_ros.design.plan import Plan
from seft_ros.design.stability_margins import HIGHEST_MASS_RATIO, Critical, Range, added_delays
from seft_ros.design.stability_verdict import Preflight
from seft_ros.drawing.tables import CENTRED, Number, make_table
from seft_ros.ground_motion.ground_motion_block import GroundMotion

Floats = npt.NDArray[np.float64]

FACTORS = {"displacement": 1.5, "velocity": 2.0, "acceleration": 2.0, "force": 1.5}
"""Proposed limit over the expected peak: oil that rings moves the piston little, but fast."""
FAR = 4.0
"""Limit over the expected peak from which on it protects little."""


def expected_peaks(experiment: Experiment) -> dict[str, float]:
    """Find the largest value of each quantity on any axis in the exact response of a test.

    Parameters
    ----------
    experiment : Experiment
        Where its rig is simulated, the specimen is that of the rig, else the model's.

    Returns
    -------
    dict
        Displacement (m), velocity (m/s), acceleration (m/s^2) and force (N). Empty where they are
        not known here, as the ground motion or another node runs elsewhere.

    Raises
    ------
    InputError
        If the record of the ground motion can't be read, or the structure makes no sense.
    """
    if not {"ground_motion", "reference_force", "supervisor"} <= set(experiment.sections):
        return {}
    section, timebase = experiment["ground_motion"], experiment.timebase
    motion = GroundMotion.from_parameters(section, experiment.axes, timebase).samples
    exact = reference_response(experiment, motion)
    return {name: float(np.abs(getattr(exact, name)).max()) for name in NAMES}


def proposed_limits(peaks: dict[str, float]) -> dict[str, float]:
    """Give limits that fit expected peaks, to two digits, rounded up."""
    return {name: _round_up(FACTORS[name] * peak) for name, peak in peaks.items()}


def limit_warning(experiment: Experiment, peaks: dict[str, float]) -> str:
    """Say which limits are far beyond what a test is expected to reach; empty if none is."""
    far = [
        f"{name} {limit:g} {unit} (expected: {peak:.3g})"
        for (name, peak), unit in zip(peaks.items(), UNITS, strict=False)
        if (limit := experiment["supervisor"][f"limits.{name}"]) > FAR * peak > 0.0
    ]
    if not far:
        return ""
    return (
        f"limits are more than {FAR:g} times what this test is expected to reach: "
        f"{', '.join(far)}; seft preflight CONFIG --write limits.yaml proposes others"
    )


def limit_rows(experiment: Experiment, peaks: dict[str, float]) -> list[list[Any]]:
    """Tabulate quantity, unit, expected peak, configured limit and proposed one."""
    rows = []
    for (name, limit), unit in zip(proposed_limits(peaks).items(), UNITS, strict=False):
        configured = experiment["supervisor"][f"limits.{name}"]
        rows.append([name, unit, f"{peaks[name]:.3g}", f"{configured:g}", f"{limit:g}"])
    return rows


def write_limits(file: Path, limits: dict[str, float]) -> None:
    """Write limits as a parameter file.

    Raises
    ------
    InputError
        If it can't be written, or there are none.
    """
    if not limits:
        raise InputError(f"{file}: no limits to write: a node that runs elsewhere has the motion")
    lines = "".join(f"    limits.{name}: {value!r}\n" for name, value in limits.items())
    text = (
        "# by seft preflight: 1.5 times the expected peaks of displacement and force, 2 times\n"
        f"# those of velocity and acceleration\nsupervisor:\n  ros__parameters:\n{lines}"
    )
    try:
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{file}: can't be written: {error.strerror}") from None


def _round_up(value: float) -> float:
    if value <= 0.0:
        return value
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(f"{np.ceil(value / unit - 1e-9) * unit:.6g}")


_COLOURS = {"stable": "green", "marginal": "yellow", "unstable": "red"}
_ERROR = "+.2g"
_MODE = (  # of the exact mode, of that in the test, and their difference
    (
        Number("natural frequency", "exact_hz", "Hz"),
        Number("", "hz", "Hz"),
        Number("", "frequency_error", "%", 100, _ERROR),
    ),
    (
        Number("damping ratio", "exact_damping", "%", 100, ".3g"),
        Number("", "damping", "%", 100, ".3g"),
        Number("", "false_damping", "% of critical", 100, _ERROR),
    ),
)


def preflight_tables(plan: Plan, found: Preflight, title: str) -> list[Table]:
    """Tabulate a preflight: its margins and verdict, and the modes that the test will show."""
    margins = make_table(
        ("", "planned", "critical", "oscillates at"),
        _margin_rows(plan, found),
        title=f"{title}: [bold {_COLOURS[found.verdict]}]{found.verdict}[/]",
        caption=found.promise,
        **CENTRED,
    )
    modes = [
        [row[0].label, *(number.text(mode) for number in row)]
        for mode in summarise(plan, found)["modes"]
        for row in _MODE
    ]
    title = "whole structure, as the test will show it"
    headings = ("", "exact", "in the test", "error")
    none = [["no oscillating mode", "", "", ""]]
    options = {**CENTRED, "title_justify": "left"}
    return [margins, make_table(headings, modes or none, title=title, **options)]


def limits_table(experiment: Experiment, peaks: dict[str, float]) -> Table:
    """Tabulate what a test is expected to reach, its limits, and limits that fit."""
    headings = ("", "", "expected peak", "limit", "proposed limit")
    rows = limit_rows(experiment, peaks)
    return make_table(headings, rows, title="limits", **{**CENTRED, "title_justify": "left"})


def _margin_rows(plan: Plan, found: Preflight) -> Iterator[list[str]]:
    margins = found.margins
    longest = float(added_delays(plan)[-1] + plan.dead_time)
    sure = "whatever it takes the valve for"
    ends = [
        ("mass ratio", plan.mass_ratio, margins.mass_ratio, HIGHEST_MASS_RATIO, 1.0, ""),
        ("actuator's dead time", plan.dead_time, margins.dead_time, longest, 1e3, " ms"),
    ]
    ranges = [("actuator's gain", margins.gain, 1.0, "")]
    if plan.follows_valves:
        ends.append((sure, plan.dead_time, margins.sure_dead_time, longest, 1e3, " ms"))
        ranges.append((sure, margins.sure_gain, 1.0, ""))
    ranges.append(("local stiffness / told", margins.stiffness, 1.0, ""))
    if plan.follows:
        ranges.append(("likewise, followed", margins.followed, 1.0, ""))
    ranges.append(("error of the told delay", margins.told_delay, 1e3, " ms"))
    for label, plan_value, end, beyond, scale, unit in ends:
        yield [label, f"{scale * plan_value:.3g}{unit}", *_end(end, ">", beyond, scale, unit)]
    for label, part, scale, unit in ranges:
        if part is None:
            yield [label, "", "" if found.verdict == "unstable" else "not used", ""]
        else:
            low, high = part.searched
            planned = f"{scale * part.planned:.3g}{unit}"
            yield [label, planned, *_end(part.lowest, "<", low, scale, unit)]
            yield ["", "", *_end(part.highest, ">", high, scale, unit)]


def _end(end: Critical | None, sign: str, limit: float, scale: float, unit: str) -> tuple[str, str]:
    if end is None:
        return f"{sign} {scale * limit:.3g}{unit}", ""
    return f"{scale * end.value:.4g}{unit}", f"{end.hz:.3g} Hz"


def summarise(plan: Plan, found: Preflight) -> dict[str, Any]:
    """Verdict, margins, predicted errors: ``seft preflight --json``; in Hz and s.

    ``critical_delay_s`` is the dead time of the actuator's path at which the planned test turns
    unstable, all of it: of an actuator of kind `delay` the delay itself, of a valve that of the
    valve. ``critical_added_delay_s`` is what it is more than planned. None: no end was found as
    far as was looked (``searched``), or, of a whole range, the method does not use the quantity
    or the plan is unstable. ``local_stiffness`` is the specimen's over the told one, while the
    method believes the told one, ``local_stiffness_followed`` the same once it has followed it.
    ``sure_delay_s`` and ``sure_gain`` hold whatever the controller takes the valves for.
    """
    margins = found.margins
    critical, dead_time = margins.mass_ratio, margins.dead_time
    first = found.modes[0] if found.modes else None
    return {
        "verdict": found.verdict,
        "reasons": found.reasons,
        "basis": found.basis,
        "promise": found.promise,
        "plant": plan.rig.plant.source,
        "compensation": plan.section["compensation.method"],
        "mass_ratio": plan.mass_ratio,
        "critical_mass_ratio": _value(critical),
        "crossing_hz": critical.hz if critical else None,
        "dead_time_s": plan.dead_time,
        "critical_delay_s": _value(dead_time),
        "critical_added_delay_s": dead_time.value - plan.dead_time if dead_time else None,
        "delay_crossing_hz": dead_time.hz if dead_time else None,
        "gain": _range(margins.gain),
        "sure_delay_s": _value(margins.sure_dead_time),
        "sure_gain": _range(margins.sure_gain),
        "local_stiffness": _range(margins.stiffness),
        "local_stiffness_followed": _range(margins.followed),
        "told_delay_error_s": _range(margins.told_delay),
        "false_damping_ratio": first.false_damping if first else None,
        "frequency_error": first.frequency_error if first else None,
        "modes": [
            asdict(mode)
            | {"false_damping": mode.false_damping, "frequency_error": mode.frequency_error}
            for mode in found.modes
        ],
        "spectral_radius": abs(found.dominant),
        "growth_rate": growth_rate(found.dominant, plan.dt),
        "dominant_hz": float(np.angle(found.dominant)) / (2 * np.pi * plan.dt),
        "states": found.states,
    }


def _value(critical: Critical | None) -> float | None:
    return critical.value if critical else None


def _range(found: Range | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "planned": found.planned,
        "lowest": _value(found.lowest),
        "highest": _value(found.highest),
        "searched": list(found.searched),
    }
