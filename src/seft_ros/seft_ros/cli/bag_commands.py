"""Commands on recorded tests: ``seft report``, ``seft recover`` and ``seft compare``.

``seft replay``: a recorded test computed once more.
"""

from pathlib import Path
from typing import Optional

import typer
from seft_msgs_py.config.experiment import parse_override
from seft_msgs_py.errors import InputError

from seft_ros.cli import shared
from seft_ros.cli.shared import option


def report(
    bag: shared.BagArgument,
    out: Optional[Path] = option(None, "The page; default report.html in BAG.", "FILE"),
    csv: Optional[Path] = option(None, "Write the time histories as csv.", "FILE"),
    json: shared.Json = False,
) -> int:
    """Assess a recorded test, and write a page about it.

    Writes one HTML page that needs no network: verdict, what was tested, displacement, force and
    acceleration against the exact response of the whole structure with windows at the peaks,
    force tracking, hysteresis, spectra, energy, timing, estimates, events. Drag to zoom, click a
    name in a legend to hide its line. --json prints the same numbers. --csv writes a row
    for each step: ground acceleration, displacement, velocity, acceleration, force, reference
    force, valve command and exact response, with units in the names.

    The bag holds all that is needed: samples, configuration, versions. Of a damaged bag, as of a
    killed recorder, the report is of what can be read; it says what is wrong and missing.

    Examples:

        seft report bags/half

        seft report bags/half --json

        seft report bags/half --out half.html

        seft report bags/half --csv half.csv
    """
    from seft_ros.analysis.report_numbers import histories, report_numbers
    from seft_ros.analysis.report_page import write_report
    from seft_ros.analysis.result_text import summary_texts
    from seft_ros.bags.recording_bag import read_bag
    from seft_ros.drawing.page import check_page
    from seft_ros.drawing.style import check_table, write_table

    beside = bag.with_suffix(".html") if bag.is_file() else bag / "report.html"
    page = beside if out is None else check_page(out)
    table = None if csv is None else check_table(csv)
    findings = report_numbers(read_bag(bag, damaged=True))
    write_report(findings, bag.resolve().name, page)
    shared.stands(f"{page} is written")
    summary = findings.summary | {"bag": str(bag), "page": str(page)}
    if table is not None:
        write_table(table, *histories(findings.recording, findings.reference))
        summary["csv"] = str(table)
    shared.show(summary, json, summary_texts(findings), "page", "csv")
    right = summary["stable"] and summary["complete"] and not summary["damage"]
    return 0 if right else 1


def recover(bag: shared.BagArgument) -> int:
    """Make a whole bag of a damaged one, or of that of a killed recorder.

    Every message is kept that can be read; what is missing is printed, and stays in the bag. The
    damaged original stays beside it, named .cut. An intact bag is left as it is.

    Example:

        seft recover bags/half
    """
    from seft_ros.bags.bag_files import recover_bag as recover_bag

    print(recover_bag(bag))
    return 0


def compare(
    bag: shared.BagArgument,
    other: Path = typer.Argument(..., metavar="BAG", help="Test to compare with it."),
    figure: Optional[Path] = option(None, "Draw both tests in one figure.", "FILE"),
    json: shared.Json = False,
) -> int:
    """Compare two recorded tests, sample by sample, bit for bit.

    Samples are aligned by the step in their stamps, independent of duration and recorder; rate and
    axes must be the same. If tests differ in length, the common part is compared, and the remainder
    is reported.

    Bags are mcap or sqlite3, also those of ros2 bag record: compressed, split into files, with
    other topics.

    Exit status 0 if all samples on the loop's topics are identical, 1 if not.

    Examples:

        seft simulate config/jhu.yaml --out bags/simulated

        seft run config/jhu.yaml -p rig:pace:=lockstep --out bags/lockstep

        seft compare bags/simulated bags/lockstep

    Hardware against the simulation, as a picture:

        seft compare bags/simulated bags/lab --figure both.png

    What the stock recorder wrote, for a script; first_difference names topic, step and field:

        ros2 bag record --all --output bags/stock

        seft compare bags/simulated bags/stock --json
    """
    from seft_ros.analysis.comparison import compare_recordings, describe_bag
    from seft_ros.analysis.figures import comparison_figure
    from seft_ros.analysis.result_text import comparison_texts, legend
    from seft_ros.bags.recording_bag import read_bag
    from seft_ros.drawing.style import check_figure, save_figure

    path = check_figure(figure) if figure is not None else None
    names = [str(bag), str(other)]
    a, b = (read_bag(name, damaged=True) for name in names)
    result = compare_recordings(a, b)
    result["bags"] = [describe_bag(*one) for one in zip(names, (a, b), strict=True)]
    if path is not None:
        titles = [f"a: {bag.name}", f"b: {other.name}"]
        save_figure(comparison_figure(a, b, result, titles), path)
        result["figure"] = str(path)
    texts = [*map(legend, "ab", result["bags"]), *comparison_texts(result)]
    shared.show(result, json, texts, "figure")
    for name, recording in zip(names, (a, b), strict=True):
        for fault in recording.damage:
            shared.complain(f"{name} is damaged: {fault}")
    return 0 if result["identical"] else 1


def replay(
    bag: shared.BagArgument,
    node: Optional[list[str]] = option(None, "Node; may be repeated; default all.", "NODE"),
    param: shared.Params = None,
    json: shared.Json = False,
) -> int:
    """Compute each node's answers of a recorded test once more, and compare them bit for bit.

    The node's block is computed here, step by step, with the recorded parameters and what the node
    received in the test. -p, with one --node, shows the effect of a changed parameter.

    reference_force takes ground_motion, rig/state, and the ramps that the operator or a fault
    started; force_controller takes rig/state and reference_force; rig takes valve_command, and
    holds its command where it missed one in the test.

    Exit status 0 if all answers are identical, 1 if not.

    Examples:

        seft replay bags/lockstep

        seft replay bags/lockstep --node reference_force

        seft replay bags/lockstep --node rig -p rig:seed:=2

        seft replay bags/lockstep --node rig --json
    """
    from seft_ros.replay import node_replays

    nodes = list(dict.fromkeys(node or node_replays.REPLAYS))
    overrides = [parse_override(text) for text in param or ()]
    if overrides and len(nodes) > 1:
        raise InputError("-p needs one --node, whose parameters it changes")
    recorded, replays = node_replays.read_recorded(bag), []
    for name in nodes:
        try:
            replays.append(node_replays.replay_to(name, recorded))
        except InputError as error:  # the bag lacks the messages to this node
            if node or (name == nodes[-1] and not replays):
                raise
            shared.complain(f"{name} is left out: {error}")
    results = []
    for one in replays:
        section = node_replays.section_of(one, overrides)
        with shared.step_progress(len(one.expected.steps)) as progress:
            progress(f"computing {one.node}", 0)
            answers, estimates = one.computed(section)
            progress(f"{one.node} has answered", len(answers.steps))
        result = node_replays.replay_verdict(one, recorded, answers, estimates)
        results.append(result | {"bag": str(bag), "overrides": param or []})
    identical = all(one["identical"] for one in results)
    one_or_all = results[0] if len(results) == 1 else {"identical": identical, "replays": results}
    texts = [text for result in results for text in node_replays.replay_texts(result)]
    shared.show(one_or_all, json, texts)
    for result in results if not json else ():
        for note in result["notes"]:
            shared.complain(f"{result['node']}: {note}")
    return 0 if identical else 1
