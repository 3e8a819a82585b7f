"""PEER AT2 files.

They have two header dialects, ``4096    0.0100    NPTS, DT`` and ``NPTS=  4096, DT= .01000 SEC``.
The values follow row by row; the last row may be shorter.
"""

import re
from pathlib import Path

import numpy as np
from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.readers.columns import Columns
from seft_ros.ground_motion.readers.record_text import NUMBER, is_comment, to_float
from seft_ros.ground_motion.readers.several import read_channel
from seft_ros.ground_motion.readers.statements import Statement, read_header

_HEADER_LINES = 50
_NPTS = re.compile(r"\bNPTS\b", re.IGNORECASE)


def is_peer(_: Path, lines: list[str]) -> bool:
    """Whether a file has the NPTS line of an AT2 file's header."""
    return _header_end(lines) is not None


def check_name(path: Path) -> None:
    """Refuse a file whose name, but not whose header, is that of an AT2 file."""
    if path.suffix.lower() == ".at2":
        raise InputError(
            f"{path}: no header line gives NPTS and DT, which an AT2 record needs; fetch it again, "
            "or if it is one motion in rows, set ground_motion rows (--rows)"
        )


def read_peer(path: Path, lines: list[str]) -> Columns:
    """Read an AT2 file: one column, in the header's unit and with its DT.

    Raises
    ------
    InputError
        If the header can't be understood or is not that of an acceleration, or if the number of
        values is not that of the header.
    """
    end = _header_end(lines) or 0
    numbers = NUMBER.findall(lines[end])
    if len(numbers) < 2 or not numbers[0].isdigit():
        raise InputError(
            f"{path}: line {end + 1}: NPTS without a count and a DT; "
            'expected "NPTS= 4096, DT= .0100 SEC" or "4096 0.0100 NPTS, DT"'
        )
    count, dt = int(numbers[0]), to_float(numbers[1], path, end + 1)
    if count < 1 or not 0 < dt < np.inf:
        raise InputError(
            f"{path}: line {end + 1}: NPTS is {count} and DT is {dt:g} s; both must be positive"
        )
    titles = [(number, line) for number, line in enumerate(lines[:end], start=1) if line.strip()]
    unit = read_header(path, titles).unit
    own_dt = Statement(dt, f"line {end + 1}")
    return read_channel(path, lines, end + 1, count, "PEER AT2", own_dt, unit)


def _header_end(lines: list[str]) -> int | None:
    header = enumerate(lines[:_HEADER_LINES])
    return next((n for n, line in header if _NPTS.search(line) and not is_comment(line)), None)
