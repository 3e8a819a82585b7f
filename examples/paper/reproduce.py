"""Reproduce the figures and claims of the paper (Nakata & Combs 2012) on one page.

    .venv/bin/python examples/paper/reproduce.py
    .venv/bin/python examples/paper/reproduce.py --file kobe.txt --unit cm/s2 --dt 0.005 --column 0

Identifies the simulated rig of config/jhu.yaml, runs the paper's tests and simulations, and
assesses every number and statement by a criterion that the page shows. Without --file the motion is
synthetic; the paper's is Kobe 1995, JMA N-S.

Exit status 0: the page was made. A claim that does not agree is a finding, not a failure. 1:
interrupted, or the rig can't be identified. 2: wrong input.
"""

import argparse
import json
import re
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.models import Range1d
from bokeh.plotting import figure
from claims import Claim, assess, decibels
from force_loop import sampled
from paper_tests import BEYOND, BEYOND_SHARE, COMPUTED, TAU, Findings, Outcome, find, whole_delay
from rich.console import Console
from seft_msgs_py.arrays import Complexes, Floats
from seft_msgs_py.errors import InputError, SeftError
from seft_ros.drawing import page, style
from seft_ros.drawing.page import Grid, PageSection, Plot, Text, line, plot
from seft_ros.drawing.style import FIRST_COLOUR, OTHERS, REFERENCE, Cell, Mark, TextTable
from seft_ros.identification.measured_test import BAND_HZ

PAPER = (
    "N. Nakata and S. Combs, Substructure Effective Force Testing: A Force-Based Real-Time Hybrid "
    "Simulation, 2012"
)
HEADINGS = ("claim", "paper", "ours", "agrees")
TABLE_HEAD = "| claim | paper | ours |"
ORDER = ("displacement", "force", "acceleration")
"""Of quantities in the table of a page, which states what agrees for the first."""
QUANTITY = re.compile("|".join(ORDER))
MEASURED, MODEL = "experiment", "analysis"
RANGE_HZ, CLOSED_TO_HZ = (0.5, 200.0), 60.0
UNITS = style.DISPLAY_UNITS | {"force": ("kN", 1e-3)}
SIMULATED, COMPENSATED = OTHERS[2], OTHERS[1]
STRONG, MARGIN_S = (0.1, 0.9), 0.3  # of the energy: the part in view at first; s around it

Response = tuple[Floats, Complexes, str]  # Hz, values, label
Curve = tuple[Floats, dict[str, Floats], str, str]  # time, signals, label, colour


def write_page(found: Findings, claims: Sequence[Claim], path: Path) -> None:
    """Write the page; an InputError says that the file can't be written."""
    peak, scale = (
        found.tests["rig", 0.0].input_peak,
        found.experiment["ground_motion"]["time_scale"],
    )
    tau, source = f"{1e3 * TAU:g} ms", Path(found.source).name
    bandwidth = found.identified.closed_loops[0].tracking.bandwidth_hz or 0.0
    sections = [PageSection("Claims", _overview(found, claims))]
    for title, where, *blocks in (
        ("The rig (section 3.1)", "Section 3.1"),
        ("Figure 3: open loop", "Figure 3", open_loop_figure(found)),
        ("Figure 4: closed force loop", "Figure 4", closed_loop_figure(found)),
        ("Figure 6: tests without compensation", ("Figure 6", "Section 4"), Text(
            f"{source}, largest force {peak:g} N, time scale {scale:g}. “Experiment” is the "
            "simulated servo-hydraulic rig with its sensors; the reference is the exact response "
            "of the whole structure (Eq. 2.1). All figures of this kind start at the strong part "
            "of the motion (pan or reset to see the rest), and those of one block zoom together."
        ), histories_figure(found)),
        ("Figure 7: simulations with the delay", ("Figure 7", "Section 5"), Text(
            f"Eq. 5.4 feeds acceleration back through a pure delay of tau = {tau} and a sampling "
            "period. Such an equation is of neutral type: at high frequency its feedback has a "
            "gain of alpha at any delay, and at alpha = 1 it is unstable however short the delay "
            "is. The paper's simulation at alpha = 1 was not, so it must have had "
            "something that ends the bandwidth. The figure therefore uses the same tau = "
            f"{tau} as the delay of an actuator whose force falls off as the identified force "
            f"loop's does (-3 dB at {bandwidth:.3g} Hz, second order, its lag counted in tau). "
            "Nothing else is fitted. The table has the equation as printed, too, and the same "
            "with the delay that was identified on this rig."
        ), simulations_figure(
            found, "banded", "simulation with delay",
            "The simulation coincides with the experiment, and both differ from the reference.",
        )),
        ("Figure 8: delay compensation", ("Figure 8", "Section 6"), Text(
            "The paper prints this figure as a second “Figure 7”, and its text also calls it "
            f"Figure 9. Here the actuator has the pure delay of tau = {tau}, and the model-based "
            "compensation (Carrion & Spencer 2007) predicts the acceleration over all of the "
            "loop's delay: tau, the sampling period, and half a period of the held force, "
            f"{1e3 * whole_delay(found.experiment):g} ms. For tau alone it leaves the rest; the "
            "last rows show that."
        ), simulations_figure(
            found, "model", "with compensation",
            "With compensation the response coincides with the reference; the experiment differs "
            "from it.",
        )),
    ):  # fmt: skip
        own = [claim for claim in claims if claim.where.startswith(where)]
        rows = [[*_cells(claim), f"{claim.criterion}.{_sentence(claim.note)}"] for claim in own]
        table = TextTable((*HEADINGS, "they agree if"), rows, numbers=False, wide=True)
        sections.append(PageSection(title, [*blocks, table]))
    sections.append(PageSection("Beyond the paper", _beyond(found)))
    subtitle = f"{PAPER}; here with the paper's rig under {source}"
    page.write_page(path, "The paper's figures and claims, reproduced", subtitle, sections)


def _overview(found: Findings, claims: Sequence[Claim]) -> list[page.Block]:
    against = [
        Cell(f"{_placed(c)}: paper {c.paper}, ours {c.ours}.{_sentence(c.note)}", Mark.BAD)
        for c in claims
        if not c.agrees
    ]
    record = f"Ground motion: {Path(found.source).name}"
    if not found.experiment["ground_motion"]["file"]:
        record += ", not the paper's Kobe (--file)"
    text = f"{len(claims) - len(against)} of {len(claims)} claims agree. {record}."
    return [page.VerdictBox(Mark.DOUBT if against else Mark.GOOD, text, against)]


def _beyond(found: Findings) -> list[page.Block]:
    rows = [[f"{ratio:g}", f"{_target_error(found, ratio):.1%}"] for ratio in BEYOND]
    peak = BEYOND_SHARE * found.tests["rig", 0.0].input_peak
    text = (
        "The paper could show compensation on an idealised actuator alone. This is the "
        "servo-hydraulic rig with noise, friction and a valve that saturates, under target_motion "
        f"(docs/compensation.md) and a motion of {peak:g} N, whose flow the valve can serve: "
        "displacement errors, RMS over RMS, without any shift."
    )
    return [Text(text), TextTable(("mass ratio alpha", "error"), rows)]


def _target_error(found: Findings, ratio: float) -> float:
    return found.tests["target", ratio].agreement("displacement").nrmse


def _cells(claim: Claim) -> list[str | Cell]:
    agrees = Cell("yes", Mark.GOOD) if claim.agrees else Cell("no", Mark.BAD)
    return [_placed(claim), claim.paper, claim.ours, agrees]


def _placed(claim: Claim) -> str:
    return f"{claim.claim} ({claim.where})"


def _sentence(note: str) -> str:
    return f" {note[:1].upper()}{note[1:]}." if note else ""


def open_loop_figure(found: Findings) -> Grid:
    """Draw Figure 3: plant, controller and loop; magnitudes above, phases below."""
    measured, model = found.identified.valves[0].measured, found.loop
    f, own, dt = measured.frequencies_hz, model.frequencies_hz, found.experiment.timebase.dt
    drive = sampled(model.controller, dt)(np.exp(2j * np.pi * f * dt))
    roots = [root.hz for root in (model.plant.antiresonance(), model.plant.oil_column()) if root]
    crossover = model.margins.crossover_hz
    columns: list[tuple[str, list[Response], list[float], str]] = [
        ("(a) valve to force, N/V",
         [(f, measured.response, MEASURED), (own, model.valve_to_force, MODEL)], roots,
         "Zero at the specimen's natural frequency; pole at the oil column's."),
        ("(b) controller, V/N", [(own, model.drive, "as it runs")], [],
         "Its poles are at the plant's zero."),
        ("(c) loop", [(f, drive * measured.response, MEASURED), (own, model.loop, MODEL)],
         [] if crossover is None else [crossover],
         "High, then low, without a kink; it crosses 0 dB at the mark."),
    ]  # fmt: skip
    shared, magnitudes, phases = Range1d(*RANGE_HZ), [], []
    for title, curves, marks, caption in columns:
        panels = [
            plot("frequency / Hz", label, x_range=shared, log_x=True)
            for label in (f"{title}, dB", "phase / degrees")
        ]
        _draw_responses(panels, curves, RANGE_HZ[1])
        for hz in marks:
            page.mark(panels[0], hz)
        magnitudes.append(Plot(panels[0], caption))
        phases.append(Plot(panels[1]))
    page.level(magnitudes[-1].figure, 0.0)
    return Grid([*magnitudes, *phases])


def closed_loop_figure(found: Findings) -> Grid:
    """Draw Figure 4: reference force to measured force."""
    shared = Range1d(0.0, CLOSED_TO_HZ, bounds=(0.0, CLOSED_TO_HZ))
    labels = ("(a) magnitude, dB", "(b) phase / degrees")
    panels = [plot("frequency / Hz", label, x_range=shared) for label in labels]
    closed, model = found.identified.closed_loops[0], found.loop
    own = closed.measured.frequencies_hz, closed.measured.response, MEASURED
    modelled = model.frequencies_hz, model.tracking, MODEL
    _draw_responses(panels, [own, modelled], CLOSED_TO_HZ)
    page.level(panels[0], 0.0)
    for panel in panels:
        page.band(panel, 0.0, BAND_HZ, color=FIRST_COLOUR)
    if closed.tracking.dip_hz is not None:
        page.mark(panels[0], closed.tracking.dip_hz)
    captions = (
        f"Flat up to {BAND_HZ:g} Hz (shaded), with a small dip at the mark.",
        f"Nearly a straight line: a delay, here of {1e3 * found.own_delay:.1f} ms.",
    )
    return Grid([Plot(*pair) for pair in zip(panels, captions, strict=True)], columns=2)


def _draw_responses(panels: Sequence[figure], curves: Sequence[Response], to_hz: float) -> None:
    """Draw magnitude and phase, the experiment below the analysis."""
    for hz, response, label in curves:
        shown = (hz >= RANGE_HZ[0]) & (hz <= to_hz)
        hz, response = hz[shown], response[shown]
        color, dash = (OTHERS[2], "6 4") if label == MODEL else (FIRST_COLOUR, "solid")
        phase = np.degrees(np.unwrap(np.angle(response)))
        for panel, values in zip(panels, (decibels(response), phase), strict=True):
            line(panel, hz, values, label, color=color, dash=dash)


def histories_figure(found: Findings) -> Grid:
    """Draw Figure 6: displacement, force and acceleration at three mass ratios."""
    cells = []
    for name, ratio in product(style.RESPONSES, (0.0, *COMPUTED)):
        test, (unit, factor) = found.tests["rig", ratio], UNITS[name]
        error = test.agreement(name)
        caption = (
            f"Error after the best-fit delay {error.nrmse_aligned:.1%}, largest "
            f"{factor * error.peak:.3g}, reference {factor * error.reference_peak:.3g} {unit}."
        )
        cells.append((name, ratio, [*_on_rig(test)], caption))
    return _grid(found, cells, 3)


def simulations_figure(found: Findings, kind: str, label: str, caption: str) -> Grid:
    """Draw Figure 7 or 8: reference, experiment and a simulation, ``kind`` of `Findings.tests`.

    ``label`` is its name in the legend, ``caption`` says what to look for.
    """
    color = SIMULATED if kind == "banded" else COMPENSATED
    cells = []
    for name, ratio in product(("displacement", "acceleration"), COMPUTED):
        test = found.tests[kind, ratio]
        curves = [*_on_rig(found.tests["rig", ratio]), (test.time, test.measured, label, color)]
        cells.append((name, ratio, curves, caption))
    return _grid(found, cells, 2)


def _on_rig(test: Outcome) -> tuple[Curve, Curve]:
    return (
        (test.time, test.exact, "reference", REFERENCE),
        (test.time, test.measured, MEASURED, FIRST_COLOUR),
    )


def _grid(
    found: Findings, cells: Iterable[tuple[str, float, list[Curve], str]], columns: int
) -> Grid:
    """Draw time histories that zoom together, and begin at the motion's strong part."""
    test = found.tests["rig", 0.0]
    shared = page.time_range(test.time)
    energy = np.cumsum(test.exact["acceleration"] ** 2)
    if energy[-1] > 0:
        start, end = np.interp(STRONG, energy / energy[-1], test.time)
        shared.start, shared.end = max(0.0, start - MARGIN_S), min(shared.end, end + MARGIN_S)
    plots = []
    for letter, (name, ratio, curves, caption) in zip("abcdefghi", cells, strict=False):
        unit, factor = UNITS[name]
        label = f"({letter}) {name}, alpha = {ratio:g} / {unit}"
        panel = plot("time / s", label, x_range=shared)
        for time, signals, label, color in curves:
            # a dashed line shows what lies below
            dash = "5 3" if color in (SIMULATED, COMPENSATED) else "solid"
            line(panel, time, factor * signals[name], label, color=color, width=1.1, dash=dash)
        plots.append(Plot(panel, caption))
    return Grid(plots, columns)


def summarise(found: Findings, claims: Sequence[Claim], path: Path) -> dict[str, Any]:
    """Summarise for ``--json``: record, synthetic, claims, agree, disagree, beyond, page."""
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
                "nrmse": style.json_safe(_target_error(found, ratio)),
            }
            for ratio, test in tests.items()
        ],
        "page": str(path),
    }


def write_table(claims: Sequence[Claim], path: Path) -> None:
    """Put the claims in place of the table of claims in a Markdown page.

    Those whose two values are equal are left out: they restate the configuration. So are those that
    agree, as does the same claim on a quantity before theirs in `ORDER`. Values that do not agree
    are bold. An InputError says if the page has no such table, or can't be read or
    written.
    """
    try:
        before, head, after = path.read_text(encoding="utf-8").partition(TABLE_HEAD + "\n")
        if not head:
            raise InputError(f"{path}: has no table to replace; it must begin with {TABLE_HEAD}")
        old = after.splitlines(keepends=True)
        length = next((i for i, row in enumerate(old) if not row.startswith("|")), len(old))
        rows = ["|---|---|---|\n"]
        agreed = {claim.claim for claim in claims if claim.agrees and claim.paper != "not stated"}
        for claim in claims:
            quantity = QUANTITY.search(claim.claim)
            earlier = ORDER[: ORDER.index(quantity[0])] if quantity else ()
            others = (QUANTITY.sub(name, claim.claim, count=1) for name in earlier)
            repeats = claim.agrees and any(other in agreed for other in others)
            if claim.ours != claim.paper and not repeats:
                ours = claim.ours if claim.agrees else f"**{claim.ours}**"
                cells = (_placed(claim), claim.paper, ours)
                rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n")
        path.write_text("".join([before, head, *rows, *old[length:]]), encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: {getattr(error, 'strerror', None) or error}") from None


def given_motion(words: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Ground motion of a command line, as changes of the experiment."""
    named = {name: getattr(words, name) for name in ("unit", "dt", "column")}
    given = {name: value for name, value in named.items() if value is not None}
    if words.file is None and given:
        raise InputError(f"--{next(iter(given))}: needs a record; name its --file")
    return {"ground_motion": {"file": str(words.file), **given} if words.file else {}}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; exit status as the module says."""
    summary, _, usage = (__doc__ or "").partition("\n\n")
    parser = argparse.ArgumentParser(
        description=summary, epilog=usage, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--file", type=Path, help="record; default a synthetic motion")
    parser.add_argument("--unit", help="g, m/s2 or cm/s2, if the file does not say")
    parser.add_argument("--dt", type=float, help="sampling period in s, if the file has none")
    parser.add_argument("--column", type=int, help="column of the file, from 0")
    parser.add_argument("--out", type=Path, default=Path("paper.html"), help="the page")
    parser.add_argument("--table", type=Path, help="replace the claims in this page, docs/paper.md")
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    words = parser.parse_args(arguments)
    try:
        path = page.check_page(words.out)
        found = find(given_motion(words))
        claims = assess(found)
        write_page(found, claims, path)
        if words.table:
            write_table(claims, words.table)
    except SeftError as error:
        print(f"reproduce: {error}", file=sys.stderr)
        return error.exit_status
    except KeyboardInterrupt:
        print("reproduce: interrupted; there is no page", file=sys.stderr)
        return 1
    result = summarise(found, claims, path)
    if words.json:
        print(json.dumps(result, indent=2, allow_nan=False))
        return 0
    verdicts = {True: Cell("yes", Mark.GOOD), False: Cell("no", Mark.BAD)}
    rows = [(_placed(c), c.paper, c.ours, verdicts[c.agrees]) for c in claims]
    print(f"{Path(found.source).name}: {result['agree']} of {len(claims)} claims agree")
    Console().print(TextTable(HEADINGS, rows, numbers=False))
    print(f"page: {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
