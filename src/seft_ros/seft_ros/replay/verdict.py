"""Whether a node answered as recorded, and where it first did not."""

from dataclasses import replace
from typing import Any

import numpy as np
from seft_msgs_py.wire.topics import ESTIMATES, LOOP_TOPICS

from seft_ros.analysis.comparison import compare
from seft_ros.recording.environment import describe_environment
from seft_ros.recording.record import Estimates, Record, Series
from seft_ros.replay.answers import Answers
from seft_ros.replay.cue import Part
from seft_ros.replay.recorded import Recorded


def replayed_record(
    part: Part, recorded: Recorded, answers: Answers, section: dict[str, Any]
) -> Record:
    """Give the recorded test with the replayed answers in place of the node's own.

    Parameters
    ----------
    part : Part
        Whose.
    recorded : Recorded
        The test.
    answers : Answers
        What the node answered.
    section : dict
        The parameters that it had.
    """
    record = recorded.record
    experiment = type(record.experiment)({**record.experiment.sections, part.node: section})
    environment = describe_environment(f"replay of {part.node}")
    return replace(
        record,
        experiment=experiment,
        series={**record.series, part.answer.name: answers.series},
        estimates=answers.estimates if part.node == "reference_force" else record.estimates,
        environment={**environment, "replayed": record.environment},
    )


def judge(part: Part, recorded: Recorded, answers: Answers) -> dict[str, Any]:
    """Hold the answers of a node against the recorded ones, by step, bit for bit.

    Returns
    -------
    dict
        JSON values: ``node``, ``topic``, ``identical``, ``first_difference`` (None, or topic,
        step, time_s, field, axis, recorded, replayed), ``steps`` (recorded answers to be given),
        ``answered``, ``ended`` (why not all were; else None), ``max_abs``, ``nrmse``, ``fields``,
        ``estimates`` (likewise, None where there are none), ``wall_s``, ``notes``.
    """
    expected = part.expected()
    given = _on(answers.series, expected)
    record = recorded.record
    names = {topic.name: record.series[topic.name] for topic in LOOP_TOPICS}
    mine = part.node == "reference_force"
    one = replace(
        record,
        series={**names, part.answer.name: expected},
        estimates=record.estimates if mine else None,
    )
    other = replace(
        one,
        series={**names, part.answer.name: given},
        estimates=_common(answers.estimates, record.estimates) if mine else None,
    )
    found = compare(one, other)
    first = found["first_difference"]
    if first is not None:
        stamp_ns = record.experiment.timebase.stamp_ns(first["step"])
        first = {
            **{key: first[key] for key in ("topic", "step")},
            "time_s": stamp_ns / 1e9,
            **{key: first[key] for key in ("field", "axis")},
            "recorded": first["a"],
            "replayed": first["b"],
        }
    topic = found["topics"][part.answer.name]
    estimates = found["topics"].get(ESTIMATES.name)
    keys = ("max_abs", "nrmse", "fields")
    return {
        "node": part.node,
        "topic": part.answer.name,
        "identical": found["identical"],
        "first_difference": first,
        "steps": len(expected.steps),
        "answered": len(given.steps),
        "ended": answers.ended or None,
        **{key: topic[key] for key in keys},
        "estimates": None if estimates is None else {key: estimates[key] for key in keys},
        "wall_s": answers.wall_s,
        "notes": list(part.notes),
    }


def _on(series: Series, expected: Series) -> Series:
    """Answers of the steps that were recorded; what else was answered has nothing to be held to."""
    (kept,) = np.nonzero(np.isin(series.steps, expected.steps))
    return Series(series.steps[kept], series.values[kept])


def _common(given: Estimates | None, expected: Estimates | None) -> Estimates | None:
    """Leave out what is answered beyond the recorded end."""
    if given is None or expected is None:
        return given
    (kept,) = np.nonzero(given.steps <= expected.steps[-1])
    return Estimates(given.steps[kept], given.values[kept], given.names)
