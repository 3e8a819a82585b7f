"""When a conformance test must stop moving a rig."""

import numpy as np
from seft_msgs_py.wire.trajectory import Floats

from seft_ros.conformance.facts import Facts

BASELINE = 20  # samples at rest that the motion is counted from
NAMES = ("displacement", "velocity", "acceleration", "force")
UNITS = ("m", "m/s", "m/s^2", "N")


class Guard:
    """Looks at each sample of a rig whose sensors are not trusted yet.

    A limit of the experiment that one sensor sees broken ends the test. Of the far smaller ones
    of this test two of displacement, integrated velocity and force must see it: one that lies is
    what the test is to find.

    Parameters
    ----------
    facts : Facts
        The rig.
    travel : float
        Largest displacement from where the rig rested, m.
    force : float
        Largest change of force, N.
    """

    def __init__(self, facts: Facts, travel: float, force: float) -> None:
        self._facts, self._travel, self._force = facts, travel, force
        self.reset()

    def reset(self) -> None:
        """Begin with a rig at rest."""
        self._samples: list[Floats] = []
        self._way = np.zeros(len(self._facts.experiment.axes))

    def fault(self, sample: Floats) -> str:
        """Take a sample, shape (4, n); say why the rig must not be moved on; empty if it may."""
        worst = np.abs(sample).max(axis=1)
        for name, unit, value, limit in zip(
            NAMES, UNITS, worst.tolist(), self._facts.limits.tolist(), strict=True
        ):
            if not value <= limit:
                told = f"{name} reads {value:.4g} {unit}, beyond the limit of {limit:g} {unit}"
                way = float(np.abs(self._way).max())
                return f"{told}; by its velocity the rig has moved {way:.2g} m"
        if len(self._samples) < BASELINE:
            self._samples.append(np.array(sample))
            return ""
        rest = np.mean(self._samples, axis=0)
        self._way += (sample[1] - rest[1]) * self._facts.dt
        way = float(np.abs(self._way).max())
        moved = float(np.abs(sample[0] - rest[0]).max())
        pushed = float(np.abs(sample[3] - rest[3]).max())
        votes = sum((moved > self._travel, way > self._travel, pushed > self._force))
        if votes < 2:
            return ""
        told = f"moved {moved:.3g} m, {way:.3g} m by its velocity, force changed {pushed:.4g} N"
        return f"{told}: more than {self._travel:g} m and {self._force:g} N"
