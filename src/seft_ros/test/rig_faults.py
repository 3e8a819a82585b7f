"""Faults that are tried on the simulated rig, and a host that holds or misses commands."""

import numpy as np
from seft_msgs_py.config.facts import CHANNELS

SENSOR_FAULTS = {  # with the channel's RMS noise and its largest value in the fault-free test
    "dead": ("set 0",),
    "dead but for noise": ("set 0", "noise {noise!r}"),
    "frozen": ("freeze",),
    "flipped": ("flip",),
    "halved": ("scale 0.5",),
    "doubled": ("scale 2",),
    "off by its peak": ("add {largest!r}",),
    "drifting": ("drift {drift!r}",),
    "noisy": ("noise {noisy!r}",),
}
_OTHERS = {
    "valve stuck": ("valve stick",),
    "valve closed": ("valve set 0",),
    "valve reversed": ("valve flip",),
    "valve of half gain": ("valve scale 0.5",),
    "valve wide open": ("valve open 10",),
    "valve off by 2 V": ("valve add 2",),
    "valve late by 20 ms": ("valve late 0.02",),
    "supply lost": ("supply scale 0.01",),
    "supply at a tenth": ("supply scale 0.1",),
    "converter frozen": tuple(f"{channel} freeze" for channel in CHANNELS),
    "converter late by 10 ms": tuple(f"{channel} late 0.01" for channel in CHANNELS),
    "cable of all sensors broken": tuple(f"{channel} set 0" for channel in CHANNELS),
}
_DEAD = "axes dead but for noise"
_OF_SENSORS = (f"{channel} {fault}" for channel in CHANNELS for fault in SENSOR_FAULTS)
FAULTS = (*_OF_SENSORS, *_OTHERS, _DEAD)


def lines_of(fault, time, noise, largest):
    """Give a fault from a time (s) on as the parameter ``rig: faults``.

    Parameters
    ----------
    fault : str
        One of `FAULTS`.
    time : float
        In s of the test.
    noise, largest : ndarray
        RMS noise and largest value of each channel, shape (4,).
    """
    if fault in _OTHERS:
        return [f"{line} at {time!r}" for line in _OTHERS[fault]]
    found = []
    for channel, rms, peak in zip(CHANNELS, noise.tolist(), largest.tolist(), strict=True):
        name = "dead but for noise" if fault == _DEAD else fault.removeprefix(f"{channel} ")
        values = {"noise": rms, "noisy": 20.0 * rms, "largest": peak, "drift": 2.0 * peak}
        kinds = SENSOR_FAULTS[name] if name != fault else ()
        found += [f"{channel} {kind.format(**values)} at {time!r}" for kind in kinds]
    return found


LATE, MISSED = "nine commands missed in a row", "commands missed at random"
"""What a slow host does to a fault-free rig, at 500 Hz."""


class SlowHost:
    """Stands in for a `Rig` that misses commands, of which nobody tells, from step 400 on.

    Parameters
    ----------
    rig : Rig
        The rig.
    how : str
        `LATE` or `MISSED`.
    interlock : Interlock
        Gives the stop along which the rig continues.
    """

    def __init__(self, rig, how, interlock):
        self._rig, self._how, self._interlock = rig, how, interlock
        self._draw, self._missed = np.random.default_rng(7), 0

    def __getattr__(self, name):
        return getattr(self._rig, name)

    def step(self, command):
        """Give the rig a command, or none."""
        index, age = self._rig.step_index, self._rig.step_index - 400
        if self._how == LATE:
            misses = age >= 0 and age % 300 < 9
        else:
            misses = age >= 0 and self._draw.random() < 0.2 and self._missed < 9
        if not misses:
            self._last, self._missed = np.array(command), 0
            self._plan = np.array(self._interlock.stop(index))
            return self._rig.step(command)
        self._missed += 1
        return self._rig.step(
            self._rig.extrapolated_command(self._last, self._missed, self._plan, self._missed)
        )
