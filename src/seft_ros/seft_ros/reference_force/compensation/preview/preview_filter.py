"""Preview inverse at given properties of the specimen: a linear filter, with its parts at hand."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import as_matrix

from seft_ros.reference_force.compensation.compensator import Knowledge
from seft_ros.reference_force.compensation.linear_filter import LinearFilter
from seft_ros.reference_force.compensation.preview.motion_filter import motion_filter
from seft_ros.reference_force.compensation.preview.preview_tracking import PreviewTracking
from seft_ros.reference_force.compensation.preview.target_prediction import TargetPrediction
from seft_ros.reference_force.compensation.preview.tracking_model import TrackingModel

Floats = npt.NDArray[np.float64]

CORNER = 70.0  # Hz up to which the target is followed: beyond, structures hardly move
HIGHEST_CORNER = 0.15  # of the sampling frequency
HORIZON = 0.06  # s beyond the loop's delay: the inverse has died out
LONGEST_HORIZON = 150  # steps

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

    Attributes
    ----------
    restoring : ndarray
        (K, C) of the specimen as they are taken to be, shape (n, 2n); set by `set_restoring`.
    motion, rest : ndarray
        Filtered displacement and velocity, shape (2, n), and what of the restoring force is
        beside K x + C v, p, shape (n,), as the last step had them.
    residual : ndarray
        Measured restoring force less K x + C v, shape (n,), N.
    model_force : ndarray
        Force that the tracking model expects of this step, shape (n,), N; with the specimen it
        was identified with.
    """

    def __init__(self, knowledge: Knowledge, bias_corner: float) -> None:
        options, dt, n = knowledge.options, knowledge.dt, knowledge.axes
        self._axes, self._mass, dt = n, knowledge.mass, knowledge.dt
        self.noise = Noise.from_options(options)
        model = TrackingModel.from_options(options, dt)
        self.delay = model.delay(dt)
        self.preview = min(LONGEST_HORIZON, int(np.ceil((self.delay + HORIZON) / dt)))
        tracking = PreviewTracking.design(model, self.preview, min(CORNER * dt, HIGHEST_CORNER))
        nominal = _nominal(options, n)
        weights = np.zeros((2, 1 + self.preview))  # of the target, and of its rate
        weights[0] = tracking.target
        weights[1, 1:] += tracking.target[:-1] / (2 * dt)
        weights[1, :-1] -= tracking.target[1:] / (2 * dt)
        self.prediction = TargetPrediction(knowledge, weights, nominal)
        self.reach = float(tracking.target.sum())
        self._nominal = nominal
        self._observe = motion_filter(
            dt, self.noise.position, self.noise.velocity, self.noise.acceleration
        )
        self._bias_gain = 1.0 - np.exp(-2 * np.pi * bias_corner * dt)
        inertia = (np.diag(self._mass) * self.noise.acceleration) ** 2
        self.restoring_noise = self.noise.force**2 + inertia
        self._trust = _TRUST * self.noise.force**2 / self.restoring_noise
        # the loop's states z and the last forces: one product gives u less the target's part
        size, past = len(model.a), len(tracking.past)
        self._loop = np.zeros((2 + size + past, size + past))
        self._loop[0, :size], self._loop[0, size:] = tracking.state, tracking.past
        self._loop[1, :size] = model.c
        self._loop[2 : 2 + size, :size] = model.a
        self._loop[3 + size :, size:-1] = np.eye(past - 1)
        self._drive = np.concatenate([model.b, np.eye(1, past)[0]])[:, np.newaxis]
        # states, then the ground motion: from x on they give the target by one product
        count = (size + past + 4) * n
        work = np.zeros(count + (1 + self.preview) * n)
        self._states, self._ground_motion = work[:count], work[count:].reshape(-1, n)
        self._known = work[count - 4 * n :]
        self._tracking = work[: count - 4 * n].reshape(-1, n)
        self._kinematic = work[count - 4 * n : count - n].reshape(3, n)
        self.rest = work[count - n : count]
        self._measured = np.zeros((6, n))
        self.motion = self._kinematic[:2]
        self._flat_motion = self.motion.reshape(-1)
        self.zero = np.zeros(n)
        self.set_restoring(np.hstack([knowledge.stiffness, knowledge.damping]))

    def reset(self) -> None:
        """Forget the test so far, but not the specimen."""
        self._states[:] = 0.0

    def set_restoring(self, restoring: Floats) -> None:
        """Take the specimen to be (K, C), shape (n, 2n)."""
        self.restoring = restoring.copy()
        n = self._axes
        motion, ground_motion, rest = self.prediction.gains(restoring)
        self.rest_gains = np.ascontiguousarray(rest[:n])
        lasting = rest.reshape(2 * n, -1, n).sum(axis=1)
        self._gain = np.hstack([motion, np.zeros((2 * n, n)), lasting, ground_motion])
        if self._nominal is not None:
            self._departure = self._nominal - self.restoring

    def observe(self, state: Floats) -> None:
        """Take the measured sample in, shape (4, n): motion, restoring force, expected force."""
        self._measured[:3] = self._kinematic
        self._measured[3:] = state[:3]
        self.motion[:] = self._observe.dot(self._measured)
        self._kinematic[2] = state[2]
        self.restoring_force = state[3] - self._mass.dot(state[2])
        self._result = self._loop.dot(self._tracking)
        self.model_force = self._result[1]

    def take_residual(self) -> None:
        """Hold the measured restoring force against K x + C v."""
        self.residual = self.restoring_force - self.restoring.dot(self._flat_motion)

    def split(self) -> None:
        """Follow the slow part of the residual, p."""
        self.rest += self._bias_gain * (self.residual - self.rest)

    def departure(self) -> Floats:
        """Force by which the specimen departs from that of the tracking model, shape (n,), N."""
        if self._nominal is None:
            return self.zero
        departure: Floats = self._departure.dot(self._flat_motion) - self.rest
        return departure

    def target(self, ground_motion: Floats, rest: Floats | None = None) -> Floats:
        """Weighted target, and its weighted rate, shape (2, n); p stays, or is given."""
        self._ground_motion[:] = ground_motion
        sets: Floats = self._gain.dot(self._known).reshape(2, self._axes)
        if rest is not None:
            change = rest.reshape(-1, self._axes) - self.rest
            sets[0] += self.rest_gains.dot(change.reshape(-1))
        return sets

    def command(self, target: Floats, departure: Floats) -> Floats:
        """Compute the reference force for a weighted target, shape (n,), N."""
        drive = self._result[0] + target
        self._tracking[:] = self._result[2:]
        self._tracking += self._drive * drive
        force: Floats = drive - departure
        force += self._trust * (self.residual - self.rest)
        return force

    def linear(self, gain: Floats, advance: Floats) -> LinearFilter:
        """Filter that this is, with a tracking gain and an advance (s) found on line."""
        n, states = self._axes, self._states.copy()
        size, inputs = len(states), 4 * n
        columns = size + inputs + (1 + self.preview) * n
        matrix = np.empty((n + size, columns))
        for column in range(columns):
            unit = np.eye(1, columns, column)[0]
            self._states[:] = unit[:size]
            ground_motion = unit[size + inputs :].reshape(-1, n)
            self.observe(unit[size : size + inputs].reshape(4, n))
            self.take_residual()
            self.split()
            target, rate = self.target(ground_motion)
            force = self.command(gain * target - advance * rate, self.departure())
            matrix[:, column] = np.concatenate([force, self._states])
        self._states[:] = states
        c, d, e = np.split(matrix[:n], [size, size + inputs], axis=1)
        a, b, h = np.split(matrix[n:], [size, size + inputs], axis=1)
        return LinearFilter(a, b, h, c, d, e)


def _nominal(options: Mapping[str, Any], axes: int) -> Floats | None:
    """(K_0, C_0) of the specimen that tracking was identified with; None: not felt."""
    if not np.any(options["tracking.stiffness"]):
        return None
    names = [str(axis) for axis in range(axes)]
    return np.hstack(
        [
            as_matrix(options[f"tracking.{name}"], names, f"reference_force: tracking.{name}")
            for name in ("stiffness", "damping")
        ]
    )
