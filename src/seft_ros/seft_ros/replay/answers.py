"""What a node answered in a replay."""

from dataclasses import dataclass

from seft_ros.recording.record import Estimates, Series


@dataclass
class Answers:
    """What a node answered.

    Attributes
    ----------
    series : Series
        On its topic, by step.
    estimates : Estimates or None
        Beside them.
    wall_s : float
        Duration, s.
    ended : str
        Why it answered no more before the end; else empty.
    """

    series: Series
    estimates: Estimates | None
    wall_s: float
    ended: str = ""
