import dataclasses
import json
import math

import matplotlib as mpl
import numpy as np
import pytest
from experiments_at_hand import load
from matplotlib.image import imread
from recordings_at_hand import noise_recording, recording_of, shown, without
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.outcome import Trip
from seft_msgs_py.wire.topics import LOOP_TOPICS
from seft_plant_sim.whole_structure import reference_response
from seft_ros.analysis import figures, result_text
from seft_ros.analysis.figures import test_figure as draw
from seft_ros.analysis.metrics import delayed
from seft_ros.analysis.report_numbers import report_numbers
from seft_ros.analysis.result_text import summary_texts
from seft_ros.analysis.summary import reference_of, summarise
from seft_ros.bags.recording import Estimates
from seft_ros.drawing.style import Mark, save_figure

COUNT = 2000
DT = 0.002
MEASURES = ["nrmse", "nrmse_aligned", "peak", "reference_peak", "delay_s"]
THREE = ("displacement", "acceleration", "force")


def experiment(axes):
    return load(("/**", "axes", list(axes)), "reference_force:mass_ratio:=0.5")


def make_recording(axes=("x",), gain=1.0, delay=0.0, **changes):
    """A test that follows the exact response with a gain and a delay."""
    time = np.arange(COUNT) * DT
    packet = np.exp(-(((time - 1.0) / 0.3) ** 2)) * np.sin(2 * np.pi * 6.0 * time)
    ground = np.stack([packet * (1 + column) for column in range(len(axes))], axis=1)
    states = reference_response(experiment(axes), ground).states
    states = gain * np.stack([delayed(states[:, row], delay, DT) for row in range(4)], axis=1)
    recording = recording_of(experiment(axes), ground, states, missed=0, wall_s=2.0)
    return dataclasses.replace(recording, **changes)


def test_gain_and_delay_of_a_test_are_reported():
    found = summarise(make_recording(gain=1.04, delay=0.0137))
    for name in THREE:
        assert list(found[name]) == MEASURES
        assert found[name]["delay_s"] == pytest.approx(0.0137, abs=1e-6)
        assert found[name]["nrmse_aligned"] == pytest.approx(0.04, rel=1e-4)
        assert found[name]["nrmse"] > 0.3
        assert found[name]["peak"] == pytest.approx(1.04 * found[name]["reference_peak"], rel=0.02)


def test_a_summary_is_json():
    recording = make_recording(("x", "y"), wall_s=None, missed=None, trip=Trip("limit", 9, 0.018))
    recording.series["rig/state"].values[5, 0, 0] = math.nan
    recording.series["rig/state"].values[5, 3, 1] = math.inf
    summary = json.loads(json.dumps(summarise(recording), allow_nan=False))
    assert summary["realtime_factor"] is None
    assert summary["displacement"]["nrmse"] is None
    assert summary["displacement"]["peak"] is None
    assert summary["force"]["peak"] is None
    assert summary["acceleration"]["nrmse"] == 0.0
    assert summary["axes"]["y"]["displacement"]["nrmse"] == 0.0


@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("topic", [topic.name for topic in LOOP_TOPICS[1:]])
def test_a_test_with_values_that_are_not_finite_is_not_stable(topic, value):
    recording = make_recording()
    recording.series[topic].values[-1, 0, 0] = value
    assert summarise(recording)["stable"] is False


def test_the_numbers_of_a_tripped_test_leave_out_its_ramp_down():
    recording = make_recording(trip=Trip("force beyond limit", 999, 1.998), missed=0)
    recording.series["rig/state"].values[1000:] = 0.0  # the force came down
    report = report_numbers(recording)
    summary = report.summary
    assert (summary["steps"], summary["judged_steps"]) == (COUNT, 1000)
    for name in THREE:
        assert summary[name]["nrmse"] == 0.0
    text = shown(summary_texts(report), 100)
    assert "numbers are of its first 1000 steps" in " ".join(text.split())
    whole = summarise(make_recording())
    assert whole["judged_steps"] == whole["steps"]


def test_lost_steps_are_counted_and_the_others_compared():
    recording = without(make_recording(gain=1.05), "rig/state", [300, 301, 700])
    summary = summarise(without(recording, "valve_command", range(10)))
    assert summary["steps"] == COUNT
    lost = {"ground_motion": 0, "rig/state": 3, "rig/measured": 3, "reference_force": 0}
    assert summary["lost"] == lost | {"valve_command": 10}
    assert summary["displacement"]["nrmse"] == pytest.approx(0.05)


def test_what_was_at_the_end_of_its_range_is_reported_by_name():
    assert summarise(make_recording())["saturated"] == {}
    saturation = {
        "valve": {"samples": 12, "first_step": 40},
        "force_range": {"samples": 3, "first_step": 500},
    }
    summary = summarise(make_recording(saturation=saturation))
    assert summary["saturated"] == saturation
    assert list(summary["saturated"]) == ["force_range", "valve"]
    assert summary["stable"] is True


def test_without_the_whole_ground_motion_there_is_no_reference():
    recording = without(make_recording(), "ground_motion", [40])
    assert reference_of(recording) is None
    summary = summarise(recording)
    assert summary["displacement"]["nrmse"] is None
    assert summary["displacement"]["reference_peak"] is None
    assert summary["displacement"]["peak"] > 0
    assert summary["lost"]["ground_motion"] == 1


def test_a_description_that_lacks_a_parameter_is_an_input_error():
    recording = make_recording()
    del recording.experiment.sections["rig"]["simulated.specimen.stiffness"]
    with pytest.raises(InputError, match="lacks stiffness"):
        reference_of(recording)


def test_an_empty_recording_is_summarised():
    recording = make_recording()
    for topic in LOOP_TOPICS:
        recording = without(recording, topic.name, range(COUNT))
    report = report_numbers(recording)
    summary = report.summary
    assert summary["steps"] == 0
    assert summary["displacement"] == dict.fromkeys(MEASURES)
    assert summary["first_step"] is None
    assert "no rig/state" in report.assessment.text


def test_the_verdict_names_values_that_are_not_finite():
    recording = make_recording()
    recording.series["rig/state"].values[-1] = math.nan
    assert "unstable: samples are not finite" in report_numbers(recording).assessment.text


def test_the_table_is_in_units_for_people():
    recording = make_recording(("x", "y"), gain=1.1, delay=0.004)
    report = report_numbers(recording)
    summary, text = report.summary, shown(summary_texts(report), 100)
    assert "SEFT, mass ratio 0.5, compensation none, 500 Hz" in text
    assert f"{summary['displacement']['peak'] * 1e3:.4g} mm" in text
    assert "4.00 ms" in text
    assert "10.0 %" in text
    assert "x displacement" in text
    assert "y force" in text


@pytest.mark.parametrize("axes", [("x",), ("x", "y", "z"), tuple("abcd")])
def test_a_figure_has_a_column_for_each_axis_up_to_three(axes):
    recording = make_recording(axes)
    drawn = figures.test_figure(recording, reference_of(recording))
    assert len(drawn.axes) == 3 * min(len(axes), 3)
    labels = [text.get_text() for text in drawn.legends[0].get_texts()]
    assert labels == ["reference response", "test"]
    for panel in drawn.axes:
        assert len(panel.lines) == 2
    assert "mass ratio 0.5" in drawn.texts[0].get_text()
    assert "500 Hz" in drawn.texts[0].get_text()


def test_a_figure_holds_the_samples_in_units_for_people_against_time():
    recording = make_recording(gain=1.1)
    panel = figures.test_figure(recording, reference_of(recording)).axes[0]
    exact, test = panel.lines
    assert panel.get_ylabel() == "displacement / mm"
    assert np.array_equal(test.get_ydata(), recording.series["rig/state"].values[:, 0, 0] * 1e3)
    assert test.get_xdata()[-1] == pytest.approx(3.998)
    assert np.array_equal(exact.get_ydata(), reference_of(recording).displacement[:, 0] * 1e3)
    assert panel.get_title(loc="right") == "NRMSE 10.0 %"
    start, end = panel.get_xlim()  # of the strong part of the ground motion, a packet about 1 s
    assert start == 0.0
    assert 3.0 < end < 3.6
    tripped = make_recording(trip=Trip("limit", 1999, 3.998))
    assert figures.test_figure(tripped, None).axes[0].get_xlim()[1] == pytest.approx(3.998)


def test_figures_are_saved_as_png_whatever_a_reason_holds_or_refused(tmp_path):
    backend = mpl.get_backend()
    tripped = make_recording(trip=Trip("force of $5 on axis $x", 1999, 3.998))
    drawn = figures.test_figure(tripped, None)
    save_figure(drawn, tmp_path / "figure")
    assert imread(tmp_path / "figure.png").shape[:2] == (1080, 1425)
    assert mpl.get_backend() == backend  # the user's pyplot
    for name in ("no/folder/figure.png", "figure.docx"):
        with pytest.raises(InputError, match="can't be saved"):
            save_figure(drawn, tmp_path / name)


def test_what_can_not_be_compared_is_drawn_still(tmp_path):
    recording = make_recording()
    recording.series["rig/state"].values[100:, 0] = math.nan
    save_figure(figures.test_figure(recording, reference_of(recording)), tmp_path / "nan.png")
    save_figure(figures.test_figure(recording, None), tmp_path / "alone.png")
    for topic in LOOP_TOPICS:
        recording = without(recording, topic.name, range(COUNT))
    save_figure(figures.test_figure(recording, None), tmp_path / "empty.png")
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize("axes", [("x", "y"), ("west/x", "east/x")])
def test_what_the_rigs_have_zeroed_is_reported(axes):
    def zeroed(*force):
        rows = {name: [0.0] * len(force) for name in CHANNELS}
        return {"zeroed": {"samples": 500, "subtracted": rows | {"force": force}, "left": rows}}

    nodes = {"rig": zeroed(5.0, 0.0)}
    if "/" in axes[0]:
        nodes = {"west/rig": zeroed(5.0), "east/rig": zeroed(0.0)}
    summary = summarise(make_recording(axes, facts=nodes))
    assert summary["zeroed"]["subtracted"]["force"] == [5.0, 0.0]
    assert ("zeroed at rest", "force 5, 0 N") in result_text.test_rows(summary)
    silent = summarise(make_recording(axes, facts={"rig": {"zeroed": 3}}))
    assert silent["zeroed"] is None and "zeroed at rest" not in dict(result_text.test_rows(silent))


# ---- What a compensation method identified, in summary, table and figure


DELAY = np.array([[0.010, 0.010], [0.0141, 0.009], [0.0136, 0.012]])
STIFFNESS = np.array([[2.11e5, 3e5], [2.0e5, 3.1e5], [1.9e5, 3.2e5]])
STEPS = np.array([0, 50, 100])


def estimating(axes=("x",), names=("delay", "stiffness"), **changes):
    values = np.stack([DELAY, STIFFNESS], axis=1)[:, :, : len(axes)].copy()
    recording = noise_recording(120, axes, estimates=Estimates(STEPS, values, names))
    return dataclasses.replace(recording, **changes)


def table(recording):
    return shown(summary_texts(report_numbers(recording)))


def test_a_summary_tells_how_each_estimate_went_per_axis_in_si_units():
    estimates = summarise(estimating(("x", "y")))["estimates"]
    assert list(estimates) == ["delay", "stiffness"]
    assert estimates["delay"] == {
        "x": {"first": 0.010, "last": 0.0136, "least": 0.010, "largest": 0.0141},
        "y": {"first": 0.010, "last": 0.012, "least": 0.009, "largest": 0.012},
    }
    assert estimates["stiffness"]["x"]["last"] == 1.9e5


def test_a_summary_of_estimates_that_are_not_finite_is_json_and_can_be_shown():
    recording = estimating()
    recording.estimates.values[2, 0, 0] = math.nan
    summary = json.loads(json.dumps(summarise(recording), allow_nan=False))
    assert summary["estimates"]["delay"]["x"]["first"] == 0.010
    assert summary["estimates"]["delay"]["x"]["last"] is None
    assert "delay as identified: 10 to - ms" in table(recording)


def test_the_table_tells_estimates_in_units_for_people():
    text = table(estimating())
    assert "delay as identified: 10 to 13.6 ms (between 10 and 14.1)" in text
    assert "stiffness as identified: 211 to 190 kN/m (between 190 and 211)" in text
    both = " ".join(table(estimating(("x", "y"))).split())
    assert "delay as identified: x 10 to 13.6 ms (between 10 and 14.1), y 10 to 12 ms" in both
    assert "gain as identified: 0.01 to 0.0136 (between" in table(estimating(names=("gain", "q")))


def test_where_nothing_is_wrong_the_summary_names_neither_detectors_nor_estimates():
    recording = estimating()
    found = report_numbers(recording)
    summary = found.summary | {"detectors": {"tracking": 0.4}}
    for mark, is_noted in ((Mark.DOUBT, True), (Mark.GOOD, False)):
        marked = dataclasses.replace(found.assessment, verdict=mark)
        report = dataclasses.replace(found, summary=summary, assessment=marked)
        text = shown(summary_texts(report))
        assert ("tracking reached 40.0 % of its threshold" in text) is is_noted
        assert ("stiffness as identified" in text) is is_noted


def test_a_figure_has_a_panel_for_each_estimate_and_axis():
    drawn = draw(estimating(("x", "y")), None)
    panels = np.array(drawn.axes).reshape(5, 2)
    assert [panel.get_ylabel() for panel in panels[3:, 0]] == ["delay\n/ ms", "stiffness\n/ (kN/m)"]
    (course,) = panels[4, 1].lines
    np.testing.assert_allclose(course.get_xdata(), [0.0, 0.1, 0.2])
    np.testing.assert_allclose(course.get_ydata(), STIFFNESS[:, 1] / 1e3)
