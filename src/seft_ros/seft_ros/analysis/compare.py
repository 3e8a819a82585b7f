"""Whether two records are the same test, bit for bit, and where they first differ."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError
from seft_msgs_py.topics import ESTIMATES, LOOP_TOPICS

from seft_ros.analysis.metrics import nrmse, peak
from seft_ros.analysis.summary import json_safe
from seft_ros.recording.record import Estimates, Record, Series

Floats = npt.NDArray[np.float64]


def compare(a: Record, b: Record) -> dict[str, Any]:
    """Compare two records by step.

    Parameters
    ----------
    a, b : Record
        Of the same axes and rate; lengths may differ.

    Returns
    -------
    dict
        ``identical``: both hold the same steps on every loop topic, and equal bits; so too of
        the estimates, if either has any.
        ``first_difference``: None, or ``topic``, ``step``, ``field``, ``axis``, ``a``, ``b`` of
        the smallest step that differs, first in the order of `LOOP_TOPICS`, estimates last;
        where a record lacks the step, field and axis are None and a, b are "present" or
        "missing".
        ``missed``: {a, b}. ``topics``: for each topic ``samples_a``, ``samples_b``,
        ``missing_a`` and ``missing_b`` (steps that only the other has), and of the common
        steps ``max_abs`` and ``nrmse`` (RMS(a - b) / RMS(a)): the largest of its fields,
        which ``fields`` has one by one.

    Raises
    ------
    InputError
        If axes or rate differ.
    """
    _check_comparable(a, b)
    topics: dict[str, Any] = {}
    first: dict[str, Any] | None = None
    for topic, fields, one, other in _pairs(a, b):
        topics[topic], difference = _compare_topic(topic, fields, a.experiment.axes, one, other)
        if difference is not None and (first is None or difference["step"] < first["step"]):
            first = difference
    found = {
        "identical": first is None,
        "first_difference": first,
        "missed": {"a": a.missed, "b": b.missed},
        "topics": topics,
    }
    return {key: json_safe(value) for key, value in found.items()}


def _check_comparable(a: Record, b: Record) -> None:
    one, other = a.experiment, b.experiment
    if one.axes != other.axes:
        raise InputError(
            f"the tests can't be compared: axes are {list(one.axes)} in the first and "
            f"{list(other.axes)} in the second"
        )
    if one.timebase != other.timebase:
        raise InputError(
            f"the tests can't be compared: the rate is {one.timebase.rate:g} Hz in the first "
            f"and {other.timebase.rate:g} Hz in the second"
        )


def _pairs(a: Record, b: Record) -> Iterator[tuple[str, Sequence[str], Series, Series]]:
    """Topic, its fields, and the samples in either record."""
    for topic in LOOP_TOPICS:
        yield topic.name, topic.quantities, a.series[topic.name], b.series[topic.name]
    found = [record.estimates for record in (a, b)]
    names = tuple(dict.fromkeys(name for some in found if some for name in some.names))
    if names:
        one, other = (_rows(some, names, len(a.experiment.axes)) for some in found)
        yield ESTIMATES.name, names, one, other


def _rows(estimates: Estimates | None, names: Sequence[str], axes: int) -> Series:
    """Estimates by these names; NaN where there is none of a name."""
    if estimates is None:
        return Series(np.empty(0, np.int64), np.empty((0, len(names), axes)))
    values = np.full((len(estimates.steps), len(names), axes), np.nan)
    values[:, [names.index(name) for name in estimates.names]] = estimates.values
    return Series(estimates.steps, values)


def _compare_topic(
    topic: str, quantities: Sequence[str], axes: Sequence[str], one: Series, other: Series
) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """Figures of a topic, and its first difference."""
    common, in_a, in_b = np.intersect1d(
        one.steps, other.steps, assume_unique=True, return_indices=True
    )
    values_a, values_b = one.values[in_a], other.values[in_b]
    fields = {
        quantity: _errors(values_a[:, row], values_b[:, row])
        for row, quantity in enumerate(quantities)
    }
    figures = {
        "samples_a": len(one.steps),
        "samples_b": len(other.steps),
        "missing_a": len(other.steps) - len(common),
        "missing_b": len(one.steps) - len(common),
        "max_abs": float(np.max([field["max_abs"] for field in fields.values()])),
        "nrmse": float(np.max([field["nrmse"] for field in fields.values()])),
        "fields": fields,
    }
    differing = np.argwhere(_bits(values_a) != _bits(values_b))
    lacking = np.setxor1d(one.steps, other.steps, assume_unique=True)
    at_value = int(common[differing[0, 0]]) if len(differing) else None
    if len(lacking) and (at_value is None or lacking[0] < at_value):
        present = bool(np.isin(lacking[0], one.steps))
        return figures, {
            "topic": topic,
            "step": int(lacking[0]),
            "field": None,
            "axis": None,
            "a": "present" if present else "missing",
            "b": "missing" if present else "present",
        }
    if at_value is None:
        return figures, None
    sample, row, column = differing[0]
    return figures, {
        "topic": topic,
        "step": at_value,
        "field": quantities[row],
        "axis": axes[column],
        "a": float(values_a[sample, row, column]),
        "b": float(values_b[sample, row, column]),
    }


def _errors(a: Floats, b: Floats) -> dict[str, float]:
    """Largest and normalised error of a field; zero where all bits are equal."""
    if np.array_equal(_bits(a), _bits(b)):
        return {"max_abs": 0.0, "nrmse": 0.0}
    with np.errstate(invalid="ignore", over="ignore"):
        return {"max_abs": peak(a - b), "nrmse": nrmse(b, a)}


def _bits(values: Floats) -> npt.NDArray[np.uint64]:
    return np.ascontiguousarray(values).view(np.uint64)
