"""What a compensation method identified, in summary, table and figure."""

import dataclasses
import json
import math

import numpy as np
from recordings_at_hand import noise_recording, shown
from seft_ros.analysis.figures import test_figure as draw
from seft_ros.analysis.report_numbers import report_numbers
from seft_ros.analysis.result_text import summary_texts
from seft_ros.analysis.summary import summarise
from seft_ros.bags.recording import Estimates
from seft_ros.drawing.style import Mark

DELAY = np.array([[0.010, 0.010], [0.0141, 0.009], [0.0136, 0.012]])
STIFFNESS = np.array([[2.11e5, 3e5], [2.0e5, 3.1e5], [1.9e5, 3.2e5]])
STEPS = np.array([0, 50, 100])


def make_recording(axes=("x",), names=("delay", "stiffness"), **changes):
    values = np.stack([DELAY, STIFFNESS], axis=1)[:, :, : len(axes)].copy()
    recording = noise_recording(120, axes, estimates=Estimates(STEPS, values, names))
    return dataclasses.replace(recording, **changes)


def table(recording):
    return shown(summary_texts(report_numbers(recording)))


def test_a_summary_tells_how_each_estimate_went_per_axis_in_si_units():
    estimates = summarise(make_recording(("x", "y")))["estimates"]
    assert list(estimates) == ["delay", "stiffness"]
    assert estimates["delay"] == {
        "x": {"first": 0.010, "last": 0.0136, "least": 0.010, "largest": 0.0141},
        "y": {"first": 0.010, "last": 0.012, "least": 0.009, "largest": 0.012},
    }
    assert estimates["stiffness"]["x"]["last"] == 1.9e5


def test_a_summary_of_estimates_that_are_not_finite_is_json_and_can_be_shown():
    recording = make_recording()
    recording.estimates.values[2, 0, 0] = math.nan
    summary = json.loads(json.dumps(summarise(recording), allow_nan=False))
    assert summary["estimates"]["delay"]["x"]["first"] == 0.010
    assert summary["estimates"]["delay"]["x"]["last"] is None
    assert "delay as identified: 10 to - ms" in table(recording)


def test_the_table_tells_estimates_in_units_for_people():
    text = table(make_recording())
    assert "delay as identified: 10 to 13.6 ms (between 10 and 14.1)" in text
    assert "stiffness as identified: 211 to 190 kN/m (between 190 and 211)" in text
    both = " ".join(table(make_recording(("x", "y"))).split())
    assert "delay as identified: x 10 to 13.6 ms (between 10 and 14.1), y 10 to 12 ms" in both
    assert "gain as identified: 0.01 to 0.0136 (between" in table(
        make_recording(names=("gain", "q"))
    )


def test_where_nothing_is_wrong_the_summary_names_neither_detectors_nor_estimates():
    recording = make_recording()
    found = report_numbers(recording)
    summary = found.summary | {"detectors": {"tracking": 0.4}}
    for mark, is_noted in ((Mark.DOUBT, True), (Mark.GOOD, False)):
        marked = dataclasses.replace(found.assessment, verdict=mark)
        report = dataclasses.replace(found, summary=summary, assessment=marked)
        text = shown(summary_texts(report))
        assert ("tracking reached 40.0 % of its threshold" in text) is is_noted
        assert ("stiffness as identified" in text) is is_noted


def test_a_figure_has_a_panel_for_each_estimate_and_axis():
    drawn = draw(make_recording(("x", "y")), None)
    panels = np.array(drawn.axes).reshape(5, 2)
    assert [panel.get_ylabel() for panel in panels[3:, 0]] == ["delay\n/ ms", "stiffness\n/ kN/m"]
    (course,) = panels[4, 1].lines
    np.testing.assert_allclose(course.get_xdata(), [0.0, 0.1, 0.2])
    np.testing.assert_allclose(course.get_ydata(), STIFFNESS[:, 1] / 1e3)
