"""The small motion that a rig is asked for: rest, two frequencies under a bell, doublets."""

import math
from dataclasses import dataclass

import numpy as np
from seft_msgs_py.wire.trajectory import Floats

REST, BELL, PAUSE, PULSE = 0.4, 2.0, 0.3, 0.05  # s
DOUBLETS, APART = 5, 0.25  # s from one to the next
FREQUENCIES = (3.0, 6.0)  # Hz
SPARED = 0.1  # s at the start, in which a rig may settle


@dataclass(frozen=True)
class Drive:
    """Commands by step.

    Attributes
    ----------
    dt : float
        Sampling period, s.
    amplitude : float
        Largest command, in the unit of what drives the rig.
    """

    dt: float
    amplitude: float

    @property
    def steps(self) -> int:
        """Steps of all."""
        return self.doublets[-1] + self.step_at(APART)

    def step_at(self, time: float) -> int:
        """Step of a time, s."""
        return round(time / self.dt)

    @property
    def rest(self) -> slice:
        """Samples at the start that rest."""
        return slice(self.step_at(SPARED), self.step_at(REST))

    @property
    def bell(self) -> slice:
        """Samples that the bell moves, and the rest after it."""
        return slice(self.step_at(REST), self.step_at(REST + BELL + PAUSE / 2))

    @property
    def doublets(self) -> list[int]:
        """Steps whose answers begin the doublets."""
        first, apart = self.step_at(REST + BELL + PAUSE), self.step_at(APART)
        return [first + number * apart for number in range(DOUBLETS)]

    def command(self, step: int) -> float:
        """Command that answers a step."""
        time = step * self.dt - REST
        if 0 <= time < BELL:
            waves = sum(math.sin(2 * math.pi * f * time) for f in FREQUENCIES)
            return self.amplitude * waves / len(FREQUENCIES) * math.sin(math.pi * time / BELL) ** 2
        since, half = step - self.doublets[0], max(1, self.step_at(PULSE))
        since = since % self.step_at(APART) if since >= 0 else since
        if 0 <= since < half:
            return self.amplitude
        return -self.amplitude if half <= since < 2 * half else 0.0

    def commands(self) -> Floats:
        """Give all commands, shape (steps,)."""
        return np.array([self.command(step) for step in range(self.steps)])
