"""A preflight for people."""

from rich.table import Table

from seft_ros.preflight.plan import Plan
from seft_ros.preflight.stability_margins import HIGHEST_MASS_RATIO, Critical, added_delays
from seft_ros.preflight.stability_verdict import Preflight

_COLOURS = {"stable": "green", "marginal": "yellow", "unstable": "red"}


def preflight_tables(plan: Plan, found: Preflight, title: str) -> list[Table]:
    """Tabulate a preflight: its margins and verdict, and the modes that the test will show."""
    return [_margins(plan, found, title), _modes(found)]


def _margins(plan: Plan, found: Preflight, title: str) -> Table:
    colour = _COLOURS[found.verdict]
    table = Table(
        title=f"{title}: [bold {colour}]{found.verdict}[/]",
        caption=found.promise,
        caption_justify="left",
    )
    for heading in ("", "planned", "critical", "oscillates at"):
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    margins = found.margins
    added = 1e3 * float(added_delays(plan)[-1] + plan.dead_time)
    sure = "whatever it takes the valve for"
    ends = [
        ("mass ratio", plan.mass_ratio, margins.mass_ratio, HIGHEST_MASS_RATIO, 1.0, ""),
        ("actuator's dead time", plan.dead_time, margins.dead_time, added, 1e3, " ms"),
    ]
    ranges = [("actuator's gain", margins.gain, 1.0, "")]
    if plan.follows_valves:
        ends.append((sure, plan.dead_time, margins.sure_dead_time, added, 1e3, " ms"))
        ranges.append((sure, margins.sure_gain, 1.0, ""))
    ranges.append(("local stiffness / told", margins.stiffness, 1.0, ""))
    if plan.follows:
        ranges.append(("likewise, followed", margins.followed, 1.0, ""))
    ranges.append(("error of the told delay", margins.told_delay, 1e3, " ms"))
    for label, planned, end, beyond, scale, unit in ends:
        table.add_row(
            label, f"{scale * planned:.3g}{unit}", *_end(end, f"> {beyond:.3g}", scale, unit)
        )
    for label, part, scale, unit in ranges:
        if part is None:
            unstable = found.verdict == "unstable"
            table.add_row(label, "", "" if unstable else "not used", "")
            continue
        own = f"{scale * part.planned:.3g}{unit}"
        low, high = (f"{scale * limit:.3g}" for limit in part.searched)
        table.add_row(label, own, *_end(part.lowest, f"< {low}", scale, unit))
        table.add_row("", "", *_end(part.highest, f"> {high}", scale, unit))
    return table


def _end(end: Critical | None, beyond: str, scale: float, unit: str) -> tuple[str, str]:
    if end is None:
        return f"{beyond}{unit}", ""
    return f"{scale * end.value:.4g}{unit}", f"{end.hz:.3g} Hz"


def _modes(found: Preflight) -> Table:
    table = Table(title="whole structure, as the test will show it", title_justify="left")
    for heading in ("", "exact", "in the test", "error"):
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    for mode in found.modes:
        table.add_row(
            "natural frequency",
            f"{mode.exact_hz:.4g} Hz",
            f"{mode.hz:.4g} Hz",
            f"{100 * mode.frequency_error:+.2g} %",
        )
        table.add_row(
            "damping ratio",
            f"{100 * mode.exact_damping:.3g} %",
            f"{100 * mode.damping:.3g} %",
            f"{100 * mode.false_damping:+.2g} % of critical",
        )
    if not found.modes:
        table.add_row("no oscillating mode", "", "", "")
    return table
