"""The tutorial, typed literally, says what it says that comes back."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from graph_tools import PATIENCE, ROOT

pytestmark = [pytest.mark.thorough, pytest.mark.wallclock]
TOLERANCE = 0.15  # relative, of numbers: noise and rounding differ from machine to machine
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def plain(text):
    """Text without wrapping and frames, as a reader compares it."""
    return re.sub(r"[\s│]+", " ", text).strip()


def appears(line, answer):
    """Tell whether a line is in an answer, with numbers that another machine may give as well."""
    words = re.split(r"(\d+\.?\d*)", plain(line))
    pattern = "".join(r"(\d+\.?\d*)" if i % 2 else re.escape(w) for i, w in enumerate(words))
    shown = [float(word) for word in words[1::2]]
    return any(
        np.allclose([float(number) for number in found.groups()], shown, rtol=TOLERANCE, atol=0.0)
        for found in re.finditer(pattern, answer)
    )


def typed(block):
    """Commands of a block, each with the lines that are shown of its answer."""
    first, *parts = re.split(r"^\$ ", block, flags=re.MULTILINE)
    assert not first
    return [part.rstrip("\n").split("\n") for part in parts]


def test_each_command_answers_as_the_tutorial_says(domain, tmp_path):
    for folder in ("config", "examples"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    here = os.environ | {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "COLUMNS": "120",
    }
    answered = 0
    for language, block in BLOCK.findall((ROOT / "docs" / "tutorial.md").read_text()):
        if language != "console":
            name, content = block.removeprefix("# ").split("\n", 1)
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_text(content)
            continue
        for command, *shown in typed(block):
            if command.startswith("export PYTHONPATH="):
                here["PYTHONPATH"] = command.partition("=")[2].replace("$PWD", str(tmp_path))
                continue
            done = subprocess.run(
                command,
                shell=True,
                cwd=tmp_path,
                env=here,
                capture_output=True,
                text=True,
                timeout=PATIENCE,
            )
            answer = plain(done.stdout + done.stderr)
            for line in shown:
                assert appears(line, answer), f"{command}\n{line}\n{done.stdout}{done.stderr}"
            answered += 1
    assert answered >= 14
