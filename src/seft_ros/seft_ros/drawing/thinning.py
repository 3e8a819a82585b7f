"""Lines of more points than can be seen, drawn with fewer."""

from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.floating[Any]]

MOST_POINTS = 4000
"""Points of a line; more than twice the pixels of a wide screen."""


def thinned(y: Floats, most: int = MOST_POINTS) -> npt.NDArray[np.int64]:
    """Choose samples of a signal that draw the same picture: least and largest of each stretch.

    Parameters
    ----------
    y : ndarray
        Shape (N,).
    most : int
        About how many to keep.

    Returns
    -------
    ndarray of int64
        Increasing indices; all N where there are no more than ``most``.
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
