"""What tests of commands share."""

from functools import partial

import pytest
from commands_at_hand import run_seft


@pytest.fixture
def seft(monkeypatch, tmp_path):
    """Run the command line in an empty folder; (status, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    return partial(run_seft, tmp_path)
