"""Settings of the methods, given as ``compensation.settings``: one table for all of them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from seft_msgs_py.config.parameter_table import nearest, parameter_rows
from seft_msgs_py.errors import InputError
from seft_ros.reference_force.compensator import OF_THE_LOOP, MethodInputs

WHERE = "reference_force: compensation.settings"
SETTINGS = parameter_rows(
    """
    order          | int    | 1             |     | 1 .. 3   |
        order of the polynomial of `polynomial`
    estimate_delay | bool   | false         |     |          |
        estimate the delay of each axis while the test runs, starting at actuator.delay; `ats`
        adapts by itself
    delay_range    | floats | [0.0, 0.04]   | s   | 0 .. 0.1 |
        shortest and longest delay that the estimate may have, as actuator.delay without the loop's
    delay_rate     | float  | 0.01          |     | 0 ..     |
        largest change of an estimated delay, s per s
    excitation     | float  | 20.0          | N   | > 0      |
        least RMS of the forces, over about a second, at which the methods adapt; above the effect
        of the sensors' noise
    band           | floats | [1.0, 12.0]   | Hz  | > 0      |
        lowest and highest frequency at which the methods compare forces to adapt: the band of the
        forces' energy
    """
)

Settings = Mapping[str, Any]
"""Value of each setting, by name."""


def read_settings(given: Settings) -> Settings:
    """Check the settings that are given, and fill in the defaults of the others.

    Raises
    ------
    InputError
        If a name is unknown, or a value is invalid.
    """
    rows = {row.name: row for row in SETTINGS}
    for name in given:
        if name not in rows:
            raise InputError(f"{WHERE}: there is no setting {name}{nearest(name, rows)}")
    return {name: row.check(given.get(name, row.default), WHERE) for name, row in rows.items()}


def delay_range(inputs: MethodInputs, settings: Settings) -> tuple[float, float]:
    """Shortest and longest delay that an adaptive method may take, with the loop's delay, s.

    Raises
    ------
    InputError
        If they make no range, or the given delay is outside.
    """
    bounds, start = np.atleast_1d(settings["delay_range"]), inputs.options["actuator.delay"]
    if len(bounds) != 2 or not bounds[0] < bounds[1]:
        raise InputError(
            f"{WHERE}: delay_range is {bounds.tolist()}, but must be two delays in s, the shorter "
            "first"
        )
    if not bounds[0] <= start <= bounds[1]:
        raise InputError(
            f"{WHERE}: delay_range is {bounds.tolist()}, but the estimate starts at {start:g} s "
            "(/**: actuator.delay); widen it"
        )
    shortest, longest = (bounds + OF_THE_LOOP * inputs.dt + inputs.late).tolist()
    return shortest, longest
