"""CSMIP files of volume 1 and 2 (CGS, formerly CDMG): a block of headers and values a channel.

Volume 2 has ``7500 points of accel data equally spaced at .010 sec, in cm/sec2. (8f10.6)`` above
the values, newer files of volume 1 ``13200 Accelerogram points at 200 pts/sec in units of g``.
Older files of volume 1 have pairs of time and acceleration, in seconds and g/10.
"""

import re
from pathlib import Path

import numpy as np

from seft_ros.ground_motion.readers.columns import Columns
from seft_ros.ground_motion.readers.record_text import NUMBER, pieces, read_values
from seft_ros.ground_motion.readers.several import as_channels, read_channel
from seft_ros.ground_motion.readers.statements import Statement, known_unit, other_quantity

_N = NUMBER.pattern
_FLAGS = re.IGNORECASE | re.ASCII
_EVEN = re.compile(
    rf"^\s*(\d+)\s+points\s+of\s+(accel|veloc|displ)\w*\.?\s+data\s+equally\s+spaced\s+at\s+({_N})"
    r"\s*sec\.?,?\s*\(?\s*(?:in|units?\s*[:=]?)\s*([^\s(),]+)",
    _FLAGS,
)
_RAW = re.compile(
    rf"^\s*(\d+)\s+accelerogram\s+points\s+at\s+({_N})\s+pts/sec\s+in\s+units\s+of\s+([^\s(),]+)",
    _FLAGS,
)
_PAIRS = re.compile(r"^\s*units\s+of\s+uncor\s+accel\s+are\s+sec\s+and\s+g/10\b", _FLAGS)
_POINTS = re.compile(r"no\.?\s+of\s+points\s*=\s*(\d+)", _FLAGS)
_WIDTH = re.compile(r"\(\s*\d*[FE](\d+)", _FLAGS)
_ABOVE_PAIRS, _PAIR_WIDTH = 16, 7  # lines of headers from the line of units on; characters
_QUANTITIES = {"veloc": "velocity", "displ": "displacement"}


def is_csmip(_: Path, lines: list[str]) -> bool:
    """Whether a file has a line above the values of a CSMIP channel."""
    return any(find.match(line) for line in lines for find in (_EVEN, _RAW, _PAIRS))


def read_csmip(path: Path, lines: list[str]) -> Columns:
    """Read a CSMIP file: a column for each of its channels of acceleration.

    Velocities and displacements, which follow each channel of volume 2, are left out.

    Raises
    ------
    InputError
        If there is no acceleration, its unit is unknown, the number of values is not that of the
        header, times are uneven, or channels differ in length, unit or sampling period.
    """
    found, other = list[Columns](), ""
    for index, line in enumerate(lines):
        if even := _EVEN.match(line):
            if even.group(2).lower() != "accel":
                other = other or _QUANTITIES[even.group(2).lower()]
                continue
            stated = int(even.group(1)), float(even.group(3)), even.group(4)
            found.append(_channel(path, lines, index, *stated))
        elif raw := _RAW.match(line):
            stated = int(raw.group(1)), 1 / float(raw.group(2)), raw.group(3)
            found.append(_channel(path, lines, index, *stated))
        elif _PAIRS.match(line):
            found.append(_pairs(path, lines, index))
    if not found:
        raise other_quantity(path, 1, other)
    return as_channels(found)


def _channel(
    path: Path, lines: list[str], index: int, count: int, period: float, unit: str
) -> Columns:
    """Read evenly spaced values below the line of this index."""
    start, place = index + 1, f"line {index + 1}"
    found = _WIDTH.search(lines[index])
    dt, own = Statement(period, place), Statement(known_unit(path, start, unit), place)
    width = int(found.group(1)) if found else 0
    return read_channel(path, lines, start, count, "CSMIP", dt, own, width=width)


def _pairs(path: Path, lines: list[str], index: int) -> Columns:
    """Read pairs of time, s, and acceleration, g/10, below the headers."""
    said = next((n for n in range(index, -1, -1) if _POINTS.search(lines[n])), index)
    points = _POINTS.search(lines[said])
    count = int(points.group(1)) if points else 0
    start = index + _ABOVE_PAIRS
    values, places = read_values(path, lines, start, 2 * count, _PAIR_WIDTH, said + 1)
    texts = [piece for line in lines[start:] for piece in pieces(line, _PAIR_WIDTH)][: 2 * count]
    table = np.reshape(values, (-1, 2))
    table[:, 1] /= 10
    unit = Statement("g", f"line {index + 1}, as g/10")
    rows = [texts[at : at + 2] for at in range(0, 2 * count, 2)]
    timed = Columns(
        path, table, places[::2], "CSMIP", ("time", "acceleration"), own_unit=unit, texts=rows
    )
    found = timed.dt()
    dt = None if found is None else Statement(found.value, "the times")
    return Columns(path, table[:, 1:], places[::2], "CSMIP", own_dt=dt, own_unit=unit)
