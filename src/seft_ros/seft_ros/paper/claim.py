"""Claims of the paper, stated in claims.yaml, and the verdict on each."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from seft_ros.paper import measures
from seft_ros.paper.findings import Findings

Values = Mapping[str, Any]

_CRITERIA: dict[str, Callable[[float, float, Any], bool]] = {
    "within": lambda ours, tolerance, paper: abs(ours - paper) <= tolerance * (1 + 1e-9),
    "at_most": lambda ours, limit, _: ours <= limit,
    "at_least": lambda ours, limit, _: ours >= limit,
    "above": lambda ours, limit, _: ours > limit,
}


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


@dataclass(frozen=True, kw_only=True)
class Statement:
    """What the paper says, and how it is measured: claims.yaml explains the fields."""

    where: str = ""
    claim: str = ""
    paper: str | float = ""
    measure: str = ""
    of: Values = field(default_factory=dict)
    each: Values = field(default_factory=dict)
    within: float | None = None
    at_most: float | Values | None = None
    at_least: float | Values | None = None
    above: float | Values | None = None
    rises: tuple[float, ...] = ()
    format: str = ".3g"
    unit: str = ""
    noun: str = ""
    what: str = ""
    ours: str = ""
    criterion: str = ""
    note: str = ""
    against: str = ""
    otherwise: Values = field(default_factory=dict)


def judge(found: Findings, rows: Iterable[Statement] | None = None) -> list[Claim]:
    """Judge every claim, or those given; none is left out for not agreeing."""
    facts = measures.facts(found)
    rows = statements() if rows is None else rows
    return [verdict(row, _measured(row, found), facts) for row in rows]


def statements() -> list[Statement]:
    """Read all claims, in the order of the paper."""
    return list(_spread(read_rows("claims.yaml"), {}))


def read_rows(name: str) -> list[dict[str, Any]]:
    """Read a list of mappings that stands beside this file."""
    rows: list[dict[str, Any]] = YAML(typ="safe", pure=True).load(Path(__file__).with_name(name))
    return rows


def _spread(rows: Iterable[dict[str, Any]], outer: Values) -> Iterator[Statement]:
    """Make a statement of every column of `each`, of a row or of a group of rows."""
    for row in rows:
        each = row.get("each", {})
        for column in zip(*each.values(), strict=True) if each else [()]:
            own = {**outer, **dict(zip(each, column, strict=True))}
            if "claims" in row:
                yield from _spread(row["claims"], own)
            else:
                yield Statement(**row | {"each": own})


def _measured(row: Statement, found: Findings) -> Values:
    measure = getattr(measures, row.measure)
    own = {key: row.each[key] for key in ("kind", "ratio", "name") if key in row.each}
    of = {**row.of, **own}
    if row.rises:
        return {f"at {ratio:g}": measure(found, **of, ratio=ratio) for ratio in row.rises}
    values = measure(found, **of)
    return values if isinstance(values, dict) else {"value": values}


def verdict(row: Statement, measured: Values, facts: Values) -> Claim:
    """Hold what was measured against a claim's criterion.

    Parameters
    ----------
    row : Statement
        The claim.
    measured : mapping
        What its measure gave, by name; a single number is the ``value``.
    facts : mapping
        What texts speak of besides.
    """
    limits = [
        (keeps, measured[name], limit)
        for sign, keeps in _CRITERIA.items()
        if (given := getattr(row, sign)) is not None
        for name, limit in (given if isinstance(given, dict) else {"value": given}).items()
    ]
    known = all(value is not None and math.isfinite(value) for _, value, _ in limits)
    agrees = known and all(keeps(value, limit, row.paper) for keeps, value, limit in limits)
    if row.rises:
        agrees = all(a < b for a, b in pairwise(measured.values()))
    row = _worded(row, measured, known)
    if not known:
        row = replace(row, **row.otherwise)
    if row.against:
        row = replace(row, note="" if agrees else row.against)
    texts = (row.where, row.claim, row.paper, row.ours, row.criterion)
    names = {k: v.format(**facts) if isinstance(v, str) else v for k, v in row.each.items()}
    names = {**facts, **names, **measured}
    where, claim, paper, ours, criterion = (str(text).format(**names) for text in texts)
    note = measured.get("note") or row.note.format(**names)
    return Claim(where, claim, paper, ours, agrees, criterion, note)


def _worded(row: Statement, measured: Values, known: bool) -> Statement:
    """Word the measured values and the criterion, where a row leaves that to its numbers."""
    unit = row.unit and f" {row.unit}"
    if row.criterion:
        return row
    if row.rises:
        ours = ", ".join(f"{value:{row.format}}" for value in measured.values())
        return replace(row, ours=ours, criterion=f"{row.what} rises from each to the next")
    if row.within is not None:
        ours = f"{{value:.4g}}{unit}" if known else "not found"
        paper = f"{row.paper:g}{unit}"
        return replace(row, paper=paper, ours=ours, criterion=f"within {row.within:g}{unit}")
    most = row.at_most is not None
    limit = f"{row.at_most if most else row.at_least:{row.format}}"
    return replace(
        row,
        ours=f"{{value:{row.format}}}{unit}{row.noun and f' {row.noun}'}"
        if known
        else "not finite",
        criterion=f"{row.what} at {'most' if most else 'least'} {limit}{unit}".strip(),
    )
