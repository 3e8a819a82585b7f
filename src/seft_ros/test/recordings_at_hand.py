"""Recordings, also with samples lost, texts as files and terminals show them, small disks."""

import dataclasses
import io
import subprocess
import sys

import numpy as np
import pytest
from rich.console import Console
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire.topics import LOOP_TOPICS
from seft_ros.bags.recording import Recording, Series


def fixed(values, width, decimals, in_a_row):
    """Text of values with a fixed width, which run together if they are long."""
    cells = [f"{value:{width}.{decimals}f}" for value in values]
    rows = [cells[at : at + in_a_row] for at in range(0, len(cells), in_a_row)]
    return "".join("".join(row) + "\n" for row in rows)


def noise_recording(count, axes=("x", "y"), rate=500.0, **facts):
    """Record of a test with noise on every topic."""
    rng, steps = np.random.default_rng(5), np.arange(count)
    shapes = {topic.name: (count, len(topic.quantities), len(axes)) for topic in LOOP_TOPICS}
    series = {name: Series(steps, rng.normal(size=shape)) for name, shape in shapes.items()}
    return Recording(Experiment({"rig": {"rate": rate, "axes": list(axes)}}), series, **facts)


def recording_of(test, ground, states, forces=None, **facts):
    """Record of a test with this ground motion (N, n), states (N, 4, n) and reference forces."""
    steps = np.arange(len(states))
    none = np.zeros((len(states), 1, len(test.axes)))
    series = {
        "ground_motion": Series(steps, ground[:, np.newaxis]),
        "rig/state": Series(steps, of_rig(states)),
        "rig/measured": Series(steps, states),
        "reference_force": Series(steps, none if forces is None else forces),
        "valve_command": Series(steps, none.copy()),
    }
    return Recording(test, series, **facts)


def of_rig(states):
    """Samples of rig/state, none of them suspect, of a rig that is not driven; (N, 6, n)."""
    return np.concatenate([states, np.zeros_like(states[:, :2])], axis=1)


def as_measured(recording, states):
    """Series of a recording with other states, all of which are judged to be right."""
    measured = dataclasses.replace(states, values=states.values[:, :4])
    return {**recording.series, "rig/state": states, "rig/measured": measured}


def assert_same_samples(found, wanted):
    """Two recordings have the same topics, steps and bits."""
    assert found.series.keys() == wanted.series.keys()
    for name, series in wanted.series.items():
        np.testing.assert_array_equal(found.series[name].steps, series.steps)
        np.testing.assert_array_equal(*(r.series[name].values.view("u8") for r in (found, wanted)))
    assert (found.estimates is None) == (wanted.estimates is None)
    if wanted.estimates is not None:
        assert found.estimates.names == wanted.estimates.names
        np.testing.assert_array_equal(found.estimates.steps, wanted.estimates.steps)
        np.testing.assert_array_equal(*(r.estimates.values.view("u8") for r in (found, wanted)))


def without(recording, topic, steps):
    """Recording in which samples are lost on a topic; of rig/state, none is replaced then."""
    series = recording.series[topic]
    kept = ~np.isin(series.steps, list(steps))
    fewer = Series(series.steps[kept], series.values[kept])
    if topic == "rig/state":
        return dataclasses.replace(recording, series=as_measured(recording, fewer))
    return dataclasses.replace(recording, series={**recording.series, topic: fewer})


def shown(texts, width=200):
    """Texts on a terminal of so many columns."""
    stream = io.StringIO()
    Console(file=stream, width=width).print(*texts, sep="\n")
    return stream.getvalue()


def run_on_a_disk(options, folder, *words):
    """Run Python on a file system of its own, mounted with options, which is gone afterwards."""
    shell = 'mount -t tmpfs -o "$1" tmpfs "$2" && cd "$2" && shift 2 && exec "$@"'
    words = ["unshare", "-m", "sh", "-c", shell, "sh", options, folder, sys.executable, *words]
    done = subprocess.run(words, capture_output=True, text=True)
    if "unshare" in done.stderr or "mount:" in done.stderr:
        pytest.skip("may not mount a file system here")
    assert done.stderr == ""
    return done.stdout.strip()
