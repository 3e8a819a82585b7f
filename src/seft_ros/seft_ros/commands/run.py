"""``seft run``: the experiment as separate node processes over DDS."""

import signal
from pathlib import Path
from typing import Annotated

import typer
from seft_msgs_py.errors import ExperimentError

from seft_ros.commands.options import (
    ConfigArgument,
    JsonOption,
    OverrideOption,
    complain,
    load_experiment,
)
from seft_ros.commands.progress import step_progress
from seft_ros.commands.results import present


def run(
    config: ConfigArgument,
    param: OverrideOption = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            help="Folder of the bag, must be new; default the recorder's directory and the time.",
        ),
    ] = None,
    pin: Annotated[
        bool,
        typer.Option(
            "--pin/--no-pin",
            help="Keep the loop's nodes on one processor core and the others off it.",
        ),
    ] = True,
    json: JsonOption = False,
) -> int:
    """Run an experiment as separate nodes over DDS, record it, and show how it went.

    Starts ground_motion, reference_force, force_controller, rig, recorder and supervisor,
    waits until all have found each other, runs the test, and ends them.

    Examples:

        seft run config/demo.yaml

        seft run config/jhu.yaml -p rig:pace:=lockstep --out bags/lockstep

        ROS_DOMAIN_ID=7 seft run config/jhu.yaml --json
    """
    from seft_ros.experiment.blocks import build_blocks
    from seft_ros.recording.bag_reader import read_bag
    from seft_ros.running.run import bag_path, run_experiment

    experiment = load_experiment(config, param)
    bag = bag_path(experiment, out)
    steps = build_blocks(experiment).ground_motion.steps
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: end in order
    with step_progress(steps) as show:
        try:
            finished = run_experiment(experiment, bag, show, pin=pin)
        except KeyboardInterrupt:
            kept = f"; what was recorded is in {bag}" if bag.exists() else ""
            raise ExperimentError(f"interrupted{kept}") from None
    if finished.fault:
        raise ExperimentError(f"{finished.fault}; what was recorded is in {finished.bag}")
    record = read_bag(finished.bag)
    summary = present(record, finished.bag, as_json=json)
    if not summary["stable"]:
        complain(f"the test tripped: {record.trip.reason}" if record.trip else "unstable")
        return 1
    return 0
