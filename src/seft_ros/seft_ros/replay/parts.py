"""The nodes that a test can be replayed to, and what they are started with."""

from collections.abc import Sequence

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_file import EVERY_NODE, Override
from seft_msgs_py.config.parameter_table import COMMON, nearest
from seft_msgs_py.errors import InputError
from seft_msgs_py.node import realtime

from seft_ros.experiment.tables import TABLES
from seft_ros.replay.cue import Part
from seft_ros.replay.force_controller import ForceControllerPart
from seft_ros.replay.recorded import Recorded
from seft_ros.replay.reference_force import ReferenceForcePart
from seft_ros.replay.rig import RigPart

PARTS = {part.node: part for part in (ReferenceForcePart, ForceControllerPart, RigPart)}
_UNTIMED = {row.name: row.default for row in realtime.PARAMETERS}
"""A replay keeps no time."""


def part_for(node: str, recorded: Recorded) -> Part:
    """Make the parts of the others for a node.

    Raises
    ------
    InputError
        If the bag does not have what the node was told, or is no node that can be replayed to.
    """
    if node not in PARTS:
        known = ", ".join(PARTS)
        raise InputError(f"--node {node}: must be one of {known}{nearest(node, PARTS)}")
    if node not in recorded.record.experiment.sections:
        raise InputError(f"the bag does not tell the parameters of {node}")
    return PARTS[node](recorded)


def experiment_of(
    part: Part, recorded: Recorded, overrides: Sequence[Override], fixed: bool = True
) -> Experiment:
    """Give the experiment that a node is started with: as recorded, but for what is overridden.

    Parameters
    ----------
    part : Part
        For which node.
    recorded : Recorded
        The test.
    overrides : sequence of (node, parameter, value)
        As on a command line.
    fixed : bool
        Whether parameters are set that a replay needs to be otherwise.

    Raises
    ------
    InputError
        If a parameter is none of the node's, or one that the samples depend on.
    """
    section = recorded.record.experiment[part.node]
    common = {row.name for row in COMMON}
    given = [(part.node, name, value) for name, value in section.items() if name not in common]
    given += [(EVERY_NODE, name, section[name]) for name in sorted(common)]
    if fixed:
        known = next(table for table in TABLES if table.node == part.node).rows
        values = {**_UNTIMED, **part.fixed}
        given += [(part.node, name, value) for name, value in values.items() if name in known]
    for node, name, _ in overrides:
        if name in common:
            raise InputError(f"-p {name}: the recorded samples have their own {name}")
        if node not in (part.node, EVERY_NODE):
            raise InputError(f"-p {node}:{name}: the replay is to {part.node} alone")
    return Experiment.load(TABLES, [], [*given, *overrides], nodes=[part.node])
