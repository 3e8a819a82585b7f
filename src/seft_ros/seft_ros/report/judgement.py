"""Whether a test can be trusted, from its numbers; every threshold stands here."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from seft_ros.drawing.tables import GOOD_ERROR, percent
from seft_ros.page.content import Mark

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
    """One thing that speaks for a test or against it: what, how much, how much would be good."""

    name: str
    verdict: Mark
    text: str


@dataclass(frozen=True)
class Judgement:
    """Verdict on a test: that of its worst finding, in one line; and all, the worst first."""

    verdict: Mark
    text: str
    findings: list[Finding]


def judge(summary: dict[str, Any]) -> Judgement:
    """Judge a test by the summary that `seft_ros.report.numbers.report_numbers` gives."""
    order = (Mark.BAD, Mark.DOUBT, Mark.GOOD, Mark.NONE)
    findings = sorted(_findings(summary), key=lambda finding: order.index(finding.verdict))
    worst = findings[0].verdict
    text = _WORDS[worst]
    if worst is not Mark.GOOD:
        reasons = [f.text.split(" (")[0] for f in findings if f.verdict is worst]
        text += f": {'; '.join(reasons)}."
    return Judgement(worst, text, findings)


def _findings(summary: dict[str, Any]) -> Iterator[Finding]:
    if summary["first_step"]:
        text = (
            f"the record begins at step {summary['first_step']} of the test; errors are of what is "
            "there, against the exact response from step 0 on"
        )
        yield Finding("beginning", Mark.BAD, text)
    yield _ending(summary)
    yield from _errors(summary)
    ratio, delay = summary["vibration"]["ratio"], summary["uncompensated_delay_s"]
    if ratio is not None:
        low, high = summary["instability_band_hz"]
        text = (
            f"vibration of {percent(ratio)} of the exact acceleration where instability would "
            f"start, {low:.3g} to {high:.3g} Hz (good: up to {GOOD_VIBRATION:.0%})"
        )
        yield Finding("vibration", _grade(ratio, GOOD_VIBRATION, BAD_VIBRATION), text)
    if delay is not None:
        good = GOOD_DELAY * (1.0 / summary["rate_hz"])
        text = (
            f"force lags by {delay * 1e3:.3g} ms and nothing compensates for it "
            f"(good: up to {good * 1e3:.3g} ms)"
        )
        yield Finding("delay", _grade(delay, good, float("inf")), text)
    yield from _losses(summary)
    if summary["energy"] and (closure := summary["energy"]["closure"]) is not None:
        text = (
            f"energy balance of the specimen closes to {percent(closure)} "
            f"(good: {GOOD_CLOSURE:.0%}; else samples and specimen do not fit)"
        )
        yield Finding("energy_balance", _grade(closure, GOOD_CLOSURE, float("inf")), text)


def _ending(summary: dict[str, Any]) -> Finding:
    trip = summary["trip"]
    if trip is not None:
        text = f"it tripped at {trip['time_s']:.3f} s (step {trip['step']}): {trip['reason']}"
    elif not summary["stable"]:
        text = "it went unstable: samples are not finite"
    elif summary["first_step"] is None:
        text = "the record has no rig/state: nothing is known of it"
    elif not summary["complete"]:
        text = "the record is cut off before the test ended"
    else:
        text = f"it ran to its end, {summary['steps']} steps, {summary['duration_s']:g} s"
        return Finding("ending", Mark.GOOD, text)
    return Finding("ending", Mark.BAD, text)


def _errors(summary: dict[str, Any]) -> Iterator[Finding]:
    """How right it was; without a simulated specimen by its own ground motion and target alone."""
    simulated, part = summary["reference_specimen"] == "simulated", summary["displacement"]
    good = f"good: up to {percent(GOOD_ERROR)}"
    if simulated and part["nrmse"] is None:
        yield Finding("displacement_error", Mark.DOUBT, "its displacement error is not known")
    elif simulated:
        text = (
            f"displacement error {percent(part['nrmse'])} against the exact response of the whole "
            f"structure ({good})"
        )
        yield Finding("displacement_error", _grade(part["nrmse"]), text)
        ratio = part["peak"] / part["reference_peak"] if part["reference_peak"] else float("nan")
        word, off = "larger" if ratio > 1 else "smaller", abs(ratio - 1)
        text = (
            f"peak displacement {percent(off)} {word} than the exact one (good: {GOOD_ERROR:.0%})"
        )
        yield Finding("displacement_peak", _grade(off), text)

    found = summary["equivalent_motion"]
    error = found and found["worst_response_nrmse"]
    if error is None:
        text = "the ground motion that was tested can't be told from the record"
        yield Finding("equivalent_motion", Mark.NONE if simulated else Mark.DOUBT, text)
    else:
        low, high = found["structure"]["band_hz"]
        text = (
            f"linear structures answer the ground motion that was tested up to {percent(error)} "
            f"differently from the one asked for (worst at {found['worst_frequency_hz']:.3g} Hz of "
            f"{low:.3g} to {high:.3g} Hz; {percent(found['response_nrmse'])} with the stiffness of "
            f"the model; {good})"
        )
        yield Finding("equivalent_motion", Mark.NONE if simulated else _grade(error), text)

    target = summary["tracking_error"]
    if target is not None and target["nrmse"] is None:
        yield Finding("tracking_error", Mark.DOUBT, "how far it was from its target is not known")
    elif target is not None:
        text = (
            f"displacement off its target by {percent(target['nrmse'])} "
            f"(RMS {target['rms'] * 1e3:.3g} mm, at most {target['peak'] * 1e3:.3g} mm; {good})"
        )
        yield Finding("tracking_error", Mark.NONE if simulated else _grade(target["nrmse"]), text)


def _losses(summary: dict[str, Any]) -> Iterator[Finding]:
    """Tell what came too late, was lost, or was at the end of its range."""
    missed, steps, link = summary["missed"], summary["steps"], summary["link"]
    if missed is None:
        yield Finding("missed", Mark.DOUBT, "it is not known how many commands came too late")
    elif missed:
        text = f"{missed} of {steps} steps ({percent(missed / steps)}) had no command in time"
        yield Finding("missed", Mark.BAD if missed > BAD_MISSED * steps else Mark.DOUBT, text)
    else:
        yield Finding("missed", Mark.GOOD, "every step had its command in time")
    if link and link["late"]:
        late, forces = link["late"], link["forces"]
        text = (
            f"{late} of {forces} reference forces ({percent(late / forces)}) came after the loop's "
            f"delay of {link['loop_delay']} steps and were predicted, {link['held']} of them held"
        )
        yield Finding("link", Mark.BAD if late > BAD_LATE * forces else Mark.DOUBT, text)
    elif link:
        text = f"every reference force came within the loop's delay of {link['loop_delay']} steps"
        yield Finding("link", Mark.GOOD, text)
    lost = [f"{count} of {topic}" for topic, count in summary["lost"].items() if count]
    if lost and summary["first_step"] is not None:
        text = f"samples are lost from the record: {', '.join(lost)}"
        yield Finding("lost", Mark.DOUBT, text)
    elif summary["first_step"] is not None:
        yield Finding("lost", Mark.GOOD, "no sample is lost from the record")
    if summary["overruns"]:
        text = f"the rig's own clock was held up {summary['overruns']} times"
        yield Finding("overruns", Mark.DOUBT, text)
    saturated = [
        f"{name.replace('_', ' ')} in {row['samples']} samples from step {row['first_step']}"
        for name, row in summary["saturated"].items()
    ]
    if saturated:
        text = f"at the end of its range: {', '.join(saturated)}"
        yield Finding("saturated", Mark.DOUBT, text)
    else:
        yield Finding("saturated", Mark.GOOD, "nothing was at the end of its range")


def _grade(value: float, good: float = GOOD_ERROR, bad: float = BAD_ERROR) -> Mark:
    if value <= good:
        return Mark.GOOD
    return Mark.DOUBT if value <= bad else Mark.BAD
