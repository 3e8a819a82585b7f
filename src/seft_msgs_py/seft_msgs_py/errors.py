"""Errors that a user sees."""

from seft_msgs_py.printing import escaped


class SeftError(Exception):
    """Base of the errors that are printed in one line.

    The text says what is wrong, where, and how to correct it.
    """

    exit_status = 1

    def __str__(self) -> str:
        # a file or an option may contain several lines
        return escaped(" ".join(super().__str__().splitlines()))


class InputError(SeftError):
    """An input (file, parameter, message, option) can't be used; exit status 2."""

    exit_status = 2


class ExperimentError(SeftError):
    """A running test could not continue; exit status 1."""


class WireError(InputError):
    """Bytes received on a topic, or values to send on it, break its contract."""
