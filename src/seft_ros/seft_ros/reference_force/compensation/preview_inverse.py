"""Preview inverse: whole-structure prediction through the inverse of the force loop."""

import numpy as np
import numpy.typing as npt

from seft_ros.reference_force.compensation.compensator import Compensator, Knowledge
from seft_ros.reference_force.compensation.linear_filter import LinearCompensator, LinearFilter
from seft_ros.reference_force.compensation.preview.force_error import ForceErrorCorrection
from seft_ros.reference_force.compensation.preview.plastic_force import PlasticForce
from seft_ros.reference_force.compensation.preview.preview_filter import PreviewFilter
from seft_ros.reference_force.compensation.preview.specimen_identification import (
    SpecimenIdentification,
)
from seft_ros.reference_force.compensation.preview.tracking_identification import (
    TrackingIdentification,
)

Floats = npt.NDArray[np.float64]

_BIAS_CORNER, _BIAS_CORNER_ADAPTIVE = 30.0, 0.3  # Hz
_NOTICEABLE = 2e-3  # relative change of stiffness or damping
_ANOTHER = 0.01  # likewise: a specimen that hardly is the same
_YIELD_SIGMAS = 5.0
_YIELD_SHARE = 0.03  # of the largest restoring force so far
_YIELD_SMOOTHING = 0.3  # part of a new sample in the error that is looked at


def preview_inverse(knowledge: Knowledge) -> Compensator:
    """Ask for the force with which the measured force meets its predicted, coming target.

    The target is the reference force of the solved loop, f_r* = -M_e a_g + S r with
    S = M_c (M_e + M_c)^-1 and the measured restoring force r = f - M_e a. Over a short horizon
    it is predicted with the whole structure, the measured state and the coming ground motion
    (`TargetPrediction`), and goes through the non-causal inverse of the identified response T
    from reference force to measured force (`PreviewTracking`).

    T depends on the specimen (control-structure interaction, Dyke et al. 1995). With
    d = K_0 x + C_0 v - r, by which the specimen departs from the one T was identified with,

        f = T (f_r + (1 + E) d) - d,  so that  f_r = T^-1 (f_r* + d) - (1 + E) d

    where E is the error over force of the loop with its piston held still
    (``tracking.blocked_error``): d changes the piston's motion, which a loop of finite gain does
    not answer at once. Of a force controller that inverts the specimen, E is larger for a stiffer
    mode, and so T differs from mode to mode; with the T of a loop without E,
    f_r = T^-1 (f_r* + d) + E (f_r* + d) - (1 + E) d. It is known then what such a loop makes of any
    specimen, and the prediction reckons with the forces that are on their way.

    With ``compensation.adaptive`` stiffness, damping, and the gain and delay of T are identified
    while the test runs; where the specimen yields, its tangent is followed (`PlasticForce`) and
    what force errors did to it is mended (`ForceErrorCorrection`).

    Raises
    ------
    InputError
        If the force loop's response is not known, or makes no sense.
    """
    if knowledge.options["compensation.adaptive"]:
        return AdaptivePreviewInverse(knowledge)
    none = np.zeros(knowledge.axes)
    return LinearCompensator(PreviewFilter(knowledge, _BIAS_CORNER).linear(1.0 + none, none))


class AdaptivePreviewInverse:
    """`preview_inverse` that identifies specimen and tracking while the test runs."""

    def __init__(self, knowledge: Knowledge) -> None:
        self._knowledge = knowledge
        self._filter = PreviewFilter(knowledge, _BIAS_CORNER_ADAPTIVE, mends=True)
        self.preview = self._filter.preview
        noise = self._filter.restoring_noise
        visible = _YIELD_SIGMAS * np.sqrt(self._filter.residual_noise().diagonal())
        self._sigmas: list[float] = visible.tolist()
        self._specimen = SpecimenIdentification(
            knowledge.mass,
            knowledge.damping,
            knowledge.stiffness,
            self._filter.residual_noise(lasting=True),
            knowledge.dt,
        )
        self._tracking = TrackingIdentification(
            knowledge.axes, noise + self._filter.noise.force**2, knowledge.dt
        )
        self.reset()

    def reset(self) -> None:
        """Forget the test so far, and what was identified."""
        n = self._knowledge.axes
        self._filter.reset()
        self._specimen.reset()
        self._tracking.reset()
        self._filter.set_restoring(self._specimen.restoring)
        self._error, self._largest = [0.0] * n, [0.0] * n
        self._plastic: PlasticForce | None = None
        self._has_learnt = True

    def step(self, ground_motion: Floats, state: Floats) -> Floats:
        """Compute the reference force of one step, see `Compensator.step`."""
        self.learn()
        known, tracking = self._filter, self._tracking
        known.observe(ground_motion, state)
        if self._plastic is None:
            self._has_learnt = False
            target = (1.0 - tracking.gain) * known.target - tracking.advance * known.rate
        else:  # the loop is taken as it was identified
            motion, rest, plastic = known.motion, known.rest, self._plastic
            plastic.update(motion, rest, known.residual)
            known.expect(plastic.coming(motion, rest, ground_motion, known.committed))
            force = state[3]
            deviation = force + known.departure - known.model_force
            target = known.target - known.reach * self._correction.step(
                ground_motion[0], force, motion, rest, plastic.slope, deviation
            )
        return known.command(target)

    def learn(self) -> None:
        """Identify specimen and tracking by the last step, if that was not done yet."""
        if self._has_learnt:
            return
        self._has_learnt = True
        known = self._filter
        self._identify()
        self._tracking.deviation(known.model_force, known.measured_force + known.departure)
        self._tracking.update(self._specimen.variance)

    def estimates(self) -> dict[str, Floats]:
        """Estimates of each axis.

        ``stiffness`` (tangent, N/m), ``damping`` (N s/m), and of the force loop ``amplitude``
        and ``delay`` (s).
        """
        self.learn()
        n = self._knowledge.axes
        restoring = self._filter.restoring
        slope = 0.0 if self._plastic is None else np.diag(self._plastic.slope)
        return {
            "stiffness": np.diag(restoring[:, :n]) + slope,
            "damping": np.diag(restoring[:, n:]).copy(),
            "amplitude": 1.0 + self._tracking.gain,
            "delay": self._filter.delay - self._tracking.advance,
        }

    def linear(self) -> LinearFilter:
        """Linear filter at what is identified now, the specimen elastic."""
        self.learn()
        return self._filter.linear(1.0 - self._tracking.gain, self._tracking.advance)

    def _identify(self) -> None:
        """Learn of the specimen; see whether it yields."""
        known, specimen = self._filter, self._specimen
        if specimen.step(known.motion, known.restoring_force) and specimen.contradicts():
            restoring, used = specimen.bounded(), known.restoring
            change, largest = np.abs(restoring - used), np.abs(restoring).max(axis=0)
            if (change > _NOTICEABLE * largest).any():
                known.set_restoring(restoring)
                specimen.take()
            if (change > _ANOTHER * largest).any():  # its course would have been another
                known.begin_course()
        if self._yields():
            self._follow_yielding()

    def _yields(self) -> bool:
        """Tell whether a restoring force is far from any that an elastic specimen might have."""
        known, seen = self._filter, False
        of_axes = zip(
            known.restoring_force.tolist(),
            known.residual.tolist(),
            self._specimen.variance.tolist(),
            strict=True,
        )
        for axis, (force, error, variance) in enumerate(of_axes):
            self._error[axis] += _YIELD_SMOOTHING * (error - self._error[axis])
            self._largest[axis] = max(self._largest[axis], abs(force))
            visible = max(self._sigmas[axis], _YIELD_SHARE * self._largest[axis])
            seen |= abs(self._error[axis]) > visible + 3.0 * variance**0.5
        return seen

    def _follow_yielding(self) -> None:
        """Take the specimen as it is known for its elastic part from now on.

        The force loop is taken as it was identified: what had been learnt of it beside belonged
        to small forces.
        """
        known = self._filter
        known.set_restoring(self._specimen.elastic(), elastic=False)
        known.rest[:] = known.residual
        self._tracking.reset()
        late = self._knowledge.loop_delay * self._knowledge.dt
        pace = 1.0 - late / known.delay
        self._correction = ForceErrorCorrection(
            self._knowledge, known.restoring, pace, known.way_back(pace)
        )
        n = self._knowledge.axes
        self._plastic = PlasticForce(
            known.restoring[:, :n],
            known.residual_noise(lasting=True),
            known.prediction.displacements(),
            self._knowledge.deformation,
        )
