"""Energy balance of a recorded test."""

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire.topics import RIG_STATE
from seft_plant_sim.dead_time import split_dead_time
from seft_plant_sim.reference.whole_structure import tested_specimen
from seft_plant_sim.specimen.energy_balance import EnergyBalance, energy_balance

from seft_ros.recording.record import Record

PARTS = ("input", "kinetic", "strain", "damped", "hysteretic")
"""Energies of a balance."""


def balance_of(record: Record) -> EnergyBalance | None:
    """Energies of the specimen at each step, as measured; from step 0.

    Returns
    -------
    EnergyBalance or None
        None if the specimen is not known, or samples are missing or not finite.
    """
    states = record.series[RIG_STATE.name]
    count = len(states.steps)
    whole = count > 1 and np.array_equal(states.steps, np.arange(count))
    if not whole or not np.isfinite(states.values).all():
        return None
    try:
        specimen = tested_specimen(record.experiment)
    except KeyError:
        return None
    displacement, velocity, _, force = np.moveaxis(states.values, 1, 0)
    dt, held = record.experiment.timebase.dt, _held(record.experiment)
    with np.errstate(over="ignore", invalid="ignore"):  # of a test that went unstable
        return energy_balance(specimen, displacement, velocity, force, dt, held=held)


def energy_numbers(balance: EnergyBalance | None) -> dict[str, float] | None:
    """Give the energies of the specimen at the end of a test.

    Returns
    -------
    dict or None
        ``input_j``, ``kinetic_j``, ``strain_j``, ``damped_j``, ``hysteretic_j`` and
        ``closure``, the largest of the balance's error over the test, relative to the largest
        input. None if there is no balance.
    """
    if balance is None:
        return None
    energies = {f"{name}_j": float(getattr(balance, name)[-1]) for name in PARTS}
    with np.errstate(over="ignore", invalid="ignore"):
        return {**energies, "closure": float(np.abs(balance.error).max())}


def _held(experiment: Experiment) -> float | None:
    """Part of a period after which an idealised actuator's force changes; None: it has none."""
    rig = experiment.sections.get("rig", {})
    if rig.get("actuator.kind") not in ("ideal", "delay") or rig.get("sensors.anti_alias"):
        return None
    delay = rig["actuator.delay"] if rig["actuator.kind"] == "delay" else 0.0
    dt = experiment.timebase.dt
    _, part = split_dead_time(delay, dt)
    return part / dt if part else 1.0
