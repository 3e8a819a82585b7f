"""The figure of two tests on one another."""

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire.topics import LOOP_TOPICS
from seft_ros.analysis.comparison import compare_records
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


def drawn(a, b):
    figure = comparison_figure(a, b, compare_records(a, b), ["a: bag", "b: bag"])
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    figure.canvas.draw()
    return figure, texts


def test_both_tests_are_drawn_and_their_difference_below():
    figure, legend = drawn(make_record(), make_record())
    assert legend == ["a: bag", "b: bag"]
    labels = [panel.get_ylabel() for panel in figure.axes]
    assert labels[0] == "displacement / mm"
    assert len(labels) == 6
    assert all(label.startswith("difference") for label in labels[1::2])
    assert figure.texts[0].get_text().startswith("axis x")


def test_the_first_difference_is_marked_and_missing_samples_are_a_gap():
    b = make_record(lost=range(30, 40))
    b.series["valve_command"].values[20] += 1.0
    figure, legend = drawn(make_record(), b)
    assert "first difference: valve_command, 0.04 s" in legend
    (line,) = (line for line in figure.axes[1].lines if len(line.get_xdata()) > 2)
    assert np.isnan(line.get_ydata()).sum() == 1
