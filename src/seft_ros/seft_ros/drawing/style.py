"""Look of the figures, and their way into a file."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from seft_msgs_py.errors import InputError

Floats = npt.NDArray[np.floating[Any]]

MOST_POINTS = 4000
"""Points of a line; more than twice the pixels of a wide screen."""
REFERENCE = "#9aa3ad"  # what should be
FIRST = "#0b5fa5"  # what is
SECOND = "#3d8c40"
OTHERS = (FIRST, SECOND, "#d9822b", "#7b4fa3", "#00857c", "#8a5a2b")
"""Lines that are held against one in `REFERENCE`, in turn."""
MARK = "#c1272d"
GRID = "#e6e9ec"
TEXT = "#33383d"


def tidy(panel: Axes) -> None:
    """Give a panel the grid, the ticks and the frame that all panels have."""
    panel.grid(color=GRID, lw=0.8)
    panel.set_axisbelow(True)
    panel.tick_params(colors=TEXT, labelsize=9)
    panel.spines[["top", "right"]].set_visible(False)


def legend_below(figure: Figure, entries: dict[str, Artist], columns: int, **font: Any) -> None:
    """Put a legend below all panels of a constrained layout, which makes room for it.

    (matplotlib before 3.7 has no place "outside lower center".) ``entries`` are what is drawn, by
    its label; ``font`` is a ``fontsize``.
    """
    legend = figure.legend(
        list(entries.values()),
        list(entries),
        loc="lower center",
        ncols=columns,
        frameon=False,
        borderaxespad=0.2,
        **font,
    )
    height = legend.get_window_extent().height / figure.bbox.height
    layout = figure.get_layout_engine()
    assert isinstance(layout, ConstrainedLayoutEngine)
    layout.set(rect=(0.0, height, 1.0, 1.0 - height))


def check_figure(path: Path) -> Path:
    """Complete the name of a figure's file, before the work is done that it is to show.

    An InputError says that there is no such folder, or that figures have no such format.
    """
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


def save_figure(figure: Figure, path: str | Path) -> None:
    """Save a figure; the suffix tells the format, png where there is none.

    An InputError says why it can't be.
    """
    path = Path(path)
    path = path if path.suffix else path.with_suffix(".png")
    try:
        figure.savefig(path, dpi=150)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise InputError(f"{path}: the figure can't be saved ({reason})") from None


def thinned(y: Floats, most: int = MOST_POINTS) -> npt.NDArray[np.int64]:
    """Choose about ``most`` of N samples that draw the same picture; all where there are no more.

    They are the least and the largest of each stretch; indices increase.
    """
    count = len(y)
    if count <= most:
        return np.arange(count)
    stretches = max(1, most // 2)
    length = -(-count // stretches)
    whole = count // length * length
    rows = np.nan_to_num(y[:whole]).reshape(-1, length)
    starts = np.arange(0, whole, length)
    rest = np.nan_to_num(y[whole:])
    ends = [0, count - 1]
    if whole < count:
        ends += [whole + int(rest.argmin()), whole + int(rest.argmax())]
    return np.unique(
        np.concatenate([starts + rows.argmin(axis=1), starts + rows.argmax(axis=1), np.array(ends)])
    )
