"""The simulated rig: actuator, specimen, sensors and limits, stepped by commands."""

from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import per_axis
from seft_msgs_py.parameters import group
from seft_msgs_py.timebase import Timebase

from seft_plant_sim.actuator import ContinuousModel, Drive, delayed_force, servo_hydraulic
from seft_plant_sim.limits import Limits
from seft_plant_sim.plant import LinearPlant
from seft_plant_sim.sensors import Sensors
from seft_plant_sim.specimen import LinearSpecimen

Floats = npt.NDArray[np.float64]


class Rig:
    """What a lab's rig is to the rest of a test: it measures, and it obeys commands.

    Parameters
    ----------
    model : ContinuousModel
        Actuator and specimen.
    sensors : Sensors
        What is measured of them.
    limits : Limits
        What trips the test.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    drive : str
        Topic that drives the actuator: ``valve_command`` or ``reference_force``.
    step_index : int
        Step of the last sample.
    violation : str or None
        The limit that the last sample breaks; the test must end with that sample.
    """

    def __init__(self, model: ContinuousModel, sensors: Sensors, limits: Limits, dt: float) -> None:
        self.drive: Drive = model.drive
        self._plant = LinearPlant(model, dt)
        self._sensors = sensors
        self._limits = limits
        self.step_index = 0
        self.violation: str | None = None

    @classmethod
    def from_parameters(
        cls, section: dict[str, Any], axes: tuple[str, ...], timebase: Timebase
    ) -> "Rig":
        """Make the rig of its section of an experiment.

        Raises
        ------
        InputError
            If sizes do not fit the axes, or values make no rig.
        """
        return cls(
            continuous_model(section, axes),
            Sensors.from_parameters(
                group(section, "sensors"), section["seed"], axes, "rig: sensors"
            ),
            Limits(group(section, "limits"), axes),
            timebase.dt,
        )

    def reset(self) -> Floats:
        """Bring the rig to rest and take the sample of step 0, shape (4, n)."""
        self.step_index = 0
        return self._measure(self._plant.reset())

    def step(self, command: Floats) -> Floats:
        """Apply a command and take the next sample.

        Parameters
        ----------
        command : ndarray
            What drives the actuators, see `drive`: valve command in V or reference force in N,
            shape (n,).

        Returns
        -------
        ndarray
            Measured displacement (m), velocity (m/s), acceleration (m/s^2), force (N); shape
            (4, n).
        """
        self.step_index += 1
        return self._measure(self._plant.step(command))

    def _measure(self, state: Floats) -> Floats:
        measured = self._sensors.measure(self.step_index, state)
        self.violation = self._limits.violation(measured)
        return measured


def continuous_model(section: dict[str, Any], axes: tuple[str, ...]) -> ContinuousModel:
    """Model of the actuator and specimen that a rig's parameters describe."""
    specimen = LinearSpecimen.from_parameters(group(section, "specimen"), axes, "rig: specimen")
    actuator = group(section, "actuator")
    if actuator["kind"] == "ideal":
        return delayed_force(specimen, 0.0)
    if actuator["kind"] == "delay":
        return delayed_force(specimen, actuator["delay"])
    names = ("oil_stiffness", "leakage", "flow_gain", "valve_frequency", "valve_damping")
    values = {name: per_axis(actuator[name], axes, f"rig: actuator.{name}") for name in names}
    return servo_hydraulic(specimen, **values, dead_time=actuator["dead_time"])
