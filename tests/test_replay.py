"""A recorded test fed to a node over DDS."""

import json
import signal

import pytest
from graph_tools import DEMO, JHU, PATIENCE, STALLS_ALLOWED, wait_for

SHORT = ("-p", "ground_motion:synthetic.duration:=2.0", "-p", "ground_motion:tail:=0.2")


def test_every_node_answers_a_recorded_test_bit_for_bit(seft_json):
    """The recommended compensation, which looks ahead and identifies on line."""
    words = ("-p", "rig:pace:=lockstep", *STALLS_ALLOWED)
    seft_json("run", DEMO, *SHORT, *words, "--out", "bag")
    result = seft_json("replay", "bag")
    assert result["identical"] is True
    for one, node in zip(
        result["replays"], ("reference_force", "force_controller", "rig"), strict=True
    ):
        assert (one["node"], one["answered"], one["notes"]) == (node, one["steps"], [])
    assert result["replays"][0]["estimates"]["max_abs"] == 0.0


def test_of_a_simulated_test_who_needs_the_coming_motion_is_left_out(seft, seft_json):
    seft_json("simulate", DEMO, *SHORT, "--out", "bag")
    done = seft("replay", "bag", "--offline", status=0)
    assert "force_controller is left out: force_controller needs the future motion" in done.stderr
    assert "rig: 601 answers identical" in done.stdout.replace("rig/state", "")


@pytest.mark.parametrize("config", [JHU, DEMO])
def test_a_stopped_test_is_replayed_ramp_and_all(seft_json, start, tmp_path, config):
    words = ("-p", "rig:pace:=lockstep", "-p", "ground_motion:synthetic.duration:=60.0")
    process = start("seft_ros.cli.main", "run", config, *words, *STALLS_ALLOWED, "--out", "bag")

    def is_under_way():
        assert process.poll() is None, process.communicate()
        return sum(file.stat().st_size for file in (tmp_path / "bag").glob("*.*")) > 500_000

    wait_for(is_under_way, "some data in the bag")
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=PATIENCE)
    result = seft_json("replay", "bag", "--node", "reference_force")
    assert result["identical"] is True
    assert [note for note in result["notes"] if "ramp" in note] == []


def test_a_change_is_seen_at_its_first_step(seft_json, seft):
    simulated = seft_json("simulate", JHU, *SHORT, "--out", "bag")
    words = ("--node", "reference_force", "-p", "reference_force:mass_ratio:=0.5")
    result = seft_json("replay", "bag", *words, "--out", "changed", status=1)
    first = result["first_difference"]
    assert result["answered"] == simulated["steps"]
    assert (first["topic"], first["field"]) == ("reference_force", "effort")
    compared = json.loads(seft("compare", "bag", "changed", "--json", status=1).stdout)
    assert compared["first_difference"]["step"] == first["step"]
    assert compared["first_difference"]["b"] == first["replayed"]


def test_a_node_that_runs_already_is_in_the_way(seft, seft_json, start_node, observer):
    seft_json("simulate", JHU, *SHORT, "--out", "bag")
    start_node("rig")
    wait_for(lambda: (observer.spin(0.05), observer.present() == ["rig"])[1], "the rig")
    done = seft("replay", "bag", "--node", "rig", status=2)
    assert "already has a node rig: of another test" in done.stderr.splitlines()[-1]
