"""How the reference force is expected to go on, whatever the compensation method."""

from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.timebase import Timebase

from seft_ros.reference_force.block import knowledge
from seft_ros.reference_force.compensation.preview.target_prediction import TargetPrediction
from seft_ros.reference_force.compensation.preview.tracking_model import TrackingModel
from seft_ros.reference_force.compensation.substructure import (
    SubstructureMotion,
    substructure_motion,
)

Floats = npt.NDArray[np.float64]

REACH = 0.03
"""s beyond the loop's delay: so long an outage of the link is bridged by prediction."""


class Continuation:
    """Expected change of the reference force after the last one that was computed.

    The ideal reference force f* = -M_e a_g + S r, see `TargetPrediction`, changes with the
    motion of the whole structure under the known coming ground motion, and a compensated force
    goes ahead of it by the delay of the force loop: with the last force for the step k + d, the
    change up to i steps later is f*[k + h + i] - f*[k + h], h being the loop's delay d and
    that of the force loop, in steps.

    Parameters
    ----------
    section : dict
        The reference force's section of an experiment.
    axes : tuple of str
        Names of the n axes.
    timebase : Timebase
        Sampling clock.

    Attributes
    ----------
    steps : int
        Steps p that it tells of.
    preview : int
        Steps of coming ground motion that it looks at.

    Raises
    ------
    InputError
        As `knowledge`.
    """

    def __init__(self, section: dict[str, Any], axes: tuple[str, ...], timebase: Timebase) -> None:
        known = knowledge(section, axes, timebase)
        self.steps = steps = max(1, round(REACH / known.dt))
        options = known.options
        told = options["compensation.delay"]
        if np.any(options["tracking.numerator"]):
            told = TrackingModel.from_options(options, known.dt).delay(known.dt)
        here = max(known.loop_delay, round(told / known.dt))
        self.preview = here + steps
        weights = np.eye(steps, 1 + self.preview, k=here + 1)
        weights[:, here] = -1.0
        restoring = np.hstack([known.stiffness, known.damping])
        coming = TargetPrediction(known, weights, None, restoring).gains()
        self._gain = np.hstack([coming.motion, coming.ground_motion])
        self._known = np.zeros(self._gain.shape[1])
        self._motion, self._ground = np.split(self._known, [2 * known.axes])
        self._substructure: SubstructureMotion | None = None
        if not known.computed.is_lumped:
            self._substructure = SubstructureMotion(substructure_motion(known, self.preview))

    def reset(self) -> None:
        """Begin a new test."""
        if self._substructure is not None:
            self._substructure.reset()

    def take(self, ground_motion: Floats, state: Floats) -> None:
        """Take a step in, as `ReferenceForce.step` is given it."""
        ground_motion = ground_motion[: 1 + self.preview]
        if self._substructure is not None:
            ground_motion = self._substructure.step(ground_motion, state)
        self._motion[:] = state[:2].ravel()
        self._ground[:] = ground_motion.ravel()

    def changes(self) -> Floats:
        """Predict the changes after the last step, shape (p, n), N."""
        return self._gain.dot(self._known).reshape(self.steps, -1)
