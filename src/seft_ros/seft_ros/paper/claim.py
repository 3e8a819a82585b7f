"""One claim of the paper, and the kinds of criteria that it is judged by."""

import math
from dataclasses import dataclass
from itertools import pairwise


@dataclass(frozen=True)
class Claim:
    """What the paper says and what comes out here.

    Attributes
    ----------
    where : str
        Figure or section of the paper.
    claim : str
        In a few words.
    paper, ours : str
        Its value or statement, and what was computed.
    agrees : bool
        By the criterion.
    criterion : str
        When they agree, with the tolerance.
    note : str
        Why they do not, or how to read it.
    """

    where: str
    claim: str
    paper: str
    ours: str
    agrees: bool
    criterion: str
    note: str = ""


def near(
    where: str,
    claim: str,
    paper: float,
    ours: float | None,
    within: float,
    unit: str = "",
    *,
    shown: str = ".4g",
    note: str = "",
) -> Claim:
    """Judge a number of the paper: ours must lie within a tolerance in the same unit."""
    known = ours is not None and math.isfinite(ours)
    return Claim(
        where,
        claim,
        _with(unit, f"{paper:g}"),
        _with(unit, f"{ours:{shown}}") if known else "not found",
        known and abs(ours - paper) <= within * (1 + 1e-9),  # type: ignore[operator]
        f"within {_with(unit, f'{within:g}')}",
        note,
    )


def at_most(
    where: str,
    claim: str,
    paper: str,
    ours: float | None,
    limit: float,
    *,
    shown: str = ".3g",
    unit: str = "",
    what: str = "",
    noun: str = "",
    note: str = "",
) -> Claim:
    """Judge a statement by a measure that must not pass a limit.

    ``what`` names the measure in the criterion, ``noun`` in a word behind the value.
    """
    measure = _measure(ours, shown, unit, noun)
    agrees = measure is not None and ours <= limit  # type: ignore[operator]
    criterion = f"{what} at most {_with(unit, f'{limit:{shown}}')}".strip()
    return Claim(where, claim, paper, measure or "not finite", agrees, criterion, note)


def at_least(
    where: str,
    claim: str,
    paper: str,
    ours: float | None,
    limit: float,
    *,
    shown: str = ".3g",
    unit: str = "",
    what: str = "",
    noun: str = "",
    note: str = "",
) -> Claim:
    """Judge a statement by a measure that must reach a limit.

    ``what`` names the measure in the criterion, ``noun`` in a word behind the value.
    """
    measure = _measure(ours, shown, unit, noun)
    agrees = measure is not None and ours >= limit  # type: ignore[operator]
    criterion = f"{what} at least {_with(unit, f'{limit:{shown}}')}".strip()
    return Claim(where, claim, paper, measure or "not finite", agrees, criterion, note)


def growing(
    where: str,
    claim: str,
    paper: str,
    values: list[float],
    *,
    shown: str = ".3g",
    what: str = "",
    note: str = "",
) -> Claim:
    """Judge a statement that something grows from test to test: every value above the last."""
    rises = all(a < b for a, b in pairwise(values))
    text = ", ".join(f"{value:{shown}}" for value in values)
    return Claim(where, claim, paper, text, rises, f"{what} rises from each to the next", note)


def holds(
    where: str, claim: str, paper: str, ours: str, agrees: bool, criterion: str, note: str = ""
) -> Claim:
    """Judge a statement by a criterion of its own."""
    return Claim(where, claim, paper, ours, bool(agrees), criterion, note)


def _with(unit: str, text: str) -> str:
    return f"{text} {unit}" if unit else text


def _measure(value: float | None, shown: str, unit: str, noun: str) -> str | None:
    """Show a measure; None if there is none, or it is not finite."""
    if value is None or not math.isfinite(value):
        return None
    return _with(noun, _with(unit, f"{value:{shown}}"))
