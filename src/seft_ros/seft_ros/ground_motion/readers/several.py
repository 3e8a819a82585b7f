"""Channels of one file, each read as a column, side by side."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.readers.columns import Columns
from seft_ros.ground_motion.readers.record_text import read_values
from seft_ros.ground_motion.readers.statements import Statement


def read_channel(
    path: Path,
    lines: Sequence[str],
    start: int,
    count: int,
    layout: str,
    dt: Statement[float] | None,
    unit: Statement[str] | None,
    width: int = 0,
    said: int = 0,
    size: float = 1.0,
) -> Columns:
    """Read evenly spaced values, each times ``size``, as a column; the rest as in `read_values`."""
    values, places = read_values(path, lines, start, count, width, said)
    return Columns(path, size * np.array([values]).T, places, layout, own_dt=dt, own_unit=unit)


def as_channels(found: Sequence[Columns], names: Sequence[str] = ()) -> Columns:
    """Join channels of one column each, which may differ in length; named if there are names.

    Raises
    ------
    InputError
        If they differ in sampling period or unit.
    """
    first = found[0]

    def key(one: Columns) -> list[object]:
        return [each and each.value for each in (one.own_dt, one.own_unit)]

    if any(key(one) != key(first) for one in found):
        raise InputError(
            f"{first.path}: its channels differ in sampling period or unit; save each as a file"
        )
    counts = tuple(len(one.values) for one in found)
    table = np.full((max(counts), len(found)), np.nan)
    for column, one in enumerate(found):
        table[: len(one.values), column] = one.values[:, 0]
    lines = max((one.lines for one in found), key=len)
    return replace(first, values=table, names=tuple(names), counts=counts, lines=lines)
