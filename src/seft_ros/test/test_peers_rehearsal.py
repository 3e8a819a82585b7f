import pytest
from seft_ros.test_run.peers import Rehearsed, judge_peers

ABLE = {"rehearses": True}


def loop(rig=ABLE):
    return {"rig": rig, "reference_force": ABLE, "force_controller": ABLE, "ground_motion": {}}


def rig(missed=0, p99=0.0005, rate=1000.0, steps=1500):
    found = {"rate_hz": rate, "steps": steps, "missed": missed, "overruns": 0}
    return loop(ABLE | {"rehearsal": {**found, "round_trip_s": {"p99": p99} if p99 else {}}})


def test_a_rig_that_can_is_asked_until_it_has_told():
    assert judge_peers(2.0, loop()) == Rehearsed(asked=2.0)
    assert judge_peers(2.0, rig()) == Rehearsed()


def test_nobody_is_asked_where_there_is_no_rehearsal():
    assert judge_peers(0.0, loop()) == Rehearsed()
    assert (
        judge_peers(2.0, {"west/rig": ABLE, "east/rig": ABLE, "reference_force": ABLE})
        == Rehearsed()
    )
    for node in ("rig", "reference_force", "force_controller"):
        assert judge_peers(2.0, loop() | {node: {"drive": "valve_command"}}) == Rehearsed()
        assert (
            judge_peers(2.0, {name: own for name, own in loop().items() if name != node})
            == Rehearsed()
        )


def test_a_loop_that_does_not_keep_its_rate_is_refused_with_one_that_fits():
    told = judge_peers(2.0, rig(missed=900, p99=0.0016)).refusal
    assert told.startswith(
        "1000 Hz does not fit here: round trip p99 1.6 ms, 900 of 1500 steps without a command in "
        "time; 500 Hz does; "
    )
    assert "--composed" in told


def test_where_no_rate_fits_none_is_proposed():
    assert "Hz does;" not in judge_peers(2.0, rig(missed=1500, p99=0.5)).refusal


def test_a_loop_that_does_not_answer_is_refused():
    assert "no answer came" in judge_peers(2.0, rig(missed=1500, p99=None)).refusal


@pytest.mark.parametrize("missed", [2, 100, 149])
def test_a_few_missed_steps_are_warned_of(missed):
    found = judge_peers(2.0, rig(missed=missed, p99=0.0009))
    assert not found.refusal and not found.asked
    assert found.warning.startswith("1000 Hz is hard to keep here: round trip p99 0.9 ms")
    assert f"{missed} of 1500" in found.warning


@pytest.mark.parametrize("told", [{}, 3, {"steps": "x"}, {"steps": 1, "missed": 0, "rate_hz": 1.0}])
def test_a_rehearsal_that_makes_no_sense_is_refused(told):
    assert "can't be read" in judge_peers(2.0, loop(ABLE | {"rehearsal": told})).refusal
