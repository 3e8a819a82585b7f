"""What a bag says of its test: one text (JSON) for each node, and one for the environment.

Where nobody recorded these, the messages of the loop tell axes and rate.
"""

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import islice, pairwise
from typing import Any

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import Section
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.timebase import NANOSECONDS_PER_SECOND
from seft_msgs_py.wire.topics import RIG_STATE, bare
from seft_msgs_py.wire.trajectory_layout import Trajectory, parse_trajectory

_ENOUGH = 2000  # messages that tell axes and rate


@dataclass
class Description:
    """What a test was: node -> its resolved parameters, and `describe_environment`, if told."""

    sections: dict[str, Section] = field(default_factory=dict)
    environment: dict[str, Any] = field(default_factory=dict)

    def experiment(self) -> Experiment:
        """Make the experiment of the nodes' parameters; of several rigs the first's count.

        Raises
        ------
        InputError
            If no node told its parameters, or they contradict one another.
        """
        if not self.sections:
            raise InputError("no node told its parameters")
        sections: dict[str, Section] = {}
        for node, section in self.sections.items():
            sections.setdefault(bare(node), section)
        try:
            return Experiment(sections)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(
                f"the parameters that nodes told make no experiment: {error!r}"
            ) from None


def write_description(sections: Mapping[str, Section], environment: Mapping[str, Any]) -> list[str]:
    """Texts that describe a test: one for each node, and one for the environment."""
    nodes = [{"node": node, "parameters": dict(section)} for node, section in sections.items()]
    return [
        json.dumps(part, allow_nan=False) for part in (*nodes, {"environment": dict(environment)})
    ]


def read_description(texts: Iterable[str]) -> tuple[Description, int]:
    """Put together what a bag's texts say, and count those that are no description.

    Of a node that spoke twice the last text counts.
    """
    description = Description()
    refused = 0
    for text in texts:
        try:
            part = json.loads(text)
        except (ValueError, RecursionError):
            part = None
        match part:
            case {"node": str(node), "parameters": dict(parameters)}:
                description.sections[node] = parameters
            case {"environment": dict(environment)}:
                description.environment = environment
            case _:
                refused += 1
    return description, refused


def infer_experiment(raws: Iterable[bytes]) -> Experiment:
    """Make an experiment that knows no more than axes and rate.

    The rate is that of the spacing which most samples have, so that lost ones do no harm.

    Parameters
    ----------
    raws : iterable of bytes
        Messages of one loop topic, of which the first few thousand are looked at.

    Raises
    ------
    InputError
        If they do not tell axes and rate.
    """
    messages = _understood(islice(raws, _ENOUGH))
    if not messages:
        raise InputError("no message of the loop can be understood")
    axes = Counter(message.axes for message in messages).most_common(1)[0][0]
    stamps = sorted({message.stamp_ns for message in messages})
    known = Counter(m.points[1].time_from_start_ns for m in messages if len(m.points) > 1)
    spacings = known or Counter(late - early for early, late in pairwise(stamps))
    if not spacings:
        raise InputError("one sample alone does not tell the rate")
    period_ns = spacings.most_common(1)[0][0]
    on_grid = sum(1 for stamp in stamps if period_ns > 0 and stamp % period_ns == 0)
    if 2 * on_grid <= len(stamps):
        raise InputError("stamps are not whole numbers of sampling periods")
    rate = NANOSECONDS_PER_SECOND / period_ns
    return Experiment({RIG_STATE.publisher: {"rate": rate, "axes": list(axes)}})


def _understood(raws: Iterable[bytes]) -> list[Trajectory]:
    messages = []
    for raw in raws:
        try:
            messages.append(parse_trajectory(raw))
        except WireError:
            continue
    return [message for message in messages if message.axes and message.points]
