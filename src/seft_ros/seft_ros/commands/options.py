"""Options that several commands share, and what they have in common in printing."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Optional

import typer
from rich.console import Console
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_file import parse_override
from seft_msgs_py.config.parameter_table import nearest
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.rigs import with_rigs
from seft_msgs_py.wire.topics import NODES

from seft_ros.experiment.tables import TABLES
from seft_ros.loop_shaping.source import Source

ConfigArgument = Annotated[
    Path, typer.Argument(metavar="CONFIG", help="Experiment: a ROS 2 parameter file.")
]
OverrideOption = Annotated[
    Optional[list[str]],
    typer.Option(
        "-p",
        "--param",
        metavar="NODE:PARAMETER:=VALUE",
        help="Override a parameter, as in ROS 2; may be given many times.",
    ),
]
ParamsFileOption = Annotated[
    Optional[list[Path]],
    typer.Option(
        "--params-file",
        metavar="FILE",
        help="Another parameter file, whose values win over CONFIG's; may be given many times.",
    ),
]
PlantOption = Annotated[
    Source,
    typer.Option(
        "--plant",
        help="rig: the simulated rig's linear model; identified: plant.* of force_controller; "
        "auto: the identified one where it is given.",
    ),
]

ExternalOption = Annotated[
    Optional[list[str]],
    typer.Option(
        "--external",
        metavar="NODE",
        help="This node runs already, started by someone else, such as a lab's hardware driver "
        "as rig; its parameters are its own. May be given many times.",
    ),
]
FigureOption = Annotated[
    bool,
    typer.Option("--figure/--no-figure", help="Draw a figure into the bag's folder."),
]
JsonOption = Annotated[
    bool,
    typer.Option("--json", help="Print one JSON object on stdout, and nothing else there."),
]


def load_experiment(
    config: Path,
    overrides: list[str] | None,
    params_files: Sequence[Path] | None = None,
    external: Sequence[str] | None = None,
) -> Experiment:
    """Read an experiment of a command line; nodes that are external have no section in it."""
    experiment = Experiment.load(
        [table for table in TABLES if table.node not in (external or ())],
        [config, *(params_files or ())],
        [parse_override(text) for text in overrides or ()],
    )
    possible = [node for node in NODES if node not in ("supervisor", "recorder")]
    possible = list(dict.fromkeys([*possible, *with_rigs(possible, experiment.rigs)]))
    for node in external or ():
        if node not in possible:
            raise InputError(
                f"--external {node}: must be one of {', '.join(possible)}{nearest(node, possible)}"
            )
    return experiment


def print_json(value: dict[str, Any]) -> None:
    """Print an object as JSON on stdout."""
    print(json.dumps(value, indent=2, allow_nan=False))


def complain(text: str) -> None:
    """Say one line on stderr."""
    print(f"seft: {text}", file=sys.stderr, flush=True)


def stderr_console() -> Console:
    """Console for progress: stderr, so that stdout holds results alone."""
    return Console(stderr=True)
