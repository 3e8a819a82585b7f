"""A planned test as a loop, and as it would be were something else than planned."""

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import VALVE_COMMAND

from seft_ros.force_controller.force_control import LinearControl
from seft_ros.force_controller.methods import force_control
from seft_ros.force_controller.names import VELOCITY_FEEDFORWARD
from seft_ros.force_controller.velocity_feedforward import VelocityFeedforward
from seft_ros.loop_shaping.source import Source
from seft_ros.preflight.closed_loop import ClosedLoop, closed_loop, growth_rate
from seft_ros.preflight.frozen import BOUNDS, frozen_feedforward, frozen_target, read_of_points
from seft_ros.preflight.loop_rig import choose_rig
from seft_ros.reference_force.block import compensator, knowledge
from seft_ros.reference_force.compensation.compensator import Compensator
from seft_ros.reference_force.compensation.linear_filter import LinearFilter
from seft_ros.reference_force.compensation.names import TARGET_MOTION
from seft_ros.target.target_motion import TargetMotion
from seft_ros.target.target_step import FORCE

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
        self._controllers = self._as_it_may_be()
        self._filter = lru_cache(maxsize=256)(self.compensation)
        self._sampled = lru_cache(maxsize=256)(self._sample)

    @property
    def dt(self) -> float:
        """Sampling period, s."""
        return self.timebase.dt

    @property
    def follows(self) -> bool:
        """Whether the method follows the specimen's local stiffness."""
        return self.section["compensation.method"] == TARGET_MOTION

    @property
    def follows_valves(self) -> bool:
        """Whether the controller follows the valves."""
        return len(self._controllers) > 1

    def compensator(
        self,
        mass_ratio: float | None = None,
        stiffness: float = 1.0,
        told_delay: float = 0.0,
        follow_delay: bool = True,
    ) -> Compensator:
        """Make the compensation method as it is made for the test, see `loops`.

        Parameters
        ----------
        stiffness : float
            Factor on the stiffness that the method is told.
        follow_delay : bool
            A method that follows the delay makes its gains for all delays, which takes long;
            without, it is made for the delay it starts at alone.
        """
        section = dict(self.section)
        section["compensation.estimate_delay"] &= follow_delay
        if mass_ratio is not None:
            section["mass_ratio"] = mass_ratio
        if stiffness != 1.0:
            section["model.stiffness"] = (
                stiffness * np.atleast_1d(section["model.stiffness"])
            ).tolist()
        if section["compensation.delay"] > 0:  # it is told
            section["compensation.delay"] = max(section["compensation.delay"] + told_delay, 0.0)
        known = knowledge(section, self.axes, self.timebase)
        return compensator(section["compensation.method"], known)

    def compensation(
        self,
        mass_ratio: float | None = None,
        stiffness: float = 1.0,
        told_delay: float = 0.0,
        measured: bool = False,
    ) -> LinearFilter:
        """Give the linear filter that the method is, see `compensator`.

        Parameters
        ----------
        measured : bool
            Of a method that follows the specimen: as it is when it takes the restoring force as
            measured. Its output then is all points, see `frozen_target`.
        """
        made = self.compensator(mass_ratio, stiffness, told_delay, follow_delay=False)
        if isinstance(made, TargetMotion):
            return frozen_target(made, measured)
        return made.linear()

    def loops(
        self,
        mass_ratio: float | None = None,
        dead_time: float | None = None,
        gain: float = 1.0,
        told_delay: float = 0.0,
        stiffness: float = 1.0,
        followed: bool = False,
        any_valve: bool = False,
    ) -> list[ClosedLoop]:
        """Close the loop, as planned where nothing is given.

        Parameters
        ----------
        mass_ratio : float, optional
            alpha; the method is made for it.
        dead_time : float, optional
            Of the rig's drive, s; the method is not told of it.
        gain : float
            Factor on the rig's drive; the method is not told of it.
        told_delay : float
            What is added to the delay that the method is told, s.
        stiffness : float
            Factor on the stiffness of the specimen on the rig.
        followed : bool
            Whether the method knows of that factor.
        any_valve : bool
            Whether a controller that follows the valves is at the bounds of what it may take them
            for, too.

        Returns
        -------
        list of ClosedLoop
            As the test starts; of a method that follows the specimen also with the restoring
            force as measured, as it is when the specimen is not what was told.

        Raises
        ------
        InputError
            If the method can't be made like this, or the dead time is many samples long.
        """
        rig = self._sampled(stiffness, self.dead_time if dead_time is None else dead_time, gain)
        told = stiffness if followed else 1.0
        loops = []
        for read, control in self._controllers if any_valve else self._controllers[:1]:
            for measured in (False, True) if self.follows else (False,):
                part = self._filter(mass_ratio, told, told_delay, measured)
                if read is not None:
                    c, d, e = read @ part.c, read @ part.d, read @ part.e
                    part = LinearFilter(part.a, part.b, part.h, c, d, e)
                part = part.delayed(self.section["loop_delay"])
                loops.append(closed_loop(rig, part, control, self.dt))
        return loops

    def loop(self, **changes: Any) -> ClosedLoop:
        """Close the loop as the test starts, see `loops`."""
        return self.loops(**changes)[0]

    def worst(self, **changes: Any) -> complex:
        """Eigenvalue of all `loops` that dies out last or grows fastest."""
        return max((loop.dominant() for loop in self.loops(**changes)), key=abs)

    def growth_rate(self, **changes: Any) -> float:
        """Rate at which it grows, 1/s: positive where the test is unstable."""
        return growth_rate(self.worst(**changes), self.dt)

    def _sample(
        self, stiffness: float, dead_time: float, gain: float
    ) -> tuple[Floats, Floats, Floats]:
        rig = self.rig
        if stiffness != 1.0:
            rig = choose_rig(self.experiment, self.source, stiffness)
        return rig.sampled(self.dt, dead_time, gain)

    def _as_it_may_be(self) -> list[tuple[Floats | None, LinearControl]]:
        """Make the controller as it starts, then as it may become; and what it reads of points.

        A method without points has None there.
        """
        n, section = len(self.axes), self.experiment["force_controller"]
        first_force, known = np.eye(n, 3 * n, k=FORCE * n), LinearControl.none(n)
        if self.rig.drive == VALVE_COMMAND.name:
            control = force_control(section, self.axes, self.timebase)
            if isinstance(control, VelocityFeedforward):
                if not self.follows:
                    raise InputError(
                        f"force_controller: {VELOCITY_FEEDFORWARD} needs the coming motion: set "
                        f"reference_force: compensation.method to {TARGET_MOTION}"
                    )
                made = [frozen_feedforward(control, errors) for errors in ((0.0, 0.0), *BOUNDS)]
                return [(self._of_points(read), rest) for read, rest in map(read_of_points, made)]
            known = control.linear()
        return [(self._of_points(first_force) if self.follows else None, known)]

    def _of_points(self, read: Floats) -> Floats:
        """Let a matrix of the first points take all, the first of which the loop's delay skips."""
        n = len(self.axes)
        before = 3 * n * self.section["loop_delay"]
        after = 3 * n * (1 + self.compensator().preview) - before - read.shape[1]
        return np.pad(read, ((0, 0), (before, after)))
