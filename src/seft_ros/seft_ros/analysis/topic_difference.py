"""How the samples of one topic differ between two records, and where they first do."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from seft_ros.analysis.common_steps import common_steps
from seft_ros.analysis.metrics import nrmse, peak
from seft_ros.recording.record import Series

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class TopicDifference:
    """Two series of a topic, compared by step.

    Attributes
    ----------
    figures : dict
        ``identical``, ``compared`` (common steps), ``missing_a``, ``missing_b``, ``max_abs``,
        ``nrmse``, ``fields``.
    first : dict or None
        The smallest step at which a value differs or a sample is missing: ``topic``, ``step``,
        ``field``, ``axis``, ``a``, ``b``.
    first_value : dict or None
        The smallest at which both have a sample, and a value differs.
    """

    figures: dict[str, Any]
    first: dict[str, Any] | None
    first_value: dict[str, Any] | None


def compare_topic(
    topic: str, quantities: Sequence[str], axes: Sequence[str], one: Series, other: Series
) -> TopicDifference:
    """Compare two series, bit for bit, of the same quantities and axes."""
    common, in_a, in_b = common_steps(one.steps, other.steps)
    values_a, values_b = one.values[in_a], other.values[in_b]
    fields = {
        quantity: _errors(values_a[:, row], values_b[:, row])
        for row, quantity in enumerate(quantities)
    }
    value = _first_value(topic, quantities, axes, common, values_a, values_b)
    missing = _first_missing(topic, one, other)
    first = min(
        (found for found in (missing, value) if found is not None),
        key=lambda found: found["step"],
        default=None,
    )
    figures = {
        "identical": first is None,
        "compared": len(common),
        "missing_a": len(other.steps) - len(common),
        "missing_b": len(one.steps) - len(common),
        "max_abs": float(np.max([field["max_abs"] for field in fields.values()])),
        "nrmse": float(np.max([field["nrmse"] for field in fields.values()])),
        "fields": fields,
    }
    return TopicDifference(figures, first, value)


def _first_value(
    topic: str,
    quantities: Sequence[str],
    axes: Sequence[str],
    steps: npt.NDArray[np.int64],
    a: Floats,
    b: Floats,
) -> dict[str, Any] | None:
    differing = _bits(a) != _bits(b)
    if not differing.any():
        return None
    sample, row, column = np.unravel_index(differing.argmax(), differing.shape)
    return {
        "topic": topic,
        "step": int(steps[sample]),
        "field": quantities[row],
        "axis": axes[column],
        "a": float(a[sample, row, column]),
        "b": float(b[sample, row, column]),
    }


def _first_missing(topic: str, one: Series, other: Series) -> dict[str, Any] | None:
    if np.array_equal(one.steps, other.steps):
        return None
    lacking = np.setxor1d(one.steps, other.steps, assume_unique=True)
    present = bool(np.isin(lacking[0], one.steps))
    return {
        "topic": topic,
        "step": int(lacking[0]),
        "field": None,
        "axis": None,
        "a": "present" if present else "missing",
        "b": "missing" if present else "present",
    }


def _errors(a: Floats, b: Floats) -> dict[str, float]:
    """Largest and normalised error of a field; zero where all bits are equal."""
    if np.array_equal(_bits(a), _bits(b)):
        return {"max_abs": 0.0, "nrmse": 0.0}
    with np.errstate(invalid="ignore", over="ignore"):
        return {"max_abs": peak(a - b), "nrmse": nrmse(b, a)}


def _bits(values: Floats) -> npt.NDArray[np.uint64]:
    return np.ascontiguousarray(values).view(np.uint64)
