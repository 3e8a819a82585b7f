"""Records with samples lost, and texts as a terminal shows them."""

import dataclasses
import io

import numpy as np
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
