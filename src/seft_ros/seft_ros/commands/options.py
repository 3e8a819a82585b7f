"""Options that several commands share, and what they have in common in printing."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from seft_msgs_py.experiment import Experiment
from seft_msgs_py.parameter_file import parse_override

from seft_ros.experiment.tables import TABLES

ConfigArgument = Annotated[
    Path, typer.Argument(metavar="CONFIG", help="Experiment: a ROS 2 parameter file.")
]
OverrideOption = Annotated[
    list[str] | None,
    typer.Option(
        "-p",
        "--param",
        metavar="NODE:PARAMETER:=VALUE",
        help="Override a parameter, as in ROS 2; may be given many times.",
    ),
]
JsonOption = Annotated[
    bool,
    typer.Option("--json", help="Print one JSON object on stdout, and nothing else there."),
]


def load_experiment(config: Path, overrides: list[str] | None) -> Experiment:
    """Read an experiment of a command line."""
    return Experiment.load(TABLES, [config], [parse_override(text) for text in overrides or ()])


def print_json(value: dict[str, Any]) -> None:
    """Print an object as JSON on stdout."""
    print(json.dumps(value, indent=2, allow_nan=False))


def complain(text: str) -> None:
    """Say one line on stderr."""
    print(f"seft: {text}", file=sys.stderr, flush=True)


def stderr_console() -> Console:
    """Console for progress: stderr, so that stdout holds results alone."""
    return Console(stderr=True)
