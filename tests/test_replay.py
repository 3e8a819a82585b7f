"""A test that was recorded over DDS, computed once more."""

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
    done = seft("replay", "bag", status=0)
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
