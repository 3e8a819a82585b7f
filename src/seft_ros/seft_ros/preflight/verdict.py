"""What the margins of a planned test come to."""

import cmath
from collections.abc import Iterator
from typing import Literal

from seft_ros.preflight.margins import Margins
from seft_ros.preflight.plan import Plan
from seft_ros.preflight.search import NEUTRAL

Verdict = Literal["stable", "marginal", "unstable"]

MASS_RATIO_RESERVE = 1.2
"""Critical over planned mass ratio: load cells, accelerometers and the mass itself are known to
some percent each, and growth so near the end of stability is slow to die out."""

GAIN_RESERVE = 1.2
"""Factor on the drive, either way: a valve's flow gain falls by a sixth where the load takes 30 %
of the supply pressure, and rises as much with a leakage or temperature that was not identified."""

DELAY_RESERVE_STEPS = 1.0
"""Added delay in samples: in pace `realtime` one missed command holds the last for one."""

STIFFNESS_RESERVE = 1.1
"""Factor on the specimen's stiffness, either way: as well as a quick identification knows it. A
method that follows it is to be stable at any that is tried."""

TOLD_DELAY_RESERVE_STEPS = 0.5
"""Error of the delay that the method is told in samples, either way: half a sample is what is
lost to the hold when it is forgotten."""


def judge(plan: Plan, margins: Margins) -> tuple[Verdict, list[str]]:
    """Judge a plan.

    Returns
    -------
    verdict : str
        ``unstable``: it oscillates; ``marginal``: stable, but a margin is below its reserve.
    reasons : list of str
        Why it is not ``stable``; empty where it is.
    """
    if plan.growth_rate() > NEUTRAL:
        return "unstable", [instability(plan)]
    reasons = list(_thin(plan, margins))
    return ("marginal" if reasons else "stable"), reasons


def _thin(plan: Plan, margins: Margins) -> Iterator[str]:
    """Name the margins that are below their reserve."""
    critical, alpha = margins.mass_ratio, plan.mass_ratio
    if critical is not None and alpha and critical.value < MASS_RATIO_RESERVE * alpha:
        yield (
            f"the critical mass ratio {critical.value:.3g} is less than {MASS_RATIO_RESERVE:g} "
            f"times the planned {alpha:g}"
        )
    dead_time = margins.sure_dead_time or margins.dead_time
    if dead_time is not None:
        added = dead_time.value - plan.dead_time
        if added < DELAY_RESERVE_STEPS * plan.dt:
            yield (
                f"{1e3 * added:.3g} ms of further dead time make it unstable, less than "
                f"{DELAY_RESERVE_STEPS:g} sample"
            )
    for name, found, reserve in (
        ("gain of the actuator's path", margins.sure_gain or margins.gain, GAIN_RESERVE),
        ("local stiffness", margins.stiffness, STIFFNESS_RESERVE),
    ):
        if found is None:
            continue
        for factor in (end.value / found.planned for end in found.ends()):
            if 1 / reserve < factor < reserve:
                yield f"{factor:.3g} times the {name} makes it unstable"
    for end in margins.followed.ends() if margins.followed else ():
        yield f"a local stiffness of {end.value:.3g} times the told one makes it unstable"
    for end in margins.told_delay.ends() if margins.told_delay else ():
        if abs(end.value) < TOLD_DELAY_RESERVE_STEPS * plan.dt:
            yield (
                f"telling the method a delay {1e3 * end.value:+.2g} ms off makes it unstable, "
                f"less than {TOLD_DELAY_RESERVE_STEPS:g} sample"
            )


def instability(plan: Plan) -> str:
    """Say in a few words how an unstable plan grows."""
    hz = abs(cmath.phase(plan.worst())) / (2 * cmath.pi * plan.dt)
    return f"oscillates at {hz:.3g} Hz, growing e-fold in {1 / plan.growth_rate():.2g} s"
