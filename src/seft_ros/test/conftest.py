"""What tests of commands share."""

import sys

import pytest


@pytest.fixture
def seft(monkeypatch, capsys, tmp_path):
    """Run the command line in this process and an empty folder; (status, stdout, stderr)."""
    from seft_ros.cli.main import main  # most tests do without all that commands need

    def run(*words):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", ["seft", *map(str, words)])
        status = main()
        return status, *capsys.readouterr()

    return run
