"""The one style of matplotlib's figures, and their way into a file.

Pages take their colours from here, too: matplotlib is imported where it draws.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = npt.NDArray[np.floating[Any]]

MOST_POINTS = 4000
"""Points of a line; more than twice the pixels of a wide screen."""
REFERENCE = "#9aa3ad"  # what should be
FIRST = "#0b5fa5"  # what is
SECOND = "#3d8c40"
OTHERS = (FIRST, SECOND, "#d9822b", "#7b4fa3", "#00857c", "#8a5a2b")
"""Colours of lines that are compared with one in `REFERENCE`, in turn."""
MARK = "#c1272d"
GRID = "#e6e9ec"
TEXT = "#33383d"


def new_figure(width: float, height: float) -> "Figure":
    """Make an empty figure, sizes in inches, that does not touch the user's pyplot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def tidy(panel: "Axes") -> None:
    """Give a panel the grid, the ticks and the frame that all panels have."""
    panel.grid(color=GRID, lw=0.8)
    panel.set_axisbelow(True)
    panel.tick_params(colors=TEXT, labelsize=9)
    panel.spines[["top", "right"]].set_visible(False)


def finish(figure: "Figure", labelled: "Iterable[Axes]", title: str) -> None:
    """Give a figure its title, and below a legend of the lines with a label in these panels."""
    figure.align_ylabels()
    entries = {
        label: handle
        for panel in labelled
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)
    }
    legend_below(figure, entries, 4)
    figure.suptitle(title, fontsize=11, color=TEXT, parse_math=False)


def legend_below(figure: "Figure", entries: "dict[str, Artist]", columns: int) -> None:
    """Put a legend below all panels of a constrained layout, which makes room for it.

    (matplotlib before 3.7 has no place "outside lower center".) ``entries`` maps labels to
    what is drawn.
    """
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    legend = figure.legend(
        list(entries.values()),
        list(entries),
        loc="lower center",
        ncols=columns,
        frameon=False,
        borderaxespad=0.2,
    )
    height = legend.get_window_extent().height / figure.bbox.height
    layout = figure.get_layout_engine()
    assert isinstance(layout, ConstrainedLayoutEngine)
    layout.set(rect=(0.0, height, 1.0, 1.0 - height))


def check_figure(path: Path) -> Path:
    """Complete the name of a figure's file, before the work is done that it shows.

    An InputError says that there is no such folder, or that figures have no such format.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    path = path if path.suffix else path.with_suffix(".png")
    known = FigureCanvasAgg.filetypes
    if path.suffix[1:].lower() not in known:
        raise InputError(f"{path}: figures end in {', '.join(f'.{name}' for name in known)}")
    return check_folder(path)


def check_folder(path: Path) -> Path:
    """Refuse a file whose folder does not exist, or that is a folder itself."""
    if not path.parent.is_dir() or path.is_dir():
        what = "is a folder" if path.is_dir() else f"there is no folder {path.parent}"
        raise InputError(f"{path}: {what}; name a file in a folder that exists")
    return path


def save_figure(figure: "Figure", path: str | Path) -> None:
    """Save a figure in the format of the suffix, png without one; an InputError says why not."""
    path = Path(path)
    path = path if path.suffix else path.with_suffix(".png")
    try:
        figure.savefig(path, dpi=150)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise InputError(f"{path}: the figure can't be saved ({reason})") from None


def thinned(y: Floats, most: int = MOST_POINTS) -> npt.NDArray[np.int64]:
    """Choose about ``most`` of N samples that draw the same picture; all where there are no more.

    They are the smallest and the largest of each stretch; indices increase.
    """
    count = len(y)
    if count <= most:
        return np.arange(count)
    length = -(-count // max(1, most // 2))
    starts = np.arange(0, count, length)
    # the last stretch is filled up with its last sample
    rows = np.pad(np.nan_to_num(y), (0, len(starts) * length - count), "edge").reshape(-1, length)
    places = (starts + rows.argmin(axis=1), starts + rows.argmax(axis=1), [0, count - 1])
    return np.unique(np.concatenate(places))
