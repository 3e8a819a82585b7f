"""A rig whose hardware fails at a given step: below what a driver measures and commands."""

import numpy as np
from seft_plant_sim.actuator import PER_CAPACITY

CHANNELS = ("displacement", "velocity", "acceleration", "force")
SENSOR_FAULTS = {
    # value of the channel now, at the fault, its RMS noise and largest value, age of the fault (s)
    "dead": lambda now, then, noise, largest, age, draw: 0.0 * now,
    "dead but for noise": lambda now, then, noise, largest, age, draw: noise * draw,
    "frozen": lambda now, then, noise, largest, age, draw: then,
    "flipped": lambda now, then, noise, largest, age, draw: -now,
    "halved": lambda now, then, noise, largest, age, draw: 0.5 * now,
    "doubled": lambda now, then, noise, largest, age, draw: 2.0 * now,
    "off by its peak": lambda now, then, noise, largest, age, draw: now + largest,
    "drifting": lambda now, then, noise, largest, age, draw: now + 2.0 * age * largest,
    "noisy": lambda now, then, noise, largest, age, draw: now + 20.0 * noise * draw,
    "clipped": lambda now, then, noise, largest, age, draw: np.clip(now, -largest / 4, largest / 4),
}
VALVE_FAULTS = {  # command now, and at the fault
    "stuck": lambda now, then: then,
    "closed": lambda now, then: 0.0 * now,
    "reversed": lambda now, then: -now,
    "of half gain": lambda now, then: 0.5 * now,
    "wide open": lambda now, then: 0.0 * now + 10.0,
    "off by 2 V": lambda now, then: now + 2.0,
}
OTHER_FAULTS = (
    *("supply lost", "supply at a tenth", "converter frozen", "cable of all sensors broken"),
    *("converter late by 10 ms", "axes dead but for noise", "valve late by 20 ms"),
)
HELD, MISSED = "commands held for 18 ms", "commands missed at random"
"""What a slow host does to a sound rig, at 500 Hz."""
FAULTS = (
    *(f"{channel} {fault}" for channel in CHANNELS for fault in SENSOR_FAULTS),
    *(f"valve {fault}" for fault in VALVE_FAULTS),
    *OTHER_FAULTS,
)


class FaultyRig:
    """Stands in for a `Rig` of a test.

    Parameters
    ----------
    rig : Rig
        The sound one.
    fault : str
        One of `FAULTS`, `HELD` or `MISSED`; empty: none.
    step : int
        At which it begins.
    noise, largest : ndarray
        RMS noise and largest value of each channel, shape (4,).

    Attributes
    ----------
    peak_force, travel : float
        Largest true force (N) and displacement (m) so far.
    felt : int or None
        Step from which on what is measured is off by more than noise.
    sampled : list of ndarray
        What a sound sensor would have measured, shape (4, n) each.
    """

    def __init__(self, rig, fault, step, noise, largest):
        self._rig, self._fault, self._at = rig, fault, step
        self._noise, self._largest = noise, largest
        self._draw, self._missed = np.random.default_rng(7), 0
        self.sensors, self.felt, self.peak_force, self.travel = rig.sensors, None, 0.0, 0.0
        self.drive = rig.drive

    violation = property(lambda self: self._rig.violation)
    saturation = property(lambda self: self._rig.saturation)

    def reset(self):
        self.sampled, self._sent, self._then, self._volt = [], [], None, None
        return self._measured(self._rig.reset())

    def step(self, command):
        age = self._rig.step_index - self._at
        self._sent.append(np.array(command))
        if age >= 0:
            if self._volt is None:
                self._volt = self._sent[-1]
            command = self._commanded(age, self._sent[-1])
        return self._measured(self._rig.step(command))

    def simulated(self, first=None):
        return self._rig.simulated(first)

    def stop(self):
        """Close the valve, as far as it obeys."""
        stopped = self._rig.stop()
        self.peak_force = max(self.peak_force, stopped.peak_force)
        self.travel = max(self.travel, float(np.abs(self._rig.sample[0]).max()))

    def _commanded(self, age, command):
        name = self._fault.removeprefix("valve ")
        if self._fault.startswith("valve ") and name in VALVE_FAULTS:
            return VALVE_FAULTS[name](command, self._volt)
        if self._fault == HELD:
            return self._sent[-1 - age % 10] if age % 300 < 10 else command
        if self._fault == MISSED:
            misses = self._draw.random() < 0.2 and self._missed < 9
            self._missed = self._missed + 1 if misses else 0
            return self._sent[-1 - self._missed]
        if name == "late by 20 ms":
            return self._sent[max(len(self._sent) - 11, 0)]
        if "supply" in self._fault and age == 0:
            pistons = self._rig.parameters.dynamics.pistons
            pistons[:, PER_CAPACITY] *= 100.0 if "lost" in name else 10.0
        return command

    def _measured(self, state):
        self.peak_force = max(self.peak_force, float(np.abs(self._rig.sample[3]).max()))
        self.travel = max(self.travel, float(np.abs(self._rig.sample[0]).max()))
        age, state = self._rig.step_index - self._at, state.copy()
        self.sampled.append(state.copy())
        if age < 0:
            return state
        if self._then is None:
            self._then = state.copy()
        draw = self._draw.standard_normal(state.shape)
        for row, channel in enumerate(CHANNELS):
            name = self._fault.removeprefix(channel + " ")
            if name != self._fault:
                fault, largest = SENSOR_FAULTS[name], self._largest[row]
                noise, seconds = self._noise[row], age * self._rig.parameters.channels.dt
                then = self._then[row]
                state[row] = fault(state[row], then, noise, largest, seconds, draw[row])
        if self._fault == "converter frozen":
            state = self._then.copy()
        elif self._fault == "cable of all sensors broken":
            state[:] = 0.0
        elif self._fault == "converter late by 10 ms":
            state = self.sampled[max(len(self.sampled) - 6, 0)].copy()
        elif self._fault == "axes dead but for noise":
            state = self._noise[:, np.newaxis] * draw
        off = np.abs(state - self.sampled[-1]) > 6.0 * self._noise[:, np.newaxis]
        if self.felt is None and off.any():
            self.felt = self._rig.step_index
        return state
