"""Options that several commands share, and the experiment that they name."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Optional

import typer
from seft_msgs_py.config.experiment import Experiment, parse_override
from seft_msgs_py.config.parameter_table import nearest
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import NODES, with_rigs

from seft_ros.design import Source
from seft_ros.test_run.parameter_tables import TABLES


def option(text: str, named: str | None = None, **more: Any) -> Any:
    """Make an option with a help text.

    ``named`` is what its value is called, where it has the name of its parameter; or its own
    name, ``--json``, where it takes no value.
    """
    names, metavar = ([named], None) if named and named.startswith("--") else ([], named)
    return typer.Option(*names, help=text, metavar=metavar, **more)


Config = Annotated[
    Path, typer.Argument(metavar="CONFIG", help="Experiment: a ROS 2 parameter file.")
]
Bag = Annotated[Path, typer.Argument(metavar="BAG", help="Folder (or file) of a recorded test.")]
Params = Annotated[
    Optional[list[str]],
    typer.Option(
        "-p",
        "--param",
        metavar="NODE:PARAMETER:=VALUE",
        help="Override a parameter, as in ROS 2; may be given many times.",
    ),
]
Files = Annotated[
    Optional[list[Path]],
    option(
        "Another parameter file, whose values win over CONFIG's; may be given many times.", "FILE"
    ),
]
Plant = Annotated[
    Source,
    option(
        "rig: the simulated rig's linear model; identified: plant.* of force_controller; "
        "auto: the identified one where it is given."
    ),
]
External = Annotated[
    Optional[list[str]],
    option(
        "This node runs already, started by someone else, such as a lab's hardware driver "
        "as rig; its parameters are its own. May be given many times.",
        "NODE",
    ),
]
Json = Annotated[bool, option("Print one JSON object on stdout, and nothing else there.", "--json")]


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
