"""`seft run` over DDS gives the samples of the offline loop: processes, one process, several rigs.

All kinds of loops are compared in virtual time: test_local_drawn.py.
"""

import numpy as np
from graph_tools import BRIDGE, GENTLE, JHU, MISSES_ALLOWED, STALLS_ALLOWED, THOROUGH
from local_tools import RIGS_NODES, TARGET_MOTION, TWO_AXES
from seft_ros.bags.recording_bag import read_bag

SHORT = ("-p", "ground_motion:synthetic.duration:=5.0", "-p", "ground_motion:tail:=0.5")
LOCKSTEP = ("-p", "rig:pace:=lockstep", "-p", "rig:lockstep_timeout:=60.0", *STALLS_ALLOWED)


def test_lockstep_gives_bits_and_estimates_of_the_offline_loop(compiled, seft_json, tmp_path):
    words = [*SHORT]
    for override in (*TARGET_MOTION, *TWO_AXES):
        words += ["-p", override]
    compiled(JHU, *words)
    words = [JHU, *words]
    simulated = seft_json("simulate", *words, "--out", "simulated")
    lockstep = seft_json("run", *words, *LOCKSTEP, "--out", "lockstep")
    compared = seft_json("compare", "simulated", "lockstep")
    assert compared["identical"] is True
    for topic in ("ground_motion", "rig/state", "reference_force", "valve_command"):
        samples = compared["topics"][topic]
        assert samples["samples_a"] == samples["samples_b"] == simulated["steps"] == 1501
    for quantity in ("displacement", "acceleration", "force", "estimates"):
        assert lockstep[quantity] == simulated[quantity]
    one, other = (read_bag(tmp_path / name).estimates for name in ("simulated", "lockstep"))
    assert one.steps.tolist() == other.steps.tolist() == list(range(0, 1501, 50))
    np.testing.assert_array_equal(one.values, other.values)


def test_realtime_in_one_process_differs_from_the_first_miss_on(compiled, seft_json, tmp_path):
    compiled(JHU, *SHORT)
    words = (JHU, *SHORT, *GENTLE, *STALLS_ALLOWED, *MISSES_ALLOWED)
    seft_json("simulate", *words, "--out", "simulated")
    words = (*words, "--composed", "--priority", "10")
    realtime = seft_json("run", *words, "--out", "realtime")
    compared = seft_json("compare", "simulated", "realtime", status=None)
    assert realtime["steps"] == 1501
    recording = read_bag(tmp_path / "realtime")
    assert realtime["missed"] == compared["missed"]["b"] == len(recording.missed_steps)
    if realtime["missed"] == 0:
        assert compared["identical"] is True
    elif compared["first_difference"] is not None:
        assert compared["first_difference"]["step"] > recording.missed_steps[0]
    replayed = seft_json("replay", "realtime", "--node", "rig")
    assert replayed["identical"] is True  # with the commands that the rig says it applied
    logs = {path.name for path in (tmp_path / "realtime" / "logs").glob("r*.log")}
    assert logs == {"recorder.log", "rig_reference_force_force_controller.log"}
    for node in ("rig", "reference_force", "force_controller"):
        asked = recording.experiment[node]
        assert (asked["thread_priority"], asked["lock_memory"]) == (10, True)


@THOROUGH
def test_two_rigs_give_the_bits_of_the_offline_loop(compiled, seft_json):
    words = (*SHORT, "-p", "loop_delay:=5")
    compiled(BRIDGE, *words, nodes=RIGS_NODES)
    words = (BRIDGE, *words)
    seft_json("simulate", *words, "--out", "simulated")
    seft_json("run", *words, *LOCKSTEP, "--out", "lockstep")
    assert seft_json("compare", "simulated", "lockstep")["identical"] is True
