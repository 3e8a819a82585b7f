"""The page: every figure beside its claims."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from seft_ros.page.content import Block, Cell, Mark, Section, Table, Text, Verdict, write_page
from seft_ros.paper import figures as drawn
from seft_ros.paper import measures
from seft_ros.paper.claim import Claim, read_rows
from seft_ros.paper.experiments import BEYOND_SHARE
from seft_ros.paper.findings import BEYOND, Findings

PAPER = (
    "N. Nakata and S. Combs, Substructure Effective Force Testing: A Force-Based Real-Time Hybrid "
    "Simulation, 2012"
)


def write_paper(found: Findings, claims: Sequence[Claim], config: str, path: Path) -> None:
    """Write the page.

    Raises
    ------
    InputError
        If the file can't be written.
    """
    facts = measures.facts(found)
    sections = [
        Section("Claims", _overview(found, claims)),
        *(_section(found, facts, claims, **row) for row in read_rows("page.yaml")),
        Section("Beyond the paper", _beyond(found)),
    ]
    subtitle = f"{PAPER}; here with {config} under {facts['source']}"
    write_page(path, "The paper's figures and claims, reproduced", subtitle, sections)


def _overview(found: Findings, claims: Sequence[Claim]) -> list[Block]:
    agree = sum(claim.agrees for claim in claims)
    against = [claim for claim in claims if not claim.agrees]
    record = f"Ground motion: {Path(found.source).name}"
    if not found.experiment["ground_motion"]["file"]:
        record += ", not the paper's Kobe (--file)"
    findings = [Cell(_reason(claim), Mark.BAD) for claim in against]
    return [
        Verdict(
            Mark.GOOD if not against else Mark.DOUBT,
            f"{agree} of {len(claims)} claims agree. {record}.",
            findings,
        ),
        Table(
            ["claim", "paper", "ours", "agrees"],
            [[_placed(claim), claim.paper, claim.ours, _verdict(claim)] for claim in claims],
            numbers=False,
            wide=True,
        ),
    ]


def _section(
    found: Findings,
    facts: Mapping[str, Any],
    judged: Sequence[Claim],
    title: str,
    claims: Sequence[str],
    text: str = "",
    figures: Sequence[Mapping[str, str]] = (),
) -> Section:
    """Make a section of a row of page.yaml."""
    blocks: list[Block] = [Text(text.format(**facts))] if text else []
    for row in figures:
        draw = getattr(drawn, row["name"])
        blocks.append(draw(found, **{key: row[key] for key in row if key != "name"}))
    rows: list[list[str | Cell]] = [
        [_placed(claim), claim.paper, claim.ours, _verdict(claim), _told(claim)]
        for claim in judged
        if claim.where.startswith(tuple(claims))
    ]
    headings = ["claim", "paper", "ours", "agrees", "they agree if"]
    return Section(title, [*blocks, Table(headings, rows, numbers=False, wide=True)])


def _beyond(found: Findings) -> list[Block]:
    full = found.peak_force
    lower = BEYOND_SHARE * full
    text = (
        "The paper could show compensation on an idealised actuator alone. This is the "
        "servo-hydraulic rig with noise, friction and a valve that saturates, under the "
        "recommended method (target_motion, docs/compensation.md). The heavier the "
        f"structure, the faster the piston must move: at {full:g} N the valve can't follow at "
        f"large mass ratios, and no compensation makes flow; the figure is of {lower:g} N."
    )
    kinds = ("plain", "target", "target_full")
    rows: list[list[str | Cell]] = [
        [f"{ratio:g}", *(_error(found, kind, ratio) for kind in kinds)] for ratio in BEYOND
    ]
    headings = [
        "mass ratio alpha",
        f"uncompensated, {lower:g} N",
        f"target_motion, {lower:g} N",
        f"target_motion, {full:g} N",
    ]
    note = Text("Displacement errors, RMS over RMS, without any shift.")
    return [Text(text), Table(headings, rows, wide=True), note, drawn.beyond_figure(found)]


def _error(found: Findings, kind: str, ratio: float) -> Cell:
    test = found.tests[kind, ratio]
    if not test.stable:
        at = "" if test.trip is None else f" at {test.trip.time_s:.2f} s"
        return Cell(f"unstable, trips{at}", Mark.BAD)
    error = test.agreement("displacement").nrmse
    mark = Mark.GOOD if error < 0.05 else Mark.DOUBT
    full = " (valve at its end)" if "valve" in test.saturated else ""
    return Cell(f"{error:.1%}{full}", mark)


def _placed(claim: Claim) -> str:
    return f"{claim.claim} ({claim.where})"


def _verdict(claim: Claim) -> Cell:
    return Cell("yes", Mark.GOOD) if claim.agrees else Cell("no", Mark.BAD)


def _told(claim: Claim) -> str:
    return f"{claim.criterion}.{_sentence(claim.note)}"


def _reason(claim: Claim) -> str:
    return f"{_placed(claim)}: paper {claim.paper}, ours {claim.ours}.{_sentence(claim.note)}"


def _sentence(note: str) -> str:
    return f" {note[:1].upper()}{note[1:]}." if note else ""
