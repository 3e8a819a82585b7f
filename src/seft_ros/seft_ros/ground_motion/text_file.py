"""Lines, numbers and units of a record's text, with errors that name the place."""

import re
from pathlib import Path

from seft_msgs_py.errors import InputError

STANDARD_GRAVITY = 9.80665
"""Standard acceleration of gravity in m/s^2, exact by definition (ISO 80000-3)."""

UNITS = {"g": STANDARD_GRAVITY, "m/s2": 1.0, "cm/s2": 0.01}
"""Unit as it is written in a parameter file -> its size in m/s^2."""

COMMENT_MARKS = ("%", "#", "//", "!", ";")
NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][+-]?\d+)?", re.ASCII)
"""A number as Fortran, C and spreadsheets write it; D is Fortran's double exponent."""

_NOT_FINITE = re.compile(r"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+")


def read_lines(path: Path) -> list[str]:
    """Read a text file, UTF-8 with any line ends; line n of it is item n - 1.

    Raises
    ------
    InputError
        If it can't be read, is empty, or is no text.
    """
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder; give the record file in it")
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is no regular file; give a record file")
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(
            f"{path}: no such file; give its full path, or one from the working directory"
        ) from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: {getattr(error, 'strerror', None) or error}") from None
    try:
        text = data.decode("utf-8-sig")
        position = text.find("\0")
        bad = None if position < 0 else len(text[:position].encode())
    except UnicodeDecodeError as error:
        bad = error.start
    if bad is not None:
        line = data.count(b"\n", 0, bad) + 1
        raise InputError(
            f"{path}: line {line}: byte 0x{data[bad]:02x} is no text; save the record as plain "
            "text (UTF-8)"
        )
    text = text.replace("\r\n", "\n").replace("\r", "\n").rstrip("\n\x1a")  # x1a: end in DOS
    if not text.strip():
        raise InputError(f"{path}: is empty; give a file that holds a record")
    return text.split("\n")


def is_comment(line: str) -> bool:
    """Whether a line begins with a comment mark."""
    return line.lstrip().startswith(COMMENT_MARKS)


def to_float(token: str, path: Path, line: int) -> float:
    """Read the number that a piece of text stands for; it may overflow to infinity.

    Raises
    ------
    InputError
        If it is no number; names the file and the line.
    """
    if NUMBER.fullmatch(token):
        return float(token.upper().replace("D", "E"))
    if _NOT_FINITE.fullmatch(token):
        return float(token)
    if not token:
        raise InputError(f"{path}: line {line}: a field is empty; write a number there")
    shown = "".join(sign if sign.isprintable() else "?" for sign in token[:30])
    mend = "correct it, or begin the line with % if it is a comment"
    if _DECIMAL_COMMA.fullmatch(token):
        mend = "write decimal points, not commas"
    raise InputError(f'{path}: line {line}: "{shown}" is no number; {mend}')


def not_finite(value: float, path: Path, line: int) -> InputError:
    """Error for a NaN or an infinity in the data."""
    return InputError(
        f"{path}: line {line}: the value is {value}, not a finite number; "
        "mend the record there, or cut it off before"
    )


def read_unit(text: str) -> str | None:
    """Recognise an acceleration unit however it is spelled: G, gal, cm/sec/sec, m/s^2.

    Returns
    -------
    str or None
        A key of `UNITS`; None if the text is none of them.
    """
    word = text.strip().strip(".,;'").lower().replace("²", "2").replace(" ", "")
    word = re.sub(r"\*\*|\^", "", word).replace("sec", "s").replace("s/s", "s2")
    word = {"gal": "cm/s2", "gals": "cm/s2", "g's": "g", "gs": "g"}.get(word, word)
    return word if word in UNITS else None
