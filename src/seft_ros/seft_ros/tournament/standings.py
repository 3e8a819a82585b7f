"""How the methods of a tournament came off, best first."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median

from seft_ros.tournament.entries import Tournament
from seft_ros.tournament.runs import Run


@dataclass(frozen=True)
class Standing:
    """One method at one mass ratio, over all rigs.

    Errors are those of the displacement, without any shift; they leave unstable tests out.

    Attributes
    ----------
    mass_ratio : float
        Of its tests.
    method : str
        Compensation method.
    rank : int or None
        From 1 on; methods that do equally well share it. None: not possible.
    nrmse_configured : float or None
        Error on the configured rig; None where it was unstable.
    nrmse_median : float or None
        Median over the stable tests; None: there is none.
    nrmse_worst : float or None
        Largest error; None where a test was unstable.
    peak_error : float or None
        (peak - exact peak) / exact peak where it is largest in magnitude.
    delay_s : float or None
        Median of the best-fit delays of the displacement, s.
    unstable_share : float or None
        Share of the tests that tripped or went beyond all numbers.
    cost_s : float or None
        Time of a step, s.
    not_possible : str or None
        Why the method could not be set up.
    """

    mass_ratio: float
    method: str
    rank: int | None = None
    nrmse_configured: float | None = None
    nrmse_median: float | None = None
    nrmse_worst: float | None = None
    peak_error: float | None = None
    delay_s: float | None = None
    unstable_share: float | None = None
    cost_s: float | None = None
    not_possible: str | None = None


def standings(
    tournament: Tournament, runs: Sequence[Run], costs: Mapping[tuple[float, str], float]
) -> list[Standing]:
    """Rank the methods of each mass ratio by their worst case.

    The fewer tests of a method went unstable the better; of those with as many, the smaller
    largest error is better, or, where some were unstable, the smaller median. Methods that are
    not possible come last.

    Parameters
    ----------
    tournament : Tournament
        Who took part.
    runs : sequence of Run
        Every test of it.
    costs : mapping
        (mass ratio, method) -> time of a step, s.
    """
    found: list[Standing] = []
    for ratio in tournament.mass_ratios:
        ranked, left_out = [], []
        for method in tournament.methods:
            reason = tournament.not_possible.get((ratio, method))
            if reason is not None:
                left_out.append(Standing(ratio, method, not_possible=reason))
                continue
            own = [run for run in runs if run.entry[::2] == (ratio, method)]
            ranked.append(_standing(ratio, method, own, costs.get((ratio, method))))
        ranked.sort(key=_badness)
        badness = [_badness(standing) for standing in ranked]
        found += [
            replace(standing, rank=1 + badness.index(bad))
            for standing, bad in zip(ranked, badness, strict=True)
        ]
        found += left_out
    return found


def _standing(ratio: float, method: str, runs: Sequence[Run], cost: float | None) -> Standing:
    stable = [run.summary["displacement"] for run in runs if run.stable]
    errors = _known(part["nrmse"] for part in stable)
    delays = _known(part["delay_s"] for part in stable)
    peaks = [
        part["peak"] / part["reference_peak"] - 1.0 for part in stable if part["reference_peak"]
    ]
    return Standing(
        mass_ratio=ratio,
        method=method,
        nrmse_configured=next((run.nrmse for run in runs if run.entry.rig == 0), None),
        nrmse_median=median(errors) if errors else None,
        nrmse_worst=max(errors) if len(errors) == len(runs) else None,
        peak_error=max(peaks, key=abs, default=None),
        delay_s=median(delays) if delays else None,
        unstable_share=1.0 - len(stable) / len(runs),
        cost_s=cost,
    )


def _badness(standing: Standing) -> tuple[float, float, float]:
    share, worst, middle = (
        math.inf if value is None else value
        for value in (standing.unstable_share, standing.nrmse_worst, standing.nrmse_median)
    )
    return share, worst, middle


def _known(values: Iterable[float | None]) -> list[float]:
    return [value for value in values if value is not None]
