"""``seft replay``: a recorded test fed to one node once more."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

from seft_msgs_py.config.experiment import Override, parse_override
from seft_msgs_py.errors import InputError

from seft_ros.commands.one_test import check_out
from seft_ros.commands.options import Bag, Json, Params, option
from seft_ros.commands.output import complain, show, step_progress

if TYPE_CHECKING:
    from seft_ros.bags.recorded_test import Recorded, Replay


def replay(
    bag: Bag,
    node: Annotated[
        Optional[list[str]],
        option(
            "reference_force, force_controller or rig; may be given many times. "
            "Default: all three, one after another.",
            "NODE",
        ),
    ] = None,
    param: Params = None,
    offline: Annotated[
        bool, option("Feed the node's block in this process, without ROS.", "--offline")
    ] = False,
    out: Annotated[
        Optional[Path],
        option(
            "Write the test with the replayed answers in place of the recorded as a bag, "
            "must be new; with one --node alone.",
            "DIR",
        ),
    ] = None,
    json: Json = False,
) -> int:
    """Feed a recorded test to one node, and see that it answers as recorded, bit for bit.

    The node runs as a process over DDS with its recorded parameters; the replay plays the others:
    it sends what the node was told, step by step, each when the one before is answered. So it is
    as fast as the node, and nothing is lost. What -p overrides shows what a change does.

    reference_force is told ground_motion, rig/state and when the operator or a fault brought the
    force down; force_controller rig/state and reference_force; rig valve_command, the held ones
    for those that it missed. Of the other nodes none runs.

    Exit status 0 if all answers are identical, 1 if not.

    Examples:

        seft replay bags/lockstep

        seft replay bags/lockstep --node reference_force

        seft replay bags/lockstep --node reference_force
        -p reference_force:compensation.method:=none --out bags/none

        seft compare bags/lockstep bags/none

        seft replay bags/lockstep --node rig --offline --json
    """
    from seft_ros.bags.node_replays import REPLAYS
    from seft_ros.bags.recorded_test import read_recorded
    from seft_ros.bags.replay_verdict import replay_table

    nodes = list(dict.fromkeys(node or REPLAYS))
    if out is not None:
        if len(nodes) > 1:
            raise InputError("--out takes the answers of one node; name it with --node")
        check_out(out)
    overrides = [parse_override(text) for text in param or ()]
    if overrides and len(nodes) > 1:
        raise InputError("-p changes one node; name it with --node")
    recorded = read_recorded(bag)
    replays = _replays(nodes, recorded, asked=bool(node))
    given = {"bag": str(bag), "overrides": param or []}
    results = [_answers(one, recorded, overrides, offline, out) | given for one in replays]
    identical = all(one["identical"] for one in results)
    one_or_all = results[0] if len(results) == 1 else {"identical": identical, "replays": results}
    tables = [replay_table(result) for result in results]
    show(one_or_all, json, [*tables, *([f"bag: {out}"] if out else [])])
    for result in results if not json else ():
        for note in result["notes"]:
            complain(f"{result['node']}: {note}")
        if result["ended"]:
            complain(f"{result['node']} answered no more: {result['ended']}")
    return 0 if identical else 1


def _replays(nodes: list[str], recorded: "Recorded", *, asked: bool) -> list["Replay"]:
    """Make the replays to some nodes; of those that nobody asked for by name some may lack.

    Raises
    ------
    InputError
        If the bag does not have what a node was told that was asked for, or what any was told.
    """
    from seft_ros.bags.node_replays import replay_to

    replays: list[Replay] = []
    for name in nodes:
        try:
            replays.append(replay_to(name, recorded))
        except InputError as error:
            if asked or (name == nodes[-1] and not replays):
                raise
            complain(f"{name} is left out: {error}")
    return replays


def _answers(
    replay: "Replay",
    recorded: "Recorded",
    overrides: Sequence[Override],
    offline: bool,
    out: Path | None,
) -> dict[str, Any]:
    from seft_ros.bags.dds_replay import replay_over_dds
    from seft_ros.bags.record_bag import write_record
    from seft_ros.bags.recorded_test import Answers, experiment_of
    from seft_ros.bags.replay_verdict import replay_verdict, replayed_record

    meant = experiment_of(replay, overrides, fixed=False)
    section = meant[replay.node]
    with step_progress(len(replay.expected.steps)) as tell:
        if offline:
            tell(f"{replay.node} answers offline", 0)
            start = time.monotonic()
            answers = Answers(*replay.computed(section), time.monotonic() - start)
            tell(f"{replay.node} has answered", len(answers.series.steps))
        else:
            answers = replay_over_dds(replay, experiment_of(replay, overrides), tell)
    result = replay_verdict(replay, recorded, answers)
    if out is not None:
        record = replayed_record(replay, recorded, answers, section)
        write_record(record, out, ground_motion=recorded.chunks)
        result["out"] = str(out)
    return result
