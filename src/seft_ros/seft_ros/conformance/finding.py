"""What a check of a rig's driver found."""

from dataclasses import dataclass, field
from typing import Literal

Verdict = Literal["passed", "failed", "not run"]


@dataclass(frozen=True)
class Finding:
    """One check.

    Attributes
    ----------
    check : str
        What was looked at.
    verdict : str
        ``passed``, ``failed`` or ``not run``.
    told : str
        What was seen, with the measured number; or why it was not run.
    mend : str
        What to do about a failure.
    measured : dict of str to float
        The numbers, by name with unit.
    """

    check: str
    verdict: Verdict
    told: str
    mend: str = ""
    measured: dict[str, float] = field(default_factory=dict)


def found(check: str, passed: bool, told: str, mend: str = "", **measured: float) -> Finding:
    """Make the finding of a check that was run; how to mend it is told where it failed."""
    return Finding(check, "passed" if passed else "failed", told, "" if passed else mend, measured)


def not_run(check: str, why: str) -> Finding:
    """Make the finding of a check that could not be run."""
    return Finding(check, "not run", why)
