"""Parts that other packages register with this project, as entry points.

A package does so in its setup.py:

    entry_points={"seft.compensation": ["ours = their_package.module:function"]}
"""

import inspect
import json
import os
import shlex
import sys
import traceback
from collections.abc import Sequence
from functools import cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from seft_msgs_py.config.parameter_table import Parameter
from seft_msgs_py.errors import InputError
from seft_msgs_py.printing import escaped


class Registered:
    """Parts that other packages provide for one group of entry points, by name.

    Their code is imported only when a part is made, so that its errors only affect tests that use
    it. Our own names can't be registered again.

    Attributes
    ----------
    own : tuple of str
        Our own choices.
    names : tuple of str
        All choices: ours first.
    """

    def __init__(self, group: str, own: Sequence[str]) -> None:
        found = {entry.name: entry for entry in _installed(tuple(sys.path)).select(group=group)}
        self._entries = {name: found[name] for name in sorted(found) if name not in own}
        self.own = tuple(own)
        self.names = (*own, *self._entries)

    def __contains__(self, name: object) -> bool:
        """Whether another package has registered it."""
        return name in self._entries

    def make(self, name: str, settings: str, where: str, *known: Any) -> Any:
        """Make a part from known arguments and its own settings.

        A name with a colon names a file or module and an object in it, e.g. ``frame.py:Frame``.
        Settings are ``name=value`` pairs separated by blanks; a value is JSON, otherwise a text.
        ``where`` is the parameter that names the part, as ``node: parameter``.

        Raises
        ------
        InputError
            If it can't be loaded, or does not take the settings.
        """
        if ":" not in name and name not in self:
            registered = ", ".join(self.names) or "none"
            raise InputError(
                f"{where} is {name!r}, but must be FILE.py:CLASS, MODULE:CLASS, or what a package "
                f"has registered: {registered}"
            )
        entry = self._entries.get(name) or EntryPoint(name, name, "")
        factory = _of_file(name, where) if ".py:" in name else _load(entry, where)
        options = _settings(settings, where)
        try:
            inspect.signature(factory).bind(*known, **options)
        except TypeError as error:
            why = f"its settings do not fit {entry.value}: {error}"
            raise InputError(f"{where} is {name}, but {why}") from None
        return factory(*known, **options)

    def row(self, name: str, default: str, description: str) -> Parameter:
        """Give the row of a parameter table that names the part."""
        others = tuple(self._entries)
        return Parameter(name, "string", default, description, choices=self.own, registered=others)

    def settings_row(self, name: str, what: str) -> Parameter:
        """Give the row of the settings in a parameter table."""
        registered = "that another package has registered, e.g. gain=2.0 poles=[1,2.5]"
        return Parameter(name, "string", "", f"settings of {what} {registered}")


@cache
def _installed(path: tuple[str, ...]) -> EntryPoints:
    """All entry points on Python's path; reading them takes about 30 ms."""
    del path
    return entry_points()


def _of_file(name: str, where: str) -> Any:
    """Give an object that a file defines, ``FILE.py:NAME``; a process runs the file once."""
    text, _, part = name.rpartition(":")
    file = Path(os.path.realpath(text))
    if not file.is_file():
        raise InputError(f"{where} is {name}, but there is no file {text}")
    module = _run(file, file.stat().st_mtime_ns, where)
    if not hasattr(module, part):
        raise InputError(f"{where} is {name}, but {text} has no {part}")
    return getattr(module, part)


@cache
def _run(file: Path, version: int, where: str) -> ModuleType:
    """Import a file by its path; as of a program, its neighbours can be imported."""
    if str(file.parent) not in sys.path:
        sys.path.append(str(file.parent))
    name = f"seft_file_{file.stem}_{abs(hash((file, version)))}"
    spec = spec_from_file_location(name, file)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        place = f"{file.name}{line_in(error, str(file))}"
        raise InputError(f"{where}: {place}: {reason_of(error)}") from None
    return module


LONGEST_TEXT = 500
"""Characters of a text of another package that are shown."""


def printable(text: str) -> str:
    """Make one line of a text of another package that no terminal takes as a command."""
    line = " ".join(text.split())
    return escaped(line if len(line) <= LONGEST_TEXT else f"{line[:LONGEST_TEXT]}...")


def reason_of(error: BaseException) -> str:
    """Text of an exception in one line; its kind if the text is empty, or it is none of errors."""
    try:
        text = printable(str(error) if isinstance(error, Exception) else repr(error))
    except Exception:  # of its own methods
        text = ""
    return text or type(error).__name__


def line_in(error: BaseException, file: str | None) -> str:
    """Name the last line of a file in an exception's traceback, as `` line 7``; empty if none."""
    passed = [f for f in traceback.extract_tb(error.__traceback__) if f.filename == file]
    if isinstance(error, SyntaxError) and error.filename == file:
        return f" line {error.lineno}"
    return f" line {passed[-1].lineno}" if passed else ""


def _load(entry: EntryPoint, where: str) -> Any:
    try:
        return entry.load()
    except Exception as error:
        package = entry.dist.name if entry.dist is not None else entry.value.partition(":")[0]
        other = f"package {package} has no {entry.value} that can be loaded: {reason_of(error)}"
        raise InputError(f"{where} is {entry.name}, but {other}") from None


def _settings(text: str, where: str) -> dict[str, Any]:
    """Read ``name=value`` pairs; a value is JSON, otherwise a text."""
    found: dict[str, Any] = {}
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise InputError(f"{where}: settings {text!r}: {error}") from None
    for word in words:
        name, equals, value = word.partition("=")
        if not equals:
            raise InputError(
                f"{where}: settings {text!r}: {word!r} is not of the form name=value; pairs are "
                "separated by blanks"
            )
        try:
            found[name] = json.loads(value)
        except ValueError:
            found[name] = value
    return found
