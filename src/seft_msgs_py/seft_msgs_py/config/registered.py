"""Parts that other packages register with this project, as entry points.

A package does so in its setup.py:

    entry_points={"seft.compensation": ["ours = their_package.module:function"]}
"""

import inspect
import json
import shlex
import sys
from collections.abc import Sequence
from functools import cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from typing import Any

from seft_msgs_py.config.parameter_table import Parameter
from seft_msgs_py.errors import InputError


class Registered:
    """Parts that other packages provide for one group of entry points, by name.

    Their code is imported only when a part is made, so that their errors break no test that does
    not use it. Our own names can't be registered again.

    Attributes
    ----------
    names : tuple of str
        All choices: ours first.
    """

    def __init__(self, group: str, own: Sequence[str]) -> None:
        found = {entry.name: entry for entry in _installed(tuple(sys.path)).select(group=group)}
        self._entries = {name: found[name] for name in sorted(found) if name not in own}
        self.names = (*own, *self._entries)

    def __contains__(self, name: object) -> bool:
        """Whether another package has registered it."""
        return name in self._entries

    def make(self, name: str, settings: str, where: str, *known: Any) -> Any:
        """Make a part from known arguments and its own settings.

        Settings are ``name=value`` pairs separated by blanks; a value is JSON, or else a text.
        ``where`` is the parameter that names the part, as ``node: parameter``.

        Raises
        ------
        InputError
            If it can't be loaded, or does not take the settings.
        """
        entry = self._entries[name]
        factory = _load(entry, where)
        options = _settings(settings, where)
        try:
            inspect.signature(factory).bind(*known, **options)
        except TypeError as error:
            raise InputError(
                f"{where} is {name}, but its settings do not fit {entry.value}: {error}"
            ) from None
        return factory(*known, **options)

    def settings_row(self, name: str, what: str) -> Parameter:
        """Give the row of the settings in a parameter table."""
        return Parameter(
            name,
            "string",
            "",
            f"settings of {what} that another package has registered, as gain=2.0 poles=[1,2.5]",
        )


@cache
def _installed(path: tuple[str, ...]) -> EntryPoints:
    """All entry points on Python's path; to read them takes some 30 ms."""
    del path
    return entry_points()


def _load(entry: EntryPoint, where: str) -> Any:
    try:
        return entry.load()
    except Exception as error:
        package = entry.dist.name if entry.dist is not None else entry.module
        raise InputError(
            f"{where} is {entry.name}, but package {package} has no {entry.value} that can be "
            f"loaded: {error}"
        ) from None


def _settings(text: str, where: str) -> dict[str, Any]:
    """Read ``name=value`` pairs; a value is JSON, or else a text."""
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
