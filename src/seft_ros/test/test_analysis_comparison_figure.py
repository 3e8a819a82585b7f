"""The figure of tests on one another."""

import numpy as np
import pytest
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import LOOP_TOPICS
from seft_ros.analysis.comparison import compare_all
from seft_ros.analysis.figures import comparison_figure
from seft_ros.bags.record import Record, Series


def make_record(rate=500.0, lost=(), axes=("x", "y")):
    steps = np.setdiff1d(np.arange(round(0.2 * rate)), lost)
    series = {}
    for topic in LOOP_TOPICS:
        shape = (len(steps), len(topic.quantities), len(axes))
        values = np.broadcast_to(np.sin(40 * steps / rate)[:, None, None], shape)
        series[topic.name] = Series(steps, values.copy())
    return Record(Experiment({"rig": {"rate": rate, "axes": list(axes)}}), series)


def drawn(*records):
    names = [f"{label}: bag" for label in "abcdefgh"[: len(records)]]
    result = compare_all(names, records)
    figure = comparison_figure(records, result.get("comparisons", [result]), names)
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    figure.canvas.draw()
    return figure, texts


def test_each_test_is_drawn_and_its_difference_below():
    figure, legend = drawn(make_record(), make_record(), make_record(250.0))
    assert legend == ["a: bag", "b: bag", "c: bag"]
    labels = [panel.get_ylabel() for panel in figure.axes]
    assert labels[0] == "displacement / mm"
    assert len(labels) == 6
    assert all(label.startswith("difference") for label in labels[1::2])
    lines = [line for line in figure.axes[1].lines if len(line.get_xdata())]
    assert [len(line.get_xdata()) for line in lines] == [100, 50]


def test_the_first_difference_and_missing_samples_are_marked():
    b = make_record(lost=[30, 31, 32, 70])
    b.series["valve_command"].values[20] += 1.0
    _, legend = drawn(make_record(), b)
    assert "first difference: valve_command, 0.04 s" in legend
    assert "samples missing" in legend


def test_where_there_is_no_difference_the_panel_says_so():
    figure, legend = drawn(make_record(), make_record())
    assert figure.axes[1].texts[0].get_text() == "no difference"
    assert legend == ["a: bag", "b: bag"]


def test_the_first_axis_that_all_have_is_drawn():
    figure, _ = drawn(make_record(axes=("x", "y")), make_record(axes=("y", "z")))
    assert figure.texts[0].get_text().startswith("axis y")
    with pytest.raises(InputError, match="no axis is in all"):
        drawn(make_record(), make_record(axes=("x",)), make_record(axes=("y",)))
