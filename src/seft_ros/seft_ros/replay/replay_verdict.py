"""Compare a node's answers with the recorded ones: verdict, first difference, table."""

from dataclasses import replace
from typing import Any

from rich.console import Group
from rich.text import Text
from seft_msgs_py.wire.topics import ESTIMATES, LOOP_TOPICS

from seft_ros.analysis.comparison import compare
from seft_ros.analysis.result_text import FIELD_UNITS
from seft_ros.bags.description import describe_environment
from seft_ros.bags.record import Estimates, Record
from seft_ros.drawing.tables import make_table, number, small_percent
from seft_ros.replay.recorded_test import Answers, Recorded, Replay


def replayed_record(
    replay: Replay, recorded: Recorded, answers: Answers, section: dict[str, Any]
) -> Record:
    """Give the recorded test with a node's answers, and the parameters of the replay."""
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
        step, time_s, field, axis, recorded, replayed), ``steps`` (of the recorded answers),
        ``answered``, ``ended`` (why some are missing; else None), ``max_abs``, ``nrmse``,
        ``fields``, ``estimates`` (likewise; None where there are none), ``wall_s``, ``notes``.
    """
    record, topic = recorded.record, replay.answer.name
    # answers beyond the recorded steps have no counterpart
    given = answers.series.of_steps(replay.expected.steps)
    names = {one.name: record.series[one.name] for one in LOOP_TOPICS}
    estimates: tuple[Estimates | None, ...] = (None, None)
    if replay.node == "reference_force":
        mine, theirs = answers.estimates, record.estimates
        if mine is not None and theirs is not None:
            mine = mine.until(int(theirs.steps[-1]))
        estimates = theirs, mine
    one, other = (
        replace(record, series={**names, topic: series}, estimates=some)
        for series, some in zip((replay.expected, given), estimates, strict=True)
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


def verdict(result: dict[str, Any]) -> str:
    """Say in one line whether a node answered as recorded, see `replay_verdict`."""
    node, first = result["node"], result["first_difference"]
    if first is None:
        return f"{node}: {result['steps']} answers identical, bit for bit"
    where = f"{node}: first difference at step {first['step']} ({first['time_s']:g} s)"
    if first["field"] is None:
        return f"{where}: {first['topic']} is {first['replayed']}, but was {first['recorded']}"
    return (
        f"{where}, {first['topic']}, {first['field']} of axis {first['axis']}: recorded "
        f"{first['recorded']!r}, replayed {first['replayed']!r}"
    )


def replay_table(result: dict[str, Any]) -> Group:
    """Tabulate how the answers of a node differ from the recorded ones; the verdict below."""
    rate = result["answered"] / result["wall_s"] if result["wall_s"] else 0.0
    groups = {result["topic"]: result["fields"]}
    if result["estimates"] is not None:
        groups["estimates"] = result["estimates"]["fields"]
    rows = [
        [
            f"{topic} {name}",
            f"{number(row['max_abs'], form='.3g')} {FIELD_UNITS.get((topic, name), '')}".strip(),
            small_percent(row["nrmse"]),
        ]
        for topic, fields in groups.items()
        for name, row in fields.items()
    ]
    title = (
        f"{result['node']}: {result['answered']} of {result['steps']} answers, {rate:.0f} a second"
    )
    table = make_table(("answers", "largest\ndifference", "NRMSE"), rows, title=title)
    colour = "green" if result["identical"] else "red"
    return Group(table, Text(verdict(result), style=f"bold {colour}"))
