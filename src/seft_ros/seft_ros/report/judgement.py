"""Whether a test can be trusted, from its numbers; every threshold stands here."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from seft_ros.analysis.table import GOOD_ERROR, percent
from seft_ros.page.content import Cell, Mark

BAD_ERROR = 0.15
"""Displacement error (nrmse), and error of its peak, from which a test is worth nothing; of the
response to its own ground motion, and of a target's displacement, likewise."""
GOOD_VIBRATION, BAD_VIBRATION = 0.1, 0.3
"""Acceleration in the instability band beyond the exact one's, over all of that."""
BAD_MISSED = 0.05
"""Share of steps without a command in time."""
BAD_LATE = 0.2
"""Share of reference forces that came over the link after the loop's delay."""
GOOD_CLOSURE = 0.05
"""Error of the energy balance: do the samples fit the specimen they are said to be of?"""
GOOD_DELAY = 2.0
"""Periods that the force loop may lag where nothing compensates for it."""

_WORDS = {
    Mark.GOOD: "This test can be trusted.",
    Mark.DOUBT: "This test can be trusted with reservations",
    Mark.BAD: "This test can not be trusted",
}


@dataclass(frozen=True)
class Finding:
    """One thing that speaks for a test or against it.

    Attributes
    ----------
    mark : Mark
        What it means.
    name : str
        For programs.
    text : str
        For people: what, how much, and how much would be good.
    """

    mark: Mark
    name: str
    text: str

    def cell(self) -> Cell:
        """For a page."""
        return Cell(self.text, self.mark)


@dataclass(frozen=True)
class Judgement:
    """Verdict on a test: its worst finding.

    Attributes
    ----------
    mark : Mark
        The worst.
    text : str
        One line.
    findings : list of Finding
        All, the worst first.
    """

    mark: Mark
    text: str
    findings: list[Finding]

    def numbers(self) -> dict[str, Any]:
        """For JSON: ``verdict`` (good, doubt, bad), ``text``, ``findings``."""
        return {
            "verdict": str(self.mark),
            "text": self.text,
            "findings": [
                {"name": f.name, "verdict": str(f.mark), "text": f.text} for f in self.findings
            ],
        }


def judge(summary: dict[str, Any]) -> Judgement:
    """Judge a test by its summary.

    Parameters
    ----------
    summary : dict
        As `seft_ros.report.numbers.report_numbers` gives it.
    """
    order = (Mark.BAD, Mark.DOUBT, Mark.GOOD, Mark.NONE)
    findings = sorted(_findings(summary), key=lambda finding: order.index(finding.mark))
    worst = findings[0].mark
    text = _WORDS[worst]
    if worst is not Mark.GOOD:
        reasons = [f.text.split(" (")[0] for f in findings if f.mark is worst]
        text += f": {'; '.join(reasons)}."
    return Judgement(worst, text, findings)


def _findings(summary: dict[str, Any]) -> Iterator[Finding]:
    if summary["first_step"]:
        yield _beginning(summary["first_step"])
    yield _ending(summary)
    if summary["reference_specimen"] == "simulated":
        yield _error(summary)
        if summary["displacement"]["nrmse"] is not None:
            yield _peak(summary)
    yield _equivalent_motion(summary)
    if summary["tracking_error"] is not None:
        yield _tracking_error(summary)
    if summary["vibration"]["ratio"] is not None:
        yield _vibration(summary)
    if summary["uncompensated_delay_s"] is not None:
        yield _delay(summary)
    yield _missed(summary)
    if summary["link"]:
        yield _link(summary["link"])
    if summary["first_step"] is not None:
        yield _lost(summary)
    if summary["overruns"]:
        text = f"the rig's own clock was held up {summary['overruns']} times"
        yield Finding(Mark.DOUBT, "overruns", text)
    yield _saturated(summary)
    if summary["energy"] and summary["energy"]["closure"] is not None:
        yield _closure(summary)


def _beginning(first: int) -> Finding:
    text = (
        f"the record begins at step {first} of the test; errors are of what is there, against the "
        "exact response from step 0 on"
    )
    return Finding(Mark.BAD, "beginning", text)


def _ending(summary: dict[str, Any]) -> Finding:
    trip = summary["trip"]
    if trip is not None:
        text = f"it tripped at {trip['time_s']:.3f} s (step {trip['step']}): {trip['reason']}"
        return Finding(Mark.BAD, "ending", text)
    if not summary["stable"]:
        return Finding(Mark.BAD, "ending", "it went unstable: samples are not finite")
    if summary["first_step"] is None:
        return Finding(Mark.BAD, "ending", "the record has no rig/state: nothing is known of it")
    if not summary["complete"]:
        return Finding(Mark.BAD, "ending", "the record is cut off before the test ended")
    text = f"it ran to its end, {summary['steps']} steps, {summary['duration_s']:g} s"
    return Finding(Mark.GOOD, "ending", text)


def _error(summary: dict[str, Any]) -> Finding:
    error = summary["displacement"]["nrmse"]
    if error is None:
        return Finding(Mark.DOUBT, "displacement_error", "its displacement error is not known")
    text = (
        f"displacement error {percent(error)} against the exact response of the whole structure "
        f"(good: up to {percent(GOOD_ERROR)})"
    )
    return Finding(_grade(error, GOOD_ERROR, BAD_ERROR), "displacement_error", text)


def _peak(summary: dict[str, Any]) -> Finding:
    part = summary["displacement"]
    ratio = part["peak"] / part["reference_peak"] if part["reference_peak"] else float("nan")
    word = "larger" if ratio > 1 else "smaller"
    off = abs(ratio - 1)
    text = f"peak displacement {percent(off)} {word} than the exact one (good: {GOOD_ERROR:.0%})"
    return Finding(_grade(off, GOOD_ERROR, BAD_ERROR), "displacement_peak", text)


def _equivalent_motion(summary: dict[str, Any]) -> Finding:
    found, simulated = summary["equivalent_motion"], summary["reference_specimen"] == "simulated"
    error = found and found["worst_response_nrmse"]
    if error is None:
        text = "the ground motion that was tested can't be told from the record"
        mark = Mark.NONE if simulated else Mark.DOUBT
        return Finding(mark, "equivalent_motion", text)
    low, high = found["structure"]["band_hz"]
    text = (
        f"linear structures answer the ground motion that was tested up to {percent(error)} "
        f"differently from the one asked for (worst at {found['worst_frequency_hz']:.3g} Hz of "
        f"{low:.3g} to {high:.3g} Hz; {percent(found['response_nrmse'])} with the stiffness of the "
        f"model; good: up to {percent(GOOD_ERROR)})"
    )
    mark = Mark.NONE if simulated else _grade(error, GOOD_ERROR, BAD_ERROR)
    return Finding(mark, "equivalent_motion", text)


def _tracking_error(summary: dict[str, Any]) -> Finding:
    found, simulated = summary["tracking_error"], summary["reference_specimen"] == "simulated"
    error = found["nrmse"]
    if error is None:
        return Finding(Mark.DOUBT, "tracking_error", "how far it was from its target is not known")
    text = (
        f"displacement off its target by {percent(error)} (RMS {found['rms'] * 1e3:.3g} mm, at "
        f"most {found['peak'] * 1e3:.3g} mm; good: up to {percent(GOOD_ERROR)})"
    )
    mark = Mark.NONE if simulated else _grade(error, GOOD_ERROR, BAD_ERROR)
    return Finding(mark, "tracking_error", text)


def _vibration(summary: dict[str, Any]) -> Finding:
    ratio = summary["vibration"]["ratio"]
    low, high = summary["instability_band_hz"]
    text = (
        f"vibration of {percent(ratio)} of the exact acceleration where instability would start, "
        f"{low:.3g} to {high:.3g} Hz (good: up to {GOOD_VIBRATION:.0%})"
    )
    return Finding(_grade(ratio, GOOD_VIBRATION, BAD_VIBRATION), "vibration", text)


def _delay(summary: dict[str, Any]) -> Finding:
    delay, dt = summary["uncompensated_delay_s"], 1.0 / summary["rate_hz"]
    text = (
        f"force lags by {delay * 1e3:.3g} ms and nothing compensates for it "
        f"(good: up to {GOOD_DELAY * dt * 1e3:.3g} ms)"
    )
    return Finding(_grade(delay, GOOD_DELAY * dt, float("inf")), "delay", text)


def _missed(summary: dict[str, Any]) -> Finding:
    missed, steps = summary["missed"], summary["steps"]
    if missed is None:
        return Finding(Mark.DOUBT, "missed", "it is not known how many commands came too late")
    if not missed:
        return Finding(Mark.GOOD, "missed", "every step had its command in time")
    text = f"{missed} of {steps} steps ({percent(missed / steps)}) had no command in time"
    mark = Mark.BAD if missed > BAD_MISSED * steps else Mark.DOUBT
    return Finding(mark, "missed", text)


def _link(link: dict[str, Any]) -> Finding:
    delay, late, forces = link["loop_delay"], link["late"], link["forces"]
    if not late:
        text = f"every reference force came within the loop's delay of {delay} steps"
        return Finding(Mark.GOOD, "link", text)
    text = (
        f"{late} of {forces} reference forces ({percent(late / forces)}) came after the loop's "
        f"delay of {delay} steps and were predicted, {link['held']} of them held"
    )
    mark = Mark.BAD if late > BAD_LATE * forces else Mark.DOUBT
    return Finding(mark, "link", text)


def _lost(summary: dict[str, Any]) -> Finding:
    lost = {topic: count for topic, count in summary["lost"].items() if count}
    if not lost:
        return Finding(Mark.GOOD, "lost", "no sample is lost from the record")
    text = ", ".join(f"{count} of {topic}" for topic, count in lost.items())
    return Finding(Mark.DOUBT, "lost", f"samples are lost from the record: {text}")


def _saturated(summary: dict[str, Any]) -> Finding:
    found = summary["saturated"]
    if not found:
        return Finding(Mark.GOOD, "saturated", "nothing was at the end of its range")
    text = ", ".join(
        f"{name.replace('_', ' ')} in {row['samples']} samples from step {row['first_step']}"
        for name, row in found.items()
    )
    return Finding(Mark.DOUBT, "saturated", f"at the end of its range: {text}")


def _closure(summary: dict[str, Any]) -> Finding:
    closure = summary["energy"]["closure"]
    text = (
        f"energy balance of the specimen closes to {percent(closure)} "
        f"(good: {GOOD_CLOSURE:.0%}; else samples and specimen do not fit)"
    )
    mark = Mark.GOOD if closure <= GOOD_CLOSURE else Mark.DOUBT
    return Finding(mark, "energy_balance", text)


def _grade(value: float, good: float, bad: float) -> Mark:
    if value <= good:
        return Mark.GOOD
    return Mark.DOUBT if value <= bad else Mark.BAD
