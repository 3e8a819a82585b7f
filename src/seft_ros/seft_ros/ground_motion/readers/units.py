"""Units of accelerations, in the spellings that records and their users have."""

import re

STANDARD_GRAVITY = 9.80665
"""Standard acceleration of gravity in m/s^2, exact by definition (ISO 80000-3)."""

UNITS = {"g": STANDARD_GRAVITY, "m/s2": 1.0, "cm/s2": 0.01, "mm/s2": 0.001}
"""Acceleration unit in a file -> its size in m/s^2."""

GIVEN_UNITS = ("g", "m/s2", "cm/s2")
"""Units in which a user may say that a file is, where it does not say so itself."""

_WORDS = {"gal": "cm/s2", "gals": "cm/s2", "g's": "g", "gs": "g", "g0": "g", "gn": "g"}
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
    """Whether a text is a unit in which no acceleration can be read: cm/s, mm, counts, in/s2."""
    if read_unit(text):
        return False
    word = _plain(text)
    length, power = _parts(word)
    return word in _OTHER or word in _LENGTHS or (length in _LENGTHS and power > 0)


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
    over = re.fullmatch(r"([a-z]+)/s(?:/s|/?2|\*s)", word)
    if over:
        return over.group(1), 2
    over = re.fullmatch(r"([a-z]+)/s", word)
    if over:
        return over.group(1), 1
    over = re.fullmatch(r"([a-z]+?)[ .*]?s-([12])", word)
    if over:
        return over.group(1), int(over.group(2))
    return word, 0
