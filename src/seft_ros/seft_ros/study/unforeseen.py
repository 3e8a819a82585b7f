"""What a test would make of a specimen that yields, which nobody knows.

Stability says nothing about that: an unforeseen change of the restoring force is answered one delay
of the valve later, and in soft oil the flow must first compress the oil.
"""

from dataclasses import dataclass

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS, EVERY_NODE, FORCE_DRIVEN
from seft_msgs_py.config.parameter_table import Section
from seft_msgs_py.errors import InputError
from seft_plant_sim.judge.detector_list import ALL
from seft_plant_sim.rig_parameters import LIMIT_ROWS
from seft_plant_sim.simulated.specimen import deformations
from seft_plant_sim.whole_structure import ReferenceResponse, is_simulated, reference_response

from seft_ros.analysis.metrics import nrmse
from seft_ros.force_controller.force_controller_parameters import VELOCITY_FEEDFORWARD
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test

AT, HARDENING = 1.0 / 3.0, 0.1
"""Deformation at which it yields, over the largest of the planned test, and stiffness that is left:
it yields often and far."""
LARGEST_ERROR = 0.015
"""Displacement error without noise up to which the valve can follow."""
_BEYOND = 100.0  # of all limits: a specimen that yields moves farther than planned


@dataclass(frozen=True)
class YieldingError:
    """Displacement error (NRMSE) of a planned test on a specimen that yields; infinite if it trips.

    Attributes
    ----------
    whole, of_valve : float
        With the noise of the sensors, and without: what is left is that of the valve.
    """

    whole: float
    of_valve: float

    def warning(self) -> str:
        """Say that the valve can't follow, and how to mend it; empty if it can."""
        mend = "take a higher rate, a faster valve or a stiffer oil column"
        is_fast = self.of_valve <= LARGEST_ERROR
        return "" if is_fast else f"{self}: the valve can't follow that fast; {mend}"

    def __str__(self) -> str:
        """Say it in one line."""
        if_so = "if the specimen yields at a third of its largest deformation, unforeseen"
        error = f"{_percent(self.whole)} ({_percent(self.of_valve)} without noise)"
        return f"{if_so}, the displacement error is {error}"


def _percent(error: float) -> str:
    return f"{100 * error:.2g} %" if np.isfinite(error) else "that of a test that trips"


def yielding_error(
    experiment: Experiment, response: ReferenceResponse | None
) -> YieldingError | None:
    """Simulate the planned test on a specimen that yields, all else as planned and assumed.

    Parameters
    ----------
    experiment : Experiment
        Of the test.
    response : ReferenceResponse or None
        See `expected_response`.

    Returns
    -------
    YieldingError or None
        None if the rig is not simulated here, no valve follows a target, a model is computed, or
        the specimen's stiffness is not that of its springs.
    """
    if not is_simulated(experiment) or response is None:
        return None
    rig, method = experiment["rig"], experiment["force_controller"]["method"]
    follows = method == VELOCITY_FEEDFORWARD and rig["actuator.kind"] not in FORCE_DRIVEN
    if not follows or experiment["reference_force"]["computed.model"]:
        return None
    where = "rig: simulated.specimen"
    springs = deformations(rig["simulated.specimen.springs"], experiment.axes, where)
    moved = np.abs(response.displacement @ springs.T).max(axis=0)
    if not moved.all():
        return None
    far = {f"limits.{name}": _BEYOND * rig[f"limits.{name}"] for name in LIMIT_ROWS}
    changes: dict[str, Section] = {
        EVERY_NODE: far,
        "rig": {
            "simulated.specimen.kind": "bilinear",
            "simulated.specimen.yield_displacement": (AT * moved).tolist(),
            "simulated.specimen.hardening_ratio": HARDENING,
            "faults": "",
            "detectors.warn_only": ALL,  # channels without noise seem frozen
        },
    }
    quiet = {"rig": {f"simulated.sensors.{name}_noise": 0.0 for name in CHANNELS}}
    try:
        yields = experiment.changed(changes)
        return YieldingError(_error(yields), _error(yields.changed(quiet)))
    except InputError:  # the stiffness is not the sum of such springs
        return None


def _error(experiment: Experiment) -> float:
    blocks = build_blocks(experiment)
    recording = simulate_test(experiment, blocks)
    if recording.trip is not None:
        return float("inf")
    exact = reference_response(experiment, blocks.ground_motion.samples)
    return float(nrmse(recording.series["rig/state"].values[:, 0], exact.displacement))
