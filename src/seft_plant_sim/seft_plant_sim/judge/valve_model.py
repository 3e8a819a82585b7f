"""A servo-valve from the held command to its flow: response and inverse."""

import cmath
import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import Complexes, Floats

from seft_plant_sim.lti import MIN_SAMPLES, noncausal_inverse

INVERTED_TO = 0.85
"""Highest inverted frequency over the valve's own: higher ones need too much drive."""
INVERSE_SPAN = 4.0
"""Length of the inverse over the mean delay from command to flow: longer weights are negligible."""
NEGLIGIBLE_FLOW = 1e-3
"""Part of a command's flow that may be neglected: it is below the noise."""


class ValveModel:
    """Second-order valve with dead time, driven by commands that are held for a period.

    A command that answers the sample of step k is held from step k + 1 on.

    Parameters
    ----------
    frequency, damping : float
        Of the valve, Hz and damping ratio.
    dead_time : float
        s.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    natural, damping : float
        Natural frequency, rad/s, and damping ratio.
    late : float
        Time from a sample to the first effect of the command that answers it, s.
    delay : float
        Mean delay from a sample to the flow of that command, s.
    memory : int
        Periods after which the flow of a command is complete.
    """

    def __init__(self, frequency: float, damping: float, dead_time: float, dt: float) -> None:
        self.natural, self.damping = 2 * math.pi * frequency, damping
        self.late, self._dt = dead_time + dt, dt
        self.delay = self.late + dt / 2 + 2 * damping / self.natural
        self._highest = min(INVERTED_TO * frequency, 1 / (MIN_SAMPLES * dt))
        slower = damping - math.sqrt(max(damping * damping - 1.0, 0.0))
        decay = slower * self.natural
        self.memory = math.ceil((self.late + dt - math.log(NEGLIGIBLE_FLOW) / decay) / dt)
        beyond = dt * np.arange(self.memory, 2 * self.memory) - self.late - dt
        lacks = np.abs(1.0 - self._after(beyond))  # more than exp(-decay t), near critical damping
        self.memory += int(np.argmax(lacks <= NEGLIGIBLE_FLOW))

    def flow(self, time: npt.NDArray[np.floating]) -> Floats:
        """Flow per command, without unit, at times after the sample that the command answers, s."""
        return self._after(time - self.late) - self._after(time - self.late - self._dt)

    def volume(self, time: npt.NDArray[np.floating]) -> Floats:
        """Integral of `flow` up to these times, s."""
        late = time - self.late
        return self._after(late, integrated=True) - self._after(late - self._dt, integrated=True)

    def _after(self, time: npt.NDArray[np.floating], integrated: bool = False) -> Floats:
        """Response of the valve to a step, or its integral."""
        t, w, zeta = np.maximum(time, 0.0), self.natural, self.damping
        root = w * cmath.sqrt(zeta * zeta - 1.0)
        if abs(root) < 1e-6 * w:  # critically damped: the poles must differ
            root = complex(1e-6 * w)
        poles = -zeta * w + root, -zeta * w - root
        first, second = poles[1] / (poles[0] - poles[1]), -poles[0] / (poles[0] - poles[1])
        parts = (first, poles[0]), (second, poles[1])
        if integrated:
            result = t + sum(c / p * (np.exp(p * t) - 1.0) for c, p in parts)
        else:
            result = 1.0 + sum(c * np.exp(p * t) for c, p in parts)
        return np.where(time > 0, result.real, 0.0)

    def inverse(self, taps: int, past: int) -> Floats:
        """Weights h of flows, so that sum_j h_j flow[k + j - past] makes this flow; (past + taps,).

        A flow is the mean over the period that begins with its sample. By `noncausal_inverse`.
        """

        def response(s: Complexes) -> Complexes:
            mean = np.exp(-s * self.late) * np.sinc(s.imag * self._dt / math.tau) ** 2
            w, zeta = self.natural, self.damping
            return mean * w * w / (s * s + 2 * zeta * w * s + w * w)

        return noncausal_inverse(response, self._highest, past + taps, self._dt, past)

    def taps(self) -> int:
        """Sufficient number of future flows in the inverse."""
        return max(4, math.ceil(INVERSE_SPAN * self.delay / self._dt))

    def past(self) -> int:
        """Sufficient number of past flows: half a cycle of the highest inverted frequency."""
        return math.ceil(0.5 / (self._highest * self._dt))

    def last_period(self) -> Floats:
        """Mean flow of past commands in the last period, and its change per delay; (2, memory)."""
        times = self._dt * np.arange(self.memory + 1)
        return np.diff([self.volume(times), -self.flow(times)]) / self._dt


def valve_models(actuator: Mapping[str, Floats], dt: float) -> list[ValveModel]:
    """Make the valves of n axes, all with the memory of the slowest.

    Parameters
    ----------
    actuator : mapping
        With ``valve_frequency`` (Hz), ``valve_damping`` and ``dead_time`` (s), shape (n,) each.
    dt : float
        Sampling period, s.
    """
    of_valve = ("valve_frequency", "valve_damping", "dead_time")
    each = np.transpose([actuator[name] for name in of_valve]).tolist()
    valves = [ValveModel(frequency, damping, late, dt) for frequency, damping, late in each]
    memory = max(valve.memory for valve in valves)
    for valve in valves:
        valve.memory = memory
    return valves
