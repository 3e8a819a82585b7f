import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

JHU = str(Path(__file__).parents[3] / "config" / "jhu.yaml")
SHORT = ("-p", "ground_motion:synthetic.duration:=4", "-p", "ground_motion:tail:=0.5")
SEFT = (sys.executable, "-m", "seft_ros.cli.main")


def start(folder, *words):
    """Start a command in a folder of its own, its output in files there."""
    folder.mkdir(exist_ok=True)
    with (folder / "out").open("w") as out, (folder / "err").open("w") as err:
        return subprocess.Popen(
            [*SEFT, "uncertainty", JHU, *SHORT, *words, "--json"],
            cwd=folder,
            stdout=out,
            stderr=err,
        )


def numbers(folder, *words):
    assert start(folder, *words).wait(timeout=300) == 0, (folder / "err").read_text()
    return json.loads((folder / "out").read_text())


def test_the_page_and_the_numbers(seft, tmp_path):
    status, out, _ = seft(
        "uncertainty", JHU, *SHORT, "--tests", "12", "--workers", "1", "--out", "page"
    )
    assert status == 0
    for told in ("12 tests, spread 10 %", "its deviation", "specimen.mass", "95 % of the tests"):
        assert told in out
    page = (tmp_path / "page.html").read_text()
    for told in ("What the error depends on", "The worst tests", "Uncertainty of jhu.yaml"):
        assert told in page
    assert list(tmp_path.glob("*.jsonl")) == []


def test_the_configured_test_is_that_of_simulate(seft):
    words = ("--tests", "2", "--workers", "1", "--json")
    status, out, _ = seft("uncertainty", JHU, *SHORT, *words)
    assert status == 0
    configured = json.loads(out)["configured"]
    _, out, _ = seft("simulate", JHU, *SHORT, "--json")
    alone = json.loads(out)
    for name in ("displacement", "acceleration", "force", "stable", "trip", "steps"):
        assert configured[name] == alone[name]


def test_a_command_that_is_killed_goes_on_where_it_was(tmp_path):
    words = ("--tests", "60")
    whole = numbers(tmp_path / "whole", *words)
    killed = start(tmp_path / "killed", *words, "--workers", "1")
    while not (kept := list((tmp_path / "killed").glob("uncertainty-*.jsonl"))):
        assert killed.poll() is None, (tmp_path / "killed" / "err").read_text()
        time.sleep(0.005)
    killed.kill()
    killed.wait()
    assert kept[0].exists()
    again = numbers(tmp_path / "killed", *words)
    assert again == whole
    assert not kept[0].exists()


def test_an_interruption_says_how_it_goes_on(tmp_path):
    command = start(tmp_path, "--tests", "5000")
    while not list(tmp_path.glob("uncertainty-*.jsonl")):
        assert command.poll() is None, (tmp_path / "err").read_text()
        time.sleep(0.01)
    command.send_signal(signal.SIGINT)
    assert command.wait(timeout=60) == 1
    assert (
        (tmp_path / "err")
        .read_text()
        .endswith("seft: interrupted; no result yet; the same command in this folder continues\n")
    )


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--tests", "1"], "--tests"),
        (["--motion", "none.AT2"], "none.AT2"),
        (["--out", "none/page.html"], "no folder none"),
        (["--spread", "2"], "--spread"),
        (["-p", "rig:specimen.mass:=0"], "specimen.mass is 0.0"),
        (["--scheduler", "tcp://127.0.0.1:9"], "no Dask scheduler answers there"),
        (["--scheduler", "cluster"], "--scheduler cluster"),
    ],
)
def test_wrong_input_is_told_in_one_line(seft, tmp_path, words, told):
    if "--scheduler" in words:
        pytest.importorskip("distributed")
    status, out, err = seft("uncertainty", JHU, *SHORT, *words)
    assert (status, out) == (2, "")
    assert told in err.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []


def test_without_dask_a_scheduler_is_refused_with_the_way_to_install_it(seft, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    status, _, err = seft("uncertainty", JHU, "--scheduler", "tcp://127.0.0.1:8786")
    assert status == 2
    assert "pip install 'seft_ros[dask]'" in err
    assert os.linesep.join(err.splitlines()[-1:]).startswith("seft: --scheduler")
