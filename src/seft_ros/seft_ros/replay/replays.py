"""The nodes that a test can be replayed to, and what they are started with."""

from collections.abc import Sequence

from seft_msgs_py.config.experiment import EVERY_NODE, Experiment, Override
from seft_msgs_py.config.parameter_table import COMMON, nearest
from seft_msgs_py.errors import InputError
from seft_msgs_py.node import realtime

from seft_ros.replay.force_controller_replay import ForceControllerReplay
from seft_ros.replay.recorded import Recorded
from seft_ros.replay.reference_force_replay import ReferenceForceReplay
from seft_ros.replay.replay_step import Replay
from seft_ros.replay.rig_replay import RigReplay
from seft_ros.test_run.parameter_tables import TABLES

REPLAYS: dict[str, type[Replay]] = {
    kind.node: kind for kind in (ReferenceForceReplay, ForceControllerReplay, RigReplay)
}
_UNTIMED = {row.name: row.default for row in realtime.PARAMETERS}
"""A replay keeps no time."""


def replay_to(node: str, recorded: Recorded) -> Replay:
    """Make the replay of a test to a node.

    Raises
    ------
    InputError
        If the bag does not have what the node was told, or is no node that can be replayed to.
    """
    if node not in REPLAYS:
        known = ", ".join(REPLAYS)
        raise InputError(f"--node {node}: must be one of {known}{nearest(node, REPLAYS)}")
    if node not in recorded.record.experiment.sections:
        raise InputError(f"the bag does not tell the parameters of {node}")
    return REPLAYS[node](recorded)


def experiment_of(replay: Replay, overrides: Sequence[Override], fixed: bool = True) -> Experiment:
    """Give the experiment that a node is started with: as recorded, but for what is overridden.

    If ``fixed``, parameters are set that a replay needs to be otherwise.

    Raises
    ------
    InputError
        If a parameter is none of the node's, or one that the samples depend on.
    """
    section = replay.experiment[replay.node]
    common = {row.name for row in COMMON}
    given = [(replay.node, name, value) for name, value in section.items() if name not in common]
    given += [(EVERY_NODE, name, section[name]) for name in sorted(common)]
    if fixed:
        known = next(table for table in TABLES if table.node == replay.node).rows
        values = {**_UNTIMED, **replay.fixed}
        given += [(replay.node, name, value) for name, value in values.items() if name in known]
    for node, name, _ in overrides:
        if name in common:
            raise InputError(f"-p {name}: the recorded samples have their own {name}")
        if node not in (replay.node, EVERY_NODE):
            raise InputError(f"-p {node}:{name}: the replay is to {replay.node} alone")
    return Experiment.load(TABLES, [], [*given, *overrides], nodes=[replay.node])
