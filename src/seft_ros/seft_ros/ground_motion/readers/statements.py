"""What the header of a record states in words: unit, sampling period, number of points, quantity.

Each form is one that public records have. Two statements that differ are refused, and so is one
that can't be used, such as an unknown unit: none of them is passed over in silence.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.readers.record_text import NUMBER, decimals, to_float

STANDARD_GRAVITY = 9.80665
"""Standard acceleration of gravity in m/s^2, exact by definition (ISO 80000-3)."""

UNITS = {"g": STANDARD_GRAVITY, "m/s2": 1.0, "cm/s2": 0.01, "mm/s2": 0.001}
"""Acceleration unit in a file -> its size in m/s^2."""

GIVEN_UNITS = ("g", "m/s2", "cm/s2")
"""Units in which a user may say that a file is, where it does not say so itself."""

_WORDS = {
    **dict.fromkeys(("gal", "gals"), "cm/s2"),
    **dict.fromkeys(("g's", "gs", "g0", "gn", "gravity"), "g"),
}
_LENGTHS = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("cm", "cms", "centimeter", "centimeters", "centimetre"), "cm"),
    **dict.fromkeys(("mm", "mms", "millimeter", "millimeters", "millimetre"), "mm"),
    **dict.fromkeys(("nm", "um", "km", "in", "inch", "inches", "ft", "feet", "foot"), ""),
}
_OTHER = {
    *("count", "counts", "cts", "digit", "digits", "raw", "bit", "bits", "lsb"),
    *("v", "mv", "volt", "volts", "v/g", "mg", "ug", "milli-g", "%g", "g/10", "kine", "kines"),
    *("n", "kn", "lb", "lbs", "kip", "kips", "kg", "kgf", "pa", "kpa", "mpa", "psi", "%"),
    *("s", "ms", "hz", "rad", "rad/s", "deg", "strain"),
}
_TIMES = ("s", "ms", "hz")
_OF_MULTIPLES = {"g", "gal", "gals"}
_LETTERS = re.compile(r"[a-z]+")


def read_unit(text: str) -> str | None:
    """Recognise an acceleration unit in any spelling, such as G, gal, cm/sec/sec, m/s^2.

    Returns a key of `UNITS`; None if the text is none of them.
    """
    word = _plain(text)
    if word in ("g", *_WORDS):
        return _WORDS.get(word, word)
    length, power = _parts(word)
    unit = f"{_LENGTHS.get(length, '')}/s2"
    return unit if power == 2 and unit in UNITS else None


def is_other_unit(text: str) -> bool:
    """Whether a text is a unit in which no acceleration can be read: cm/s, mm, counts, 0.1 g."""
    if read_unit(text):
        return False
    word = _plain(text)
    length, power = _parts(word)
    of_multiples = not _OF_MULTIPLES.isdisjoint(_LETTERS.findall(word))
    multiple = of_multiples and re.search(r"[\d%*/]|milli|micro", word)
    of_length = word.partition("/")[0] in _LENGTHS or (length in _LENGTHS and power > 0)
    return word in _OTHER or of_length or bool(multiple)


def _plain(text: str) -> str:
    """Write a unit in small letters, with s for seconds, without powers' marks and blanks."""
    word = text.strip().strip(".,;:'\"[]()").strip().lower()
    word = word.replace("²", "2").replace("⁻", "-").replace("·", ".")
    word = re.sub(r"\*\*|\^|\{|\}", "", word)
    word = re.sub(r"\bper\b", "/", word)
    word = re.sub(r"sec(?:ond)?s?\b|sec(?=\d)", "s", word)
    word = re.sub(r"\bsquared\b", "2", re.sub(r"(?<=[a-z]s)quared", "2", word))
    return re.sub(r"\s+", "", word) if "/" in word else re.sub(r"\s+", " ", word)


def _parts(word: str) -> tuple[str, int]:
    """Length and power of the time below it: cm/s/s, cm/s2, cm/(s2), cm s-2, cms-2 -> cm, 2."""
    word = re.sub(r"[() ]", "", word) if "/" in word else word
    if over := re.fullmatch(r"([a-z]+)/s(/s|/?2|\*s)?", word):
        return over[1], 2 if over[2] else 1
    if over := re.fullmatch(r"([a-z]+?)[ .*]?s-([12])", word):
        return over[1], int(over[2])
    over = re.fullmatch(r"([a-z]+?)(?:[_p]s|(?=s2))(?:s?(2))?", word)  # m_s2, mps2, cms2; m_s
    return (over[1], int(over[2] or 1)) if over and over[1] in _LENGTHS else (word, 0)


SAME_PERIOD = 1e-3
"""Relative difference up to which two sampling periods are the same."""

_N = NUMBER.pattern
_FLAGS = re.IGNORECASE | re.ASCII

_WORD = (  # cm/s2, cm / s^2, cm s-2, cm/(s^2), cm per second squared, g / 10
    r"([^\s,;()\[\]]+(?:\s*/\s*s(?:ec)?\b(?:[*^]*2)?|\s+s(?:ec)?[*^]*-\d|\s?\(s(?:ec)?[*^]*2\)"
    r"|\s+per\s+sec\w*(?:\s+(?:squared|per\s+sec\w*))?|\s*[/*x]\s*[\d.]+)*)"
)
_UNIT = re.compile(
    r"(?:units?|unidad(?:es)?)\b[\w\s]{0,24}?\s*(?:\bof\b|\bin\b|\bis\b|\bare\b|[:=(\[])"
    rf"[\s:=(\[]*(?:acceleration\s*[:=(\[]?\s*|the\s+)?{_WORD}",
    _FLAGS,
)
_IN_UNIT = re.compile(rf"\b(?:in|units?|fractions?\s+of)\s+{_WORD}", _FLAGS)
_ACCELERATION_IN = re.compile(rf"^\W*acc(?:el(?:eration)?s?)?\.?\s*[:=(\[/]+\s*{_WORD}", _FLAGS)
_UNIT_CELL = re.compile(rf"^\W*(?:units?|unidad(?:es)?)\W*[,;\t]\W*{_WORD}", _FLAGS)
_PER_SQUARED = re.compile(r"\b\w+\s+per\s+sec\w*\s+(?:squared|per\s+sec\w*)", _FLAGS)
_BARE = re.compile(r"[\s,;:()\[\]]+")
_VALUE = re.compile(  # the unit of one value, not of the record
    rf"peak|max|pga|trigger|threshold|umbral|\bscale|sensit|factor|{_N}\s*(?:gal|c?m/s)", _FLAGS
)
_PERIOD_NAME = (
    r"(?:\bdt\b|\bdelta[_ ]?t\b|\b(?:sampling|sample|time)[\s_]*(?:interval|period|step|spacing|"
    r"increment)|\bintervalo\s+de\s+muestreo|Δt|\bdelta(?=\s*[:=])"
    r"|\bequal(?:ly)?[\s-]+spac(?:ed|ing)(?:[\s-]+intervals?)?|\btime[\s_]*delta\b)"
)
_IN_MILLI = r"(?:[\s_]*[(\[]?\s*(ms|msec|milliseconds?|s|secs?|seconds?)\b\s*[)\]]?)?"
_PERIOD = re.compile(
    rf"{_PERIOD_NAME}{_IN_MILLI}\s*(?:of|at|is)?\s*[:=,]?\s*"
    rf"({_N})(?:\s*/\s*({_N}))?\s*(ms|msec|milliseconds?|s|secs?|seconds?|hz)?\b"
    r"(?!\d|\.\d|\s*(?:deg|°|km))",  # delta may be a distance
    _FLAGS,
)
_RATE = re.compile(
    r"\b(?:sampling|sample)[\s_]*(?:rate|freq(?:uency)?)\b\.?[\s_]*(?:[(\[]?\s*hz\s*[)\]]?)?"
    rf"\s*(?:of|at|is)?\s*[:=,]?\s*({_N})"
    rf"|\bsampl(?:ed|ing)\s*(?:at|:)?\s*({_N})(?=\s*k?hz\b)"
    rf"|\bfs\s*[:=]\s*({_N})(?=\s*(?:k?hz\b|sps\b|[,;)]|$))",  # fs may be the full scale
    _FLAGS,
)
_EVERY = re.compile(
    rf"(?:\b(?:every|intervals?|(?:points|pts|samples)\s+at))()(?:\s+of)?[\s:=]*({_N})()"
    r"\s*(ms|msec|milliseconds?|s|secs?|seconds?)\b",
    _FLAGS,
)
_KILO = re.compile(r"\s*khz\b", _FLAGS)
_PER_SECOND = re.compile(
    rf"({_N})\s*(?:(?:samples?|points?|pts)\s*(?:/|per)\s*s(?:ec(?:ond)?)?|sps)\b", _FLAGS
)
_COUNT = re.compile(
    r"\b(?:ndata|npts|npoints?|(?:no\.?|num(?:ber)?\.?)\s*(?:of)?\s*(?:data\s*)?"
    r"(?:points?|pts|samples?|values?|data))\b\s*(?:is|of)?\s*[:=]?\s*(\d+)\b(?!\.\d)",
    _FLAGS,
)
_COUNT_FIRST = re.compile(
    r"(?<![\d.])(\d+)\s+(?:data\s+|acceleration\s+|acc\s+)?(?:points|pts|samples|values)\b"
    r"(?!\s*(?:/|per|across|in\s+(?:a|each)|(?:a|each)\s+(?:row|line)))",
    _FLAGS,
)
_SCALE = re.compile(
    r"\b(?:(?:scal(?:e|ing)|conversion)[\s_]*factor|multipl(?:ier|y\s+by)|sensitivity)\W*"
    rf"(?:of|is)?\W*({_N})",
    _FLAGS,
)
_PEAK = re.compile(
    r"(?:\b(?:pga|amax|peak|max(?:imum)?|m[aá]xim[ao])|(?<=acc)max)(?![a-z])\.?\s*"
    r"(?:(?:ground|(?:un)?corrected|values?)[\s:]+)*(?:acc\w*|acel\w*)?"
    rf"[\s._:=(\[]*([a-z%][^\s:=,;()\[\]]*)?[\s:=,;)\]]*({_N})\s*([^\s,;()\d]\S*?)?(?=[\s,;()]|$)",
    _FLAGS,
)
_OF_ACCELERATION = re.compile(r"acc|acel|pga|amax", _FLAGS)
_OF_OTHERS = re.compile(  # a peak of the instrument, the site, or of several components
    r"trigger|threshold|umbral|scale|range|limit|sensor|clip|satur|horiz|result|vector|mean|spectr"
    r"|design|target|expected|hazard",
    _FLAGS,
)
_ROUGHLY = 0.1
"""Of a peak: zeros, filters and rounding differ by no more, units and offsets by far more."""
_OTHER_QUANTITY = re.compile(
    r"\b(?:(?:data[_ ]?)?type|tipo(?:\s+de\s+datos?)?|quantity)\W+(?:[\w-]+\s+){0,2}?"
    r"(vel\w*|disp\w*|despl\w*|spectr\w*|espectr\w*)\b"
    r"|\b(velocity|displacement)\s+(?:time|history|series|record)\b"
    r"|^\W*(?:(?:un)?corrected|ground|relative|filtered)\s+(velocity|displacement)\b",
    _FLAGS,
)
_QUANTITIES = {"v": "velocity", "d": "displacement", "s": "spectrum"}
_OTHER_FIRST = re.compile(
    r"^\W*(?:(?:ground|relative)\s+|(?:data\W*)?type\W+|quantity\W+)?"
    r"(?:(vel|veloc\w*)|disp|displ|displacements?|desplazamientos?)\b(?!\W+de\s+muestreo)",
    _FLAGS,
)


@dataclass(frozen=True)
class Statement[T]:
    """A value that a file states, and where, as messages name the place."""

    value: T
    place: str


@dataclass(frozen=True)
class Peak:
    """Largest acceleration that a file states, m/s^2, with half its last digit, and where."""

    size: float
    half_digit: float
    place: str

    def is_of(self, largest: float) -> bool:
        """Whether a motion with this largest acceleration may be meant."""
        return abs(largest - self.size) <= _ROUGHLY * self.size + self.half_digit


def stated_peaks(path: Path, lines: Sequence[str]) -> tuple[Peak, ...]:
    """Find the peaks of accelerations that a text states with their unit."""
    found = []
    for number, line in enumerate(lines, start=1):
        if not _OF_ACCELERATION.search(line) or _OF_OTHERS.search(line):
            continue
        for before, text, after in _PEAK.findall(line):
            unit = read_unit(before) or read_unit(after)
            if unit and (size := abs(to_float(text, path, number))) > 0:
                half = 0.5 * 10.0 ** -decimals(text)
                found.append(Peak(UNITS[unit] * size, UNITS[unit] * half, f"line {number}"))
    return tuple(found)


@dataclass(frozen=True)
class Header:
    """What the lines above the data state; None: nothing.

    Attributes
    ----------
    unit : Statement of str or None
        Key of `UNITS`.
    dt : Statement of float or None
        Sampling period in s.
    count : Statement of int or None
        Number of points.
    """

    unit: Statement[str] | None = None
    dt: Statement[float] | None = None
    count: Statement[int] | None = None


def read_header(path: Path, lines: Sequence[tuple[int, str]]) -> Header:
    """Read the statements of numbered header lines.

    Raises
    ------
    InputError
        If two differ, or a unit is unknown, or the file holds a velocity or displacement.
    """
    lines = [(number, line.replace('"', "")) for number, line in lines]
    of_acceleration = any("acc" in line.lower() for _, line in lines)
    for number, line in lines:
        if found := _OTHER_QUANTITY.search(line):
            word = next(filter(None, found.groups())).lower()
            raise other_quantity(path, number, _QUANTITIES[word.removeprefix("e")[0]])
        first = _OTHER_FIRST.match(line)
        if first and not (of_acceleration or _VALUE.search(line)):
            raise other_quantity(path, number, "velocity" if first.group(1) else "displacement")
    units = [Statement(unit, f"line {n}") for n, line in lines for unit in _units(path, n, line)]
    periods = [Statement(dt, f"line {n}") for n, line in lines for dt in _periods(path, n, line)]
    counts = [Statement(count, f"line {n}") for n, line in lines for count in _counts(line)]
    return Header(
        agreed(path, "unit", *units),
        agreed(path, "sampling period, s,", *periods),
        agreed(path, "number of points", *counts),
    )


def check_factor(path: Path, lines: Sequence[tuple[int, str]]) -> None:
    """Refuse counts, or values without a unit, that are to be multiplied by a factor."""
    for number, line in lines:
        if (scale := _SCALE.search(line)) and to_float(scale.group(1), path, number) != 1:
            raise InputError(
                f"{path}: line {number}: states the factor {scale.group(1)}, but no line the unit "
                "of the values, or they are whole numbers, as counts are; multiply them by it, if "
                "they are not yet, and take off that line"
            )


def is_same_period(first: float, second: float) -> bool:
    """Whether two sampling periods are the same, within 0.1 %."""
    return abs(first - second) <= SAME_PERIOD * first


def known_unit(path: Path, number: int, text: str) -> str:
    """Give the acceleration unit that a header names.

    Raises
    ------
    InputError
        If it is none that is known here.
    """
    unit = read_unit(text)
    if unit is None:
        mend = "convert the record to g, m/s2 or cm/s2"
        why = f"{text} is no acceleration unit known here; {mend}"
        raise InputError(f"{path}: line {number}: {why}")
    return unit


def other_quantity(path: Path, number: int, quantity: str) -> InputError:
    """Make the error on a file of velocities or displacements."""
    what = f"holds a {quantity.lower()}; give the record of the acceleration"
    return InputError(f"{path}: line {number}: {what}")


def agreed[T](path: Path, what: str, *found: Statement[T] | None) -> Statement[T] | None:
    """Give the first of some statements on one thing; None: there is none.

    Raises
    ------
    InputError
        If another one is not the same.
    """
    stated = [each for each in found if each]
    for each in stated[1:]:
        if not _is_same(stated[0].value, each.value):
            other = f"{stated[0].place} {stated[0].value}; correct one of them"
            raise InputError(f"{path}: {each.place} states the {what} {each.value}, but {other}")
    return stated[0] if stated else None


def _is_same(first: object, second: object) -> bool:
    if isinstance(first, float) and isinstance(second, float):  # sampling periods
        return is_same_period(first, second)
    return first == second


def _units(path: Path, number: int, line: str) -> Iterable[str]:
    stated = _UNIT.findall(line)
    units = _ACCELERATION_IN.findall(line) + _UNIT_CELL.findall(line)
    for text in stated:
        if not read_unit(text) and not is_other_unit(text):
            raise InputError(
                f'{path}: line {number}: states the unit "{text[:30]}", which is not known here; '
                "convert the record to g, m/s2 or cm/s2, and name that unit there"
            )
    for text in (*stated, *units):
        if read_unit(text) or is_other_unit(text):
            yield known_unit(path, number, text)
    for text in () if stated else _IN_UNIT.findall(line):
        of_motion = "accel" in line.lower() and _plain(text) not in _TIMES
        if read_unit(text) or (of_motion and is_other_unit(text)):
            yield known_unit(path, number, text)
    if not (stated or units or _VALUE.search(line)):
        alone = "g" if line.strip(" \t%#/!;").lower() == "g" else ""
        for text in (alone, *_PER_SQUARED.findall(line), *_BARE.split(line)):
            unit = (text == alone or len(text) > 1) and read_unit(text)
            if unit or text.lower() in ("counts", "volts"):
                yield known_unit(path, number, text)


def _periods(path: Path, number: int, line: str) -> Iterable[float]:
    for found in (*_PERIOD.finditer(line), *(() if _VALUE.search(line) else _EVERY.finditer(line))):
        before, value, divisor, after = (text or "" for text in found.groups())
        _check_point(path, number, line, found.end(2))
        period = to_float(value, path, number)
        if divisor:
            period /= to_float(divisor, path, number) or float("nan")
        if after.lower() == "hz":
            period = 1 / period if period else 0.0
        elif (after or before).lower().startswith("m"):
            period = float(f"{period * 1e-3:.12g}")
        if 0 < period < float("inf"):
            yield period
    for found in (*_RATE.finditer(line), *_PER_SECOND.finditer(line)):
        rate = to_float(next(filter(None, found.groups())), path, number)
        _check_point(path, number, line, found.end(found.lastindex or 0))
        if rate > 0:
            yield 1e-3 / rate if _KILO.match(line, found.end()) else 1 / rate


def _check_point(path: Path, number: int, line: str, end: int) -> None:
    """Refuse a number that goes on with a decimal comma."""
    if re.match(r",\d", line[end:]):
        raise InputError(f"{path}: line {number}: write decimal points, not commas")


def _counts(line: str) -> Iterable[int]:
    yield from map(int, _COUNT.findall(line) or _COUNT_FIRST.findall(line))
