"""`seft run`, `simulate` and `report` give a test the same verdicts: in words, page and JSON."""

import html
from dataclasses import replace
from functools import cache

import pytest
from experiments_at_hand import load, simulated
from recordings_at_hand import as_measured, without
from seft_msgs_py.wire.outcome import Trip
from seft_ros.analysis.assessment import BY_TRUTH, IN_LABORATORY
from seft_ros.bags.recording import Series
from seft_ros.bags.recording_bag import write_recording
from seft_ros.cli.shared import show_test

PLAN = (
    *("reference_force:compensation.method:=target_motion", "reference_force:mass_ratio:=1.3"),
    *("force_controller:method:=velocity_feedforward", "ground_motion:peak_force:=450.0"),
    "ground_motion:synthetic.duration:=3.0",
)
WORDS = {
    "good": "test can be trusted.",
    "doubt": "test can be trusted with reservations: ",
    "bad": "test can not be trusted: ",
}


@cache
def right():
    return simulated(load(*PLAN))


def biased(bias):
    """Record in which the displacement is off, m."""
    states = right().series["rig/state"]
    values = states.values.copy()
    values[:, 0] += bias
    return replace(right(), series=as_measured(right(), Series(states.steps, values)))


def saturated():
    return replace(right(), saturation={"force_range": {"samples": 12, "first_step": 40}})


def lost():
    return without(right(), "valve_command", [7, 8])


def tripped():
    return replace(right(), trip=Trip("force [N] beyond limit", 1500, 3.0))


RECORDINGS = {
    "right": (right, "good", ""),
    "saturated": (saturated, "doubt", "saturated: force range in 12 samples from 0.080 s"),
    "missed": (lambda: replace(right(), missed=7), "doubt", "7 of 1751 steps missed"),
    "often missed": (lambda: replace(right(), missed=700), "bad", "700 of 1751 steps missed"),
    "overrun": (lambda: replace(right(), overruns=2), "doubt", "sampling overruns of the rig: 2"),
    "lost": (lost, "doubt", "samples lost: 2 of valve_command"),
    "tripped": (tripped, "bad", "tripped at 3.000 s (step 1500): force [N] beyond limit"),
    "biased": (lambda: biased(1.2e-4), "doubt", "displacement error"),
    "biased much": (lambda: biased(2e-2), "bad", "displacement error"),
    "uncompensated": (lambda: simulated(load(PLAN[-1])), "bad", "displacement error"),
}
PAGES = ("right", "biased", "tripped")
"""Of these, one of each mark, the page is looked at, too."""


@pytest.mark.parametrize("name", RECORDINGS)
def test_terminal_page_and_json_give_the_same_verdicts(seft_json, tmp_path, capsys, name):
    make, word, reason = RECORDINGS[name]
    recording = make()
    show_test(recording, None, as_json=False, figure=False)
    shown = capsys.readouterr().out
    (line,) = [line for line in shown.splitlines() if line.startswith(BY_TRUTH)]
    assert line.startswith(f"{BY_TRUTH} {WORDS[word]}") and reason in line
    if name not in PAGES:
        return
    write_recording(recording, tmp_path / "bag")
    found = seft_json("report", "bag", status=int(name == "tripped"))
    page = html.unescape((tmp_path / "bag" / "report.html").read_text()).replace("\u00a0", " ")
    for key, begin in (("verdict", BY_TRUTH), ("laboratory_verdict", IN_LABORATORY)):
        mark, line = found[key]["verdict"], found[key]["text"]
        assert line.startswith(f"{begin} {WORDS[mark]}")
        assert line in shown.splitlines()
        assert f'<div class="verdict {mark}">' in page
        assert line in page
    assert found["verdict"]["verdict"] == word
