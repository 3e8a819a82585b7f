"""Records of the PEER strong-motion database (AT2), in both of its header dialects.

One dialect says ``4096    0.0100    NPTS, DT``, the other ``NPTS=  4096, DT= .01000 SEC``.
The values follow row by row, as many to a line as fit; the last line may be shorter.
"""

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.column_file import Columns
from seft_ros.ground_motion.text_file import NUMBER, is_comment, not_finite, read_unit, to_float

_HEADER_LINES = 50
_NPTS = re.compile(r"\bNPTS\b", re.IGNORECASE)
_NAME_FIRST = re.compile(
    rf"\bNPTS\s*[=:]?\s*(\d+)[\s,;]*DT\s*[=:]?\s*({NUMBER.pattern})", re.IGNORECASE | re.ASCII
)
_NUMBER_FIRST = re.compile(
    rf"^\s*(\d+)[\s,;]+({NUMBER.pattern})[\s,;]*NPTS[\s,;]*DT\b", re.IGNORECASE | re.ASCII
)
_UNIT = re.compile(
    r"\bUNITS?\s*(?:OF\b|IN\b|:|=|[\[(])\s*[\[(]?\s*([A-Z][^\s,;()\[\]]*)", re.IGNORECASE
)
_OTHER_QUANTITY = re.compile(r"\b(VELOCITY|DISPLACEMENT)\s+TIME\b", re.IGNORECASE)
_RUN_TOGETHER = re.compile(r"(?<=[0-9.])(?=[+-])")


def is_at2(path: Path, lines: list[str]) -> bool:
    """Whether a file is an AT2 record: by its header, or by its name's ending."""
    return path.suffix.lower() == ".at2" or _header_end(lines) is not None


def read_at2(path: Path, lines: list[str]) -> Columns:
    """Read an AT2 file: one column, in the header's unit and with its DT.

    Raises
    ------
    InputError
        If the header can't be understood or is not that of an acceleration, if a value is
        no finite number, or if there are not as many values as NPTS says.
    """
    end = _header_end(lines)
    if end is None:
        raise InputError(
            f"{path}: no header line gives NPTS and DT; an AT2 record needs one, "
            "a file of plain columns must not be named .at2"
        )
    found = _NAME_FIRST.search(lines[end]) or _NUMBER_FIRST.search(lines[end])
    if found is None:
        raise InputError(
            f"{path}: line {end + 1}: NPTS without a count and a DT; "
            'expected "NPTS= 4096, DT= .0100 SEC" or "4096 0.0100 NPTS, DT"'
        )
    count, dt = int(found.group(1)), to_float(found.group(2), path, end + 1)
    if count < 1 or not 0 < dt < np.inf:
        raise InputError(
            f"{path}: line {end + 1}: NPTS is {count} and DT is {dt:g} s; both must be positive"
        )
    unit = _header_unit(path, lines[: end + 1])
    values = _read_values(path, lines, end + 1)
    if len(values) != count:
        what = "the file is truncated" if len(values) < count else "that is too many"
        raise InputError(
            f"{path}: line {end + 1} says NPTS {count}, but {len(values)} values follow: {what}; "
            "fetch the record again, or correct NPTS"
        )
    names = () if unit is None else (f"acceleration ({unit})",)
    return Columns(path, values[:, np.newaxis], lines, end + 1, names, own_dt=dt)


def _header_end(lines: list[str]) -> int | None:
    """Index of the line with NPTS, which is the header's last."""
    for index, line in enumerate(lines[:_HEADER_LINES]):
        if _NPTS.search(line) and not is_comment(line):
            return index
    return None


def _header_unit(path: Path, header: list[str]) -> str | None:
    for number, line in enumerate(header, start=1):
        other = _OTHER_QUANTITY.search(line)
        if other:
            raise InputError(
                f"{path}: line {number}: holds a {other.group(1).lower()}; "
                "give the acceleration record (.AT2)"
            )
        found = _UNIT.search(line)
        if found:
            unit = read_unit(found.group(1))
            if unit is None:
                raise InputError(
                    f"{path}: line {number}: {found.group(1)} is no acceleration unit known "
                    "here; convert the record to g, m/s2 or cm/s2"
                )
            return unit
    return None


def _read_values(path: Path, lines: list[str], start: int) -> npt.NDArray[np.float64]:
    tokens = " ".join(lines[start:]).split()
    if not tokens:
        return np.empty(0)
    try:
        values = np.loadtxt(tokens, comments=None, ndmin=1)
        if np.isfinite(values).all():
            return values
    except ValueError:
        pass  # run-together numbers, Fortran's D, or a fault: read on line by line
    by_line: list[float] = []
    for number, line in enumerate(lines[start:], start=start + 1):
        for token in line.split():
            for piece in _RUN_TOGETHER.split(token):
                value = to_float(piece, path, number)
                if not np.isfinite(value):
                    raise not_finite(value, path, number)
                by_line.append(value)
    return np.array(by_line)
