"""Units of recorded acceleration, and the ways in which files spell them."""

import re

STANDARD_GRAVITY = 9.80665
"""Standard acceleration of gravity in m/s^2, exact by definition (ISO 80000-3)."""

UNITS = {"g": STANDARD_GRAVITY, "m/s2": 1.0, "cm/s2": 0.01}
"""Unit as it is written in a parameter file -> its size in m/s^2."""

_IN_BRACKETS = re.compile(r"[\[(]([^\[\]()]+)[\])]")


def read_unit(text: str) -> str | None:
    """Recognise an acceleration unit however it is spelled.

    Parameters
    ----------
    text : str
        For example ``G``, ``cm/sec/sec``, ``gal``, ``m/s^2``.

    Returns
    -------
    str or None
        A key of `UNITS`; None if the text is none of them.
    """
    word = text.strip().strip(".,;'").lower().replace("²", "2").replace(" ", "")
    word = re.sub(r"\*\*|\^", "", word).replace("sec", "s").replace("s/s", "s2")
    word = {"gal": "cm/s2", "gals": "cm/s2", "g's": "g", "gs": "g"}.get(word, word)
    return word if word in UNITS else None


def unit_of_name(name: str) -> str | None:
    """Acceleration unit in the brackets of a column's name, ``acc (g)``; None if there is none."""
    found = _IN_BRACKETS.search(name)
    return read_unit(found.group(1)) if found else None
