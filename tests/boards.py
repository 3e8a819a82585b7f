"""Laboratories' hardware for tests: classes on a simulated converter board, good and bad."""

import sys
import textwrap
import threading
import time

import numpy as np
from seft_plant_sim.simulated.rig import ConverterBoard

CALLS: list[tuple[str, int]] = []
"""Method and thread of each call since a test has emptied it."""


class Board:
    """Fault-free; it notes its calls."""

    def __init__(self, parameters, axes):
        self._board, self._n = ConverterBoard(parameters, axes), len(axes)
        self.reads = 0

    def _note(self, method):
        CALLS.append((method, threading.get_ident()))

    def read(self):
        self._note("read")
        self.reads += 1
        return self._board.inputs()

    def write(self, drive):
        self._note("write")
        self._board.output(drive)

    def safe(self):
        self._note("safe")
        self._board.output(np.zeros(self._n))

    def close(self):
        self._note("close")


class Waits(Board):
    """One that runs in lockstep, too."""

    can_wait = True


class Dumps(Board):
    """Its piston goes on after the valve was closed, until the pressure is taken away."""

    def safe(self):
        self._note("safe")
        was_open = ("write", threading.get_ident()) in CALLS
        self._board.output(np.full(self._n, 0.3 if was_open else 0.0))

    def dump_pressure(self):
        self._note("dump_pressure")
        self._board.output(np.zeros(self._n))


class NoVelocity(Board):
    """It has no velocity sensor."""

    def read(self):
        shown = super().read()
        shown[1] = np.nan
        return shown


AT = 700
"""Reads after which the bad ones are bad: before the test's beginning, or in it."""


class Spoilt(Board):
    """What it reads is."""

    def read(self):
        shown = super().read()
        return self.spoilt(shown) if self.reads > AT else shown


class Raises(Spoilt):
    """The converter fails."""

    def spoilt(self, shown):
        raise OSError("the converter does not answer")


class Shrinks(Spoilt):
    """A channel is lost."""

    def spoilt(self, shown):
        return shown[:3]


class Loses(Spoilt):
    """A value is lost."""

    def spoilt(self, shown):
        shown[3, -1] = np.nan
        return shown


class Tells(Spoilt):
    """It gives no numbers."""

    def spoilt(self, shown):
        return "no numbers"


class Refuses(Board):
    """The amplifier refuses a command."""

    def write(self, drive):
        super().write(drive)
        if self.reads > AT:
            raise ValueError("refused")


class Exits(Spoilt):
    """A library ends the program."""

    def spoilt(self, shown):
        sys.exit("no licence")


class Inherits(Board):
    """It never reads, by a method that another file has."""

    read = textwrap.dedent


class Slow(Spoilt):
    """A call takes longer than a period."""

    clock = time  # of the test

    def spoilt(self, shown):
        self.clock.sleep(0.003)
        return shown


class Stuck(Board):
    """Its relay does not close the valve after a test."""

    def safe(self):
        super().safe()
        if self.reads > AT:
            raise OSError("the relay is stuck")


class WithoutSafe:
    """It lacks a method."""

    def __init__(self, parameters, axes):
        del parameters, axes

    read = write = close = print


class Broken(Board):
    """It can't be made."""

    def __init__(self, parameters, axes):
        super().__init__(parameters, axes)
        raise OSError("no board in slot 3")
