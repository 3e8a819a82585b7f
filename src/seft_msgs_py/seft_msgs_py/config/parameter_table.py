"""Parameter tables: one row a parameter, with type, unit, default, bounds, text; their arrays.

A node declares its ROS parameters from its table, the `seft` command checks experiments
with it, and `seft parameters` prints it.
"""

import ast
import difflib
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from seft_msgs_py.arrays import Floats
from seft_msgs_py.errors import InputError


def per_axis(value: float | Sequence[float], axes: Sequence[str], where: str) -> Floats:
    """One value for each of the n axes, shape (n,); a single number is for all.

    Raises
    ------
    InputError
        If there are neither 1 nor n values; ``where`` names the parameter.
    """
    array = np.array(value, dtype=np.float64, ndmin=1)
    if array.size not in (1, len(axes)):
        raise InputError(
            f"{where}: {array.size} values for {len(axes)} axes [{', '.join(axes)}]; "
            "give one, or one for each axis"
        )
    return array if array.size == len(axes) else np.full(len(axes), array)


def as_matrix(value: float | Sequence[float], axes: Sequence[str], where: str) -> Floats:
    """Matrix over n axes, shape (n, n): a number or n numbers are its diagonal.

    n * n numbers are its rows, in order.

    Raises
    ------
    InputError
        If there are neither 1, n nor n * n values.
    """
    count = len(axes)
    array = np.array(value, dtype=np.float64, ndmin=1)
    if array.size == count * count:
        return array.reshape(count, count)
    if array.size in (1, count):
        return np.diag(np.broadcast_to(array, count))
    mend = f"give 1, {count} (a diagonal) or {count * count} (a matrix, row by row)"
    raise InputError(f"{where}: {array.size} values for {count} axes [{', '.join(axes)}]; {mend}")


def mass_matrix(value: float | Sequence[float], axes: Sequence[str], where: str) -> Floats:
    """Mass matrix over n axes, shape (n, n); InputError if not symmetric positive definite."""
    matrix = symmetric_matrix(value, axes, where)
    if np.linalg.eigvalsh(matrix)[0] <= 0:
        raise InputError(f"{where} is {value}, but mass must be positive (definite) on every axis")
    return matrix


def symmetric_matrix(value: float | Sequence[float], axes: Sequence[str], where: str) -> Floats:
    """Matrix over n axes, shape (n, n), see `as_matrix`; InputError if it is not symmetric."""
    matrix = as_matrix(value, axes, where)
    if not (np.abs(matrix - matrix.T) <= 1e-9 * np.abs(matrix.T)).all():
        raise InputError(f"{where}: the matrix {matrix.tolist()} is not symmetric")
    return matrix


_LARGEST = 1e30
"""In SI units nothing of a rig is larger, or smaller than its inverse; squares do not overflow."""
LONGEST_NAME = 200  # bytes; of the 255 that a file's name may have, the others are for endings
Kind = Literal["float", "int", "bool", "string", "floats", "ints", "strings", "texts"]
Value = Any
Section = dict[str, Value]

_WORDS: dict[str, str] = {
    "float": "a number",
    "int": "a whole number",
    "bool": "true or false",
    "string": "text",
    "floats": "a number, or a list of numbers",
    "ints": "a whole number, or a list of them",
    "strings": "a list of texts",
    "texts": "text, or a list of texts",
}


@dataclass(frozen=True)
class Parameter:
    """One row of a node's parameter table.

    Attributes
    ----------
    name : str
        Name within the node, dots included.
    kind : str
        ``float``, ``int``, ``bool``, ``string``, or a list of one of these: ``floats``, ``ints``
        and ``texts`` also take a single value, which is for every axis; ``strings`` do not.
    default : value or None
        None: the parameter must be given.
    description : str
        Its meaning, for ``ros2 param describe`` and ``seft parameters``.
    unit : str
        SI unit; empty if it has none.
    minimum, maximum : float or None
        Bounds, inclusive; ``minimum`` is exclusive if ``positive`` is set.
    positive : bool
        The value must be greater than zero.
    choices : tuple of str
        Allowed texts; empty: any.
    registered : tuple of str or None
        Texts that other installed packages add to ``choices``; None: no package can.
    file_name : bool
        The text must be a valid name of a file or folder, without a path; it may be empty.
    live : bool
        The parameter may be set while the node runs, and takes effect at its next use.
    """

    name: str
    kind: Kind
    default: Value
    description: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    positive: bool = False
    choices: tuple[str, ...] = ()
    registered: tuple[str, ...] | None = None
    file_name: bool = False
    live: bool = False

    @property
    def allowed(self) -> tuple[str, ...]:
        """All allowed texts, ours first; empty: any."""
        return (*self.choices, *(self.registered or ()))

    def check(self, value: Value, where: str) -> Value:
        """Return the value in this parameter's type; InputError with ``where`` if it is invalid."""
        scalar = "string" if self.kind == "texts" else self.kind.removesuffix("s")
        if scalar != self.kind and isinstance(value, list | tuple):
            if not value:
                raise self._error(where, value, "must not be empty")
            return [self._check_one(item, scalar, where) for item in value]
        if self.kind == "strings":
            raise self._error(where, value, f"must be {_WORDS[self.kind]}")
        return self._check_one(value, scalar, where)

    def _check_one(self, value: Value, kind: str, where: str) -> Value:
        if rule := self._broken_rule(value, kind):
            raise self._error(where, value, rule)
        return float(value) if kind == "float" else value

    def _broken_rule(self, value: Value, kind: str) -> str:
        """Rule that a value breaks; empty if none."""
        number = isinstance(value, int | float) and not isinstance(value, bool)
        fits = {
            "float": number,
            "int": number and isinstance(value, int) and -(2**63) <= value < 2**63,
            "bool": isinstance(value, bool),
            "string": isinstance(value, str),
        }[kind]
        unit = f" {self.unit}" if self.unit else ""
        if not fits:
            return f"must be {_WORDS[self.kind]}"
        if self.positive and value <= 0:
            return "must be greater than zero"
        if self.minimum is not None and value < self.minimum:
            return f"must be at least {self.minimum:g}{unit}"
        if self.maximum is not None and value > self.maximum:
            return f"must be at most {self.maximum:g}{unit}"
        if kind == "float" and value and not 1 / _LARGEST <= abs(value) <= _LARGEST:
            return f"must be 0, or {1 / _LARGEST:g} to {_LARGEST:g} in size"
        if self.kind in ("string", "texts") and (rule := _refusal(value, self.file_name)):
            return rule
        if self.allowed and value not in self.allowed:
            allowed = ", ".join(choice or '""' for choice in self.allowed)
            return f"must be one of {allowed}{nearest(value, self.allowed)}"
        return ""

    def _error(self, where: str, value: Value, rule: str) -> InputError:
        return InputError(f"{where}: {self.name} is {_shown(value)}, but {rule}")


def _refusal(text: str, file_name: bool) -> str:
    """Rule that a text breaks; empty if none."""
    if "\0" in text:
        return "must hold no NUL character"
    if not file_name or not text:
        return ""
    if "/" in text or text in (".", ".."):
        return "must be a name alone, without a path"
    if text.startswith("-") or not text.isprintable() or text != text.strip():
        return "must not begin with -, begin or end with a blank, nor hold control characters"
    if len(text.encode()) > LONGEST_NAME:
        return f"must be at most {LONGEST_NAME} bytes long"
    return ""


def _shown(value: Value) -> str:
    """Write a value as in a parameter file, in one line; a long text is cut."""
    if isinstance(value, list | tuple):
        items = ("[...]" if isinstance(item, list | tuple) else _shown(item) for item in value)
        return f"[{', '.join(items)}]"
    if value is None or isinstance(value, bool):
        return {None: "empty", True: "true", False: "false"}[value]
    if not isinstance(value, str):
        return str(value)
    text = value if value.isprintable() else repr(value)[1:-1]
    return f'"{text[:100]}..."' if len(text) > 103 else f'"{text}"'


def parameter_rows(text: str, group: str = "") -> tuple[Parameter, ...]:
    """Read rows of a parameter table: name | kind | default | unit | allowed | description.

    An indented line continues the row above. The default is empty if the parameter must be given.
    Allowed is empty, ``> 0``, ``> 0 .. MAXIMUM``, ``MINIMUM ..``, ``MINIMUM .. MAXIMUM``,
    ``a file's name``, or a list of texts, ``""`` for the empty one. Names are put into a group:
    with ``specimen``, ``mass`` becomes ``specimen.mass``.
    """
    prefix = f"{group}." if group else ""
    lines: list[str] = []
    for line in textwrap.dedent(text).strip().splitlines():
        if line.startswith(" "):
            lines[-1] += " " + line.strip()
        else:
            lines.append(line)
    return tuple(_row(prefix, *(cell.strip() for cell in line.split("|", 5))) for line in lines)


def _row(
    prefix: str, name: str, kind: Any, default: str, unit: str, allowed: str, description: str
) -> Parameter:
    value: Value = default
    if kind != "string":
        words = {"": None, "true": True, "false": False}
        value = words[value] if value in words else ast.literal_eval(value)
    row = Parameter(prefix + name, kind, value, description, unit)
    if allowed.startswith("> 0"):
        row, allowed = replace(row, positive=True), allowed.removeprefix("> 0")
    if allowed == "a file's name":
        return replace(row, file_name=True)
    if ".." not in allowed:
        listed = allowed.replace(",", " ").split()
        return replace(row, choices=tuple("" if word == '""' else word for word in listed))
    minimum, maximum = (float(end) if end.strip() else None for end in allowed.split(".."))
    return replace(row, minimum=minimum, maximum=maximum)


class Table:
    """The parameters of one node: the facts that it uses, and its own settings."""

    def __init__(self, node: str, rows: Iterable[Parameter]) -> None:
        self.node = node
        self.rows: dict[str, Parameter] = {row.name: row for row in rows}

    def check(self, given: Mapping[str, Value], where: str = "") -> Section:
        """Check the values that are given; defaults are not filled in.

        Raises
        ------
        InputError
            If a name is unknown (the text gives the nearest known one), or a value is invalid.
        """
        where = where or self.node
        checked: Section = {}
        for name, value in given.items():
            row = self.rows.get(name)
            if row is None:
                raise InputError(f"{where}: there is no parameter {name}{nearest(name, self.rows)}")
            checked[name] = row.check(value, where)
        return checked


def nearest(name: str, known: Iterable[str]) -> str:
    """Give a hint with the known text nearest to a mistyped one; empty if none is near."""
    known = [text for text in known if text]
    same = [text for text in known if text.replace(".", "_") == name.replace(".", "_")]
    last = same or [text for text in known if text.split(".")[-1] == name.split(".")[-1]]
    close = difflib.get_close_matches(name, last or known, n=1, cutoff=0.5) or last[:1]
    return f"; did you mean {close[0]}?" if close else ""


def group(section: Mapping[str, Value], prefix: str) -> Section:
    """Parameters of one group, without the prefix: ``specimen.mass`` -> ``mass``."""
    dotted = prefix + "."
    return {k.removeprefix(dotted): v for k, v in section.items() if k.startswith(dotted)}
