"""The page: every figure beside its claims."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from seft_ros.page.content import Block, Cell, Mark, Section, Table, Text, Verdict, write_page
from seft_ros.paper.claim import Claim
from seft_ros.paper.experiments import BEYOND_SHARE, DELAY, told_delay
from seft_ros.paper.figures_loop import closed_loop_figure, open_loop_figure
from seft_ros.paper.figures_tests import (
    beyond_figure,
    histories_figure,
    pure_delay_figure,
    simulations_figure,
)
from seft_ros.paper.findings import BEYOND, Findings

PAPER = (
    "N. Nakata and S. Combs, Substructure Effective Force Testing: A Force-Based Real-Time Hybrid "
    "Simulation, 2012"
)
_FIGURE_8 = (
    "The paper prints this figure as a second “Figure 7”, and its text also calls it Figure 9. "
)


def write_paper(found: Findings, claims: Sequence[Claim], config: str, path: Path) -> None:
    """Write the page.

    Raises
    ------
    InputError
        If the file can't be written.
    """
    sections = [
        Section("Claims", _overview(found, claims)),
        _section("The rig (section 3.1)", claims, ("Section 3.1",), []),
        _section("Figure 3: open loop", claims, ("Figure 3",), [open_loop_figure(found)]),
        _section("Figure 4: closed force loop", claims, ("Figure 4",), [closed_loop_figure(found)]),
        _section(
            "Figure 6: tests without compensation",
            claims,
            ("Figure 6", "Section 4"),
            [Text(_motion(found)), histories_figure(found)],
        ),
        _section(
            "Figure 7: simulations with the delay", claims, ("Figure 7", "Section 5"), _delay(found)
        ),
        _section(
            "Figure 8: delay compensation", claims, ("Figure 8", "Section 6"), _compensation(found)
        ),
        Section("Beyond the paper", _beyond(found)),
    ]
    subtitle = f"{PAPER}; here with {config} under {_source(found)}"
    write_page(path, "The paper's figures and claims, reproduced", subtitle, sections)


def _overview(found: Findings, claims: Sequence[Claim]) -> list[Block]:
    agree = sum(claim.agrees for claim in claims)
    against = [claim for claim in claims if not claim.agrees]
    record = (
        f"Ground motion: {_source(found)}."
        if found.experiment["ground_motion"]["file"]
        else f"Ground motion: {_source(found)}, not the paper's Kobe (--file)."
    )
    findings = [Cell(_reason(claim), Mark.BAD) for claim in against]
    return [
        Verdict(
            Mark.GOOD if not against else Mark.DOUBT,
            f"{agree} of {len(claims)} claims agree. {record}",
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
    title: str, claims: Sequence[Claim], wheres: Sequence[str], blocks: Iterable[Block]
) -> Section:
    own = [claim for claim in claims if claim.where.startswith(tuple(wheres))]
    rows: list[list[str | Cell]] = [
        [_placed(claim), claim.paper, claim.ours, _verdict(claim), _told(claim)] for claim in own
    ]
    headings = ["claim", "paper", "ours", "agrees", "they agree if"]
    return Section(title, [*blocks, Table(headings, rows, numbers=False, wide=True)])


def _source(found: Findings) -> str:
    return Path(found.source).name


def _motion(found: Findings) -> str:
    section = found.experiment["ground_motion"]
    return (
        f"{_source(found)}, largest force {found.peak_force:g} N, time scale "
        f"{section['time_scale']:g}. “Experiment” is the simulated servo-hydraulic rig with its "
        "sensors; the reference is the exact response of the whole structure (Eq. 2.1). All "
        "figures of this kind start at the strong part of the motion (pan or reset to see the "
        "rest), and those of one block zoom together."
    )


def _delay(found: Findings) -> list[Block]:
    bandwidth = found.identified.closed_loops[0].tracking.bandwidth_hz or 0.0
    tau = 1e3 * DELAY
    text = (
        f"Eq. 5.4 feeds acceleration back through a pure delay of tau = {tau:g} ms and a sampling "
        "period. Such an equation is of neutral type: at high frequency its feedback has a gain "
        "of alpha at any delay, and at alpha = 1 it is unstable however short the delay is "
        "(below). The paper's simulation at alpha = 1 was not, so it must have had something that "
        f"ends the bandwidth. The figure therefore uses the same tau = {tau:g} ms as the delay of "
        "an actuator whose force falls off as the identified force loop's does (-3 dB at "
        f"{bandwidth:.3g} Hz, second order, its lag counted in tau). Nothing else is fitted. The "
        "table has the equation as it stands too, and the same with the delay that was "
        "identified on this rig."
    )
    caption = "The simulation lies on the experiment, both off the reference."
    return [
        Text(text),
        simulations_figure(found, "banded", "simulation with delay", caption),
        pure_delay_figure(found),
    ]


def _compensation(found: Findings) -> list[Block]:
    told = 1e3 * told_delay(found.experiment)
    text = (
        f"{_FIGURE_8}Here the actuator has the pure delay of tau = {1e3 * DELAY:g} ms, and the "
        "model-based compensation (Carrion & Spencer 2007) predicts the acceleration over all of "
        "the loop's delay: tau, the sampling period, and half a period of the held force, "
        f"{told:g} ms. Told tau alone it leaves the rest; the last rows show that."
    )
    caption = "With compensation the response lies on the reference; the experiment is off it."
    return [Text(text), simulations_figure(found, "model", "with compensation", caption)]


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
    rows: list[list[str | Cell]] = [
        [
            f"{ratio:g}",
            _error(found, "plain", ratio),
            _error(found, "target", ratio),
            _error(found, "target_full", ratio),
        ]
        for ratio in BEYOND
    ]
    headings = [
        "mass ratio alpha",
        f"uncompensated, {lower:g} N",
        f"target_motion, {lower:g} N",
        f"target_motion, {full:g} N",
    ]
    note = Text("Displacement errors, RMS over RMS, without any shift.")
    return [Text(text), Table(headings, rows, wide=True), note, beyond_figure(found)]


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
    return f"{claim.criterion}. {_capital(claim.note)}." if claim.note else f"{claim.criterion}."


def _reason(claim: Claim) -> str:
    reason = f" {_capital(claim.note)}." if claim.note else ""
    return f"{_placed(claim)}: paper {claim.paper}, ours {claim.ours}.{reason}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
