"""The two ways in which something a user asked for can fail."""


class SeftError(Exception):
    """Base of the errors that are told to a user in one line.

    The text says what is wrong, where, and how to mend it.
    """

    exit_status = 1

    def __str__(self) -> str:
        return " ".join(super().__str__().splitlines())  # whatever a file or an option held


class InputError(SeftError):
    """What was given (file, parameter, message, option) can't be used; exit status 2."""

    exit_status = 2


class ExperimentError(SeftError):
    """A test that was under way could not go on; exit status 1."""


class WireError(InputError):
    """Bytes received on a topic, or values to be sent on it, do not fit its contract."""
