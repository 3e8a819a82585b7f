"""What sampling folds down into acceleration and force.

A valve's commands are steps, and what they excite above half the rate looks like the motion itself:
at 250 Hz 0.8 % of its acceleration, which the displacement has not. Of force and M a it is the same
part, so that the restoring force has none, and the equivalent ground motion all of it.
"""

import numpy as np
from seft_msgs_py.arrays import Complexes, Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS, FORCE_DRIVEN
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RIG_STATE
from seft_plant_sim.calibration import known_channels
from seft_plant_sim.channels import VELOCITY

from seft_ros.analysis.channel_estimates import motion_frequency
from seft_ros.design.planned_tests import choose_rig
from seft_ros.design.plant import held_relations
from seft_ros.identification.time_shift import moved_ahead

_A, _F = (RIG_STATE.quantities.index(name) for name in ("accelerations", "effort"))


def without_folding(samples: Floats, mass: Floats, experiment: Experiment) -> Floats:
    """Take what is folded down out of acceleration and force, as of the motion's frequency.

    ``samples`` have shape (N, 4, n), ``mass`` is the specimen's, (n, n), kg. Where no actuator is
    known, or it is idealised, nothing is taken.
    """
    frequency = motion_frequency(samples)
    section = experiment.sections.get("reference_force", {})
    idealised = section.get("actuator.kind") in FORCE_DRIVEN
    expected = None
    if frequency > 0 and not idealised:
        expected = expected_relations(experiment, frequency)
    if expected is None:
        return samples
    own, a, dt = expected[1], samples[:, _A], experiment.timebase.dt
    late = np.angle(own) / (2 * np.pi * frequency)
    folded = a - moved_ahead(a, -late, dt) / np.abs(own)
    found = samples.copy()
    found[:, _A] -= folded
    found[:, _F] -= folded @ mass.T
    return found


def expected_relations(experiment: Experiment, frequency: float) -> Complexes | None:
    """Velocity and acceleration of fault-free channels over the derivatives of x.

    See `seft_ros.design.plant.held_relations`; it follows from the actuator that the test knows,
    on the specimen's model, and from what is known of the channels' lags.

    Parameters
    ----------
    experiment : Experiment
        Of the test.
    frequency : float
        Of the motion, Hz.

    Returns
    -------
    ndarray or None
        Shape (2, n); None if no actuator is known.
    """
    nodes = ("reference_force", "force_controller")
    if any(node not in experiment.sections for node in nodes):
        return None
    section = experiment["reference_force"]
    lag = known_channels(section, experiment.axes)["lag"]
    # what the samples wait for after the channels are read turns nothing that is folded down
    at_once = {f"calibration.{name}_{what}": 0.0 for name in CHANNELS for what in ("lag", "filter")}
    known = Experiment({node: experiment[node] | at_once for node in nodes})
    if section["sensors.velocity"] == "derived":
        lag[VELOCITY] = lag[0]
    try:
        plant = choose_rig(known).plant
        held = held_relations(plant, np.array([frequency]), experiment.timebase.dt, lag)
    except (InputError, KeyError):
        return None
    return held[0]
