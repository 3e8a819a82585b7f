"""Whether a test can be trusted, from the numbers of its summary; all thresholds are here."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from seft_msgs_py.wire.outcome import BY_OPERATOR

from seft_ros.drawing.style import GOOD_ERROR, Mark, percent

BAD_ERROR = 0.15
"""Displacement error (nrmse), and error of its peak, from which a test is worth nothing; likewise
for the response to its own ground motion, and for a target's displacement."""
GOOD_VIBRATION, BAD_VIBRATION = 0.1, 0.3
"""Acceleration in the instability band beyond the reference's, over all of the reference's."""
GOOD_EFFECT = 0.02
"""Displacement error that a wrong mass, scale or lag would mean: less than half of what would be
too much, because it is an estimate. It may be several times too large, so no test is worth nothing
for it. What a drift means is known better: `GOOD_ERROR` is its bound."""
BAD_MISSED = 0.05
"""Share of steps that missed the command deadline."""
BAD_LATE = 0.2
"""Share of reference forces that came over the link after the loop's delay."""
GOOD_CLOSURE = 0.05
"""Error of the energy balance: do the samples fit the specimen they are said to be of?"""
UNTOLD = 0.01
"""Of the forces' scale: no motion shows it, so what it would mean is said where nobody told it."""
GOOD_DELAY = 2.0
"""Periods that the force loop may lag where nothing compensates for it."""

BY_TRUTH = "By the truth of the simulation, this"
IN_LABORATORY = "As a laboratory would see it, this"
"""Beginnings of the two verdicts on a simulated test."""
_WORDS = {
    Mark.GOOD: "test can be trusted",
    Mark.DOUBT: "test can be trusted with reservations",
    Mark.BAD: "test can not be trusted",
}
_ACTUATORS = ("force_capacity", "stroke", "valve")
"""What may be saturated without a sample being wrong."""
_CLIPPED = "acceleration_range"


@dataclass(frozen=True)
class TestFinding:
    """One fact for or against a test: what and how much; in detail, how much would be good."""

    name: str
    verdict: Mark
    text: str
    detail: str = ""

    @property
    def whole(self) -> str:
        """Text and detail in one line."""
        return f"{self.text} ({self.detail})" if self.detail else self.text


@dataclass(frozen=True)
class Assessment:
    """Verdict on a test: that of its worst finding, in one line; and all, the worst first."""

    verdict: Mark
    text: str
    findings: list[TestFinding]


def assess_test(summary: dict[str, Any], this: str = "This") -> Assessment:
    """Assess a test by the summary that `seft_ros.analysis.report_numbers` gives.

    No other place marks a test: terminal, page and JSON show what comes of this. ``this`` begins
    the line.
    """
    order = (Mark.BAD, Mark.DOUBT, Mark.GOOD, Mark.NONE)
    parts = (_beginning, response_findings, calibration_findings, _together, _untold, _loop, losses)
    found = (finding for part in parts for finding in part(summary))
    findings = sorted(found, key=lambda finding: order.index(finding.verdict))
    worst = findings[0].verdict
    reasons = "; ".join(finding.text for finding in findings if finding.verdict is worst)
    because = "".join(f", but {one.text}" for one in _untold(summary))
    because = because if worst is Mark.GOOD else f": {reasons}"
    return Assessment(worst, f"{this} {_WORDS[worst]}{because}.", findings)


def own_response(summary: dict[str, Any]) -> float | None:
    """Give the response error to the test's own ground motion, beyond noise; None if unknown."""
    found = summary["equivalent_motion"]
    if not found or found["specimen_response_nrmse"] is None:
        return None
    error, noise = found["specimen_response_nrmse"], found["noise_nrmse"] or 0.0
    return math.sqrt(max(error**2 - noise**2, 0.0))


def _is_simulated(summary: dict[str, Any]) -> bool:
    return bool(summary["reference_specimen"] == "simulated")


def ramp_note(summary: dict[str, Any]) -> str:
    """Say where a test's numbers leave out its ramp-down; empty if there is none."""
    assessed, steps = summary["judged_steps"], summary["steps"]
    note = f"numbers are of its first {assessed} steps and leave out the ramp-down"
    return "" if assessed == steps else note


def _early_ending(summary: dict[str, Any]) -> str:
    """Say how a test ended before its time; empty: it did not."""
    trip = summary["trip"]
    if trip is not None:
        return f"tripped at {trip['time_s']:.3f} s (step {trip['step']}): {trip['reason']}"
    if not summary["stable"]:
        return "unstable: samples are not finite"
    if summary["first_step"] is None:
        return "nothing known: the recording has no rig/state"
    if not summary["complete"]:
        return "cut off: the recording ends before the test did"
    return ""


def _beginning(summary: dict[str, Any]) -> Iterator[TestFinding]:
    """Find whether all of the test is there."""
    if summary["damage"]:
        yield TestFinding("damage", Mark.DOUBT, "the bag is damaged", "; ".join(summary["damage"]))
    elif not summary["checked"]:
        text = "the bag has no checksums: samples that were changed would not be noticed"
        yield TestFinding("checked", Mark.NONE, text)
    if summary["first_step"]:
        errors = "errors are of what is there, against the reference response from step 0 on"
        text = f"the recording begins at step {summary['first_step']} of the test; {errors}"
        yield TestFinding("beginning", Mark.BAD, text)
    ending = _early_ending(summary)
    if ending:
        yield TestFinding("ending", Mark.BAD, ending, ramp_note(summary))
    elif summary["stopped"]:
        text = f"it was {BY_OPERATOR} at {summary['judged_steps'] / summary['rate_hz']:.3f} s"
        yield TestFinding("ending", Mark.DOUBT, text, ramp_note(summary))
    else:
        text = f"it ran to its end, {summary['steps']} steps, {summary['duration_s']:g} s"
        yield TestFinding("ending", Mark.GOOD, text)


def response_findings(summary: dict[str, Any]) -> Iterator[TestFinding]:
    """Find how right it was; without a simulated specimen its own ground motion and target say."""
    simulated, part = _is_simulated(summary), summary["displacement"]
    good = _up_to(GOOD_ERROR)
    if simulated and part["nrmse"] is None:
        yield TestFinding("displacement_error", Mark.DOUBT, "its displacement error is not known")
    elif simulated:
        against = "against the reference response of the whole structure"
        text = f"displacement error {percent(part['nrmse'])} {against}"
        yield TestFinding("displacement_error", _grade(part["nrmse"]), text, good)
        ratio = part["peak"] / part["reference_peak"] if part["reference_peak"] else float("nan")
        word, off = "larger" if ratio > 1 else "smaller", abs(ratio - 1)
        text = f"peak displacement {percent(off)} {word} than the reference's"
        yield TestFinding("displacement_peak", _grade(off), text, good)

    found, error = summary["equivalent_motion"], own_response(summary)
    target = summary["tracking_error"]
    if error is None:
        text = "the equivalent ground motion is not known from the recording"
        yield TestFinding("equivalent_motion", Mark.NONE if simulated else Mark.DOUBT, text)
    else:
        differs = f"differs by {percent(error)} from that to the one asked for"
        text = f"the specimen's response to the equivalent ground motion {differs}"
        detail = f"{percent(found['response_nrmse'])} if it were its model; {good}"
        # a target's displacement says more: where a specimen slips, the fitted law may be wrong
        mark = _grade(error, GOOD_ERROR, BAD_ERROR if target is None else float("inf"))
        mark = Mark.NONE if simulated else mark
        yield TestFinding("equivalent_motion", mark, text, detail)

    if target is not None and target["nrmse"] is None:
        yield TestFinding("tracking_error", Mark.DOUBT, "its distance from its target is not known")
    elif target is not None:
        text = f"displacement off its target by {percent(target['nrmse'])}"
        detail = f"RMS {target['rms'] * 1e3:.3g} mm, at most {target['peak'] * 1e3:.3g} mm; {good}"
        mark = Mark.NONE if simulated else _grade(target["nrmse"])
        yield TestFinding("tracking_error", mark, text, detail)


_AGAINST = {"force": "acceleration", "acceleration": "displacement", "velocity": "displacement"}


def calibration_findings(summary: dict[str, Any]) -> Iterator[TestFinding]:
    """Find whether mass and channels were as known, by the test's own samples.

    A mass that is not known may be any. The truth of a simulation makes these needless.
    """
    simulated = _is_simulated(summary)
    found: dict[str, Any] = summary["calibration"] or dict.fromkeys(_DEVIATIONS)
    for kind, (shown, what) in _DEVIATIONS.items():
        one = found[kind]
        if one is None:
            text = f"{what} is not known from the test: too short, too quiet, or not described"
            mark = Mark.DOUBT if kind == "mass" and not simulated else Mark.NONE
            yield TestFinding(kind, mark, text)
            continue
        of = "" if len(summary["axes"]) == 1 else f" of {one['axis']}"
        of += f" in the {one['part']}" if one["part"] else ""
        text = f"{shown(one, of)}, an error of {_about(one['effect'])} in displacement"
        bound = GOOD_ERROR if kind == "drift" else GOOD_EFFECT
        mark = Mark.NONE if simulated else _grade(one["effect"], bound, float("inf"))
        yield TestFinding(kind, mark, text, _up_to(bound))


def _together(summary: dict[str, Any]) -> Iterator[TestFinding]:
    """Add up what motion, mass and channels may mean, with what is not known of them."""
    motion, found = own_response(summary), summary["calibration"]
    if motion is None or not found or found["at_most"] is None:
        return
    most = math.hypot(motion, found["at_most"])
    text = f"ground motion, mass and channels together may mean an error of {_about(most)}"
    counts = "which also counts how well the test shows them, or seft identify --specimen"
    both = f"{_about(motion)} and {_about(found['at_most'])}"
    detail = f"{both}, {counts}; {_up_to(GOOD_ERROR)}"
    mark = _grade(most, GOOD_ERROR, float("inf"))
    yield TestFinding("together", Mark.NONE if _is_simulated(summary) else mark, text, detail)


def _untold(summary: dict[str, Any]) -> Iterator[TestFinding]:
    """Find what an error of the forces would mean, where nobody told it: nothing can show it."""
    effect = (summary["calibration"] or {}).get("force_scale")
    if effect and not _is_simulated(summary):
        means = f"{_about(UNTOLD)} would mean an error of {_about(effect)} in displacement"
        text = f"nobody told the load cell's scale, of which {means}"
        how = "it is told by seft identify --known-mass or --known-force"
        yield TestFinding("force_scale", Mark.NONE, text, how)


def _about(value: float) -> str:
    """Write an estimated ratio as a percentage of two digits."""
    return f"{float(f'{value * 100:.2g}'):g} %"


def _up_to(bound: float) -> str:
    """Give the bound of what is good, in the unit of the ratios that it is for."""
    return f"good: up to {bound * 100:g} %"


def _of_mass(one: dict[str, Any], of: str) -> str:
    shown = f"mass{of} {one['estimate']:.4g} ± {one['error']:.2g} kg, known {one['told']:.4g} kg"
    share = percent(one["estimate"] / one["told"])
    return shown if one["effect"] <= GOOD_EFFECT else f"{shown}, or {share} of the true force"


def _of_scale(one: dict[str, Any], of: str) -> str:
    off = one["estimate"] - one["told"]
    if one["part_of"] != one["axis"]:
        size = f"{off * 100:.3g} ± {one['error'] * 100:.2g} %"
        return f"{one['channel']}{of} shows {size} of that of {one['part_of']}"
    size = f"{abs(off) * 100:.3g} ± {one['error'] * 100:.2g} %"
    more = "larger" if off > 0 else "smaller"
    return f"{one['channel']}{of} is {size} {more} than the displacement says"


def _of_lag(one: dict[str, Any], of: str) -> str:
    late = one["estimate"] - one["told"]
    word, against = "behind" if late > 0 else "ahead of", _AGAINST[one["channel"]]
    size = f"{abs(late) * 1e3:.2g} ± {one['error'] * 1e3:.2g} ms"
    return f"{one['channel']}{of} is {size} {word} the {against}"


def _of_drift(one: dict[str, Any], of: str) -> str:
    unit = "N" if one["channel"] == "force" else "m/s²"
    size = f"{abs(one['estimate']):.3g} ± {one['error']:.3g} {unit}"
    word = f"is {size} off" if one["part"] else f"moved by {size}"
    return f"the zero of {one['channel']}{of} {word}"


_DEVIATIONS = {
    "mass": (_of_mass, "the specimen's mass"),
    "scale": (_of_scale, "the channels' scale"),
    "lag": (_of_lag, "their lag"),
    "drift": (_of_drift, "their zero"),
}


def _loop(summary: dict[str, Any]) -> Iterator[TestFinding]:
    """Find what the force loop did, of the numbers that are known."""
    ratio, delay = summary["vibration"]["ratio"], summary["uncompensated_delay_s"]
    if ratio is not None:
        low, high = summary["instability_band_hz"]
        where = f"where instability would start, {low:.3g} to {high:.3g} Hz"
        text = f"vibration of {percent(ratio)} of the reference acceleration {where}"
        mark, detail = _grade(ratio, GOOD_VIBRATION, BAD_VIBRATION), _up_to(GOOD_VIBRATION)
        if not _is_simulated(summary) and summary["tracking_error"] is not None:
            mark, detail = Mark.NONE, "the reference is of the assumed specimen; the target decides"
        yield TestFinding("vibration", mark, text, detail)
    if delay is not None:
        good = GOOD_DELAY * (1.0 / summary["rate_hz"])
        text = f"force lags by {delay * 1e3:.3g} ms and nothing compensates for it"
        detail = f"good: up to {good * 1e3:.3g} ms"
        yield TestFinding("delay", _grade(delay, good, float("inf")), text, detail)
    if summary["energy"] and (closure := summary["energy"]["closure"]) is not None:
        text = f"energy balance of the specimen closes to {percent(closure)}"
        detail = f"{_up_to(GOOD_CLOSURE)}; otherwise samples and specimen do not fit"
        mark = _grade(closure, GOOD_CLOSURE, float("inf"))
        if not _is_simulated(summary):
            mark, detail = Mark.NONE, "of the assumed specimen, which need not be the real one"
        yield TestFinding("energy_balance", mark, text, detail)


def losses(summary: dict[str, Any]) -> Iterator[TestFinding]:
    """Find what was too late, lost, or saturated."""
    missed, steps, link = summary["missed"], summary["steps"], summary["link"]
    mark, text = Mark.GOOD, "no step missed the command deadline"
    if missed is None:
        mark, text = Mark.DOUBT, "it is not known how many steps missed the command deadline"
    elif missed:
        mark = Mark.BAD if missed > BAD_MISSED * steps else Mark.DOUBT
        text = f"{missed} of {steps} steps missed the command deadline{_in_a_stall(summary)}"
    yield TestFinding("missed", mark, text)
    if link and link["late"]:
        late, forces = link["late"], link["forces"]
        predicted = f"{link['loop_delay']} steps and were predicted, {link['held']} of them held"
        text = f"{late} of {forces} reference forces came after the loop's delay of {predicted}"
        yield TestFinding("link", Mark.BAD if late > BAD_LATE * forces else Mark.DOUBT, text)
    elif link:
        text = f"every reference force came within the loop's delay of {link['loop_delay']} steps"
        yield TestFinding("link", Mark.GOOD, text)
    lost = [f"{count} of {topic}" for topic, count in summary["lost"].items() if count]
    if summary["first_step"] is not None:
        text = f"samples lost: {', '.join(lost)}"
        text = text if lost else "no sample is lost from the recording"
        yield TestFinding("lost", Mark.DOUBT if lost else Mark.GOOD, text)
    if summary["overruns"]:
        text = f"sampling overruns of the rig: {summary['overruns']}"
        yield TestFinding("overruns", Mark.DOUBT, text)
    saturated = [
        f"{name.replace('_', ' ')} in {row['samples']} samples from "
        f"{row['first_step'] * (1.0 / summary['rate_hz']):.3f} s"
        for name, row in summary["saturated"].items()
    ]
    text = f"saturated: {', '.join(saturated)}" if saturated else "nothing was saturated"
    error, allowed = _error_of_motion(summary), set(_ACTUATORS)
    clipped = (summary["calibration"] or {}).get("clipped")
    if clipped is not None and clipped <= GOOD_EFFECT:
        allowed.add(_CLIPPED)
    no_sensor = set(summary["saturated"]) <= allowed
    good = not saturated or (no_sensor and error is not None and error <= GOOD_ERROR)
    detail = "and the specimen moved as it should all the same" if saturated and good else ""
    yield TestFinding("saturated", Mark.GOOD if good else Mark.DOUBT, text, detail)


def _error_of_motion(summary: dict[str, Any]) -> float | None:
    """Give how far the specimen was from where it should be; without a target, its own motion."""
    if _is_simulated(summary):
        return summary["displacement"]["nrmse"]
    target = summary["tracking_error"]
    return own_response(summary) if target is None else target["nrmse"]


def _in_a_stall(summary: dict[str, Any]) -> str:
    """Say how many of the missed steps were the host's doing, if that was watched."""
    stalls = (summary.get("timing") or {}).get("stalls")
    if not stalls or not stalls["missed_listed"]:
        return ""
    text = f", {stalls['missed_in_a_stall']} of them during a host scheduling stall"
    if stalls["missed_listed"] < summary["missed"]:
        text += f" (of the first {stalls['missed_listed']})"
    return text


def _grade(value: float, good: float = GOOD_ERROR, bad: float = BAD_ERROR) -> Mark:
    if value <= good:
        return Mark.GOOD
    return Mark.DOUBT if value <= bad else Mark.BAD
