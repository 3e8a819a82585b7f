"""Dead time of a drive that is held between samples."""

from seft_msgs_py.errors import InputError

MAX_STEPS = 1_000_000


def split_dead_time(delay: float, dt: float) -> tuple[int, float]:
    """Split a dead time into whole samples and the rest.

    Between two samples the delayed drive changes once, that rest after the first.

    Parameters
    ----------
    delay, dt : float
        Dead time and sampling period, s.

    Returns
    -------
    whole : int
        Whole sampling periods.
    part : float
        Time into the period at which the drive changes, s; 0: at the sample itself.

    Raises
    ------
    InputError
        If the delay is too many samples long.
    """
    whole = int(delay / dt + 1e-9)
    if whole > MAX_STEPS:
        raise InputError(f"actuator: a delay of {delay:g} s is {whole} samples long")
    rest = delay - whole * dt
    return whole, rest if rest > 1e-9 * dt else 0.0
