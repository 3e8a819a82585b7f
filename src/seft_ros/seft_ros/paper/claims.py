"""Claims of the paper, stated in claims.yaml, and the verdict on each."""

import math
import operator
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

from rich.table import Table
from ruamel.yaml import YAML

from seft_ros.drawing.style import CENTRED, json_safe, make_table
from seft_ros.paper import measures
from seft_ros.paper.findings import Findings
from seft_ros.paper.paper_tests import BEYOND

Values = Mapping[str, Any]

_CRITERIA = {"at_most": operator.le, "at_least": operator.ge, "above": operator.gt}


@dataclass(frozen=True)
class Claim:
    """A claim of the paper, and the verdict on it.

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
    """A statement of the paper, and how it is measured: claims.yaml explains the fields."""

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


def judge_claims(found: Findings, rows: Iterable[Statement] | None = None) -> list[Claim]:
    """Judge every claim, or those given; none is left out for not agreeing."""
    facts = measures.facts(found)
    claims = []
    for row in statements() if rows is None else rows:
        own = {key: row.each[key] for key in ("kind", "ratio", "name") if key in row.each}
        measure = partial(getattr(measures, row.measure), found, **row.of, **own)
        if row.rises:
            values = {f"at {ratio:g}": _named(measure(ratio=ratio)) for ratio in row.rises}
            measured: Values = {at: named["value"] for at, named in values.items()}
        else:
            measured = _named(measure())
        claims.append(verdict(row, measured, facts))
    return claims


def _named(values: Any) -> Values:
    return values if isinstance(values, dict) else {"value": values}


def statements() -> list[Statement]:
    """Read all claims, in the order of the paper."""
    return list(_spread(read_rows("claims.yaml"), {}))


def read_rows(name: str) -> list[dict[str, Any]]:
    """Read a list of mappings from a file beside this one."""
    return YAML(typ="safe", pure=True).load(Path(__file__).with_name(name))


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


def verdict(row: Statement, measured: Values, facts: Values) -> Claim:
    """Check measured values against a claim's criterion.

    Parameters
    ----------
    row : Statement
        The claim.
    measured : mapping
        What its measure gave, by name; a single number is the ``value``.
    facts : mapping
        Other numbers that its texts name.
    """
    limits = [
        (keeps, measured[name], limit)
        for sign, keeps in _CRITERIA.items()
        if (given := getattr(row, sign)) is not None
        for name, limit in _named(given).items()
    ]
    if row.within is not None:
        value = math.nan if measured["value"] is None else measured["value"]
        limits.append((operator.le, abs(value - float(row.paper)), row.within * (1 + 1e-9)))
    known = all(value is not None and math.isfinite(value) for _, value, _ in limits)
    agrees = known and all(bool(keeps(value, limit)) for keeps, value, limit in limits)
    if row.rises:
        agrees = all(a < b for a, b in pairwise(measured.values()))
    row = _worded(row, measured, known)
    if not known:
        row = replace(row, **row.otherwise)
    if row.against:
        row = replace(row, note="" if agrees else row.against)
    names = {k: v.format(**facts) if isinstance(v, str) else v for k, v in row.each.items()}
    names = {**facts, **names, **measured}
    texts = (row.where, row.claim, row.paper, row.ours, row.criterion)
    where, claim, paper, ours, criterion = (str(text).format(**names) for text in texts)
    note = measured.get("note") or row.note.format(**names)
    return Claim(where, claim, paper, ours, agrees, criterion, note)


def _worded(row: Statement, measured: Values, known: bool) -> Statement:
    """Word the measured values and the criterion, where a row leaves that to its numbers."""
    unit, noun = row.unit and f" {row.unit}", row.noun and f" {row.noun}"
    if row.criterion:
        return row
    if row.rises:
        ours = ", ".join(f"{value:{row.format}}" for value in measured.values())
        return replace(row, ours=ours, criterion=f"{row.what} rises from each to the next")
    if row.within is not None:
        ours = f"{{value:.4g}}{unit}" if known else "not found"
        paper = f"{row.paper:g}{unit}"
        return replace(row, paper=paper, ours=ours, criterion=f"within {row.within:g}{unit}")
    sign, limit = ("least", row.at_least) if row.at_most is None else ("most", row.at_most)
    ours = f"{{value:{row.format}}}{unit}{noun}" if known else "not finite"
    criterion = f"{row.what} at {sign} {limit:{row.format}}{unit}".strip()
    return replace(row, ours=ours, criterion=criterion)


def claims_table(claims: Sequence[Claim], title: str) -> Table:
    """Make a table of claim, paper, ours, agrees."""
    headings = ("claim", "paper", "ours", "agrees")
    verdicts = {True: "[green]yes[/]", False: "[bold red]no[/]"}
    rows = [(f"{c.claim} ({c.where})", c.paper, c.ours, verdicts[c.agrees]) for c in claims]
    return make_table(headings, rows, left=range(4), wrap=True, title=title, **CENTRED)


def summarise_paper(found: Findings, claims: list[Claim], page: Path) -> dict[str, Any]:
    """Summarise a reproduction: ``seft paper --json``.

    Returns
    -------
    dict
        ``record`` (source of the ground motion) and ``synthetic``; ``claims``, a list of claim,
        paper, ours, agrees, criterion, where and note; ``agree`` and ``disagree``, counts;
        ``beyond``, errors of the displacement with the recommended compensator; ``page``, its
        path.
    """
    agree = sum(claim.agrees for claim in claims)
    tests = {ratio: found.tests["target", ratio] for ratio in BEYOND}
    return {
        "record": found.source,
        "synthetic": not found.experiment["ground_motion"]["file"],
        "claims": [asdict(claim) for claim in claims],
        "agree": agree,
        "disagree": len(claims) - agree,
        "beyond": [
            {
                "mass_ratio": ratio,
                "peak_force": test.input_peak,
                "stable": test.stable,
                "nrmse": json_safe(test.agreement("displacement").nrmse),
            }
            for ratio, test in tests.items()
        ],
        "page": str(page),
    }
