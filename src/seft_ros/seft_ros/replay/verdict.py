"""Whether a node answered as recorded, and where it first did not."""

from dataclasses import replace
from typing import Any

from seft_msgs_py.wire.topics import ESTIMATES, LOOP_TOPICS

from seft_ros.analysis.comparison import compare
from seft_ros.recording.environment import describe_environment
from seft_ros.recording.record import Estimates, Record
from seft_ros.recording.samples import of_steps
from seft_ros.replay.recorded import Recorded
from seft_ros.replay.replay_step import Answers, Replay


def replayed_record(
    replay: Replay, recorded: Recorded, answers: Answers, section: dict[str, Any]
) -> Record:
    """Give the recorded test with a node's answers, and the parameters that it had for them."""
    record = recorded.record
    return replace(
        record,
        experiment=type(record.experiment)({**record.experiment.sections, replay.node: section}),
        series={**record.series, replay.answer.name: answers.series},
        estimates=answers.estimates if replay.node == "reference_force" else record.estimates,
        environment={
            **describe_environment(f"replay of {replay.node}"),
            "replayed": record.environment,
        },
    )


def replay_verdict(replay: Replay, recorded: Recorded, answers: Answers) -> dict[str, Any]:
    """Compare the answers of a node with the recorded ones, by step, bit for bit.

    Returns
    -------
    dict
        JSON values: ``node``, ``topic``, ``identical``, ``first_difference`` (None, or topic,
        step, time_s, field, axis, recorded, replayed), ``steps`` (recorded answers to be given),
        ``answered``, ``ended`` (why not all were; else None), ``max_abs``, ``nrmse``, ``fields``,
        ``estimates`` (likewise, None where there are none), ``wall_s``, ``notes``.
    """
    record, topic = recorded.record, replay.answer.name
    # what was answered beyond the recorded steps has nothing to be compared with
    given = of_steps(answers.series, replay.expected.steps)
    names = {one.name: record.series[one.name] for one in LOOP_TOPICS}
    estimates: tuple[Estimates | None, ...] = (None, None)
    if replay.node == "reference_force":
        estimates = record.estimates, _until_end(answers.estimates, record.estimates)
    one, other = (
        replace(record, series={**names, topic: series}, estimates=told)
        for series, told in zip((replay.expected, given), estimates, strict=True)
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
    of_estimates = found["topics"].get(ESTIMATES.name)
    keys = ("max_abs", "nrmse", "fields")
    return {
        "node": replay.node,
        "topic": topic,
        "identical": found["identical"],
        "first_difference": first,
        "steps": len(replay.expected.steps),
        "answered": len(given.steps),
        "ended": answers.ended or None,
        **{key: found["topics"][topic][key] for key in keys},
        "estimates": None if of_estimates is None else {key: of_estimates[key] for key in keys},
        "wall_s": answers.wall_s,
        "notes": list(replay.notes),
    }


def _until_end(given: Estimates | None, recorded: Estimates | None) -> Estimates | None:
    if given is None or recorded is None:
        return given
    kept = given.steps <= recorded.steps[-1]
    return Estimates(given.steps[kept], given.values[kept], given.names)
