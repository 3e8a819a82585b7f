"""Whether recordings are the same test, bit for bit, and where they first differ."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire import topics

from seft_ros.analysis.metrics import common_steps, nrmse, peak
from seft_ros.analysis.result_text import title_of
from seft_ros.bags.recording import Estimates, Recording, Series
from seft_ros.bags.recording_bag import UNDECODABLE
from seft_ros.drawing.style import json_safe


def compare_recordings(a: Recording, b: Recording) -> dict[str, Any]:
    """Compare two recordings of the same rate and axes, step by step.

    Returns
    -------
    dict
        ``identical``: both hold the same steps on every loop topic, and equal bits; also of the
        estimates, if either has any.
        ``first_difference``: None, or ``topic``, ``step``, ``field``, ``axis``, ``a``, ``b`` of
        the smallest step that differs, first in the order of `LOOP_TOPICS`, estimates last;
        where a recording lacks the step, field and axis are None and a, b are "present" or
        "missing".
        ``first_value_difference``: the same of the steps that both hold.
        ``missed``, ``length_s`` (time of the last sample): {a, b}.
        ``topics``: for each topic ``samples_a``, ``samples_b``, ``identical``, ``compared``
        (samples both hold), ``missing_a`` and ``missing_b`` (steps that only the other has), and
        of the compared samples ``max_abs`` and ``nrmse`` (RMS(a - b) / RMS(a)): the largest of
        its ``fields``, which have the same two.

    Raises
    ------
    InputError
        If rates or axes differ.
    """
    one, other = a.experiment, b.experiment
    for what, x, y in (
        ("rate is", f"{one.timebase.rate:g} Hz", f"{other.timebase.rate:g} Hz"),
        ("axes are", ", ".join(one.axes), ", ".join(other.axes)),
    ):
        if x != y:
            differ = f"the {what} {x} in the first and {y} in the second"
            raise InputError(f"the tests can't be compared: {differ}")
    by_topic: dict[str, Any] = {}
    differences: list[dict[str, Any]] = []
    for topic, fields, series_a, series_b in _pairs(a, b):
        figures, apart = _compare_topic(fields, one.axes, series_a, series_b)
        counts = {"samples_a": len(series_a.steps), "samples_b": len(series_b.steps)}
        by_topic[topic] = {**counts, "identical": not apart, **figures}
        differences += ({"topic": topic, **difference} for difference in apart)
    of_values = [difference for difference in differences if difference["field"] is not None]
    first, first_value = (
        min(some, key=lambda difference: difference["step"], default=None)
        for some in (differences, of_values)
    )
    found = {
        "identical": first is None,
        "first_difference": first,
        "first_value_difference": first_value,
        "missed": {"a": a.missed, "b": b.missed},
        "length_s": {"a": length_s(a), "b": length_s(b)},
        "topics": by_topic,
    }
    return json_safe(found)


def describe_bag(path: str, recording: Recording) -> dict[str, Any]:
    """Describe a bag, as ``--json`` prints it; what is not known is None."""
    return {
        "bag": path,
        "title": title_of(recording),
        "mode": recording.environment.get("mode"),
        "rate_hz": recording.experiment.timebase.rate,
        "axes": list(recording.experiment.axes),
        "length_s": length_s(recording),
        "complete": recording.complete,
        "damage": recording.damage,
        "undecodable": recording.environment.get(UNDECODABLE, 0),
    }


def length_s(recording: Recording) -> float:
    """Experiment time of a test's last sample of the rig or, without, of any; s."""
    states = recording.states
    every = [states] if len(states.steps) else list(recording.series.values())
    last = max((int(series.steps[-1]) for series in every if len(series.steps)), default=0)
    return recording.experiment.timebase.stamp_ns(last) / topics.NANOSECONDS_PER_SECOND


def _pairs(a: Recording, b: Recording) -> Iterator[tuple[str, Sequence[str], Series, Series]]:
    """Topic, its fields, and the samples in either recording."""
    for topic in topics.LOOP_TOPICS:
        one, other = a.series[topic.name], b.series[topic.name]
        quantities = topic.quantities
        if topic == topics.REFERENCE_FORCE:  # with target_motion after the target's motion
            count = min(one.values.shape[1], other.values.shape[1])
            quantities = topics.TARGET.quantities[-count:]
            one, other = (replace(s, values=s.values[:, -count:]) for s in (one, other))
        yield topic.name, quantities, one, other
    found = [recording.estimates for recording in (a, b)]
    names = tuple(dict.fromkeys(name for some in found if some for name in some.names))
    if names:
        yield topics.ESTIMATES.name, names, _estimates(a, names), _estimates(b, names)


def _estimates(recording: Recording, names: Sequence[str]) -> Series:
    """Estimates by these names; NaN where there is none of a name."""
    axes = len(recording.experiment.axes)
    found = recording.estimates or Estimates(np.empty(0, np.int64), np.empty((0, 0, axes)), ())
    values = np.full((len(found.steps), len(names), axes), np.nan)
    values[:, [names.index(name) for name in found.names]] = found.values
    return Series(found.steps, values)


def _compare_topic(
    fields: Sequence[str], axes: Sequence[str], one: Series, other: Series
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Errors of the samples that both series have, by field, and where they first differ.

    That is at most the first sample that one lacks, and the first value that differs.
    """
    common, in_a, in_b = common_steps(one.steps, other.steps)
    a, b = one.values[in_a], other.values[in_b]
    differing = np.ascontiguousarray(a).view(np.uint64) != np.ascontiguousarray(b).view(np.uint64)
    errors = {field: {"max_abs": 0.0, "nrmse": 0.0} for field in fields}
    for row, field in enumerate(fields):
        if differing[:, row].any():
            with np.errstate(invalid="ignore", over="ignore"):
                x, y = a[:, row], b[:, row]
                errors[field] = {"max_abs": peak(x - y), "nrmse": nrmse(y, x)}
    figures = {
        "compared": len(common),
        "missing_a": len(other.steps) - len(common),
        "missing_b": len(one.steps) - len(common),
        **{key: float(np.max([e[key] for e in errors.values()])) for key in ("max_abs", "nrmse")},
        "fields": errors,
    }
    # a missing sample comes before a value that differs in the same step
    found: list[tuple[int, dict[str, Any]]] = []
    if len(common) < max(len(one.steps), len(other.steps)):
        step = int(np.setxor1d(one.steps, other.steps, assume_unique=True)[0])
        words = ("present", "missing") if step in one.steps else ("missing", "present")
        found.append((step, {"field": None, "axis": None, "a": words[0], "b": words[1]}))
    if differing.any():
        at = np.unravel_index(differing.argmax(), differing.shape)
        sample, row, column = at
        place = {"field": fields[row], "axis": axes[column]}
        found.append((int(common[sample]), place | {"a": float(a[at]), "b": float(b[at])}))
    return figures, [{"step": step} | difference for step, difference in found]
