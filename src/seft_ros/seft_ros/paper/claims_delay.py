"""Claims of sections 5 and 6: the delay, and its compensation (Figures 7 and 8)."""

from collections.abc import Iterator

import numpy as np

from seft_ros.paper.claim import Claim, at_least, at_most, holds, near
from seft_ros.paper.claims_tests import AGREES
from seft_ros.paper.experiments import DELAY, told_delay
from seft_ros.paper.findings import COMPUTED, Findings
from seft_ros.paper.measures import VIBRATION_HZ
from seft_ros.paper.outcome import Outcome, against

DELAYED, COMPENSATED = "Section 5", "Section 6"
FIGURE_7, FIGURE_8 = "Figure 7", "Figure 8"

PURE_DELAY = (
    "a pure delay in acceleration feedback is a neutral delay equation: at alpha = 1 it is "
    "unstable at any delay, so the paper's simulation must have had something that ends its "
    "bandwidth"
)
_OWN_DELAY = (
    "a loop that crosses over at 12 Hz has about 1 / (2 π 12 Hz) = 13.3 ms, whatever the actuator"
)
_BAND = "delay within the force loop's bandwidth"
_CAUSE = 0.9
_ABSENT = 1.5  # times the reference's share


def claims_delay(found: Findings) -> Iterator[Claim]:
    """Judge what section 5 says of the delay, and its simulations against our rig."""
    dt = found.experiment.timebase.dt
    yield near(
        DELAYED,
        "delay of the actuator, identified",
        DELAY,
        found.own_delay,
        0.1 * DELAY,
        "s",
        note=_OWN_DELAY,
    )
    yield near(DELAYED, "sampling period", 0.002, dt, 0.0, "s")
    for ratio, panel in zip(COMPUTED, ("a", "b"), strict=True):
        yield from _displacement(found, ratio, f"{FIGURE_7} ({panel})")
    for ratio, panel in zip(COMPUTED, ("c", "d"), strict=True):
        yield from _acceleration(found, ratio, f"{FIGURE_7} ({panel})")


def claims_compensation(found: Findings) -> Iterator[Claim]:
    """Judge what section 6 says of the model-based compensation."""
    told = told_delay(found.experiment)
    for index, name in enumerate(("displacement", "acceleration")):
        for column, ratio in enumerate(COMPUTED):
            where = f"{FIGURE_8} ({'abcd'[2 * index + column]})"
            yield at_most(
                where,
                f"{name} with delay compensation agrees with the reference at alpha = {ratio:g}",
                "good agreement",
                found.tests["model", ratio].agreement(name).nrmse,
                AGREES,
                shown=".1%",
                noun="error",
                what="error without any shift",
                note=f"told {1e3 * told:g} ms: tau = {1e3 * DELAY:g} ms, the sampling period of "
                "Eq. 5.4, and half a period of the held force",
            )
    for ratio in COMPUTED:
        test = found.tests["model", ratio]
        ours, exact = test.vibration("acceleration"), test.exact_vibration("acceleration")
        yield holds(
            COMPENSATED,
            f"vibration does not appear with delay compensation at alpha = {ratio:g}",
            "does not appear",
            f"{ours.share:.2%} of the acceleration's energy above {VIBRATION_HZ:g} Hz, reference "
            f"{exact.share:.2%}",
            test.stable and ours.share <= _ABSENT * exact.share,
            f"share at most {_ABSENT:g} times the reference's",
        )
    for ratio in COMPUTED:
        yield at_most(
            COMPENSATED,
            f"displacement with compensation told tau = {DELAY:g} s alone agrees with the "
            f"reference at alpha = {ratio:g}",
            "good agreement",
            found.tests["model_tau", ratio].agreement("displacement").nrmse,
            AGREES,
            shown=".1%",
            noun="error",
            what="error without any shift",
            note="a sampling period and half a held one are left: 3 ms of 13",
        )


def _displacement(found: Findings, ratio: float, where: str) -> Iterator[Claim]:
    rig = found.tests["rig", ratio]
    measure = "error against the rig, without any shift,"
    yield _matches(
        where,
        f"displacement of Eq. 5.4 as it stands matches the experiment at alpha = {ratio:g}",
        found.tests["delay", ratio],
        rig,
        found,
        ratio,
    )
    own = 1e3 * (found.own_delay - found.experiment.timebase.dt)
    bandwidth = found.identified.closed_loops[0].tracking.bandwidth_hz
    for kind, delay in (("banded", f"tau = {1e3 * DELAY:g} ms"), ("own", f"our own {own:.1f} ms")):
        yield at_most(
            where,
            f"displacement of the simulation ({delay}, {_BAND}) matches the experiment at "
            f"alpha = {ratio:g}",
            "matches very well",
            against(found.tests[kind, ratio], rig, "displacement").nrmse,
            AGREES,
            shown=".1%",
            noun="error",
            what=measure,
            note=_at_its_end(rig) or ("" if bandwidth is None else f"-3 dB at {bandwidth:.3g} Hz"),
        )
    yield at_least(
        where,
        f"the delay is the major source of error at alpha = {ratio:g}",
        "the major source",
        explained(found.tests["banded", ratio], rig),
        _CAUSE,
        shown=".1%",
        noun="of the error's energy explained",
        what="share of the experiment's error energy that the simulation explains",
    )


def _acceleration(found: Findings, ratio: float, where: str) -> Iterator[Claim]:
    rig, banded = found.tests["rig", ratio], found.tests["banded", ratio]
    yield at_most(
        where,
        f"acceleration of the simulation agrees with the experiment at alpha = {ratio:g}",
        "agrees well",
        against(banded, rig, "acceleration", controlled=True).nrmse,
        AGREES,
        shown=".1%",
        noun="error",
        what=f"error against the rig below {VIBRATION_HZ:g} Hz, without any shift,",
        note=_at_its_end(rig) or f"tau = {1e3 * DELAY:g} ms, {_BAND}",
    )
    levels = [test.vibration("acceleration").rms for test in (banded, rig)]
    yield holds(
        where,
        f"less vibration in the simulation than in the experiment at alpha = {ratio:g}",
        "smaller",
        f"{levels[0]:.3g} against {levels[1]:.3g} m/s² above {VIBRATION_HZ:g} Hz",
        banded.stable and levels[0] < levels[1],
        "smaller level",
    )


def _matches(
    where: str, claim: str, test: Outcome, rig: Outcome, found: Findings, ratio: float
) -> Claim:
    """Judge the pure delay, which need not be stable."""
    paper = "matches very well"
    if test.stable:
        error = against(test, rig, "displacement").nrmse
        what = "error against the rig, without any shift,"
        note = _at_its_end(rig)
        return at_most(
            where, claim, paper, error, AGREES, shown=".1%", noun="error", what=what, note=note
        )
    growth = found.growths["delay", ratio]
    return holds(
        where,
        claim,
        paper,
        f"unstable: grows e-fold in {1 / growth.rate:.2g} s at {growth.hz:.3g} Hz",
        False,
        f"stable, and error against the rig at most {AGREES:.1%}",
        PURE_DELAY,
    )


def _at_its_end(rig: Outcome) -> str:
    """Say why a rig may depart from any linear simulation."""
    if not rig.saturated:
        return ""
    return f"under this motion the rig was at the end of a range ({', '.join(rig.saturated)})"


def explained(simulation: Outcome, rig: Outcome) -> float:
    """Share of the rig's error energy in displacement that a simulation has too, at most 1."""
    count = min(len(simulation.time), len(rig.time))
    y, x, exact = (
        part["displacement"][:count] for part in (rig.measured, simulation.measured, rig.exact)
    )
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return float(1.0 - np.sum((y - x) ** 2) / np.sum((y - exact) ** 2))
