"""Preview inverse at given properties of the specimen: a linear filter, with its parts at hand."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import as_matrix, mass_matrix

from seft_ros.reference_force.compensation.compensator import Knowledge
from seft_ros.reference_force.compensation.linear_filter import LinearFilter
from seft_ros.reference_force.compensation.preview.blocked_error import (
    blocked_error,
    is_of_each_mode,
)
from seft_ros.reference_force.compensation.preview.motion_filter import (
    motion_filter,
    motion_noise,
)
from seft_ros.reference_force.compensation.preview.preview_tracking import PreviewTracking
from seft_ros.reference_force.compensation.preview.target_prediction import (
    Gains,
    NominalSpecimen,
    TargetPrediction,
    critically_damped,
)
from seft_ros.reference_force.compensation.preview.tracking_model import TrackingModel

Floats = npt.NDArray[np.float64]

CORNER = 70.0  # Hz up to which the target is followed: beyond, structures hardly move
HIGHEST_CORNER = 0.15  # of the sampling frequency
HORIZON = 0.06  # s beyond the loop's delay: the inverse has died out
LONGEST_HORIZON = 150  # steps

_WAY_BACK = 3.0  # Hz
_TRUST = 0.8  # in the model's force against the measured one, of what their noise allows
_LEAST_NOISE = (1e-6, 2e-4, 0.01, 0.6)  # m, m/s, m/s^2, N: converters and their cables have it


@dataclass(frozen=True)
class Noise:
    """RMS noise of the sensors: m, m/s, m/s^2 and N, above 0."""

    position: float
    velocity: float
    acceleration: float
    force: float

    @classmethod
    def from_options(cls, options: Mapping[str, Any]) -> "Noise":
        """Take ``compensation.noise.*`` over all axes, with a least one where a sensor has none."""
        given = [
            float(np.sqrt(np.mean(np.square(options[f"compensation.noise.{name}"]))))
            for name in cls.__annotations__
        ]
        return cls(*np.maximum(given, _LEAST_NOISE).tolist())


class PreviewFilter:
    """Linear part of `preview_inverse`; see there for the equations.

    Parameters
    ----------
    knowledge : Knowledge
        What is known of the test.
    bias_corner : float
        Frequency up to which the restoring force is corrected by its measurement, Hz.
    mends : bool
        Whether a deviation from `course` is taken back. With it goes what noise does to the
        specimen; the model must be that of the specimen.

    Attributes
    ----------
    restoring : ndarray
        (K, C) of the specimen as they are taken to be, shape (n, 2n); set by `set_restoring`.
    motion, rest, restoring_force, residual : ndarray
        As the last step had them: filtered (x, v), shape (2n,); what of the restoring force is
        beside K x + C v, p; the measured restoring force; and its part beside K x + C v; the
        last three of shape (n,), N. To change p is to tell it.
    measured_force : ndarray
        Of the last step, shape (n,), N.
    course : ndarray
        (x, v) that the whole structure, as it is taken to be, makes of the ground motion alone,
        shape (2n,), for the step to come. Like p it may be changed until then.
    departure : ndarray
        Force by which the specimen departs from that of the tracking model, shape (n,), N.
    committed : ndarray
        Forces f + d of this step and those to come that nothing asked for now will change, shape
        (1 + steps, n), N; as far as it is known, else of this step alone.
    target, rate : ndarray
        Weighted target and its weighted rate, shape (n,).
    model_force : ndarray
        Force that the tracking model expects of this step, shape (n,), N; with the specimen it
        was identified with.
    """

    def __init__(self, knowledge: Knowledge, bias_corner: float, mends: bool = False) -> None:
        options, dt, n = knowledge.options, knowledge.dt, knowledge.axes
        self._axes, self._mass, self._mends = n, knowledge.mass, mends
        self._loop_delay, self._dt = knowledge.loop_delay, dt
        self.noise = Noise.from_options(options)
        model = TrackingModel.from_options(options, dt)
        self.delay = model.delay(dt)
        self.preview = min(LONGEST_HORIZON, int(np.ceil((self.delay + HORIZON) / dt)))
        tracking = PreviewTracking.design(model, self.preview, min(CORNER * dt, HIGHEST_CORNER))
        self._nominal = _nominal(options, knowledge.mass)
        self._ahead = self._weights_ahead(options, dt)
        weights = np.zeros((2, 1 + self.preview))  # of the target, and of its rate
        weights[0] = tracking.target
        weights[1, 1:] += tracking.target[:-1] / (2 * dt)
        weights[1, :-1] -= tracking.target[1:] / (2 * dt)
        restoring = np.hstack([knowledge.stiffness, knowledge.damping])
        # on its way is what comes before T, beyond its dead time, has answered half
        committed = round((model.dead_time + self.delay) / 2 / dt)
        committed = min(committed, self.preview - 1) if is_of_each_mode(options) else 0
        self.prediction = TargetPrediction(knowledge, weights, self._nominal, restoring, committed)
        self.reach = float(tracking.target.sum())
        self._observe = motion_filter(
            dt, self.noise.position, self.noise.velocity, self.noise.acceleration
        )
        self._bias_gain = 1.0 - np.exp(-2 * np.pi * bias_corner * dt)
        inertia = (np.diag(self._mass) * self.noise.acceleration) ** 2
        self.restoring_noise = self.noise.force**2 + inertia
        self._trust = _TRUST * self.noise.force**2 / self.restoring_noise
        self._direct_by_rest = -np.diag(self._trust)
        if self._nominal is not None:
            self._departing = self.prediction.departing()[2]
            self._direct_by_rest -= self._departing
        if self._loop_delay:  # nothing passes the inverse by but what arrives
            self._trust, self._direct_by_rest = np.zeros(n), np.zeros((n, n))
        # the loop's states z and the last forces: one product gives u less the target's part
        size, past = len(model.a), len(tracking.past)
        going_on = np.zeros((size + past, size + past))
        going_on[:size, :size] = model.a
        going_on[1 + size :, size:-1] = np.eye(past - 1)
        self._drive = np.concatenate([model.b, np.eye(1, past)[0]])[:, np.newaxis]
        held = going_on + self._drive @ np.eye(1, size + past, k=size)  # by what is asked for last
        forces = [np.append(model.c, np.zeros(past))]  # of this step and the committed ones
        for _ in range(committed):
            forces.append(forces[-1] @ held)
        asked = np.append(tracking.state, tracking.past)
        self._loop = np.vstack([asked, forces, going_on])
        self._loop_result = np.zeros((len(self._loop), n))
        self.model_force = self._loop_result[1]
        self.committed = self._loop_result[1 : 2 + committed]
        self._going_on = self._loop_result[2 + committed :]
        self._by_committed = np.zeros((3 * n, self.committed.size))
        # z, then what is kept of the specimen, then inputs: the last two give all by one product
        self._work = np.zeros(((size + past) + 6 + 4 + 1 + self.preview) * n)
        loop, rest = np.split(self._work, [(size + past) * n])
        self._states = self._work[: len(loop) + 6 * n]
        self._tracking, self._known = loop.reshape(-1, n), rest
        self._kept = rest[: 6 * n]  # x, v, a, p and the course
        self._kept_course = rest[4 * n : 6 * n]
        self._measured = rest[6 * n : 10 * n].reshape(4, n)
        self.measured_force = self._measured[3]
        self._ground_motion = rest[10 * n :].reshape(-1, n)
        self._result = np.zeros(12 * n)
        parts = np.split(self._result, n * np.array([2, 3, 4, 6, 7, 8, 9, 10, 11]))
        self.motion, _, self.rest, self.course, *forces = parts
        self.residual, self.restoring_force, self.departure, self.target, self.rate = forces[:5]
        self._direct = forces[5]  # part of the reference force that passes the inverse by
        self._asked_for = self._result[9 * n :]  # these last three
        self.set_restoring(restoring)

    def reset(self) -> None:
        """Forget the test so far, but not the specimen."""
        self._states[:] = 0.0
        self._result[:] = 0.0

    def set_restoring(self, restoring: Floats, elastic: bool = True) -> None:
        """Take the specimen to be (K, C) from the next step on.

        Parameters
        ----------
        restoring : ndarray
            Shape (n, 2n).
        elastic : bool
            Whether it is no more than that. Else p is told by others, see `expect`, and no
            deviation is taken back.
        """
        self.restoring = restoring.copy()
        self.prediction.set_restoring(self.restoring)
        n, known, eye = self._axes, len(self._known), np.eye(self._axes)
        coming = self.prediction.gains()
        self._rest_gains = np.ascontiguousarray(coming.rest[:n])
        self._by_committed[: 2 * n] = coming.committed
        a, p = slice(2 * n, 3 * n), slice(3 * n, 4 * n)
        course = slice(4 * n, 6 * n)
        measured = slice(6 * n, 9 * n)
        motion, residual, rest = (
            np.zeros((2 * n, known)),
            np.zeros((n, known)),
            np.zeros((n, known)),
        )
        motion[:, : 3 * n] = np.kron(self._observe[:, :3], eye)
        motion[:, measured] = np.kron(self._observe[:, 3:], eye)
        residual[:, 8 * n : 9 * n], residual[:, 9 * n : 10 * n] = -self._mass, eye
        restoring_force = residual.copy()
        residual -= self.restoring @ motion
        rest[:, p] = eye
        if elastic:
            rest += self._bias_gain * (residual - rest)
        targets = self._of_known(coming, motion, rest if elastic else None)
        if elastic and self._mends:
            lowering, of_course = self.prediction.mending()
            targets[:n] -= self._of_known(lowering, motion, rest)
            targets[:n, course] -= of_course
            self._by_committed[:n] -= lowering.committed
        free, course_by_rest, course_by_ground = self.prediction.course()
        going_on = course_by_rest @ rest
        going_on[:, course] += free
        going_on[:, 10 * n : 12 * n] += course_by_ground
        self._free = free
        gain = np.zeros((12 * n, known))
        gain[: 2 * n], gain[p], gain[4 * n : 6 * n] = motion, rest, going_on
        gain[a, 8 * n : 9 * n] = eye
        gain[6 * n : 7 * n], gain[7 * n : 8 * n] = residual, restoring_force
        known_rest = rest if elastic else np.zeros_like(rest)
        if self._nominal is not None:
            by_own, by_first, by_known = self.prediction.departing()
            gain[8 * n : 9 * n] = by_own @ motion + by_known @ known_rest
            gain[8 * n : 9 * n, 10 * n : 11 * n] += by_first
        gain[9 * n : 11 * n] = targets
        gain[11 * n :] = np.diag(self._trust) @ (residual - known_rest) - gain[8 * n : 9 * n]
        if len(self._ahead[0]):
            arriving = self.prediction.weighed(*self._ahead)
            if self._loop_delay:  # what departs now does not count any more
                gain[11 * n :] = 0.0
            gain[11 * n :] -= self._of_known(arriving, motion, rest if elastic else None)
            self._by_committed[2 * n :] = -arriving.committed
            self._arriving = arriving.rest
        self._gain = gain

    def observe(self, ground_motion: Floats, state: Floats) -> None:
        """Take a step in: known ground motion, shape (1 + preview, n), and state, (4, n)."""
        self._kept[:] = self._result[: len(self._kept)]
        self._measured[:] = state
        self._ground_motion[:] = ground_motion
        np.dot(self._gain, self._known, out=self._result)
        np.dot(self._loop, self._tracking, out=self._loop_result)
        if self.prediction.committed:
            self._asked_for += self._by_committed.dot(self.committed.reshape(-1))

    def expect(self, coming: Floats) -> None:
        """Reckon with p as `rest` has been told it is, and with a coming one.

        Parameters
        ----------
        coming : ndarray
            p over the horizon, shape ((1 + horizon) n,), N.
        """
        if self._nominal is not None:
            self.departure += self._departing.dot(self.rest)
        self._direct += self._direct_by_rest.dot(self.rest)
        if len(self._ahead[0]):
            self._direct -= self._arriving.dot(coming)
        self.target += self._rest_gains.dot(coming)

    def way_back(self, pace: float) -> Floats | None:
        """Gain by which the target is lowered for a deviation (d, d') that is to go back.

        It is taken back over the horizon as an elastic specimen's is, see
        `TargetPrediction.way_back`. Where the prediction reckons with what is on its way, it goes
        back critically damped, at ``pace`` times the usual frequency. Shape (n, 2n); None where
        the force loop is not known for any specimen.
        """
        if self.prediction.committed:
            return self._mass @ critically_damped(pace * _WAY_BACK, self._axes)
        return self.prediction.way_back() / self.reach if self._knows_any_specimen else None

    def residual_noise(self, lasting: bool = False) -> Floats:
        """Covariance that the sensors' noise makes in the residual, shape (n, n), N^2.

        With ``lasting`` as `motion_noise` has it, for who learns of many steps.
        """
        noise = self.noise
        left = motion_noise(self._dt, noise.position, noise.velocity, noise.acceleration, lasting)
        parts = self.restoring.reshape(self._axes, 2, self._axes)
        of_motion = np.einsum("ikj,kl,mlj->im", parts, left, parts)
        found: Floats = np.diag(self.restoring_noise) + of_motion
        return found

    def begin_course(self) -> None:
        """Let the course begin at the motion of this step."""
        self.course += self._free.dot(self.motion - self._kept_course)

    def command(self, target: Floats) -> Floats:
        """Compute the reference force for a weighted target, shape (n,), N."""
        drive = self._loop_result[0] + target
        np.multiply(self._drive, drive, out=self._tracking)
        self._tracking += self._going_on
        force: Floats = drive + self._direct
        return force

    def _of_known(self, coming: Gains, motion: Floats, rest: Floats | None) -> Floats:
        """Gains of all that is known of something that is to come, but for committed forces.

        Of p where it stays what it is known as; None: it is told.
        """
        n = self._axes
        found: Floats = coming.motion @ motion
        found[:, 10 * n :] += coming.ground_motion
        if rest is not None:
            found += coming.rest.reshape(len(found), -1, n).sum(axis=1) @ rest
        return found

    def _weights_ahead(self, options: Mapping[str, Any], dt: float) -> tuple[Floats, Floats]:
        """Weights of steps to come in the force that passes the inverse by, with other sign.

        Of the departure d: beside d itself, which is known now or arrives after the loop's delay,
        it is E d, E the error of the blocked loop: f + d = T (f_r + d + E d). Where the controller
        inverts the specimen, E is one for each mode, and T that of a loop without it, so that E
        times the target comes to the reference force. Shapes (m, n, n).
        """
        error = blocked_error(options, self._nominal, dt, self._axes)
        of_each_mode = is_of_each_mode(options)
        self._knows_any_specimen = len(error) > 0 and not of_each_mode
        begin, steps = self._loop_delay, 1 + self.preview
        error = error[: steps - begin]
        departures, targets = np.zeros((2, steps, self._axes, self._axes))
        if self._nominal is not None and begin:
            departures[begin] = np.eye(self._axes)
        departures[begin : begin + len(error)] += error
        if of_each_mode:
            targets[begin : begin + len(error)] -= error
        last = begin + max(len(error), 1) if departures.any() else 0
        return departures[:last], targets[:last]

    def linear(self, gain: Floats, advance: Floats) -> LinearFilter:
        """Filter that this is, with a tracking gain and an advance (s) found on line."""
        n, size = self._axes, len(self._states)
        # a step of `observe` and `command` from every unit of (states, inputs) at once
        tracking, known = np.split(np.eye(len(self._work)), [self._tracking.size])
        result = self._gain @ known
        loop = np.tensordot(self._loop, tracking.reshape(*self._tracking.shape, -1), axes=1)
        first = len(loop) - len(tracking) // n
        committed = self._by_committed @ loop[1:first].reshape(self.committed.size, -1)
        target, rate, direct = (result[9 * n :] + committed).reshape(3, n, -1)
        each = (n, 1)
        drive = loop[0] + np.reshape(gain, each) * target - np.reshape(advance, each) * rate
        going_on = self._drive[..., np.newaxis] * drive + loop[first:]
        kept = result[: len(self._kept)]
        matrix = np.vstack([drive + direct, going_on.reshape(len(tracking), -1), kept])
        places = [size, size + 4 * n]
        c, d, e = np.split(matrix[:n], places, axis=1)
        a, b, h = np.split(matrix[n:], places, axis=1)
        return LinearFilter(a, b, h, c, d, e)


def _nominal(options: Mapping[str, Any], mass: Floats) -> NominalSpecimen | None:
    """Specimen that tracking was identified with; None: not felt."""
    if not np.any(options["tracking.stiffness"]):
        return None
    names = [str(axis) for axis in range(len(mass))]
    where = "reference_force: tracking"
    restoring = np.hstack(
        [
            as_matrix(options[f"tracking.{name}"], names, f"{where}.{name}")
            for name in ("stiffness", "damping")
        ]
    )
    if np.any(options["tracking.mass"]):
        mass = mass_matrix(options["tracking.mass"], names, f"{where}.mass")
    return NominalSpecimen(mass, restoring)
