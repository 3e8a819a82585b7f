"""A planned test as a loop, and as it would be were something else than planned."""

from functools import lru_cache

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError
from seft_msgs_py.experiment import Experiment
from seft_msgs_py.topics import VALVE_COMMAND

from seft_ros.force_controller.force_control import LinearControl
from seft_ros.force_controller.methods import force_control
from seft_ros.loop_shaping.source import Source
from seft_ros.preflight.closed_loop import ClosedLoop, Matrices, closed_loop, loop_matrix
from seft_ros.preflight.loop_rig import choose_rig
from seft_ros.reference_force.block import compensator, knowledge
from seft_ros.reference_force.compensation.compensator import Compensator
from seft_ros.reference_force.compensation.linear_filter import LinearFilter

Floats = npt.NDArray[np.float64]


class Plan:
    """The loop of an experiment, and what may come out otherwise.

    Parameters
    ----------
    experiment : Experiment
        Its sections `reference_force` and `force_controller`, and `rig` where it is simulated.
    source : str
        Where the model of the rig comes from, see `seft_ros.preflight.loop_rig.choose_rig`.

    Attributes
    ----------
    rig : LoopRig
        What the loop closes over.
    mass_ratio, dead_time : float
        As planned; the dead time, of the rig's drive, in s.

    Raises
    ------
    InputError
        If there is no model of the rig, or parameters make no sense together.
    """

    def __init__(self, experiment: Experiment, source: Source = Source.AUTO) -> None:
        for node in ("reference_force", "force_controller"):
            if node not in experiment.sections:
                raise InputError(f"{node}: runs elsewhere, so its parameters are not known here")
        self.experiment, self.source = experiment, source
        self.axes, self.timebase = experiment.axes, experiment.timebase
        self.rig = choose_rig(experiment, source)
        self.section = experiment["reference_force"]
        self.mass_ratio = float(self.section["mass_ratio"])
        self.dead_time = self.rig.plant.delay
        self._control = LinearControl.none(len(self.axes))
        if self.rig.drive == VALVE_COMMAND.name:
            control = force_control(experiment["force_controller"], self.axes, self.timebase)
            self._control = control.linear()
        self._filter = lru_cache(maxsize=64)(self.compensation)
        self._rig = lru_cache(maxsize=64)(self.rig.sampled)

    @property
    def dt(self) -> float:
        """Sampling period, s."""
        return self.timebase.dt

    def compensator(
        self,
        mass_ratio: float | None = None,
        stiffness: float = 1.0,
        told_delay: float = 0.0,
        follow_delay: bool = True,
    ) -> Compensator:
        """Make the compensation method as it is made for the test, see `loop`.

        A method that follows the delay makes its gains for all delays, which takes long; without
        ``follow_delay`` it is made for the delay it starts at alone.
        """
        section = dict(self.section)
        section["compensation.estimate_delay"] &= follow_delay
        if mass_ratio is not None:
            section["mass_ratio"] = mass_ratio
        section["model.stiffness"] = (
            stiffness * np.atleast_1d(section["model.stiffness"])
        ).tolist()
        for name in ("compensation.delay", "tracking.dead_time"):
            if section[name] > 0:  # it is told
                section[name] = max(section[name] + told_delay, 0.0)
        known = knowledge(section, self.axes, self.timebase)
        return compensator(section["compensation.method"], known)

    def compensation(
        self, mass_ratio: float | None = None, stiffness: float = 1.0, told_delay: float = 0.0
    ) -> LinearFilter:
        """Give the linear filter that the method is at the start, see `loop`."""
        return self.compensator(mass_ratio, stiffness, told_delay, follow_delay=False).linear()

    def loop(
        self,
        mass_ratio: float | None = None,
        dead_time: float | None = None,
        stiffness: float = 1.0,
        told_delay: float = 0.0,
        gain: float = 1.0,
    ) -> ClosedLoop:
        """Close the loop, as planned where nothing is given.

        Parameters
        ----------
        mass_ratio : float, optional
            alpha; the method is made for it.
        dead_time : float, optional
            Of the rig's drive, s; the method is not told of it.
        stiffness : float
            Factor on the stiffness that the method is told.
        told_delay : float
            What is added to the delays that the method is told, s.
        gain : float
            Factor on the rig's drive; the method is not told of it.

        Raises
        ------
        InputError
            If the method can't be made like this, or the dead time is many samples long.
        """
        rig = self._rig(self.dt, self.dead_time if dead_time is None else dead_time, gain)
        compensation = self._filter(mass_ratio, stiffness, told_delay)
        compensation = compensation.delayed(self.section["loop_delay"])
        return closed_loop(rig, compensation, self._control, self.dt)

    def loop_matrices(self, filters: Matrices, dead_time: float | None = None) -> Floats:
        """Close the loop with a stack of compensations, see `loop_matrix`; shape (..., N, N)."""
        rig = self._rig(self.dt, self.dead_time if dead_time is None else dead_time, 1.0)
        return loop_matrix(rig, filters, self._control)
