"""The loop is rehearsed before anything moves, and the test that follows has the usual bits."""

import json
import subprocess
import sys

import numpy as np
import pytest
from graph_tools import JHU, PATIENCE, wait_for
from seft_ros.bags.record_bag import read_bag

SEFT = (sys.executable, "-m", "seft_ros.cli.main")
SHORT = ("-p", "ground_motion:synthetic.duration:=2.0", "-p", "ground_motion:tail:=0.2")


def seft(*words):
    words = [*SEFT, *map(str, words)]
    return subprocess.run(words, capture_output=True, text=True, timeout=PATIENCE, check=False)


@pytest.mark.alone
def test_a_test_after_a_rehearsal_has_the_bits_of_simulate_and_its_bag_the_figures(tmp_path):
    simulated, real = tmp_path / "simulated", tmp_path / "real"
    done = seft("simulate", JHU, *SHORT, "--out", simulated, "--no-figure", "--json")
    assert done.returncode == 0, done.stderr
    one, other = read_bag(simulated), None
    for _ in range(3):  # the machine may stall
        done = seft("run", JHU, *SHORT, "--out", real, "--no-figure", "--json")
        assert done.returncode in (0, 1), done.stderr
        other = read_bag(real)
        if not other.missed:
            break
        real = tmp_path / f"{real.name}_again"
    found = other.facts["rig"]["rehearsal"]
    assert (found["rate_hz"], found["steps"]) == (500.0, 750)
    assert 0 < found["round_trip_s"]["p50"] < 0.02
    assert json.loads(done.stdout)["timing"]["rehearsal"] == found
    last = min([*other.missed_steps, other.series["rig/state"].steps[-1]])
    for name in ("rig/state", "reference_force", "valve_command"):
        both = one.series[name].values, other.series[name].values
        assert np.array_equal(*(values[:last] for values in both)), name
    assert last > 50


def test_a_rate_that_can_not_be_kept_is_refused_before_anything_moves(tmp_path):
    words = ("-p", "rate:=8000.0", "--accept-unstable", "--out", tmp_path / "bag")
    done = seft("run", JHU, *SHORT, *words)
    assert done.returncode == 1
    (told,) = [line for line in done.stderr.splitlines() if "does not fit here" in line]
    assert "8000 Hz does not fit here: " in told and "--composed" in told
    assert not (tmp_path / "bag").exists()


def test_no_rehearsal_is_made_in_lockstep_or_where_none_is_asked_for(tmp_path):
    for number, word in enumerate(("rig:pace:=lockstep", "supervisor:rehearsal.duration:=0.0")):
        bag = tmp_path / str(number)
        done = seft("run", JHU, *SHORT, "-p", word, "--out", bag, "--no-figure", "--json")
        assert done.returncode in (0, 1), done.stderr
        assert "rehearsal" not in read_bag(bag).facts["rig"]


def test_nodes_that_did_not_keep_their_rate_rehearse_once_more_when_reset(start_node, domain):
    words = (
        "rate:=8000.0",
        "supervisor:rehearsal.duration:=2.0",
        "supervisor:peers:=[ground_motion, reference_force, force_controller, rig]",
    )
    for node in ("ground_motion", "reference_force", "force_controller", "rig", "supervisor"):
        start_node(node, *words)

    def detail():
        return seft("status").stdout

    wait_for(lambda: "does not fit here" in detail(), "a refusal")
    first = detail()
    assert seft("reset").returncode == 0
    wait_for(
        lambda: "does not fit here" in (other := detail()) and other != first,
        "another refusal, of other times",
    )
    assert seft("reset").returncode == 0
