"""COSMOS files (v1.20): lines with the number and the format of the values that follow."""

import re
from pathlib import Path

from seft_ros.ground_motion.readers.columns import Columns
from seft_ros.ground_motion.readers.record_text import header_numbers
from seft_ros.ground_motion.readers.several import as_channels, read_channel
from seft_ros.ground_motion.readers.statements import Statement, known_unit, other_quantity

_FORMAT = r"Format\s*=\s*\(\s*(?:1P)?\d*[DEFGI](\d+)"
_DATA = re.compile(
    rf"^\s*(\d+)\s+(.+?)\s+pts\b.*?\bunits\s*=\s*([^,(]+).*?{_FORMAT}", re.IGNORECASE | re.ASCII
)
_REAL_HEADER = re.compile(
    rf"^\s*\d+\s+Real-header values follow on\s+(\d+)\s+lines.*?{_FORMAT}",
    re.IGNORECASE | re.ASCII,
)
_PERIODS = ((62, 1e-3), (34, 1.0))
"""Places of the sampling period in the real header, and its unit in s: the period of these values,
then that of the instrument."""


def is_cosmos(_: Path, lines: list[str]) -> bool:
    """Whether a file has a line with the number and the format of values."""
    return any(map(_DATA.match, lines))


def read_cosmos(path: Path, lines: list[str]) -> Columns:
    """Read a COSMOS file: a column for each of its channels of acceleration.

    Velocities and displacements, which may follow each channel, are left out.

    Raises
    ------
    InputError
        If there is no acceleration, its unit is unknown, the number of values is not that of the
        header, or channels differ in length or sampling period.
    """
    found, other, dt = list[Columns](), "", None
    for index, line in enumerate(lines):
        if real := _REAL_HEADER.match(line):
            end = index + 1 + int(real.group(1))
            numbers = header_numbers(path, lines, index + 1, end, int(real.group(2)))
            known = [
                Statement(float(f"{numbers[place - 1] * unit:.7g}"), f"line {index + 1}")
                for place, unit in _PERIODS
                if len(numbers) >= place and numbers[place - 1] > 0
            ]
            dt = known[0] if known else None
        elif data := _DATA.match(line):
            quantity = data.group(2).lower()
            if quantity in ("velocity", "displacement"):
                other = other or quantity
                continue
            unit = known_unit(path, index + 1, data.group(3).strip())
            own = Statement(unit, f"line {index + 1}")
            count, width = int(data.group(1)), int(data.group(4))
            found.append(read_channel(path, lines, index + 1, count, "COSMOS", dt, own, width))
    if not found:
        raise other_quantity(path, 1, other)
    return as_channels(found)
