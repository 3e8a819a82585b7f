"""What is printed gives a terminal no commands, and its loss ends no program."""

import subprocess
import sys
from pathlib import Path

import pytest
from seft_msgs_py.errors import InputError
from seft_msgs_py.printing import escaped

MANY = """
import sys
from seft_msgs_py.printing import unbroken

def main():
    for _ in range(50_000):
        print("a line")
    print("a message", file=sys.stderr)
    return {status}

sys.exit(unbroken("many", main))
"""


def test_control_characters_are_escaped_and_lines_and_letters_stay():
    shown = "täglich\n\\x1b[31mred\\x07 \\u202e\\udcff"
    assert escaped("täglich\n\x1b[31mred\x07 \u202e\udcff") == shown
    assert str(InputError("a\nb\x1b]0;title")) == "a b\\x1b]0;title"


@pytest.mark.parametrize("status", [0, 2])
def test_a_full_device_is_reported_when_the_program_has_ended(status):
    with Path("/dev/full").open("w") as full:
        words = [sys.executable, "-c", MANY.format(status=status)]
        done = subprocess.run(words, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.stderr == "a message\nmany: stdout can't be written (No space left on device)\n"
    assert done.returncode == (status or 1)


def test_a_reader_that_leaves_is_reported_and_a_full_stderr_is_no_fault():
    words = [sys.executable, "-c", MANY.format(status=0)]
    pipe = subprocess.PIPE
    with subprocess.Popen(words, stdout=pipe, stderr=pipe, text=True) as child:
        assert child.stdout.readline() == "a line\n"
        child.stdout.close()
        assert child.stderr.read() == "a message\nmany: stdout can't be written (Broken pipe)\n"
    assert child.returncode == 1
    with Path("/dev/full").open("w") as full:
        assert subprocess.run(words, stdout=subprocess.DEVNULL, stderr=full).returncode == 0


OWN_FILE = """
import os, sys
from seft_msgs_py.printing import unbroken

def main():
    with open("own", "w"):
        sys.stdout.write("a line")
        sys.stderr.write("a line")
        os.write(2, b"what a library says")
    return 0

sys.exit(unbroken("own", main))
"""


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_what_is_printed_to_a_closed_stream_comes_into_no_file(tmp_path, closed):
    words = ["sh", "-c", f'exec "$0" "$@" {closed}', sys.executable, "-c", OWN_FILE]
    lost = closed != "2>&-"  # what is printed to stdout
    assert subprocess.run(words, cwd=tmp_path, capture_output=True).returncode == lost
    assert (tmp_path / "own").read_text() == ""
