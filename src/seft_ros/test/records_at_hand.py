"""Records with samples lost, texts as a terminal shows them, and disks with little room."""

import dataclasses
import io
import subprocess
import sys

import numpy as np
import pytest
from rich.console import Console
from seft_ros.bags.record import Series


def as_measured(record, states):
    """Series of a record with other states, all of which are judged to be right."""
    return {**record.series, "rig/state": states, "rig/judged": states}


def without(record, topic, steps):
    """Record in which samples are lost on a topic; of rig/state, none is judged then."""
    series = record.series[topic]
    kept = ~np.isin(series.steps, list(steps))
    fewer = Series(series.steps[kept], series.values[kept])
    if topic == "rig/state":
        return dataclasses.replace(record, series=as_measured(record, fewer))
    return dataclasses.replace(record, series={**record.series, topic: fewer})


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
