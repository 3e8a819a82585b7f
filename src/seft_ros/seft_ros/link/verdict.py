"""What a link is good for, and what a test over it is."""

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import TARGET
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.link.round_trips import RoundTrips
from seft_ros.preflight.verdict import MASS_RATIO_RESERVE as RESERVE
from seft_ros.reference_force.topic import reference_force_topic

Verdict = Literal["good", "marginal", "unusable"]

SOME_LOST, TOO_MANY_LOST = 0.005, 0.2
"""Share of the messages lost from which a link is marginal, and unusable."""
LONGEST_DELAY = 100
"""Steps that `loop_delay` may have."""


@dataclass(frozen=True)
class Allowed:
    """What preflight says of a test with the delay that its link needs.

    Attributes
    ----------
    mass_ratio : float
        As planned.
    critical_mass_ratio : float or None
        At which it is unstable; None where no mass ratio is, or that is not known.
    growing : bool
        Whether it is unstable as planned.
    unknown : str
        Why preflight could not tell; else empty.
    """

    mass_ratio: float
    critical_mass_ratio: float | None
    growing: bool
    unknown: str = ""

    def numbers(self) -> dict[str, Any]:
        """Give JSON values."""
        return {
            "mass_ratio": self.mass_ratio,
            "critical_mass_ratio": self.critical_mass_ratio,
            "stable": None if self.unknown else not self.growing,
            "unknown": self.unknown or None,
        }


def with_loop_delay(experiment: Experiment, steps: int) -> Experiment:
    """Give the same experiment with another delay of the loop, in steps."""
    sections = {
        node: {**section, **({"loop_delay": steps} if "loop_delay" in section else {})}
        for node, section in experiment.sections.items()
    }
    return Experiment(sections)


def message_size(experiment: Experiment) -> int:
    """Size of the messages of the reference force over a link of ten steps, bytes."""
    section, axes = experiment["reference_force"], experiment.axes
    topic, points = reference_force_topic(section), 11
    if topic == TARGET:
        points += math.ceil(section["compensation.horizon"] * experiment.timebase.rate)
    codec = TrajectoryCodec(topic, axes, experiment.timebase)
    return len(codec.encode_points(0, np.zeros((points, len(topic.quantities), len(axes)))))


def allowed(experiment: Experiment, loop_delay: int) -> Allowed:
    """Ask preflight about a test with a delay of the loop, in steps."""
    from seft_ros.preflight.margins import critical_mass_ratio
    from seft_ros.preflight.plan import Plan
    from seft_ros.preflight.search import NEUTRAL

    planned = float(experiment["reference_force"]["mass_ratio"])
    try:
        plan = Plan(with_loop_delay(experiment, loop_delay))
        growing = plan.growth_rate() > NEUTRAL
        critical = critical_mass_ratio(plan)
    except InputError as error:
        return Allowed(planned, None, growing=False, unknown=str(error))
    return Allowed(planned, critical.value if critical else None, growing)


def judge(trips: RoundTrips, test: Allowed | None) -> tuple[Verdict, list[str]]:
    """Judge a link, and a test over it.

    Returns
    -------
    verdict : str
        ``good``, ``marginal`` or ``unusable``.
    reasons : list of str
        Why it is not good.
    """
    lost, bad, thin = trips.lost / trips.sent, [], []
    if trips.loop_delay > LONGEST_DELAY:
        bad.append(
            f"the loop would need a delay of {trips.loop_delay} steps, more than {LONGEST_DELAY}"
        )
    if lost > TOO_MANY_LOST:
        bad.append(f"{100 * lost:.3g} % of the messages were lost")
    elif lost > SOME_LOST:
        thin.append(
            f"{100 * lost:.3g} % of the messages were lost, up to {trips.longest_burst} in a row: "
            "they are bridged, with some error"
        )
    if test is not None and test.growing:
        bad.append(
            f"mass ratio {test.mass_ratio:g} is unstable with a delay of {trips.loop_delay} steps"
        )
    elif test is not None and test.unknown:
        thin.append(f"preflight could not be done: {test.unknown}")
    elif test is not None and (test.critical_mass_ratio or np.inf) < RESERVE * test.mass_ratio:
        thin.append(
            f"the critical mass ratio {test.critical_mass_ratio:.3g} is less than {RESERVE:g} "
            f"times the planned {test.mass_ratio:g}"
        )
    verdict: Verdict = "unusable" if bad else "marginal" if thin else "good"
    return verdict, [*bad, *thin]
