"""Text of a record: its bytes as lines, in any encoding, and its pieces as numbers."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from seft_msgs_py.errors import InputError
from seft_msgs_py.files import open_regular

NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][+-]?\d+)?", re.ASCII)
"""A number of Fortran, C or a spreadsheet; D is Fortran's double exponent."""

COMMENT_MARKS = ("%", "#", "//", "!", ";")
"""What a line of comment begins with."""

_NOT_FINITE = re.compile(r"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+")
_RUN_TOGETHER = re.compile(r"(?<=[0-9.])(?=[+-])")
_END_MARK = re.compile(r"\W*(?:(?:end|eof|stop)\b.*|)", re.IGNORECASE | re.DOTALL)
_BYTE_ORDER_MARKS = ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"), (b"", "utf-8-sig"))


def read_bytes(path: Path) -> bytes:
    """Read a file.

    Raises
    ------
    InputError
        If it can't be read, or is no regular file.
    """
    try:
        with open_regular(path) as file:
            return file.read()
    except FileNotFoundError:
        mend = "give its full path, or one from the working directory"
        raise InputError(f"{path}: no such file; {mend}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: {getattr(error, 'strerror', None) or error}") from None


def to_lines(path: Path, data: bytes) -> list[str]:
    """Decode a text, with any line ends; line n of it is item n - 1.

    It is UTF-8, or UTF-16, or else each byte stands for itself (Latin-1): numbers are the same in
    all other encodings, and only the names in a header differ.

    Raises
    ------
    InputError
        If it is empty, or no text.
    """
    encoding = next(name for mark, name in _BYTE_ORDER_MARKS if data.startswith(mark))
    for offset, order in ((1, "le"), (0, "be")):  # ASCII in UTF-16: each second byte is zero
        if 0 < len(data) <= 2 * data[offset::2].count(0) and not data[1 - offset :: 2].count(0):
            encoding = f"utf-16-{order}"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    if (place := text.find("\0")) >= 0:
        raise InputError(
            f"{path}: line {text.count('\n', 0, place) + 1}: byte 0x00 is no text; save the record "
            "as plain text, or fetch it again"
        )
    text = text.replace("\r\n", "\n").replace("\r", "\n").rstrip("\n\x1a")  # x1a: end in DOS
    if not text.strip():
        raise InputError(f"{path}: is empty; give a file that holds a record")
    return text.split("\n")


def is_comment(line: str) -> bool:
    """Whether a line begins with a comment mark."""
    return line.lstrip().startswith(COMMENT_MARKS)


def is_end_mark(line: str) -> bool:
    """Whether a line ends the data, such as ``*** End of data``, ``/& -----`` or a blank one."""
    return not is_comment(line) and bool(_END_MARK.fullmatch(line.strip()))


def is_number(text: str) -> bool:
    """Whether a piece of text is a number, also one that is not finite."""
    return bool(NUMBER.fullmatch(text) or _NOT_FINITE.fullmatch(text))


def to_float(token: str, path: Path, line: int) -> float:
    """Convert a piece of text to a number; it may overflow to infinity.

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
    remedy = "correct it, or begin the line with % if it is a comment"
    if _DECIMAL_COMMA.fullmatch(token):
        remedy = "write decimal points, not commas"
    raise InputError(f'{path}: line {line}: "{shown}" is no number; {remedy}')


def decimals(text: str) -> int:
    """Count the decimals of a number as it is written; with an exponent, as if without."""
    mantissa, _, exponent = text.upper().replace("D", "E").partition("E")
    return len(mantissa.partition(".")[2]) - int(exponent or 0)


def pieces(line: str, width: int = 0) -> list[str]:
    """Cut a line of numbers: each has ``width`` characters, or blanks or signs separate them."""
    if width:
        text = line.rstrip()
        return [text[at : at + width].strip() for at in range(0, len(text), width)]
    return [piece for token in line.split() for piece in _RUN_TOGETHER.split(token)]


def header_numbers(
    path: Path, lines: Sequence[str], start: int, end: int, width: int
) -> list[float]:
    """Read the numbers of a header with a fixed width for each number.

    Raises
    ------
    InputError
        If one is no finite number; names the line.
    """
    numbers = []
    for number, line in enumerate(lines[start:end], start=start + 1):
        numbers += [to_float(piece, path, number) for piece in pieces(line, width)]
        if not np.isfinite(numbers).all():
            raise InputError(f"{path}: line {number}: a number is not finite; correct it")
    return numbers


def read_values(
    path: Path, lines: Sequence[str], start: int, count: int, width: int = 0, said: int = 0
) -> tuple[list[float], list[int]]:
    """Read the values of one motion, which follow row by row; the last row may be shorter.

    What follows the last of ``count`` values is no value, but must not be a number.

    Parameters
    ----------
    start : int
        Index of the first line.
    count : int
        Number of values that the header states.
    width : int
        Characters of each value; 0: blanks or signs separate them.
    said : int
        Number of the line that states the count; 0: the one above the values.

    Returns
    -------
    values, places : list
        Values, and the numbers of their lines.

    Raises
    ------
    InputError
        If a value is no number, or if there are more or less of them; names the line.
    """
    values, places = list[float](), list[int]()
    for number, line in enumerate(lines[start:], start=start + 1):
        cut = pieces(line, width)
        if len(values) >= count and not all(map(is_number, cut)):
            break
        if is_end_mark(line) and line.strip():
            break
        for piece in cut:
            if len(values) >= count and not is_number(piece):
                break
            values.append(to_float(piece, path, number))
            places.append(number)
    if len(values) != count or not values:
        what = "the file is truncated" if len(values) < count else "too many"
        other = f"{len(values)} values follow: {what}; fetch the record again, or correct that line"
        raise InputError(f"{path}: line {said or start} says {count} values, but {other}")
    return values, places
