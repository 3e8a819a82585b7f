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
from seft_ros.loop_shaping import Source
from seft_ros.preflight.closed_loop import ClosedLoop, closed_loop, growth_rate
from seft_ros.preflight.frozen import BOUNDS, frozen_feedforward, frozen_target, read_of_points
from seft_ros.preflight.loop_rig import choose_rig
from seft_ros.reference_force.compensator import Compensator
from seft_ros.reference_force.linear_filter import LinearFilter
from seft_ros.reference_force.reference_force_block import compensator, knowledge
from seft_ros.reference_force.reference_force_parameters import TARGET_MOTION
from seft_ros.target.target_motion import TargetMotion
from seft_ros.target.target_step import FORCE

Floats = npt.NDArray[np.float64]

NEUTRAL = 1e-6
"""Growth rate up to which a loop counts as stable, 1/s: what rounding makes of zero."""


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
    dt : float
        Sampling period, s.
    follows, follows_valves : bool
        Whether the method follows the specimen's local stiffness, the controller the valves.

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
        self.axes, self.dt = experiment.axes, experiment.timebase.dt
        self.rig = choose_rig(experiment, source)
        self.section = experiment["reference_force"]
        self._late = self.section["loop_delay"]
        self.mass_ratio = float(self.section["mass_ratio"])
        self.dead_time = self.rig.plant.delay
        self.follows = self.section["compensation.method"] == TARGET_MOTION
        self._controllers = self._as_it_may_be()
        self.follows_valves = len(self._controllers) > 1
        self._filter = lru_cache(maxsize=256)(self.compensation)
        self._sampled = lru_cache(maxsize=256)(self._sample)

    def compensator(
        self,
        mass_ratio: float | None = None,
        stiffness: float = 1.0,
        told_delay: float = 0.0,
        follow_delay: bool = True,
    ) -> Compensator:
        """Make the compensation method as it is made for the test, see `loops`.

        ``stiffness`` is a factor on what the method is told. One that follows the delay makes its
        gains for all delays, which takes long; without ``follow_delay`` for the first alone.
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
        known = knowledge(section, self.axes, self.experiment.timebase)
        return compensator(section["compensation.method"], known)

    def compensation(
        self,
        mass_ratio: float | None = None,
        stiffness: float = 1.0,
        told_delay: float = 0.0,
        measured: bool = False,
    ) -> LinearFilter:
        """Give the linear filter that the method is, see `compensator`.

        Of one that follows the specimen its output is all points, see `frozen_target`;
        ``measured``: as it is when it takes the restoring force as measured.
        """
        made = self.compensator(mass_ratio, stiffness, told_delay, follow_delay=False)
        return frozen_target(made, measured) if isinstance(made, TargetMotion) else made.linear()

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
                part, late = self._filter(mass_ratio, told, told_delay, measured), self._late
                if read is not None:  # of the points from the one that the loop's delay leads to
                    first = 3 * len(self.axes) * late
                    of = slice(first, first + read.shape[1])
                    c, d, e = read @ part.c[of], read @ part.d[of], read @ part.e[of]
                    part = LinearFilter(part.a, part.b, part.h, c, d, e)
                part = part.delayed(late)
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

    def is_stable(self, **changes: Any) -> bool:
        """Whether none of `loops` grows."""
        return self.growth_rate(**changes) <= NEUTRAL

    def _sample(
        self, stiffness: float, dead_time: float, gain: float
    ) -> tuple[Floats, Floats, Floats]:
        other = stiffness != 1.0
        rig = choose_rig(self.experiment, self.source, stiffness) if other else self.rig
        return rig.sampled(self.dt, dead_time, gain)

    def _as_it_may_be(self) -> list[tuple[Floats | None, LinearControl]]:
        """Make the controller as it starts, then as it may become, beside what it reads of points.

        None: the method has no points.
        """
        n, section = len(self.axes), self.experiment["force_controller"]
        control = LinearControl.none(n)
        if self.rig.drive == VALVE_COMMAND.name:
            made = force_control(section, self.axes, self.experiment.timebase)
            if isinstance(made, VelocityFeedforward):
                if not self.follows:
                    raise InputError(
                        f"force_controller: {VELOCITY_FEEDFORWARD} needs the coming motion: set "
                        f"reference_force: compensation.method to {TARGET_MOTION}"
                    )
                frozen = [frozen_feedforward(made, errors) for errors in ((0.0, 0.0), *BOUNDS)]
                return [read_of_points(each) for each in frozen]
            control = made.linear()
        return [(np.eye(n, 3 * n, k=FORCE * n) if self.follows else None, control)]
