"""What the tests of a study say: distribution of the error, trips, causes, the worst tests."""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest, rankdata
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import write_parameter_file
from seft_msgs_py.config.parameter_table import Section
from seft_msgs_py.errors import InputError

from seft_ros.drawing.style import RESPONSES, json_safe
from seft_ros.ground_motion.ground_motion_block import FILES
from seft_ros.ground_motion.record_file import files_of, source_name
from seft_ros.study.drawn_tests import DrawnTests, StudyDesign, StudyTest
from seft_ros.study.study_runs import Run

STUDY_QUANTILES = {"median": 0.5, "p90": 0.9, "p95": 0.95, "max": 1.0}
"""Share of the tests whose error is at most a number of this name."""
CORRELATIONS = ("value", "deviation")

_Z95 = 1.959964  # of the normal distribution: 95 % are within
_WORST = 5  # tests that are listed
_FURTHEST = 3  # quantities that are listed with one of them


def summarise_study(design: StudyDesign, runs: Sequence[Run]) -> dict[str, Any]:
    """Summarise a study: ``seft study --json``.

    Parameters
    ----------
    design : StudyDesign
        With N drawn tests.
    runs : sequence of Run
        Of all its tests.

    Returns
    -------
    dict
        ``tests`` (N), ``seed``, ``spread``, ``results`` (see `result_of`; the mass ratios in their
        order, the methods of each with the best first), ``not_possible`` (mass_ratio, method,
        reason), ``chance`` (rank correlations up to this come about by chance alone, 95 %) and
        ``drawn`` (of each test: test, motion, factors, offsets).

        A method is better if fewer of its tests tripped; of those with as many, if the error of
        the displacement is smaller in 95 % of the tests, at most, as a median.
    """
    drawn, by_method = design.drawn, dict[tuple[float, str], list[Run]]()
    for run in runs:
        by_method.setdefault(run.test[:2], []).append(run)
    results = [result_of(design, own) for own in by_method.values()]
    results.sort(key=lambda one: (design.mass_ratios.index(one["mass_ratio"]), *_rank(one)))
    not_possible = [
        {"mass_ratio": ratio, "method": method, "reason": reason}
        for (ratio, method), reason in design.not_possible.items()
    ]
    tests = [
        {
            "test": number + 1,
            "motion": _motion(sections),
            "factors": {name: own[number] for name, own in drawn.factors.items()},
            "offsets": {name: own[number] for name, own in drawn.offsets.items()},
        }
        for number, sections in enumerate(drawn.sections[1:])
    ]
    found: dict[str, Any] = {"tests": len(tests), "seed": drawn.seed, "spread": drawn.spread}
    found |= {"results": results, "not_possible": not_possible}
    found |= {"chance": _Z95 / math.sqrt(len(tests) - 1), "drawn": tests}
    return json_safe(found)


def result_of(design: StudyDesign, runs: Sequence[Run]) -> dict[str, Any]:
    """Summarise the tests of one method at one mass ratio, the configured one first.

    Returns
    -------
    dict
        ``mass_ratio``, ``method``, ``uncompiled`` (why its tests were simulated uncompiled, or
        empty), ``configured`` (summary of test 0); of the drawn tests ``distribution``
        of the errors of displacement, force and acceleration (`STUDY_QUANTILES`; a test that
        tripped is infinitely wrong), ``trips`` (count, share and its 95 % interval by Wilson 1927;
        of the tests that tripped or became unstable), ``causes`` (see `causes_of`), ``motions``
        (file -> tests, and `STUDY_QUANTILES` of the displacement's error), ``worst`` (test,
        nrmse, stable, trip, furthest: the factors that differ most from 1, and the offsets from
        0, for how they are drawn) and ``runs`` (test, and its summary).
    """
    configured, drawn = runs[0], [run.summary for run in runs[1:]]
    errors, lost = errors_of(drawn), sum(not one["stable"] for one in drawn)
    motions = np.array([_motion(sections) for sections in design.drawn.sections[1:]])
    groups = {str(name): errors[motions == name] for name in np.unique(motions)}
    ranked = sorted(range(len(drawn)), key=lambda n: -np.nan_to_num(errors[n], nan=math.inf))
    return {
        "mass_ratio": configured.test.mass_ratio,
        "method": configured.test.method,
        "uncompiled": configured.why_not_compiled,
        "configured": configured.summary,
        "distribution": {name: quantiles(errors_of(drawn, name)) for name in RESPONSES},
        "trips": {
            "count": lost,
            "share": lost / len(drawn),
            "interval_95": binomtest(lost, len(drawn)).proportion_ci(method="wilson"),
        },
        "causes": causes_of(design.drawn, errors),
        "motions": {name: {"tests": len(own), **quantiles(own)} for name, own in groups.items()},
        "worst": [_worst(design, 1 + n, drawn[n]) for n in ranked[:_WORST]],
        "runs": [{"test": number} | one for number, one in enumerate(drawn, 1)],
    }


def _motion(sections: Mapping[str, Section]) -> str:
    return source_name(sections["ground_motion"]["file"])


def _worst(design: StudyDesign, number: int, outcome: Mapping[str, Any]) -> dict[str, Any]:
    drawn, far = design.drawn.factors | design.drawn.offsets, design.drawn.deviations()
    shares = {name: own[number - 1] / (own.max() or 1.0) for name, own in far.items()}
    names = sorted(shares, key=lambda name: -shares[name])[:_FURTHEST]
    furthest = {name: drawn[name][number - 1] for name in names}
    error, stable, trip = outcome["displacement"]["nrmse"], outcome["stable"], outcome["trip"]
    found = {"test": number, "nrmse": error, "stable": stable, "trip": trip}
    return found | {"furthest": furthest}


def _rank(result: Mapping[str, Any]) -> list[float]:
    errors = result["distribution"]["displacement"]
    values = [result["trips"]["share"], *(errors[name] for name in ("p95", "max", "median"))]
    return [math.inf if math.isnan(value) else value for value in values]


def errors_of(outcomes: Sequence[Mapping[str, Any]], response: str = "displacement") -> Floats:
    """NRMSE of tests by their summaries; infinite where unstable, NaN where it is undefined."""
    values = [one[response]["nrmse"] if one["stable"] else math.inf for one in outcomes]
    return np.array(values, dtype=float)


def quantiles(errors: Floats) -> dict[str, float]:
    """Smallest errors that so many of the tests do not exceed, see `STUDY_QUANTILES`."""
    known = np.sort(errors[~np.isnan(errors)])
    if not len(known):
        return dict.fromkeys(STUDY_QUANTILES, math.nan)
    places = {name: math.ceil(share * len(known)) - 1 for name, share in STUDY_QUANTILES.items()}
    return {name: float(known[max(place, 0)]) for name, place in places.items()}


def causes_of(drawn: DrawnTests, errors: Floats) -> list[dict[str, Any]]:
    """Rank correlations (Spearman) of the error with each drawn quantity, largest first.

    With its value, and with how far that is from the configured one either way (`CORRELATIONS`);
    the square of the larger one is the share of the differences between the tests' ranks that the
    quantity explains. Unstable tests are the most wrong. NaN where all errors are equal.
    """
    known, deviations, found = ~np.isnan(errors), drawn.deviations(), list[dict[str, Any]]()
    for name, values in (drawn.factors | drawn.offsets).items():
        pairs = zip(CORRELATIONS, (values, deviations[name]), strict=True)
        cause = {key: _spearman(x[known], errors[known]) for key, x in pairs}
        found.append({"quantity": name, **cause, "explains": strength(cause) ** 2})
    return sorted(found, key=strength, reverse=True)


def strength(cause: Mapping[str, Any]) -> float:
    """Magnitude of the larger of both correlations; 0 where there is none."""
    values = [cause[key] for key in CORRELATIONS if cause[key] is not None]
    return max((abs(value) for value in values if math.isfinite(value)), default=0.0)


def _spearman(x: Floats, y: Floats) -> float:
    """Correlation of the ranks; that of scipy cannot rank what is infinite."""
    ranks = rankdata(x), rankdata(y)
    if not len(x) or any(np.ptp(rank) == 0 for rank in ranks):
        return math.nan
    return float(np.corrcoef(*ranks)[0, 1])


def worst_folder(page: Path) -> Path:
    """Name the folder for the worst tests beside a page, before the work is done.

    An InputError says that a file has this name.
    """
    folder = page.with_suffix("")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is no folder; name another page, or remove it")
    return folder


def write_worst_tests(design: StudyDesign, summary: dict[str, Any], folder: Path) -> None:
    """Write the worst tests of each method and mass ratio as complete experiments.

    ``seft simulate FILE`` repeats one. The summary gets their paths, as ``file`` of each; files of
    an earlier study in this folder are replaced.

    Raises
    ------
    InputError
        If a file can't be written.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: can't be made: {error.strerror or error}") from None
    for result in summary["results"]:
        for worst in result["worst"]:
            test = StudyTest(result["mass_ratio"], result["method"], worst["test"])
            method = re.sub(r"[^\w.-]", "_", test.method)
            path = folder / f"{method}_{test.mass_ratio:g}_{test.number}.yaml"
            sections = design.experiment_of(test).by_place()
            motion = sections["ground_motion"]
            sections["ground_motion"] = motion | {
                name: [str(Path(file).resolve()) for file in files]
                for name in FILES
                if (files := files_of(motion[name], design.experiment.axes))
            }
            drawn = f"seed {design.drawn.seed}, spread {design.drawn.spread:g}"
            write_parameter_file(path, sections, [f"{test} of seft study, {drawn}"], replace=True)
            worst["file"] = str(path)
