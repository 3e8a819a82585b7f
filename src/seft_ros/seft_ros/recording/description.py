"""What a bag says of its test: one text (JSON) for each node, and one for the environment."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import Section
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.rigs import bare


@dataclass
class Description:
    """What a test was.

    Attributes
    ----------
    sections : dict
        Node -> its resolved parameters.
    environment : dict
        As `describe_environment` gives it; empty if it was not told.
    """

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
    """Put together what a bag's texts say; of a node that spoke twice the last text counts.

    Returns
    -------
    description : Description
        What could be understood.
    refused : int
        Number of texts that are no description.
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
