"""The tests that reproduce the paper, each a change of one experiment."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError

import seft_ros
from seft_ros.design.rig_tests import has_valve
from seft_ros.reference_force.reference_force_parameters import TARGET_MOTION
from seft_ros.test_run.blocks import build_blocks, with_method

DELAY = 0.01
"""Delay of the actuator that the paper identified and simulates with (section 5.2), s."""

BEYOND_SHARE = 0.4
"""Of the motion's amplitude, beyond the paper: what the valve can serve at a mass ratio of 1.5."""

LEAST_RATE = 200.0
"""Sampling rate that shows the vibration, at 30 to 45 Hz, Hz."""

_CONFIG = "jhu.yaml"
_QUANTITIES = ("position", "velocity", "acceleration", "force")
_FAR = {"displacement": 1e3, "velocity": 1e3, "acceleration": 1e4, "force": 1e6}
_FAR |= {f"{name}_rate": 1e6 * value for name, value in _FAR.items()}


def default_config() -> Path:
    """Find config/jhu.yaml: in the source tree, or under share of what pip or colcon installed.

    Raises
    ------
    InputError
        If it is not there.
    """
    assert seft_ros.__file__ is not None
    package = Path(seft_ros.__file__).parent
    for place in (package, package.resolve()):  # colcon --symlink-install links to the source
        sources = place.parent / "config"
        shares = (prefix / "share" / "seft_ros" / "config" for prefix in place.parents)
        for folder in (sources, *shares):
            if (folder / _CONFIG).is_file():
                return folder / _CONFIG
    raise InputError(
        f"{_CONFIG}: the paper's rig was not installed with seft_ros; name an experiment: "
        "seft paper config/jhu.yaml"
    )


def check_rig(experiment: Experiment) -> None:
    """See that an experiment is one of the paper's kind.

    Raises
    ------
    InputError
        If parameters make no sense, the record can't be read, or the experiment has several
        axes, no valve, a low rate, or another reference force than the paper's.
    """
    if len(experiment.axes) != 1:
        raise InputError(f"/**: axes are {list(experiment.axes)}, but the paper's rig has one axis")
    if not has_valve(experiment):
        kind = experiment["rig"]["actuator.kind"]
        raise InputError(
            f"rig: actuator.kind is {kind}, but the paper's experiment needs servo_hydraulic; its "
            "simulations with a delay are made of it"
        )
    if experiment.timebase.rate < LEAST_RATE:
        raise InputError(
            f"/**: rate is {experiment.timebase.rate:g} Hz, but the paper's vibration needs at "
            f"least {LEAST_RATE:g} Hz to be seen"
        )
    if experiment["reference_force"]["method"] != "seft":
        raise InputError("reference_force: method is eft, but the paper's experiment needs seft")
    build_blocks(uncompensated(experiment, 0.0))


def changed(experiment: Experiment, changes: Mapping[str, Mapping[str, Any]]) -> Experiment:
    """Copy an experiment with other values: node -> parameter -> value."""
    return Experiment(
        {node: {**own, **changes.get(node, {})} for node, own in experiment.sections.items()}
    )


def uncompensated(experiment: Experiment, mass_ratio: float) -> Experiment:
    """Test on the rig by Eq. 2.5 (paper, section 4); as there, nobody looks for instability."""
    force = {"mass_ratio": mass_ratio, "instability.ratio": 0.0}
    return changed(with_method(experiment, "none"), {"reference_force": force})


def conventional(experiment: Experiment) -> Experiment:
    """Conventional effective force test of the specimen alone (Eq. 2.3)."""
    force = {"method": "eft", "mass_ratio": 0.0}
    return changed(with_method(experiment, "none"), {"reference_force": force})


def delayed(
    experiment: Experiment, mass_ratio: float, delay: float, bandwidth_hz: float = 0.0
) -> Experiment:
    """Numerical simulation with a delayed actuator, without sensors' errors (Eq. 5.4).

    The loop adds its sampling period, the Delta t of the equation.

    Parameters
    ----------
    experiment : Experiment
        Specimen, motion and sampling.
    mass_ratio : float
        alpha.
    delay : float
        tau of the actuator at low frequency, s.
    bandwidth_hz : float
        Where its force falls off (-3 dB of a second-order Butterworth low-pass, whose own lag
        is part of ``delay``), Hz; 0: a pure delay, as Eq. 5.2 has it.
    """
    lag = math.sqrt(2) / (2 * math.pi * bandwidth_hz) if bandwidth_hz else 0.0
    rig: dict[str, Any] = {"actuator.kind": "delay", "actuator.delay": max(delay - lag, 0.0)}
    for name in _QUANTITIES:
        rig |= {f"sensors.{name}_{what}": [0.0] for what in ("noise", "bias", "range")}
    # all of it is linear: a low-pass on every measured signal is one on the actuator's force
    rig |= {"sensors.adc_bits": 0, "sensors.anti_alias": bandwidth_hz}
    rig |= {f"limits.{name}": value for name, value in _FAR.items()}  # calculated, nothing breaks
    force = {"limits.force": math.inf, "limits.force_rate": math.inf}
    simulated = uncompensated(experiment, mass_ratio)
    return changed(simulated, {"rig": rig, "reference_force": force})


def model_compensated(experiment: Experiment, mass_ratio: float, told: float) -> Experiment:
    """Simulate the pure delay with the paper's compensation, told a delay in s (section 6)."""
    force = {"compensation.method": "model", "compensation.delay": told}
    return changed(delayed(experiment, mass_ratio, DELAY), {"reference_force": force})


def told_delay(experiment: Experiment) -> float:
    """Whole delay of the simulated loop: tau, the sampling period of Eq. 5.4, half a one held."""
    return DELAY + 1.5 * experiment.timebase.dt


def recommended(experiment: Experiment, mass_ratio: float, peak_force: float) -> Experiment:
    """Test on the rig with the method that docs/compensation.md recommends."""
    changes = {
        "reference_force": {"mass_ratio": mass_ratio},
        "ground_motion": {"peak_force": peak_force},
    }
    return changed(with_method(experiment, TARGET_MOTION), changes)
