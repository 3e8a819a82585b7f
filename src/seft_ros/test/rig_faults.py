"""Faults that are tried on the simulated rig, and a host that holds or misses commands."""

import numpy as np

CHANNELS = ("displacement", "velocity", "acceleration", "force")
SENSOR_FAULTS = {  # with the channel's RMS noise and its largest value in the sound test
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
FAULTS = (
    *(f"{channel} {fault}" for channel in CHANNELS for fault in SENSOR_FAULTS),
    *_OTHERS,
    _DEAD,
)


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


HELD, MISSED = "commands held for 18 ms", "commands missed at random"
"""What a slow host does to a sound rig, at 500 Hz."""


class SlowHost:
    """Stands in for a `Rig` that gets its commands late, from step 400 on.

    Parameters
    ----------
    rig : Rig
        The rig.
    how : str
        `HELD` or `MISSED`.
    """

    def __init__(self, rig, how):
        self._rig, self._how = rig, how
        self._draw, self._missed, self._sent = np.random.default_rng(7), 0, []

    def __getattr__(self, name):
        return getattr(self._rig, name)

    def step(self, command):
        """Give the rig the newest command that it has by now."""
        age = self._rig.step_index - 400
        self._sent.append(np.array(command))
        if age < 0:
            self._missed = 0
        elif self._how == HELD:
            self._missed = age % 10 if age % 300 < 10 else 0
        else:
            misses = self._draw.random() < 0.2 and self._missed < 9
            self._missed = self._missed + 1 if misses else 0
        return self._rig.step(self._sent[-1 - self._missed])
