"""``seft simulate``: the experiment in one process, without ROS."""

from pathlib import Path
from typing import Annotated, Optional

import typer

from seft_ros.commands.options import (
    ConfigArgument,
    FigureOption,
    JsonOption,
    OverrideOption,
    ParamsFileOption,
    complain,
    load_experiment,
)
from seft_ros.commands.progress import step_progress
from seft_ros.commands.results import check_out, present, save


def simulate(
    config: ConfigArgument,
    param: OverrideOption = None,
    params_file: ParamsFileOption = None,
    out: Annotated[
        Optional[Path],
        typer.Option(
            "--out",
            metavar="DIR",
            help="Write a bag of the same form as seft run, and a figure, into this new folder.",
        ),
    ] = None,
    figure: FigureOption = True,
    json: JsonOption = False,
) -> int:
    """Run an experiment in one process, without ROS, and compare it with the exact response.

    The samples are, bit for bit, those of seft run where no command was missed.

    Examples:

        seft simulate config/jhu.yaml

        seft simulate config/jhu.yaml -p reference_force:mass_ratio:=0.5 --out bags/half

        seft simulate config/jhu.yaml -p ground_motion:file:=kobe.txt
        -p ground_motion:unit:=cm/s2 -p ground_motion:dt:=0.005 --json
    """
    from seft_ros.experiment.blocks import build_blocks
    from seft_ros.experiment.offline import simulate as run_offline

    experiment = load_experiment(config, param, params_file)
    if out is not None:
        check_out(out)
    blocks = build_blocks(experiment)
    with step_progress(blocks.ground_motion.steps) as show:
        record = run_offline(experiment, blocks, lambda done: show("simulating", done))
        show("done", len(record.series["rig/state"].steps))
    bag = save(record, blocks, out) if out is not None else None
    summary = present(record, bag, as_json=json, figure=figure)
    if not summary["stable"]:
        complain(f"unstable: {record.trip.reason if record.trip else 'values are not finite'}")
        return 1
    return 0
