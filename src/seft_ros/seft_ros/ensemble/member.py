"""One test of an ensemble: what it shares with others is made once."""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.experiment import Experiment
from seft_msgs_py.parameters import Section
from seft_plant_sim.rig import Rig, saturation_of

from seft_ros.ensemble.arrays import (
    NotLinearError,
    control_arrays,
    force_arrays,
)
from seft_ros.ensemble.compiler import compiled_run
from seft_ros.ensemble.loop_steps import FORCE, INSTABILITY, NONSENSE, STATE, Course, ForceArrays
from seft_ros.experiment.blocks import check_lead
from seft_ros.experiment.offline import loop_series, trip_of
from seft_ros.force_controller.interlock import Interlock
from seft_ros.force_controller.methods import force_control
from seft_ros.ground_motion.block import GroundMotion
from seft_ros.interlock.instability import InstabilityWatch
from seft_ros.interlock.protected_force import ProtectedForce
from seft_ros.recording.environment import describe_environment
from seft_ros.recording.record import Record

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Loop:
    """Everything of a test but its rig."""

    motion: GroundMotion
    force: ProtectedForce
    force_arrays: ForceArrays
    interlock: Interlock


class Workshop:
    """Makes the tests of an ensemble ready, and runs them.

    Tests whose ground motion, reference force and force controller are the same share them: the
    rigs alone differ from member to member of most ensembles.
    """

    def __init__(self) -> None:
        self._known: dict[tuple[str, ...], Any] = {}
        self._run = compiled_run()
        self._environment = cache(lambda: describe_environment("ensemble"))

    def run(self, experiment: Experiment) -> Record:
        """Run a test: what `seft_ros.experiment.offline.simulate` gives, but for rounding.

        Raises
        ------
        InputError
            As `seft_ros.experiment.blocks.build_blocks`.
        NotLinearError
            If it can't be compiled.
        """
        loop = self.loop(experiment)
        motion = loop.motion
        steps, n = motion.samples.shape
        rig = _rig(experiment)
        course = Course(
            np.empty((steps, 4, n)),
            np.empty((steps, n)),
            np.empty((steps, n)),
            np.empty(steps, dtype=np.int64),
            np.zeros(n),
            np.empty((3, n)),
        )
        ran, _, stopped, cause, begun = self._run(
            rig.parameters,
            rig.state,
            rig.sensors.noise(steps),
            loop.force_arrays,
            control_arrays(loop.interlock, rig),
            course,
        )
        last = ran - 1
        trip = trip_of(
            rig.violation_of(int(course.flags[last]))
            or _stop(loop.interlock, course, last, stopped),
            _cause(loop.force, course, begun, cause),
            last,
            begun,
            experiment.timebase,
        )
        return Record(
            experiment=experiment,
            series=loop_series(
                motion.samples[:ran],
                course.states[:ran],
                course.forces[:ran, np.newaxis],
                course.commands[:ran],
            ),
            trip=trip,
            saturation=saturation_of(course.flags[:ran]),
            environment=self._environment(),
        )

    def obstacle(self, experiment: Experiment) -> str:
        """Say why a test can't be compiled; empty if it can.

        Raises
        ------
        InputError
            As `run`.
        """
        try:
            control_arrays(self.loop(experiment).interlock, _rig(experiment))
        except NotLinearError as error:
            return str(error)
        return ""

    def loop(self, experiment: Experiment) -> _Loop:
        """Everything of a test but its rig, see `run`."""
        axes, timebase = experiment.axes, experiment.timebase
        common = repr((axes, timebase))

        def shared(make: Callable[[], Any], *of: str) -> Any:
            key = common, *of
            if key not in self._known:
                self._known[key] = make()
            return self._known[key]

        own = {
            node: _key(experiment[node])
            for node in ("ground_motion", "reference_force", "force_controller")
        }

        def make() -> _Loop:
            motion: GroundMotion = shared(
                lambda: GroundMotion.from_parameters(experiment["ground_motion"], axes, timebase),
                own["ground_motion"],
            )
            force = ProtectedForce.from_parameters(experiment["reference_force"], axes, timebase)
            check_lead(experiment, motion, force)
            if experiment["reference_force"]["loop_delay"]:
                raise NotLinearError("a link with loop_delay")
            section = experiment["force_controller"]
            controller = force_control(section, axes, timebase)
            interlock = Interlock.from_parameters(controller, section, axes, timebase)
            arrays = force_arrays(force, motion.known, motion.steps)
            return _Loop(motion, force, arrays, interlock)

        found: _Loop = shared(make, *own.values())
        return found


def _rig(experiment: Experiment) -> Rig:
    return Rig.from_parameters(experiment["rig"], experiment.axes, experiment.timebase)


def _key(section: Section) -> str:
    return repr(sorted(section.items()))


def _stop(interlock: Interlock, course: Course, last: int, stopped: int) -> str | None:
    """Let the force controller's interlock say what it tripped by."""
    if not stopped:
        return None
    if stopped == NONSENSE:
        points = course.forces[last : last + 1, np.newaxis]
        return interlock.nonsense_in(points, course.states[last])
    return interlock.saturation()


def _cause(force: ProtectedForce, course: Course, begun: int, cause: int) -> str | None:
    """Let the reference force's own guards say why it came down."""
    state, watch = course.states[begun], force.guards[1]
    if cause == FORCE:
        plausible = copy(force.plausible)  # other threads use it, too
        plausible.reset()
        if begun:
            plausible.fault(course.forces[begun - 1])
        return plausible.fault(course.odd_force)
    if cause == STATE:
        return force.guards[0].step(course.forces[begun], state)
    if cause == INSTABILITY:
        assert isinstance(watch, InstabilityWatch)
        return watch.fault(course.squares[1].tolist(), course.squares[2].tolist())
    return None
