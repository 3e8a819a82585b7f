"""Text files of agencies: PEER AT2, SMC of the USGS, COSMOS, CSMIP and GeoNet.

Each has headers that state the number of values, which follow row by row; the last row may be
shorter. CSMIP and GeoNet files have a block of headers and values for each channel.
"""

import re
from itertools import takewhile
from pathlib import Path

import numpy as np
from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.readers.columns import Columns, as_channels, read_channel
from seft_ros.ground_motion.readers.record_text import (
    NUMBER,
    header_numbers,
    is_comment,
    is_number,
    pieces,
    read_values,
    to_float,
)
from seft_ros.ground_motion.readers.statements import (
    Statement,
    known_unit,
    other_quantity,
    read_header,
)

_N = NUMBER.pattern
_FLAGS = re.IGNORECASE | re.ASCII


_PEER_HEADER = 50
_PEER_NPTS = re.compile(r"\bNPTS\b", re.IGNORECASE)


def check_name(path: Path) -> None:
    """Refuse a file whose name, but not whose header, is that of an AT2 file."""
    if path.suffix.lower() == ".at2":
        raise InputError(
            f"{path}: no header line gives NPTS and DT, which an AT2 record needs; fetch it again, "
            "or if it is one motion in rows, set ground_motion rows (--rows)"
        )


def read_peer(path: Path, lines: list[str]) -> Columns | None:
    """Read an AT2 file: one column, in the header's unit and with its DT.

    There are two header dialects, ``4096    0.0100    NPTS, DT`` and ``NPTS=  4096, DT= .01000
    SEC``.

    Raises
    ------
    InputError
        If the header is not that of an acceleration, or if the number of values is not that of the
        header.
    """
    if (end := _header_end(lines)) is None:
        return None
    numbers = NUMBER.findall(lines[end])
    count, dt = int(numbers[0]), to_float(numbers[1], path, end + 1)
    if count < 1 or not 0 < dt < np.inf:
        found = f"NPTS is {count} and DT is {dt:g} s; both must be positive"
        raise InputError(f"{path}: line {end + 1}: {found}")
    titles = [(number, line) for number, line in enumerate(lines[:end], start=1) if line.strip()]
    unit = read_header(path, titles).unit
    own_dt = Statement(dt, f"line {end + 1}")
    return read_channel(path, lines, end + 1, count, "PEER AT2", own_dt, unit)


def _header_end(lines: list[str]) -> int | None:
    for index, line in enumerate(lines[:_PEER_HEADER]):
        numbers = NUMBER.findall(line) if _PEER_NPTS.search(line) and not is_comment(line) else []
        if len(numbers) > 1 and numbers[0].isdigit():
            return index
    return None


_SMC_FIRST_LINE = re.compile(r"^\s*[0-9]\s+(?:UN)?CORRECTED\s+ACCELEROGRAM\b", re.IGNORECASE)
_SMC_TEXT, _SMC_INTEGERS, _SMC_REALS = 11, 6, 10  # lines
_SMC_COMMENTS, _SMC_COUNT, _SMC_RATE = 15, 16, 1  # places, from 0
_SMC_NO_RATE = 1e6  # Hz; records of uneven times have 1.7e38


def read_smc(path: Path, lines: list[str]) -> Columns | None:
    """Read an SMC file: one column, in cm/s^2; its headers have a fixed length.

    Raises
    ------
    InputError
        If the header gives no count or rate, or the number of values is another.
    """
    if not _SMC_FIRST_LINE.match(lines[0]):
        return None
    reals = _SMC_TEXT + _SMC_INTEGERS
    end = reals + _SMC_REALS
    integers = header_numbers(path, lines, _SMC_TEXT, reals, 10)
    numbers = header_numbers(path, lines, reals, end, 15)
    known = len(integers) == 8 * _SMC_INTEGERS and len(numbers) == 5 * _SMC_REALS
    if not known or not 0 < numbers[_SMC_RATE] < _SMC_NO_RATE:
        raise InputError(
            f"{path}: the header of an SMC record gives no count of values and no rate; fetch the "
            "record again, evenly sampled"
        )
    end += max(int(integers[_SMC_COMMENTS]), 0)
    dt = Statement(float(f"{1 / numbers[_SMC_RATE]:.7g}"), f"line {reals + 1}")
    unit = Statement("cm/s2", "the SMC format")
    count = int(integers[_SMC_COUNT])
    return read_channel(path, lines, end, count, "SMC", dt, unit, said=_SMC_TEXT + 2)


_COSMOS_FORMAT = r"Format\s*=\s*\(\s*(?:1P)?\d*[DEFGI](\d+)"
_COSMOS_DATA = re.compile(
    rf"^\s*(\d+)\s+(.+?)\s+pts\b.*?\bunits\s*=\s*([^,(]+).*?{_COSMOS_FORMAT}", _FLAGS
)
_COSMOS_REALS = re.compile(
    rf"^\s*\d+\s+Real-header values follow on\s+(\d+)\s+lines.*?{_COSMOS_FORMAT}", _FLAGS
)
_COSMOS_PERIODS = ((62, 1e-3), (34, 1.0))
"""Places of the sampling period in the real header, and its unit in s: the period of these values,
then that of the instrument."""


def read_cosmos(path: Path, lines: list[str]) -> Columns | None:
    """Read a COSMOS file (v1.20): a column for each of its channels of acceleration.

    Lines state the number and the format of the values that follow.

    Velocities and displacements, which may follow each channel, are left out.

    Raises
    ------
    InputError
        If there is no acceleration, its unit is unknown, the number of values is not that of the
        header, or channels differ in length or sampling period.
    """
    found, other, dt = list[Columns](), "", None
    for index, line in enumerate(lines):
        if real := _COSMOS_REALS.match(line):
            end = index + 1 + int(real.group(1))
            numbers = header_numbers(path, lines, index + 1, end, int(real.group(2)))
            known = [
                Statement(float(f"{numbers[place - 1] * unit:.7g}"), f"line {index + 1}")
                for place, unit in _COSMOS_PERIODS
                if len(numbers) >= place and numbers[place - 1] > 0
            ]
            dt = known[0] if known else None
        elif data := _COSMOS_DATA.match(line):
            quantity = data.group(2).lower()
            if quantity in ("velocity", "displacement"):
                other = other or quantity
                continue
            unit = known_unit(path, index + 1, data.group(3).strip())
            own = Statement(unit, f"line {index + 1}")
            count, width = int(data.group(1)), int(data.group(4))
            found.append(read_channel(path, lines, index + 1, count, "COSMOS", dt, own, width))
    return _only_accelerations(path, found, other)


def _only_accelerations(path: Path, found: list[Columns], other: str) -> Columns | None:
    """Join the channels of acceleration; None: the file has no channel of its format."""
    if other and not found:
        raise other_quantity(path, 1, other)
    return as_channels(found) if found else None


_CSMIP_EVEN = re.compile(
    rf"^\s*(\d+)\s+points\s+of\s+(accel|veloc|displ)\w*\.?\s+data\s+equally\s+spaced\s+at\s+({_N})"
    r"\s*sec\.?,?\s*\(?\s*(?:in|units?\s*[:=]?)\s*([^\s(),]+)",
    _FLAGS,
)
_CSMIP_RAW = re.compile(
    rf"^\s*(\d+)\s+(accelerogram)\s+points\s+at\s+({_N})\s+pts/sec\s+in\s+units\s+of\s+([^\s(),]+)",
    _FLAGS,
)
_CSMIP_PAIRS = re.compile(r"^\s*units\s+of\s+uncor\s+accel\s+are\s+sec\s+and\s+g/10\b", _FLAGS)
_CSMIP_POINTS = re.compile(r"no\.?\s+of\s+points\s*=\s*(\d+)", _FLAGS)
_CSMIP_WIDTH = re.compile(r"\(\s*\d*[FE](\d+)", _FLAGS)
_ABOVE_PAIRS, _PAIR_WIDTH = 16, 7  # lines of headers from the line of units on; characters
_CSMIP_OTHERS = {"veloc": "velocity", "displ": "displacement"}


def read_csmip(path: Path, lines: list[str]) -> Columns | None:
    """Read a CSMIP file (CGS, formerly CDMG): a column for each of its channels of acceleration.

    Volume 2 has ``7500 points of accel data equally spaced at .010 sec, in cm/sec2. (8f10.6)``
    above the values, newer files of volume 1 ``13200 Accelerogram points at 200 pts/sec in units of
    g``. Older files of volume 1 have pairs of time and acceleration, in seconds and g/10.

    Velocities and displacements, which follow each channel of volume 2, are left out.

    Raises
    ------
    InputError
        If there is no acceleration, its unit is unknown, the number of values is not that of the
        header, times are uneven, or channels differ in length, unit or sampling period.
    """
    found, other = list[Columns](), ""
    for index, line in enumerate(lines):
        if said := _CSMIP_EVEN.match(line) or _CSMIP_RAW.match(line):
            count, quantity, period, unit = said.groups()
            if quantity.lower() in _CSMIP_OTHERS:
                other = other or _CSMIP_OTHERS[quantity.lower()]
                continue
            place, width = f"line {index + 1}", _CSMIP_WIDTH.search(line)
            step = float(period) if said.re is _CSMIP_EVEN else 1 / float(period)
            dt = Statement(step, place)
            own = Statement(known_unit(path, index + 1, unit), place)
            wide = int(width.group(1)) if width else 0
            found.append(read_channel(path, lines, index + 1, int(count), "CSMIP", dt, own, wide))
        elif _CSMIP_PAIRS.match(line):
            found.append(_pairs(path, lines, index))
    return _only_accelerations(path, found, other)


def _pairs(path: Path, lines: list[str], index: int) -> Columns:
    """Read pairs of time, s, and acceleration, g/10, below the headers."""
    said = next((n for n in range(index, -1, -1) if _CSMIP_POINTS.search(lines[n])), index)
    points = _CSMIP_POINTS.search(lines[said])
    count = int(points.group(1)) if points else 0
    start = index + _ABOVE_PAIRS
    values, places = read_values(path, lines, start, 2 * count, _PAIR_WIDTH, said + 1)
    texts = [piece for line in lines[start:] for piece in pieces(line, _PAIR_WIDTH)][: 2 * count]
    table = np.reshape(values, (-1, 2))
    table[:, 1] /= 10
    unit = Statement("g", f"line {index + 1}, as g/10")
    rows = [texts[at : at + 2] for at in range(0, 2 * count, 2)]
    names, places = ("time", "acceleration"), places[::2]
    found = Columns(path, table, places, "CSMIP", names, own_unit=unit, texts=rows).dt()
    dt = None if found is None else Statement(found.value, "the times")
    return Columns(path, table[:, 1:], places, "CSMIP", own_dt=dt, own_unit=unit)


_GEONET_PERIOD = re.compile(
    rf"^\s*(?:instrument corrected data|raw readings in units of\s+({_N})\s*(\S+))"
    rf"\s+at\s+(?:intervals of\s+)?({_N})\s*s",
    _FLAGS,
)
_GEONET_POINTS = re.compile(r"^\s*number of points\s+(\d+)", _FLAGS)
_GEONET_PEAK = re.compile(rf"^\s*acceleration:\s+peak\s+{_N}\s+(\S+)\s+at", _FLAGS)
_GEONET_COMPONENT = re.compile(r"^\s*component\s+(\S+)", _FLAGS)
_BEFORE_PERIOD, _AFTER_PERIOD = 10, 16  # lines of headers
_GEONET_WIDTH, _IN_A_ROW = 8, 10


def _is_geonet_row(line: str) -> bool:
    cut = pieces(line, _GEONET_WIDTH)
    return bool(cut) and all(map(is_number, cut))


def read_geonet(path: Path, lines: list[str]) -> Columns | None:
    """Read a GeoNet file, V1A or V2A: a column for each component's acceleration.

    Each component has 26 lines of headers, then values; in volume 2 as many velocities and
    displacements follow.

    Raises
    ------
    InputError
        If the header lacks the number of points or the unit, the number of values is not that of
        the header, or components differ in length or sampling period.
    """
    found, names = list[Columns](), list[str]()
    if not any(map(_GEONET_POINTS.match, lines)):
        return None
    for index, line in enumerate(lines):
        if not (period := _GEONET_PERIOD.match(line)):
            continue
        start = index + _AFTER_PERIOD
        header = lines[max(index - _BEFORE_PERIOD, 0) : start]
        points, peak, component = (
            next(filter(None, map(form.match, header)), None)
            for form in (_GEONET_POINTS, _GEONET_PEAK, _GEONET_COMPONENT)
        )
        if points is None or peak is None:
            lacks = "the number of points and the acceleration's peak with its unit"
            why = f"the header around it does not state {lacks}; fetch the record again"
            raise InputError(f"{path}: line {index + 1}: {why}")
        count = int(points.group(1))
        rows = -(-count // _IN_A_ROW)
        there = sum(1 for _ in takewhile(_is_geonet_row, lines[start:]))
        if there % max(rows, 1):
            wanted = f"{count} points are {rows} rows for each quantity; fetch the record again"
            what = f"{there} rows of values follow, but {wanted}"
            raise InputError(f"{path}: line {index + 1}: {what}")
        size, place = float(period.group(1) or 1), f"line {index + 1}"
        dt = Statement(float(period.group(3)), place)
        unit = Statement(known_unit(path, index + 1, period.group(2) or peak.group(1)), place)
        known = count, "GeoNet", dt, unit, _GEONET_WIDTH, index, size
        found.append(read_channel(path, lines[: start + rows], start, *known))
        names.append(component.group(1) if component else f"component {len(found)}")
    return as_channels(found, names) if found else None


AGENCY_FORMATS = read_cosmos, read_smc, read_geonet, read_csmip, read_peer
"""Readers of texts with an agency's header: None if a file has another."""
