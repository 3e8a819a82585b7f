"""The `seft` command in this process."""

import contextlib
import io
import sys
from unittest import mock


def run_seft(folder, *words):
    """Run the command line in a folder; (status, stdout, stderr)."""
    from seft_ros.cli.main import main  # most tests do without all that commands need

    out, errors = io.StringIO(), io.StringIO()
    with (
        mock.patch.object(sys, "argv", ["seft", *map(str, words)]),
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(errors),
    ):
        status = main()
    return status, out.getvalue(), errors.getvalue()
