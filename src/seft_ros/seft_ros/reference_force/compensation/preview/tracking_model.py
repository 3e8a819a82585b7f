"""Force tracking as it was identified: from reference force to measured force, sampled."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm
from seft_msgs_py.errors import InputError

from seft_ros.loop_shaping.companion import companion_form

Floats = npt.NDArray[np.float64]

_LONGEST = 250  # samples of dead time
_SETTLING = 1000  # samples of an impulse response by which the states are scaled


@dataclass(frozen=True, eq=False)
class TrackingModel:
    """One axis of the force loop: z[k+1] = a z[k] + b u[k], f[k] = c z[k].

    u is the reference force, linear between its samples (first-order hold), so that no phase
    is added to the identified response; f is the force measured at the same step.

    Attributes
    ----------
    a, b, c : ndarray
        Shapes (s, s), (s,) and (s,). The states are scaled to equal size.
    dead_time : float
        s, during which f does not answer at all.
    """

    a: Floats
    b: Floats
    c: Floats
    dead_time: float

    @classmethod
    def from_options(cls, options: Mapping[str, Any], dt: float) -> "TrackingModel":
        """Sample ``tracking.*``; where it is not known, the pure delay ``compensation.delay``.

        Raises
        ------
        InputError
            If neither is given, or the response is improper, unstable or answers at once.
        """
        numerator = np.trim_zeros(np.atleast_1d(options["tracking.numerator"]).astype(float), "f")
        denominator = np.trim_zeros(
            np.atleast_1d(options["tracking.denominator"]).astype(float), "f"
        )
        dead_time = float(options["tracking.dead_time"])
        if not numerator.size:
            numerator = denominator = np.ones(1)
            dead_time = float(options["compensation.delay"])
            if not dead_time:
                raise InputError(
                    "reference_force: compensation.method preview_inverse needs tracking.*, the "
                    "identified response of the force loop (or compensation.delay, a pure "
                    "delay); seft identify writes it into model.yaml, to be read by --params-file"
                )
        return _sampled(tuple(numerator.tolist()), tuple(denominator.tolist()), dead_time, dt)

    @classmethod
    def sampled(
        cls, numerator: Floats, denominator: Floats, dead_time: float, dt: float
    ) -> "TrackingModel":
        """Sample a response in s, highest power first, with a dead time in s.

        Raises
        ------
        InputError
            If it is improper, unstable, or its dead time no sensible number of samples.
        """
        if numerator.size > denominator.size or not denominator.size:
            raise InputError(
                f"reference_force: tracking is improper: numerator of degree {numerator.size - 1} "
                f"over denominator of degree {denominator.size - 1}"
            )
        a, b, c, direct = companion_form(numerator, denominator)
        order = len(a)
        whole = int(np.ceil(dead_time / dt - 1e-9))
        if not 1 <= whole <= _LONGEST:
            raise InputError(
                f"reference_force: tracking.dead_time is {dead_time:g} s, but must be more than 0 "
                f"and at most {_LONGEST} samples ({_LONGEST * dt:g} s): the loop's own latency is "
                "in it"
            )
        part = round(whole - dead_time / dt, 9)  # of u[k - whole + 1], the rest of u[k - whole]
        early, late = _ramp(a, b, (1 - part) * dt), _ramp(a, b, part * dt)
        free = late[0] @ early[0]
        oldest = late[0] @ (early[1] * (1 - part) - early[2] / dt)
        middle = late[0] @ (early[1] * part + early[2] / dt) + late[1] - late[2] / dt
        newest = late[2] / dt
        size = order + whole
        system, drive, output = np.zeros((size, size)), np.zeros(size), np.zeros(size)
        system[:order, :order] = free
        drive[order] = 1.0  # the states after the first are u[k-1], u[k-2], ...
        system[order + 1 :, order:-1] = np.eye(whole - 1)
        output[:order] = c
        for gain, to_output, lag in (
            (oldest, (1 - part) * direct, whole),
            (middle, part * direct, whole - 1),
            (newest, 0.0, whole - 2),
        ):
            if lag > 0:
                system[:order, order + lag - 1] += gain
                output[order + lag - 1] += to_output
            elif lag == 0 and not to_output:
                drive[:order] += gain
            elif gain.any() or to_output:
                raise InputError(
                    "reference_force: tracking.* answers at once, but no loop does; is "
                    "tracking.dead_time without the loop's latency?"
                )
        if np.abs(np.linalg.eigvals(system)).max() >= 1.0:
            raise InputError("reference_force: tracking.denominator has an unstable pole")
        scale = _sizes(system, drive)
        scaled = system * scale / scale[:, np.newaxis]
        return cls(scaled, drive / scale, output * scale, dead_time)

    def delay(self, dt: float, hz: float = 1.0) -> float:
        """Phase delay at a frequency, s."""
        z = np.exp(2j * np.pi * hz * dt)
        response = self.c @ np.linalg.solve(z * np.eye(len(self.a)) - self.a, self.b)
        return float(-np.angle(response) / (2 * np.pi * hz))


@lru_cache(maxsize=8)
def _sampled(
    numerator: tuple[float, ...], denominator: tuple[float, ...], dead_time: float, dt: float
) -> TrackingModel:
    """One model to a response, as whoever varies mass ratio or specimen asks for it often."""
    return TrackingModel.sampled(np.array(numerator), np.array(denominator), dead_time, dt)


def _sizes(system: Floats, drive: Floats) -> Floats:
    """Root of the sum of squares of each state after an impulse, about; never zero."""
    squares, state = np.zeros_like(drive), drive
    for _ in range(_SETTLING):
        squares += state * state
        state = system @ state
    return np.sqrt(np.maximum(squares, 1e-24))


def _ramp(a: Floats, b: Floats, time: float) -> tuple[Floats, Floats, Floats]:
    """Transition over some time of z' = a z + b (u0 + u1 t): its gains of z, u0 and u1."""
    size = len(a)
    augmented = np.zeros((size + 2, size + 2))
    augmented[:size, :size] = a
    augmented[:size, size] = b
    augmented[size, size + 1] = 1.0
    exponential = expm(augmented * time)
    return exponential[:size, :size], exponential[:size, size], exponential[:size, size + 1]
