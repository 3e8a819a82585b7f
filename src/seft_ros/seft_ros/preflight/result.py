"""Preflight of a test: everything it finds."""

from collections.abc import Callable
from dataclasses import dataclass

from seft_ros.preflight.margins import Margins, find_margins
from seft_ros.preflight.modes import Mode, predicted_modes
from seft_ros.preflight.plan import Plan
from seft_ros.preflight.verdict import Verdict, judge

LINEAR = "Exact eigenvalues of the sampled closed loop."
SMALL_SIGNAL = (
    "The rig is not linear: exact eigenvalues of its limit for small motions. Valve flow, "
    "friction, stops and yielding are not in them; seft simulate shows what they do."
)
IDENTIFIED = (
    "Exact eigenvalues for the identified plant: as good as its fit, within the band it was "
    "identified in."
)
ADAPTIVE = (
    "The method adapts: this holds for the filter as it is at the start, and as long as its "
    "estimates stay near. It does not promise that the estimates stay there, nor that the test "
    "is stable while they move."
)
FOLLOWS = (
    "The method follows the specimen: all numbers are the worse of the loop as it starts, and of "
    "the loop with the restoring force as measured. What happens while an estimate moves is not "
    "in them."
)


@dataclass(frozen=True)
class Preflight:
    """What is known of a test before anything moves.

    Attributes
    ----------
    verdict, reasons
        See `seft_ros.preflight.verdict.judge`.
    basis : str
        ``exact``: eigenvalues.
    promise : str
        What that promises, and what not.
    margins : Margins
        How far it is from instability.
    modes : list of Mode
        Of the whole structure as the test will show them, lowest first.
    dominant : complex
        Eigenvalue that dies out last or grows fastest.
    states : int
        States of the loop, or loops.
    """

    verdict: Verdict
    reasons: list[str]
    basis: str
    promise: str
    margins: Margins
    modes: list[Mode]
    dominant: complex
    states: int


def preflight(plan: Plan, progress: Callable[[str, int, int], None] | None = None) -> Preflight:
    """Find stability, margins and predicted errors of a plan.

    Parameters
    ----------
    plan : Plan
        The test.
    progress : callable, optional
        See `seft_ros.preflight.margins.find_margins`.
    """
    margins = find_margins(plan, progress)
    verdict, reasons = judge(plan, margins)
    return Preflight(
        verdict,
        reasons,
        "exact",
        promise(plan),
        margins,
        predicted_modes(plan),
        plan.worst(),
        sum(len(loop.matrix) for loop in plan.loops()),
    )


def promise(plan: Plan) -> str:
    """Say what the eigenvalues of a plan promise, and what not."""
    parts = [SMALL_SIGNAL if plan.rig.small_signal else LINEAR]
    if plan.rig.plant.source == "identified":
        parts = [IDENTIFIED]
    if plan.follows:
        parts.append(FOLLOWS)
    elif plan.compensator().estimates():
        parts.append(ADAPTIVE)
    return " ".join(parts)
