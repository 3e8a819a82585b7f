"""Figures of the benchmark: its criteria by controller, and the histories of one test."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rths_problem import DT
from rths_tests import CONTROLLERS, INVERSE, SAMPLE, SEFT, Histories, Outcome
from seft_ros.drawing import style
from seft_ros.drawing.style import new_figure, thinned, tidy

COLOURS = dict(zip(CONTROLLERS, style.OTHERS, strict=False))
SHORT_NAMES = {SEFT: "seft", SAMPLE: "sample", INVERSE: "inverse"}
DRAWN = ("true J2", "true J3", "true J4", "true J5", "J6", "J7", "J8", "J9")
STRONG_S = 12.0
"""Of the histories that is shown, from the motion's beginning, s."""

Groups = dict[tuple[str, str], list[Outcome]]
Summary = Callable[[Sequence[Outcome], str], tuple[float, float]]


def criteria_figure(groups: Groups, mean_and_worst: Summary) -> Figure:
    """Draw mean and worst of the criteria by controller, nominal and perturbed plants."""
    figure = new_figure(9.5, 4.5)
    panel = figure.subplots()
    width = 0.8 / len(groups)
    for place, ((controller, plants), chosen) in enumerate(groups.items()):
        pairs = np.array([mean_and_worst(chosen, name) for name in DRAWN])
        at = np.arange(len(DRAWN)) + (place - 0.5 * (len(groups) - 1)) * width
        look: dict[str, Any] = {"color": COLOURS[controller]}
        if plants == "nominal":
            look = {"color": "white", "edgecolor": COLOURS[controller], "lw": 1.4}
        label = f"{SHORT_NAMES[controller]}, {len(chosen)} {plants}"
        panel.bar(at, pairs[:, 0], 0.85 * width, label=label, **look)
        panel.vlines(at, pairs[:, 0], pairs[:, 1], color=style.TEXT, lw=1.2)
    panel.set_yscale("log")
    panel.set_xticks(range(len(DRAWN)), DRAWN)
    panel.set_ylabel("mean, and line to the worst / %", color=style.TEXT)
    tidy(panel)
    style.finish(figure, [panel], "RTHS benchmark: tracking (J2, J3) and structure (J4 to J9)")
    return figure


def histories_figure(found: Histories) -> Figure:
    """Draw displacement of the first floor, and errors of the specimen and of the third floor.

    The errors of the sample controller are many times as large as the others, and left out.
    """
    figure = new_figure(9.5, 6.5)
    panels = figure.subplots(3, 1, sharex=True, height_ratios=[1.4, 1.0, 1.0])
    size = np.abs(found.reference[:, 0])
    begin = int(np.argmax(size > 0.02 * size.max()))
    part = slice(begin, begin + round(STRONG_S / DT))
    time, exact = DT * np.arange(len(size))[part], 1e3 * found.reference[part]
    panels[0].plot(time, exact[:, 0], color=style.REFERENCE, lw=2.4, label="whole structure")
    for name, motion in reversed(found.motions.items()):
        true, third = 1e3 * motion.true[part], 1e3 * motion.numerical[part, 2]
        shown = true, true - exact[: len(true), 0], third - exact[: len(third), 2]
        for panel, y in zip(panels, shown[: 1 if name == SAMPLE else 3], strict=False):
            at = thinned(y)
            panel.plot(time[at], y[at], color=COLOURS[name], lw=0.9, label=SHORT_NAMES[name])
    labels = ("floor 1, true\n/ mm", "its error / mm", "error of\nfloor 3 / mm")
    for panel, label in zip(panels, labels, strict=True):
        panel.set_ylabel(label, color=style.TEXT)
        panel.margins(x=0.01)
        tidy(panel)
    panels[-1].set_xlabel("time / s", color=style.TEXT)
    test = found.test
    title = f"case {test.case}, {test.record.replace('_', ' ')}, {test.plant} plant"
    style.finish(figure, panels[:1], title)
    return figure
