"""A few of the rounds of `fault_rounds.py`: one each that it is hard to come out of cleanly."""

import subprocess
import sys
from pathlib import Path

import pytest
from graph_tools import PATIENCE

pytestmark = [pytest.mark.thorough, pytest.mark.wallclock]
PROGRAM = Path(__file__).with_name("fault_rounds.py")


@pytest.mark.parametrize(("first", "rounds"), [(4, 1), (13, 2), (53, 1)])
def test_random_rounds_leave_nothing_and_say_what_happened(domain, first, rounds):
    """Two Ctrl-C; SIGTERM at the record's end, then a killed run; Ctrl-C three times."""
    words = ["--seed", "1", "--first", str(first), "--rounds", str(rounds)]
    done = subprocess.run(
        [sys.executable, str(PROGRAM), *words],
        capture_output=True,
        text=True,
        timeout=rounds * PATIENCE,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert "nothing wrong" in done.stdout
