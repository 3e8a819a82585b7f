"""Experiment time: steps, and the stamps that name them."""

from dataclasses import dataclass
from fractions import Fraction

from seft_msgs_py.errors import InputError, WireError

NANOSECONDS_PER_SECOND = 1_000_000_000


@dataclass(frozen=True)
class Timebase:
    """Sampling clock of a test: step k is at experiment time ``k * period_ns``.

    Attributes
    ----------
    rate : float
        Sampling rate in Hz.
    period_ns : int
        Sampling period in nanoseconds, exact.
    """

    rate: float
    period_ns: int

    @classmethod
    def from_rate(cls, rate: float) -> "Timebase":
        """Make the time base of a rate in Hz.

        Raises
        ------
        InputError
            If the rate is not positive, or its period is no whole number of nanoseconds:
            stamps could then not name steps exactly.
        """
        if not 1e-6 < rate < float("inf"):
            raise InputError(f"rate: {rate:g} Hz is no sampling rate; give a positive number")
        period = Fraction(NANOSECONDS_PER_SECOND) / Fraction(rate)
        if period.denominator != 1:
            below, above = _nearest_exact_rates(rate)
            raise InputError(
                f"rate: the period of {rate:g} Hz is no whole number of nanoseconds; "
                f"the nearest usable rates are {below} and {above} Hz"
            )
        return cls(rate=float(rate), period_ns=period.numerator)

    @property
    def dt(self) -> float:
        """Sampling period in seconds."""
        return self.period_ns / NANOSECONDS_PER_SECOND

    def stamp_ns(self, step: int) -> int:
        """Experiment time of a step, in nanoseconds."""
        return step * self.period_ns

    def step(self, stamp_ns: int) -> int:
        """Step whose experiment time is ``stamp_ns``.

        Raises
        ------
        WireError
            If the stamp is negative or lies between two steps.
        """
        step, rest = divmod(stamp_ns, self.period_ns)
        if rest or step < 0:
            raise WireError(
                f"stamp {stamp_ns} ns is not on the {self.rate:g} Hz grid (period "
                f"{self.period_ns} ns); does the sender run at another rate?"
            )
        return step


def _nearest_exact_rates(rate: float) -> tuple[int, int]:
    """Whole-number rates below and above ``rate`` whose period is whole in nanoseconds."""
    exact = sorted(2**i * 5**j for i in range(10) for j in range(10))
    below = [r for r in exact if r < rate] or [1]
    above = [r for r in exact if r > rate] or [NANOSECONDS_PER_SECOND]
    return below[-1], above[0]
