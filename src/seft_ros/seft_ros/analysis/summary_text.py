"""A test's summary for people: its table, and how it went in one line."""

from typing import Any

from rich.table import Table
from rich.text import Text

from seft_ros.bags.record import Record
from seft_ros.drawing.tables import (
    DISPLAY_UNITS,
    GOOD_ERROR,
    RESPONSES,
    Number,
    make_table,
    number,
    percent,
)


def agreement_columns(quantity: str, delay_form: str) -> tuple[Number, ...]:
    """Describe how a measured quantity agrees with the exact one, by column of a table."""
    unit, scale = DISPLAY_UNITS[quantity]
    return (
        Number("peak", f"{quantity}.peak", unit, scale),
        Number("exact peak", f"{quantity}.reference_peak", unit, scale),
        Number("NRMSE", f"{quantity}.nrmse", form=percent),
        Number("NRMSE aligned", f"{quantity}.nrmse_aligned", form=percent),
        Number("delay", f"{quantity}.delay_s", "ms", 1e3, delay_form),
    )


def agreement_rows(part: dict[str, Any], prefix: str = "", delay_form: str = ".2f") -> list[Any]:
    """Make a row of each measured quantity in a summary, or in the part of it on an axis."""
    return [
        [
            f"{prefix}{quantity}",
            *(column.text(part) for column in agreement_columns(quantity, delay_form)),
        ]
        for quantity in RESPONSES
    ]


def summary_table(record: Record, summary: dict[str, Any]) -> Table:
    """Tabulate a test's summary: agreement with the exact response; the caption is its verdict."""
    lines = [title_of(record), _pace(summary), *_trust_lines(summary), *_estimate_lines(summary)]
    rows = agreement_rows(summary)
    if len(summary["axes"]) > 1:
        for axis, part in summary["axes"].items():
            rows += [None, *agreement_rows(part, f"{axis} ")]
    return make_table(
        ["", *(column.label for column in agreement_columns(RESPONSES[0], ""))],
        rows,
        title=Text("\n".join(lines)),
        caption=Text(verdict(summary), style=f"bold {_colour(summary)}"),
    )


def title_of(record: Record) -> str:
    """Name method, mass ratio, compensation and rate of a test in one line."""
    section = record.experiment.sections.get("reference_force", {})
    parts = [str(section.get("method", "test")).upper()]
    if "mass_ratio" in section:
        parts.append(f"mass ratio {section['mass_ratio']:g}")
    if "compensation.method" in section:
        parts.append(f"compensation {section['compensation.method']}")
    parts.append(f"{record.experiment.timebase.rate:g} Hz")
    return ", ".join(parts)


def verdict(summary: dict[str, Any]) -> str:
    """Say how a test went, in one line."""
    trip, missed = summary["trip"], summary["missed"]
    error, aligned = (summary["displacement"][key] for key in ("nrmse", "nrmse_aligned"))
    if trip is not None:
        text = f"TRIPPED at {trip['time_s']:.3f} s (step {trip['step']}): {trip['reason']}"
    elif not summary["stable"]:
        text = "UNSTABLE: samples are not finite"
    elif summary["first_step"] is None:
        text = "NOTHING KNOWN: the record has no rig/state"
    elif not summary["complete"]:
        text = "CUT OFF: the record ends before the test did"
    elif error is not None and summary["reference_specimen"] == "simulated":
        text = f"done: displacement error {percent(error)}, {percent(aligned)} without its delay"
    elif (worst := _worst_response(summary)) is not None:
        text = (
            f"done: response to the ground motion that was tested off by {percent(worst)} at most"
        )
    else:
        text = "done, with nothing to hold it against"
    if missed:
        text += f"; {missed} of {summary['steps']} steps had no command in time"
        text += _in_a_stall(summary["timing"], missed)
    if summary["overruns"]:
        text += f"; the rig's own clock was held up {summary['overruns']} times"
    if summary["saturated"]:
        found = (
            f"{name.replace('_', ' ')} ({row['samples']} samples from "
            f"{row['first_step'] * (1.0 / summary['rate_hz']):.3f} s)"
            for name, row in summary["saturated"].items()
        )
        text += f"; at the end of its range: {', '.join(found)}"
    link = summary["link"]
    if link and link["late"]:
        text += f"; {link['late']} forces came after the loop's delay and were predicted"
    lost = {topic: count for topic, count in summary["lost"].items() if count}
    if lost:
        text += f"; samples lost: {', '.join(f'{n} of {topic}' for topic, n in lost.items())}"
    return text


def _in_a_stall(timing: dict[str, Any] | None, missed: int) -> str:
    """Say how many of the missed steps were the machine's doing, if somebody watched it."""
    stalls = timing and timing["stalls"]
    if not stalls or not stalls["missed_listed"]:
        return ""
    text = f", {stalls['missed_in_a_stall']} of them while the machine itself stood still"
    if stalls["missed_listed"] < missed:
        text += f" (of the first {stalls['missed_listed']})"
    return text


def _worst_response(summary: dict[str, Any]) -> float | None:
    found = summary["equivalent_motion"]
    return found and found["worst_response_nrmse"]


def _colour(summary: dict[str, Any]) -> str:
    """Red: the test did not run to its end; yellow: it did, and is wrong or not as timed."""
    if not (summary["stable"] and summary["complete"]):
        return "red"
    simulated = summary["reference_specimen"] == "simulated"
    error = summary["displacement"]["nrmse"] if simulated else _worst_response(summary)
    right = error is not None and error <= GOOD_ERROR
    return "green" if right and not summary["missed"] else "yellow"


def _pace(summary: dict[str, Any]) -> str:
    text = f"{summary['steps']} steps, {summary['duration_s']:g} s"
    if summary["realtime_factor"] is not None:
        text += f", in {summary['wall_s']:.3g} s ({summary['realtime_factor']:.3g} x real time)"
    return text


def _trust_lines(summary: dict[str, Any]) -> list[str]:
    """Say what tells without a model whether a test is right."""
    found, tracking, lines = summary["equivalent_motion"], summary["tracking_error"], []
    if found is not None:
        lines.append(
            "ground motion tested against the one asked for: response differs by "
            f"{percent(found['response_nrmse'])}, at worst {percent(found['worst_response_nrmse'])}"
        )
    if tracking is not None:
        lines.append(f"displacement off its target by {percent(tracking['nrmse'])}")
    if summary["detectors"]:
        name, share = max(summary["detectors"].items(), key=lambda item: item[1])
        lines.append(f"detectors of faults: {name} came to {percent(share)} of its threshold")
    return lines


def _estimate_lines(summary: dict[str, Any]) -> list[str]:
    """Tell how each estimate of a summary went, one line each."""
    lines = []
    for name, by_axis in summary["estimates"].items():
        unit, scale = DISPLAY_UNITS.get(name, ("", 1.0))
        texts = []
        for axis, found in by_axis.items():
            values = (number(found[key], scale) for key in ("first", "last", "least", "largest"))
            first, last, least, largest = values
            text = f"{first} to {last} {unit}".rstrip() + f" (between {least} and {largest})"
            texts.append(f"{axis} {text}" if len(by_axis) > 1 else text)
        lines.append(f"{name} as identified: {', '.join(texts)}")
    return lines
