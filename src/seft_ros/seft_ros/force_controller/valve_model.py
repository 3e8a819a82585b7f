"""A servo-valve from the held command to its flow: response, inverse, and flow still to come."""

import cmath
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import Complexes, Floats
from seft_msgs_py.config.parameter_table import per_axis
from seft_plant_sim.lti import MIN_SAMPLES, noncausal_inverse

INVERTED_TO = 0.85
"""Highest inverted frequency over the valve's own: higher ones need too much drive."""
INVERSE_SPAN = 4.0
"""Length of the inverse over the mean delay from command to flow: longer weights are negligible."""
ASSUMED_ACTUATOR = ("flow_gain", "oil_stiffness", "leakage", "force_capacity")
"""Columns of `FeedforwardParameters.actuator`."""
_VALVE = ("valve_frequency", "valve_damping", "dead_time")
DERIVATIVE_STEP = 1e-4  # s, by which the response is differentiated
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
    delay : float
        Mean delay from a sample to the flow of the command that answers it, s.
    """

    def __init__(self, frequency: float, damping: float, dead_time: float, dt: float) -> None:
        self._w, self._zeta = 2 * math.pi * frequency, damping
        self._late, self._dt = dead_time + dt, dt
        self.delay = self._late + dt / 2 + 2 * damping / self._w
        self._highest = min(INVERTED_TO * frequency, 1 / (MIN_SAMPLES * dt))
        decay = min(damping, 1 / damping) * self._w  # of the slower part
        self.memory = math.ceil((self._late + dt - math.log(NEGLIGIBLE_FLOW) / decay) / dt)

    def flow(self, time: npt.NDArray[np.floating]) -> Floats:
        """Flow per command, without unit, at times after the sample that the command answers, s."""
        return self._after(time - self._late) - self._after(time - self._late - self._dt)

    def volume(self, time: npt.NDArray[np.floating]) -> Floats:
        """Integral of `flow` up to these times, s."""
        late = time - self._late
        return self._after(late, integrated=True) - self._after(late - self._dt, integrated=True)

    def _after(self, time: npt.NDArray[np.floating], integrated: bool = False) -> Floats:
        """Response of the valve to a step, or its integral."""
        t, w, zeta = np.maximum(time, 0.0), self._w, self._zeta
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

    def inverse(self, taps: int) -> Floats:
        """Weights h of the future flows, so that sum_j h_j flow[k + j] makes this flow; (taps,).

        By `noncausal_inverse`.
        """

        def response(s: Complexes) -> Complexes:
            hold = np.exp(-s * (self._late + self._dt / 2)) * np.sinc(s.imag * self._dt / math.tau)
            return hold * self._w**2 / (s * s + 2 * self._zeta * self._w * s + self._w**2)

        return noncausal_inverse(response, self._highest, taps, self._dt)

    def taps(self) -> int:
        """Sufficient length of the inverse."""
        return max(4, math.ceil(INVERSE_SPAN * self.delay / self._dt))

    def in_flight(self) -> Floats:
        """Part of the flow of past commands that is still to come, the newest first; (memory,).

        The newest is the one that answered the last sample.
        """
        return 1.0 - self.volume(self._dt * np.arange(1.0, self.memory + 1)) / self._dt

    def past(self, late: float = 0.0) -> Floats:
        """Present flow of past commands, the newest first, with a further delay of ``late`` s."""
        return self.flow(self._dt * np.arange(1, self.memory + 1) - late)

    def later(self) -> Floats:
        """Change of `past` per delay, 1/s."""
        return (self.past(DERIVATIVE_STEP) - self.past()) / DERIVATIVE_STEP

    def last_period(self) -> Floats:
        """Mean flow of past commands in the last period, and its change per delay; (2, memory)."""
        times = self._dt * np.arange(self.memory + 1)
        return np.diff([self.volume(times), -self.flow(times)]) / self._dt


def read_actuators(
    section: Mapping[str, Any], axes: tuple[str, ...], places: Sequence[int]
) -> dict[str, Floats]:
    """Read ``actuator.*`` of a force controller's section, for the axes at some places.

    Returns
    -------
    dict of str to ndarray
        `ASSUMED_ACTUATOR` and `_VALVE`, by name, shape (number of places,) each. The dead time is
        that from a command to the measured flow, with the lag of the measured state.
    """
    where, own = "force_controller: actuator", list(places)
    known = {
        name: per_axis(section[f"actuator.{name}"], axes, f"{where}.{name}")[own]
        for name in (*ASSUMED_ACTUATOR, *_VALVE)
    }
    known["dead_time"] = known["dead_time"] + section["sensor_lag"]
    return known


def valve_models(actuator: Mapping[str, Floats], dt: float) -> list[ValveModel]:
    """Make the valves of n axes, all with the memory of the slowest.

    Parameters
    ----------
    actuator : mapping
        With ``valve_frequency`` (Hz), ``valve_damping`` and ``dead_time`` (s), shape (n,) each.
    dt : float
        Sampling period, s.
    """
    each = np.transpose([actuator[name] for name in _VALVE]).tolist()
    valves = [ValveModel(frequency, damping, late, dt) for frequency, damping, late in each]
    memory = max(valve.memory for valve in valves)
    for valve in valves:
        valve.memory = memory
    return valves
