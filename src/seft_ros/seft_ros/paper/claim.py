"""A statement of the paper as data, when it is met, and the verdict on it."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from seft_ros.paper.findings import Findings


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


@dataclass(frozen=True)
class Criterion:
    """When what was measured agrees with the paper.

    Attributes
    ----------
    words : str
        The criterion for people to read, with the tolerance.
    agrees : callable
        Takes the measured values.
    shown : str
        Format of the measured values.
    unknown : str
        Shown where a value is missing or not finite, which does not agree; empty: such values
        are judged like others.
    """

    words: str
    agrees: Callable[..., bool]
    shown: str
    unknown: str = ""


Text = str | Callable[..., str]
"""A text, or a function of the findings and of what is measured that makes it."""


@dataclass(frozen=True)
class Statement:
    """What the paper says, and how it is measured here.

    Attributes
    ----------
    where, claim, paper, note
        As in `Claim`.
    criterion : Criterion
        Of what ``measure`` gives.
    measure : callable
        Takes the findings and ``of``; gives one value, several in a tuple, or None.
    of : tuple
        What is measured: kind of test, mass ratio, quantity, as the measure asks for.
    otherwise : Statement or None
        Judged in its place where the measure gives None.
    """

    where: str
    claim: Text
    paper: str
    criterion: Criterion
    measure: Callable[..., Any]
    of: tuple[Any, ...] = ()
    note: Text = ""
    otherwise: "Statement | None" = None

    def judge(self, found: Findings) -> Claim:
        """Measure, and hold it against the criterion."""
        measured = self.measure(found, *self.of)
        if measured is None and self.otherwise is not None:
            return self.otherwise.judge(found)
        values = measured if isinstance(measured, tuple) else (measured,)
        rule = self.criterion
        known = not (rule.unknown and any(v is None or not math.isfinite(v) for v in values))
        claim, note = (
            text if isinstance(text, str) else text(found, *self.of)
            for text in (self.claim, self.note)
        )
        return Claim(
            self.where,
            claim,
            self.paper,
            rule.shown.format(*values) if known else rule.unknown,
            known and bool(rule.agrees(*values)),
            rule.words,
            note,
        )


def number(
    where: str,
    claim: str,
    paper: float,
    within: float,
    unit: str,
    measure: Callable[..., Any],
    *of: Any,
    note: str = "",
) -> Statement:
    """State a number of the paper: ours must lie within a tolerance in the same unit."""
    rule = Criterion(
        f"within {within:g} {unit}".strip(),
        lambda ours: abs(ours - paper) <= within * (1 + 1e-9),
        _format(".4g", unit),
        "not found",
    )
    return Statement(where, claim, f"{paper:g} {unit}".strip(), rule, measure, of, note)


def at_most(
    limit: float, what: str = "", shown: str = ".3g", unit: str = "", noun: str = ""
) -> Criterion:
    """Let a measure not pass a limit.

    ``what`` names the measure in the criterion, ``noun`` in a word behind the value.
    """
    words = f"{what} at most {limit:{shown}} {unit}".strip()
    return Criterion(words, lambda ours: ours <= limit, _format(shown, unit, noun), "not finite")


def at_least(
    limit: float, what: str = "", shown: str = ".3g", unit: str = "", noun: str = ""
) -> Criterion:
    """Let a measure reach a limit; as `at_most`."""
    words = f"{what} at least {limit:{shown}} {unit}".strip()
    return Criterion(words, lambda ours: ours >= limit, _format(shown, unit, noun), "not finite")


def rising(what: str, shown: str = ".3g") -> Criterion:
    """Let three values, of three mass ratios, rise from each to the next."""
    return Criterion(
        f"{what} rises from each to the next",
        lambda *values: all(a < b for a, b in pairwise(values)),
        ", ".join([_format(shown)] * 3),
    )


def _format(shown: str, *words: str) -> str:
    return " ".join([f"{{:{shown}}}", *filter(None, words)])
