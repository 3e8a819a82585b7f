"""What is known of a rig before it moves."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import VALVE_COMMAND
from seft_msgs_py.wire.trajectory import Floats
from seft_plant_sim.rig.limits import NAMES
from seft_plant_sim.specimen.specimen import Specimen


@dataclass(frozen=True)
class Facts:
    """A rig, as the experiment has it and as it describes itself.

    Attributes
    ----------
    experiment : Experiment
        Rate and axes.
    limits : ndarray
        Largest displacement (m), velocity (m/s), acceleration (m/s^2) and force (N), shape (4,).
    specimen : tuple of ndarray or None
        Mass, damping and stiffness, shape (n, n) each; None where they are not known.
    parameters : dict
        The rig's own parameters, as it tells them; empty before.
    drive : str
        Topic that drives it.
    """

    experiment: Experiment
    limits: Floats
    specimen: tuple[Floats, Floats, Floats] | None
    parameters: Mapping[str, Any]
    drive: str = VALVE_COMMAND.name

    @classmethod
    def of(cls, experiment: Experiment) -> "Facts":
        """Take from an experiment what it says of its rig, and of the specimen on it."""
        supervisor = experiment["supervisor"]
        limits = np.array([supervisor[f"limits.{name}"] for name in NAMES])
        return cls(experiment, limits, _specimen(experiment), {})

    def described(self, description: Mapping[str, Any]) -> "Facts":
        """Add what the rig says of itself."""
        drive = description.get("drive", VALVE_COMMAND.name)
        return replace(self, parameters=description["parameters"], drive=str(drive))

    @property
    def dt(self) -> float:
        """Sampling period, s."""
        return self.experiment.timebase.dt

    @property
    def command_timeout(self) -> float:
        """Time without a command in which the rig must trip, s."""
        return self._told("watchdog.command_timeout")

    @property
    def supervisor_timeout(self) -> float:
        """Silence of the supervisor in which it must trip, s."""
        return self._told("watchdog.supervisor_timeout")

    @property
    def largest_command(self) -> float | None:
        """Largest command that the rig applies, in the unit of what drives it; None: not told."""
        name = "limits.command" if self.drive == VALVE_COMMAND.name else "limits.force"
        value = self.parameters.get(name)
        return float(value) if isinstance(value, int | float) else None

    def _told(self, name: str) -> float:
        value = self.parameters.get(name)
        if isinstance(value, int | float) and value > 0:
            return float(value)
        return float(self.experiment["supervisor"].get(name, 1.0))


def _specimen(experiment: Experiment) -> tuple[Floats, Floats, Floats] | None:
    """Take the specimen of a rig that is simulated, else the reference force's model of it."""
    rig, force = experiment.sections.get("rig"), experiment.sections.get("reference_force")
    given = None
    if rig is not None and rig.get("specimen.mass") is not None:
        given = {name: rig[f"specimen.{name}"] for name in ("mass", "damping", "stiffness")}
    elif force is not None and force.get("model.mass") is not None:
        given = {name: force[f"model.{name}"] for name in ("mass", "damping", "stiffness")}
    if given is None:
        return None
    try:
        made = Specimen.from_parameters({"kind": "linear", **given}, experiment.axes, "specimen")
    except (InputError, KeyError):
        return None
    return made.mass, made.damping, made.stiffness
