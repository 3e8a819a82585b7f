"""A rig to try the driver with until there is one: simulated, behind the same protocol.

It goes on moving between tests, as a rig does: what its valve was left at, it follows.
"""

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.experiment import Experiment
from seft_plant_sim.rig_parameters import RIG_TABLE as SIMULATED
from seft_plant_sim.simulated.rig import Rig

Floats = npt.NDArray[np.float64]

VOLTS = np.array([[0.01], [0.1], [3.924], [2220.0]])
"""SI units per volt of its amplifiers, shape (4, 1)."""
_RIG = {
    "specimen.mass": 52.7,  # kg
    "specimen.damping": 800.3,  # N s/m
    "specimen.stiffness": 2.11e5,  # N/m
    "actuator.kind": "servo_hydraulic_linear",
    "actuator.oil_stiffness": 1.664e7,  # N/m
    "actuator.leakage": 50.0,  # 1/s
    "actuator.flow_gain": 0.0403,  # m/s/V
    "sensors.displacement_noise": 5e-6,  # m
    "sensors.velocity_noise": 1e-3,  # m/s
    "sensors.acceleration_noise": 0.05,  # m/s^2
    "sensors.force_noise": 3.0,  # N
    "calibration.zeroing": 0.0,  # s: the driver zeroes, not the board
}


class StandIn:
    """The simulated rig as `rig_driver.hardware.Hardware`.

    Parameters
    ----------
    rate : float
        Samples a second, Hz: each `read_sample` is one period later than the last.
    axes : sequence of str
        Names of the n axes.
    safe : ndarray
        Safe command of the valve, V, shape (n,).
    """

    def __init__(self, rate: float, axes: tuple[str, ...], safe: Floats) -> None:
        given = [("/**", "rate", rate), ("/**", "axes", list(axes))]
        given += [("/**", name, value) for name, value in _RIG.items()]
        experiment = Experiment.load([SIMULATED], [], given)
        self._rig = Rig.from_parameters(experiment["rig"], experiment.axes, experiment.timebase)
        self._rig.reset()
        self._safe = safe
        self._volts = safe

    def read_sample(self) -> Floats:
        """Read all channels, V, shape (4, n)."""
        volts: Floats = self._rig.step(self._volts)[:4] / VOLTS
        return volts

    def write_command(self, volts: Floats) -> None:
        """Put out the valve commands, V, shape (n,)."""
        self._volts = np.array(volts)

    def to_safe_command(self) -> None:
        """Bring the valves to their safe command."""
        self._volts = self._safe

    def close(self) -> None:
        """Leave the valves at their safe command."""
        self.to_safe_command()
