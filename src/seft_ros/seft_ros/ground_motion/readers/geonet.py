"""GeoNet files of volume 1 and 2 (V1A, V2A): for each component 26 lines of headers, then values.

Volume 2 has accelerations, then as many velocities and displacements.
"""

import re
from pathlib import Path

from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.readers.columns import Columns
from seft_ros.ground_motion.readers.record_text import NUMBER
from seft_ros.ground_motion.readers.several import as_channels, read_channel
from seft_ros.ground_motion.readers.statements import Statement, known_unit

_N = NUMBER.pattern
_FLAGS = re.IGNORECASE | re.ASCII
_PERIOD = re.compile(
    rf"^\s*(?:instrument corrected data|raw readings in units of\s+({_N})\s*(\S+))"
    rf"\s+at\s+(?:intervals of\s+)?({_N})\s*s",
    _FLAGS,
)
_POINTS = re.compile(r"^\s*number of points\s+(\d+)", _FLAGS)
_PEAK = re.compile(rf"^\s*acceleration:\s+peak\s+{_N}\s+(\S+)\s+at", _FLAGS)
_COMPONENT = re.compile(r"^\s*component\s+(\S+)", _FLAGS)
_BEFORE_PERIOD, _AFTER_PERIOD = 10, 16  # lines of headers
_WIDTH, _IN_A_ROW = 8, 10


def is_geonet(_: Path, lines: list[str]) -> bool:
    """Whether a file has a GeoNet line of the sampling period, and of the number of points."""
    return any(map(_PERIOD.match, lines)) and any(map(_POINTS.match, lines))


def read_geonet(path: Path, lines: list[str]) -> Columns:
    """Read a GeoNet file: a column for each component's acceleration.

    Raises
    ------
    InputError
        If the header lacks the number of points or the unit, the number of values is not that of
        the header, or components differ in length or sampling period.
    """
    found, names = list[Columns](), list[str]()
    for index, line in enumerate(lines):
        if not (period := _PERIOD.match(line)):
            continue
        start = index + _AFTER_PERIOD
        header = lines[max(index - _BEFORE_PERIOD, 0) : start]
        points = next(filter(None, map(_POINTS.match, header)), None)
        peak = next(filter(None, map(_PEAK.match, header)), None)
        component = next(filter(None, map(_COMPONENT.match, header)), None)
        if points is None or peak is None:
            raise InputError(
                f"{path}: line {index + 1}: the header around it does not state the number of "
                "points and the acceleration's peak with its unit; fetch the record again"
            )
        count = int(points.group(1))
        last = start + -(-count // _IN_A_ROW)
        size, place = float(period.group(1) or 1), f"line {index + 1}"
        dt = Statement(float(period.group(3)), place)
        unit = Statement(known_unit(path, index + 1, period.group(2) or peak.group(1)), place)
        values = lines[:last]
        found.append(
            read_channel(path, values, start, count, "GeoNet", dt, unit, _WIDTH, index, size)
        )
        names.append(component.group(1) if component else f"component {len(found)}")
    return as_channels(found, names)
