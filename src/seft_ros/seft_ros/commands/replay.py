"""``seft replay``: a recorded test fed to one node once more."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer
from seft_msgs_py.config.parameter_file import Override, parse_override
from seft_msgs_py.errors import InputError

from seft_ros.commands.options import JsonOption, OverrideOption, complain, print_json
from seft_ros.commands.progress import step_progress

if TYPE_CHECKING:
    from seft_ros.replay.cue import Part
    from seft_ros.replay.recorded import Recorded


def replay(
    bag: Annotated[
        Path, typer.Argument(metavar="BAG", help="Folder (or file) of a recorded test.")
    ],
    node: Annotated[
        Optional[list[str]],
        typer.Option(
            "--node",
            metavar="NODE",
            help="reference_force, force_controller or rig; may be given many times. "
            "Default: all three, one after another.",
        ),
    ] = None,
    param: OverrideOption = None,
    offline: Annotated[
        bool,
        typer.Option("--offline", help="Feed the node's block in this process, without ROS."),
    ] = False,
    out: Annotated[
        Optional[Path],
        typer.Option(
            "--out",
            metavar="DIR",
            help="Write the test with the replayed answers in place of the recorded as a bag, "
            "must be new; with one --node alone.",
        ),
    ] = None,
    json: JsonOption = False,
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
    from seft_ros.commands.results import check_out
    from seft_ros.replay.parts import PARTS
    from seft_ros.replay.recorded import read_recorded

    nodes = list(dict.fromkeys(node or PARTS))
    if out is not None:
        if len(nodes) > 1:
            raise InputError("--out takes the answers of one node; name it with --node")
        check_out(out)
    overrides = [parse_override(text) for text in param or ()]
    if overrides and len(nodes) > 1:
        raise InputError("-p changes one node; name it with --node")
    recorded = read_recorded(bag)
    parts = _parts(nodes, recorded, asked=bool(node))
    results = [_replay(part, recorded, overrides, offline, out) for part in parts]
    for result in results:
        result["bag"] = str(bag)
        result["overrides"] = param or []
    if json:
        several = {"identical": all(one["identical"] for one in results), "replays": results}
        print_json(results[0] if len(results) == 1 else several)
    else:
        _show(results, out)
    return 0 if all(result["identical"] for result in results) else 1


def _parts(nodes: list[str], recorded: "Recorded", *, asked: bool) -> list["Part"]:
    """Make the parts for some nodes; of those that nobody asked for by name some may lack.

    Raises
    ------
    InputError
        If the bag does not have what a node was told that was asked for, or what any was told.
    """
    from seft_ros.replay.parts import part_for

    parts = []
    for name in nodes:
        try:
            parts.append(part_for(name, recorded))
        except InputError as error:
            if asked or (name == nodes[-1] and not parts):
                raise
            complain(f"{name} is left out: {error}")
    return parts


def _replay(
    part: "Part",
    recorded: "Recorded",
    overrides: list[Override],
    offline: bool,
    out: Path | None,
) -> dict[str, Any]:
    from seft_ros.replay.parts import experiment_of
    from seft_ros.replay.verdict import judge, replayed_record

    meant = experiment_of(part, recorded, overrides, fixed=False)
    with step_progress(len(part.expected().steps)) as show:
        if offline:
            answers = _answer_offline(part, meant[part.node], show)
        else:
            from seft_ros.replay.stage import play

            answers = play(part, experiment_of(part, recorded, overrides), show)
    result = judge(part, recorded, answers)
    if out is not None:
        from seft_ros.recording.record_bag import write_record

        record = replayed_record(part, recorded, answers, meant[part.node])
        write_record(record, out, ground_motion=recorded.chunks)
        result["out"] = str(out)
    return result


def _answer_offline(part: Any, section: dict[str, Any], show: Callable[[str, int], None]) -> Any:
    import time

    from seft_ros.replay.answers import Answers

    show(f"{part.node} answers offline", 0)
    start = time.monotonic()
    series, estimates = part.computed(section)
    show(f"{part.node} has answered", len(series.steps))
    return Answers(series, estimates, time.monotonic() - start)


def _show(results: list[dict[str, Any]], out: Path | None) -> None:
    from rich.console import Console

    from seft_ros.replay.replay_table import replay_table

    console = Console()
    for result in results:
        console.print(replay_table(result))
        for note in result["notes"]:
            complain(f"{result['node']}: {note}")
        if result["ended"]:
            complain(f"{result['node']} answered no more: {result['ended']}")
    if out is not None:
        console.print(f"bag: {out}", soft_wrap=True, highlight=False)
