"""Claims of section 4: tests on the rig with computed mass (Figure 6)."""

from collections.abc import Iterator

import numpy as np

from seft_ros.analysis.metrics import Agreement
from seft_ros.paper.claim import Claim, at_least, at_most, growing, holds, near
from seft_ros.paper.findings import COMPUTED, Findings
from seft_ros.paper.measures import VIBRATION_HZ, magnitude_and_phase
from seft_ros.paper.outcome import Outcome

FIGURE = "Figure 6"
TESTS = "Section 4"

AGREES = 0.10
"""Error of a response that agrees, RMS over RMS: at alpha = 0, which "agrees well" in the paper,
it is 3 to 5 % here, and where the paper sees discrepancies 16 to 54 % (Kobe JMA N-S)."""

_PANELS = {
    "displacement": ("a", "b", "c"),
    "force": ("d", "e", "f"),
    "acceleration": ("g", "h", "i"),
}
_PEAKS = {0.5: "smaller", 1.0: "more so than at alpha = 0.5"}
_SMALLER = 0.95  # of the reference's peak
_MISMATCH = (0.10, 10.0)  # of the magnitude, degrees
_VISIBLE = 3.0  # times the reference's share


def claims_tests(found: Findings) -> Iterator[Claim]:
    """Judge everything that section 4 says of the tests on the rig."""
    yield from _input(found)
    yield from _conventional(found)
    yield from _discrepancies(found)
    yield from _vibration(found)
    yield from _instability(found)


def _input(found: Findings) -> Iterator[Claim]:
    motion = found.experiment["ground_motion"]
    yield near(TESTS, "amplitude of the input", 1000, found.peak_force, 0.5, "N")
    yield near(TESTS, "time scale of the input", 0.5, motion["time_scale"], 0.0)
    mass = float(found.identified.specimen.mass[0, 0])
    total = mass + float(np.atleast_1d(found.experiment["reference_force"]["model.mass"])[0])
    yield near(TESTS, "total mass at alpha = 1", 105.4, total, 1.0, "kg")


def _conventional(found: Findings) -> Iterator[Claim]:
    test, eft = found.tests["rig", 0.0], found.tests["eft", 0.0]
    worst = max(
        float(np.abs(test.measured[name] - eft.measured[name]).max() / _peak(eft, name))
        for name in _PANELS
    )
    yield at_most(
        TESTS,
        "at alpha = 0 acceleration is not fed back, as in conventional EFT",
        "the same",
        worst,
        1e-9,
        shown=".1g",
        what="largest difference of the signals of both tests over their peak",
    )
    for name, panels in _PANELS.items():
        yield at_most(
            f"{FIGURE} ({panels[0]})",
            f"{name} agrees with the reference at alpha = 0",
            "agrees well",
            test.controlled_agreement(name).nrmse_aligned,
            AGREES,
            shown=".1%",
            noun="error",
            what=f"error below {VIBRATION_HZ:g} Hz, after the best-fit delay,",
            note="up to there the paper controls force; the delay is a claim of its own",
        )


def _discrepancies(found: Findings) -> Iterator[Claim]:
    half, one = (found.tests["rig", ratio] for ratio in COMPUTED)
    for name, panels in _PANELS.items():
        yield at_least(
            f"{FIGURE} ({panels[1]})",
            f"discrepancy of the {name} at alpha = 0.5",
            "discrepancies show up",
            half.agreement(name).nrmse_aligned,
            AGREES,
            shown=".1%",
            noun="error",
            what="error after the best-fit delay",
        )
    for test, ratio, index in ((half, 0.5, 1), (one, 1.0, 2)):
        for name in ("displacement", "force", "acceleration"):
            peaks = test.agreement(name)
            said = "not stated" if name == "displacement" else _PEAKS[ratio]
            smaller = peaks.peak <= _SMALLER * peaks.reference_peak
            yield holds(
                f"{FIGURE} ({_PANELS[name][index]})",
                f"peak {name} smaller than the reference at alpha = {ratio:g}",
                said,
                _share(peaks),
                smaller,
                f"at most {_SMALLER:g}: at alpha = 0 peaks differ by some percent too",
                "" if smaller else _in_total(test, name),
            )
    for name, panels in _PANELS.items():
        tests = (found.tests["rig", ratio] for ratio in (0.0, *COMPUTED))
        yield growing(
            f"{FIGURE} ({panels[2]})",
            f"discrepancy of the {name} grows: alpha = 0, 0.5, 1.0",
            "larger at alpha = 1.0",
            [test.agreement(name).nrmse_aligned for test in tests],
            shown=".1%",
            what="error after the best-fit delay",
        )
    natural = found.identified.specimen.axis_root(0).hz / np.sqrt(2.0)
    dt = found.experiment.timebase.dt
    exact, measured = one.exact["displacement"], one.measured["displacement"]
    magnitude, phase = magnitude_and_phase(measured, exact, 1 / dt, natural, found.own_delay)
    yield holds(
        f"{FIGURE} (c, f, i)",
        "magnitude does not match at alpha = 1.0",
        "does not match",
        f"{magnitude:.2f} of the reference's about {natural:.2g} Hz",
        abs(magnitude - 1) > _MISMATCH[0],
        f"off by more than {_MISMATCH[0]:.0%} about the structure's natural frequency",
    )
    yield holds(
        f"{FIGURE} (c, f, i)",
        "phase does not match at alpha = 1.0",
        "does not match",
        f"{phase:.0f} degrees beyond the force loop's own delay",
        phase > _MISMATCH[1],
        f"more than {_MISMATCH[1]:g} degrees about the structure's natural frequency",
    )


def _vibration(found: Findings) -> Iterator[Claim]:
    one = found.tests["rig", 1.0]
    for name, panel in (("force", "f"), ("acceleration", "i")):
        ours, exact = one.vibration(name), one.exact_vibration(name)
        yield holds(
            f"{FIGURE} ({panel})",
            f"high-frequency {name} appears at alpha = 1.0",
            "appears",
            f"{ours.share:.2%} of the energy above {VIBRATION_HZ:g} Hz, strongest at "
            f"{ours.peak_hz:.3g} Hz; reference {exact.share:.2%}",
            ours.share >= _VISIBLE * exact.share,
            f"share at least {_VISIBLE:g} times the reference's",
        )
    for name in ("force", "acceleration"):
        tests = [found.tests["rig", ratio] for ratio in (0.0, *COMPUTED)]
        yield growing(
            TESTS,
            f"high-frequency {name} grows with alpha: 0, 0.5, 1.0",
            "increases with alpha",
            [test.vibration_ratio(name) for test in tests],
            what=f"level above {VIBRATION_HZ:g} Hz over the reference's",
        )
    growth = found.growths["rig", 1.5]
    hz = one.vibration("acceleration").peak_hz
    yield holds(
        TESTS,
        "the vibration is induced by acceleration feedback",
        "induced by it",
        f"{hz:.3g} Hz at alpha = 1.0; the feedback loop turns unstable at {growth.hz:.3g} Hz",
        abs(hz - growth.hz) <= 0.15 * growth.hz,
        "within 15 % of the frequency at which the loop's eigenvalue grows",
    )


def _instability(found: Findings) -> Iterator[Claim]:
    test = found.tests["rig", 1.5]
    told = "runs to its end" if test.trip is None else f"trips at {test.trip.time_s:.2f} s"
    yield holds(TESTS, "test at alpha = 1.5", "became unstable", told, not test.stable, "trips")
    for ratio, unstable in ((1.5, True), (1.0, False)):
        growth = found.growths["rig", ratio]
        grows = growth.rate > 0
        yield holds(
            TESTS,
            f"eigenvalues of the loop at alpha = {ratio:g}",
            "unstable" if unstable else "stable",
            f"{'grows' if grows else 'decays'} e-fold in {1 / abs(growth.rate):.2g} s, at "
            f"{growth.hz:.3g} Hz",
            grows == unstable,
            "sign of the largest growth rate (exact for small motions)",
        )


def _share(found: Agreement) -> str:
    if not found.reference_peak > 0:
        return "no reference"
    return f"{found.peak / found.reference_peak:.3f} of the reference's"


def _in_total(test: Outcome, name: str) -> str:
    """Say what else there is to a peak that is not smaller."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = float(np.std(test.measured[name]) / np.std(test.exact[name]))
    return f"the peak is one cycle of the record; the RMS is {ratio:.2f} of the reference's"


def _peak(test: Outcome, name: str) -> float:
    return float(np.abs(test.measured[name]).max())
