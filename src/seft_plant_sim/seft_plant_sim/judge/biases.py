"""What a rig has zeroed at rest: whether that may be, and what it may hide."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from seft_msgs_py.config.facts import CHANNELS

from seft_plant_sim.rig_parameters import LIMIT_UNITS

MAX_BIAS = 0.1
"""Of a channel's limit, for its bias. The limits count from it, so it moves them by as much;
limits that fit a test are 1.5 times its peaks and more, and bear that."""
SHOWN_BY_SENSOR = 1e-3
"""Of the limit of force, which a load cell of accuracy class 0.1 may show without a force."""


class CheckedBiases(NamedTuple):
    """Why biases are refused, and what they may hide; empty if there is nothing."""

    refusal: str = ""
    warning: str = ""


def check_biases(zeroed: Mapping[str, Any] | None, limits: Mapping[str, float]) -> CheckedBiases:
    """Check what a rig has measured at rest.

    Parameters
    ----------
    zeroed : mapping or None
        As of `seft_plant_sim.calibration.zeroed_at_rest`; None: it measured nothing.
    limits : mapping
        Of displacement (m), velocity (m/s), acceleration (m/s^2) and force (N).
    """
    if zeroed is None:
        return CheckedBiases()
    try:
        subtracted, left = (
            {name: float(np.abs(zeroed[what][name]).max()) for name in CHANNELS}
            for what in ("subtracted", "left")
        )
    except (KeyError, TypeError, ValueError):
        return CheckedBiases("the rig reports biases that can't be read; see docs/hardware.md")
    for name, unit in zip(CHANNELS, LIMIT_UNITS, strict=False):
        if not subtracted[name] <= MAX_BIAS * limits[name]:
            return CheckedBiases(
                f"{name} is {subtracted[name]:.3g} {unit} at rest, more than a tenth of its "
                f"limit of {limits[name]:g} {unit}; unload the rig, adjust the sensor's amplifier, "
                f"or give its bias (/**: calibration.{name}_bias)"
            )
    may_hold = SHOWN_BY_SENSOR * limits["force"]
    if left["force"] > may_hold:
        return CheckedBiases(
            warning=f"the force at rest is {left['force']:.3g} N beside its known bias: friction "
            "or a static load holds it, or the bias has changed since (seft identify --specimen)"
        )
    if subtracted["force"] > may_hold:
        return CheckedBiases(
            warning=f"a force of {subtracted['force']:.3g} N at rest was zeroed: if friction or a "
            "static load holds it, it is real; a multisine test shows it (seft identify --specimen)"
        )
    return CheckedBiases()
