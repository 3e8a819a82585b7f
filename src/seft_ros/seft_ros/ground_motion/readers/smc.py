"""SMC files of the USGS: headers of fixed length, then the values row by row, in cm/s^2."""

import re
from pathlib import Path

from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.readers.columns import Columns
from seft_ros.ground_motion.readers.record_text import header_numbers
from seft_ros.ground_motion.readers.several import read_channel
from seft_ros.ground_motion.readers.statements import Statement

_FIRST_LINE = re.compile(r"^\s*[0-9]\s+(?:UN)?CORRECTED\s+ACCELEROGRAM\b", re.IGNORECASE)
_TEXT, _INTEGERS, _REALS = 11, 6, 10  # lines
_COMMENTS, _COUNT, _RATE = 15, 16, 1  # places, from 0
_NO_RATE = 1e6  # Hz; records of uneven times have 1.7e38


def is_smc(_: Path, lines: list[str]) -> bool:
    """Whether a file has the first line of an SMC accelerogram."""
    return bool(_FIRST_LINE.match(lines[0]))


def read_smc(path: Path, lines: list[str]) -> Columns:
    """Read an SMC file: one column, in cm/s^2.

    Raises
    ------
    InputError
        If the header gives no count or rate, or the number of values is another.
    """
    reals = _TEXT + _INTEGERS
    end = reals + _REALS
    integers = header_numbers(path, lines, _TEXT, reals, 10)
    numbers = header_numbers(path, lines, reals, end, 15)
    known = len(integers) > _COUNT and len(numbers) > _RATE
    if not known or not 0 < numbers[_RATE] < _NO_RATE:
        raise InputError(
            f"{path}: the header of an SMC record gives no count of values and no rate; fetch the "
            "record again, evenly sampled"
        )
    end += max(int(integers[_COMMENTS]), 0)
    dt = Statement(float(f"{1 / numbers[_RATE]:.7g}"), f"line {reals + 1}")
    unit = Statement("cm/s2", "the SMC format")
    count = int(integers[_COUNT])
    return read_channel(path, lines, end, count, "SMC", dt, unit, said=_TEXT + 2)
