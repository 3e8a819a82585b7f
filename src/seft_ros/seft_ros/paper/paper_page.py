"""The page on the paper: its figures, each beside its claims."""

from collections.abc import Callable, Iterable, Sequence
from itertools import product
from pathlib import Path

import numpy as np
from bokeh.models import Range1d
from bokeh.plotting import figure
from seft_msgs_py.arrays import Complexes, Floats

from seft_ros.design.loop_margins import BAND_HZ
from seft_ros.drawing import page, style
from seft_ros.drawing.page import Cell, Grid, Plot, Section, Table, Text, line, mark, plot
from seft_ros.drawing.style import FIRST, OTHERS, REFERENCE, Mark
from seft_ros.paper import measures
from seft_ros.paper.claims import Claim, read_rows
from seft_ros.paper.findings import Findings
from seft_ros.paper.paper_tests import BEYOND, BEYOND_SHARE, COMPUTED, Outcome

Response = tuple[Floats, Complexes, str]  # Hz, values, label
Curve = tuple[Floats, dict[str, Floats], str, str]  # time, signals, label, colour

PAPER = (
    "N. Nakata and S. Combs, Substructure Effective Force Testing: A Force-Based Real-Time Hybrid "
    "Simulation, 2012"
)
_HEADINGS = ("claim", "paper", "ours", "agrees")
_MEASURED, _MODEL = "experiment", "analysis"
_RANGE_HZ = (0.5, 200.0)
_CLOSED_TO_HZ = 60.0
_HEIGHT, _SMALL = 250, 230  # pixels
_UNITS = style.DISPLAY_UNITS | {"force": ("kN", 1e-3)}
_SIMULATED, _COMPENSATED = OTHERS[2], OTHERS[1]
_STRONG = (0.1, 0.9)  # of the energy: the part that is in view at first
_MARGIN = 0.3  # s before and after
_FAR = 2.0  # times the largest reference: where a curve that grows is cut


def write_paper(found: Findings, claims: Sequence[Claim], config: str, path: Path) -> None:
    """Write the page; an InputError says that the file can't be written."""
    facts = measures.facts(found)
    sections = [Section("Claims", _overview(found, claims))]
    for row in read_rows("paper_page.yaml"):
        blocks: list[page.Block] = [Text(row["text"].format(**facts))] if "text" in row else []
        for chosen in row.get("figures", ()):
            draw: Callable[..., page.Block] = globals()[chosen.pop("name")]
            blocks.append(draw(found, **chosen))
        own = [claim for claim in claims if claim.where.startswith(tuple(row["claims"]))]
        rows = [[*_cells(claim), f"{claim.criterion}.{_sentence(claim.note)}"] for claim in own]
        blocks.append(Table((*_HEADINGS, "they agree if"), rows, numbers=False, wide=True))
        sections.append(Section(row["title"], blocks))
    sections.append(Section("Beyond the paper", _beyond(found)))
    subtitle = f"{PAPER}; here with {config} under {facts['source']}"
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
    rows = [_cells(claim) for claim in claims]
    return [
        page.Verdict(Mark.DOUBT if against else Mark.GOOD, text, against),
        Table(_HEADINGS, rows, numbers=False, wide=True),
    ]


def _beyond(found: Findings) -> list[page.Block]:
    full = found.peak_force
    lower = BEYOND_SHARE * full
    text = (
        "The paper could show compensation on an idealised actuator alone. This is the "
        "servo-hydraulic rig with noise, friction and a valve that saturates, under the "
        "recommended method (target_motion, docs/compensation.md). The heavier the "
        f"structure, the faster the piston must move: at {full:g} N the valve can't follow at "
        f"large mass ratios, and no compensation makes flow; the figure is of {lower:g} N."
    )
    kinds = {
        "plain": f"uncompensated, {lower:g} N",
        "target": f"target_motion, {lower:g} N",
        "target_full": f"target_motion, {full:g} N",
    }
    rows: list[list[str | Cell]] = [
        [f"{ratio:g}", *(_error(found.tests[kind, ratio]) for kind in kinds)] for ratio in BEYOND
    ]
    note = "Displacement errors, RMS over RMS, without any shift."
    table = Table(("mass ratio alpha", *kinds.values()), rows, wide=True)
    return [Text(text), table, Text(note), beyond_figure(found)]


def _error(test: Outcome) -> Cell:
    if not test.stable:
        at = "" if test.trip is None else f" at {test.trip.time_s:.2f} s"
        return Cell(f"unstable, trips{at}", Mark.BAD)
    error = test.agreement("displacement").nrmse
    full = " (valve saturated)" if "valve" in test.saturated else ""
    return Cell(f"{error:.1%}{full}", Mark.GOOD if error < style.GOOD_ERROR else Mark.DOUBT)


def _cells(claim: Claim) -> list[str | Cell]:
    agrees = Cell("yes", Mark.GOOD) if claim.agrees else Cell("no", Mark.BAD)
    return [_placed(claim), claim.paper, claim.ours, agrees]


def _placed(claim: Claim) -> str:
    return f"{claim.claim} ({claim.where})"


def _sentence(note: str) -> str:
    return f" {note[:1].upper()}{note[1:]}." if note else ""


def open_loop_figure(found: Findings) -> Grid:
    """Draw Figure 3: plant, controller and loop; magnitudes above, phases below."""
    measured, model = found.valve.measured, found.valve.loop
    f, own, sampled = measured.frequencies_hz, model.frequencies_hz, model.sampled
    controller = model.controller.sampled_response(f, found.experiment.timebase.dt)
    zero, pole, crossover = found.zero_hz, found.pole_hz, model.sampled.margins.crossover_hz
    columns: list[tuple[str, list[Response], list[float], str]] = [
        ("(a) valve to force, N/V",
         [(f, measured.response, _MEASURED), (own, sampled.plant, _MODEL)], [zero, pole],
         f"Zero at {zero:.3g} Hz, the specimen's natural frequency; pole at {pole:.3g} Hz, the oil "
         "column."),
        ("(b) controller, V/N", [(own, sampled.controller, "as it runs")], [],
         "Its poles are at the plant's zero."),
        ("(c) loop",
         [(f, controller * measured.response, _MEASURED), (own, sampled.loop, _MODEL)],
         [] if crossover is None else [crossover],
         "High, then low, without a kink; it crosses 0 dB at the mark."),
    ]  # fmt: skip
    shared, magnitudes, phases = Range1d(*_RANGE_HZ), [], []
    for title, curves, marks, caption in columns:
        panels = [
            plot("frequency / Hz", label, x_range=shared, log_x=True, height=_HEIGHT)
            for label in (f"{title}, dB", "phase / degrees")
        ]
        _draw_responses(panels, curves, _RANGE_HZ[1])
        if title.startswith("(c)"):
            page.level(panels[0], 0.0)
        for hz in marks:
            mark(panels[0], hz)
        magnitudes.append(Plot(panels[0], caption))
        phases.append(Plot(panels[1]))
    return Grid([*magnitudes, *phases])


def closed_loop_figure(found: Findings) -> Grid:
    """Draw Figure 4: reference force to measured force."""
    shared = Range1d(0.0, _CLOSED_TO_HZ, bounds=(0.0, _CLOSED_TO_HZ))
    labels = ("(a) magnitude, dB", "(b) phase / degrees")
    panels = [plot("frequency / Hz", label, x_range=shared) for label in labels]
    measured, model = found.closed.measured, found.valve.loop
    own = measured.frequencies_hz, measured.response, _MEASURED
    modelled = model.frequencies_hz, model.sampled.tracking, _MODEL
    _draw_responses(panels, [own, modelled], _CLOSED_TO_HZ)
    page.level(panels[0], 0.0)
    for panel in panels:
        page.band(panel, 0.0, BAND_HZ, color=FIRST)
    if found.closed.tracking.dip_hz is not None:
        mark(panels[0], found.closed.tracking.dip_hz)
    captions = (
        f"Flat up to {BAND_HZ:g} Hz (shaded), with a small dip at the mark.",
        f"Nearly a straight line: a delay, here of {1e3 * found.own_delay:.1f} ms.",
    )
    return Grid([Plot(*pair) for pair in zip(panels, captions, strict=True)], columns=2)


def _draw_responses(panels: Sequence[figure], curves: Sequence[Response], to_hz: float) -> None:
    """Draw magnitude and phase, the experiment below the analysis."""
    for hz, response, label in curves:
        shown = (hz >= _RANGE_HZ[0]) & (hz <= to_hz)
        hz, response = hz[shown], response[shown]
        color, dash = (OTHERS[2], "6 4") if label == _MODEL else (FIRST, "solid")
        phase = np.degrees(np.unwrap(np.angle(response)))
        for panel, values in zip(panels, (measures.decibels(response), phase), strict=True):
            line(panel, hz, values, label, color=color, dash=dash)


def histories_figure(found: Findings) -> Grid:
    """Draw Figure 6: displacement, force and acceleration at three mass ratios."""
    cells = []
    for name, ratio in product(style.RESPONSES, (0.0, *COMPUTED)):
        test, (unit, factor) = found.tests["rig", ratio], _UNITS[name]
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
    color = _SIMULATED if kind == "banded" else _COMPENSATED
    cells = []
    for name, ratio in product(("displacement", "acceleration"), COMPUTED):
        test = found.tests[kind, ratio]
        curves = [*_on_rig(found.tests["rig", ratio]), (test.time, test.measured, label, color)]
        cells.append((name, ratio, curves, caption))
    return _grid(found, cells, 2)


def beyond_figure(found: Findings) -> Grid:
    """Draw displacements with the recommended method on the servo-hydraulic rig."""
    cells = []
    for ratio in BEYOND:
        test, plain = found.tests["target", ratio], found.tests["plain", ratio]
        curves = [
            (plain.time, plain.measured, "uncompensated", "#b9c9da"),
            (test.time, test.exact, "reference", REFERENCE),
            (test.time, test.measured, "target_motion", _COMPENSATED),
        ]
        caption = f"Error {test.agreement('displacement').nrmse:.1%} without any shift."
        cells.append(("displacement", ratio, curves, caption))
    return _grid(found, cells, 3)


def pure_delay_figure(found: Findings) -> Plot:
    """Draw what a delay of unlimited bandwidth does at a mass ratio of 1."""
    rig, test, name = found.tests["rig", 1.0], found.tests["delay", 1.0], "acceleration"
    most = _FAR * float(np.abs(rig.exact[name]).max())
    beyond = np.flatnonzero(np.abs(test.measured[name]) > most)
    count = int(beyond[0]) if len(beyond) else len(test.time)
    end = min(len(rig.time), max(count + count // 4, 2))
    panel = plot("time / s", f"{name}, alpha = 1 / (m/s²)", x_range=page.time_range(rig.time[:end]))
    line(panel, rig.time[:end], rig.exact[name][:end], "reference", color=REFERENCE)
    signal = test.measured[name][:count]
    line(panel, test.time[:count], signal, "Eq. 5.4 as printed", color=_SIMULATED)
    grows = "{grows} e-fold in {time:.2g} s at {hz:.3g} Hz".format(
        **measures.growth(found, "delay", 1.0)
    )
    caption = f"Eq. 5.4 with the pure delay {grows}; cut at {_FAR:g} times the reference's peak."
    return Plot(panel, caption, wide=True)


def _on_rig(test: Outcome) -> tuple[Curve, Curve]:
    return (
        (test.time, test.exact, "reference", REFERENCE),
        (test.time, test.measured, "experiment", FIRST),
    )


def _grid(
    found: Findings, cells: Iterable[tuple[str, float, list[Curve], str]], columns: int
) -> Grid:
    """Draw time histories that zoom together, and begin at the motion's strong part."""
    test = found.tests["rig", 0.0]
    shared = page.time_range(test.time)
    energy = np.cumsum(test.exact["acceleration"] ** 2)
    if energy[-1] > 0:
        start, end = np.interp(_STRONG, energy / energy[-1], test.time)
        shared.start, shared.end = max(0.0, start - _MARGIN), min(shared.end, end + _MARGIN)
    plots = []
    for letter, (name, ratio, curves, caption) in zip("abcdefghi", cells, strict=False):
        unit, factor = _UNITS[name]
        label = f"({letter}) {name}, alpha = {ratio:g} / {unit}"
        panel = plot("time / s", label, x_range=shared, height=_SMALL)
        for time, signals, label, color in curves:
            # a dashed line shows what lies below
            dash = "5 3" if color in (_SIMULATED, _COMPENSATED) else "solid"
            line(panel, time, factor * signals[name], label, color=color, width=1.1, dash=dash)
        plots.append(Plot(panel, caption))
    return Grid(plots, columns)
