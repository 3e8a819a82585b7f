"""Whether a planned test can be right: units that were mixed up, and what its parts allow."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS, EVERY_NODE, FORCE_DRIVEN, POSITION_SERVO
from seft_msgs_py.config.parameter_table import Section, group, per_axis
from seft_plant_sim.rig_parameters import LIMIT_UNITS, is_imposed
from seft_plant_sim.simulated.actuator import Hydraulics
from seft_plant_sim.simulated.specimen import Specimen
from seft_plant_sim.whole_structure import (
    ReferenceResponse,
    is_simulated,
    reference_response,
    tested_specimen,
)

from seft_ros.ground_motion.ground_motion_block import GroundMotion

FACTORS = {"displacement": 1.5, "velocity": 2.0, "acceleration": 2.0, "force": 1.5}
"""Proposed limit over the expected peak: oil that rings moves the piston little, but fast. As much
beyond its limit, a peak is none that an estimate of the specimen explains."""
SMALLEST_SHARE, LARGEST_SHARE = 0.02, 0.9
"""Of a sensor's range, for the expected peak. A sensor of accuracy class 0.1 is wrong by a
thousandth of its range, 5 % of less than the first; beyond the second a peak that is a tenth larger
than expected is cut off."""
PER_PERIOD = 5.0
"""Samples in a period of the specimen, below which its motion can't be seen."""
CONTROLLED = 10.0
"""Samples in a period with which it can be controlled."""
USUAL_DAMPING = 0.2
"""Damping ratio that a structure has at most."""


_MEANT = {
    ("stiffness", 1e3): "N/m (kN/m?)",
    ("stiffness", 1e6): "N/m (kN/mm?)",
    ("mass", 1e3): "kg (t?)",
}
"""Quantity, and factor: its unit, and the one that may be meant."""
_QUANTITIES = "stiffness", "damping", "mass"
_MIXED_UP = (
    *((1e3, 1.0, 1.0), (1e3, 1e3, 1.0), (1e3, 1.0, 1e3), (1e3, 1e3, 1e3)),
    *((1.0, 1.0, 1e3), (1e6, 1.0, 1.0)),
)
"""Factors by which these may have been given too small, in this order: who gives a mass in t gives
a stiffness in kN/m, if the other fits, too."""


def expected_response(
    experiment: Experiment, planned: GroundMotion | None
) -> ReferenceResponse | None:
    """Find the reference response of a test.

    Parameters
    ----------
    experiment : Experiment
        The specimen is that of its rig, if it is simulated, else the known one.
    planned : GroundMotion or None
        Its motion.

    Returns
    -------
    ReferenceResponse or None
        None if the ground motion or another node runs elsewhere.

    Raises
    ------
    InputError
        If the structure makes no sense.
    """
    if planned is None or not {"reference_force", "supervisor"} <= set(experiment.sections):
        return None
    return reference_response(experiment, planned.samples)


def peaks_of(response: ReferenceResponse | None) -> dict[str, Floats]:
    """Largest value of each quantity on each axis in the reference response of a test.

    Displacement (m), velocity (m/s), acceleration (m/s^2) and force (N), shape (n,); empty if the
    response is not known.
    """
    if response is None:
        return {}
    return {name: np.abs(getattr(response, name)).max(axis=0) for name in CHANNELS}


def peaks_by_axis(experiment: Experiment, planned: GroundMotion | None) -> dict[str, Floats]:
    """Find the `peaks_of` the `expected_response`."""
    return peaks_of(expected_response(experiment, planned))


def unit_refusal(
    experiment: Experiment, planned: GroundMotion | None, peaks: Mapping[str, Floats]
) -> str:
    """Say which unit of the specimen seems to be mixed up; empty if there is none.

    A planned test is refused where it can't be right and would be with stiffness in kN/m, or mass
    in t, in place of the numbers as given: its specimen vibrates too fast for the rate, or has more
    than critical damping, or expected peaks are far beyond the limits, or are next to nothing.

    Parameters
    ----------
    experiment : Experiment
        Of the rig, if it is simulated, and as it is known.
    planned : GroundMotion or None
        Its motion.
    peaks : mapping
        Its `peaks_by_axis`.
    """
    if planned is None or not peaks:
        return ""
    for place, prefix, seen in _specimens(experiment):
        of_seen = peaks if seen is experiment else peaks_by_axis(seen, planned)
        if refusal := _mixed_up(seen, place, prefix, planned, of_seen):
            return refusal
    return ""


def _specimens(experiment: Experiment) -> Iterator[tuple[str, str, Experiment]]:
    """Give place and group of a specimen's parameters, and the experiment in which it counts."""
    known, seen = group(experiment["reference_force"], "specimen"), experiment
    if is_simulated(experiment):
        true = group(experiment["rig"], "simulated.specimen")
        if any(true[name] != known[name] for name in _QUANTITIES):
            yield "rig", "simulated.specimen", experiment
            others = {node: own for node, own in experiment.sections.items() if node != "rig"}
            seen = Experiment(others)
    yield EVERY_NODE, "specimen", seen


def _mixed_up(
    experiment: Experiment,
    place: str,
    prefix: str,
    planned: GroundMotion,
    peaks: Mapping[str, Floats],
) -> str:
    misfit, too_small = _misfit(experiment, planned, peaks)
    if not misfit:
        return ""
    given, (now, _) = _given(experiment, place, prefix), _first_mode(tested_specimen(experiment))
    rate, dt = experiment.timebase.rate, experiment.timebase.dt
    slow, fast = 1.0 / (planned.steps * dt), rate / CONTROLLED
    for factors in _MIXED_UP:
        by = dict(zip(_QUANTITIES, factors, strict=True))
        if (by["mass"] > 1.0) is not (too_small == "mass"):
            continue
        changed = _scaled(experiment, place, prefix, by)
        hz, damping = _first_mode(tested_specimen(changed))
        if not slow < hz < fast or damping > USUAL_DAMPING:
            continue
        motion = GroundMotion(changed["ground_motion"], changed.axes, changed.timebase)
        if _misfit(changed, motion, peaks_by_axis(changed, motion))[0]:
            continue
        fitting = [
            f"a {name} of {_largest(given[name]) * factor:.6g} {_MEANT[name, factor]}"
            for name, factor in by.items()
            if (name, factor) in _MEANT
        ]
        return (
            f"{place}: {prefix}: stiffness {_largest(given['stiffness']):.6g} N/m and mass "
            f"{_largest(given['mass']):.6g} kg give a natural frequency of {now:.3g} Hz, "
            f"{misfit}; {' and '.join(fitting)} would give {hz:.3g} Hz and fit"
        )
    return ""


def _misfit(
    experiment: Experiment, planned: GroundMotion, peaks: Mapping[str, Floats]
) -> tuple[str, str]:
    """Say how a specimen does not fit the test, and what too small a number would explain it."""
    hz, damping = _first_mode(tested_specimen(experiment))
    if not hz:  # nothing that a unit could change
        return "", ""
    rate, limits = experiment.timebase.rate, group(experiment["supervisor"], "limits")
    if hz * PER_PERIOD > rate:
        return f"less than {PER_PERIOD:g} samples in a period at {rate:g} Hz", "mass"
    ground, most = float(np.abs(planned.samples).max()), limits["acceleration"]
    if ground > FACTORS["acceleration"] * most:
        return f"and a ground acceleration of {ground:.2g} m/s^2 (limit: {most:g})", "mass"
    highest = {name: float(peak.max()) for name, peak in peaks.items()}
    farthest, limit = highest["displacement"], limits["displacement"]
    text = f"and a peak displacement of {farthest:.2g} m (limit: {limit:g})"
    if farthest > FACTORS["displacement"] * limit:
        return text, "stiffness"
    if all(highest[name] < SMALLEST_SHARE * limits[name] for name in highest if name != "force"):
        return text, "mass"
    if damping > 1.0:
        return f"and {damping:.3g} times the critical damping", "stiffness"
    return "", ""


def _first_mode(specimen: Specimen) -> tuple[float, float]:
    """Frequency in Hz and damping ratio of a specimen's slowest mode; 0 Hz without stiffness."""
    hz, damping = specimen.modes()
    return (float(hz[0]), float(damping[0])) if len(hz) == specimen.axes else (0.0, 0.0)


def _given(experiment: Experiment, place: str, prefix: str) -> Section:
    return group(experiment["reference_force" if place == EVERY_NODE else place], prefix)


def _scaled(experiment: Experiment, place: str, prefix: str, by: Mapping[str, float]) -> Experiment:
    """Give the experiment with other values of the specimen, also of the one on a simulated rig."""
    given = _given(experiment, place, prefix)
    scaled = {name: (np.asarray(given[name]) * factor).tolist() for name, factor in by.items()}
    changes = {place: {f"{prefix}.{name}": value for name, value in scaled.items()}}
    if place == EVERY_NODE and is_simulated(experiment):
        changes["rig"] = {f"simulated.{prefix}.{name}": value for name, value in scaled.items()}
    return experiment.changed(changes)


def _largest(value: Any) -> float:
    return float(np.abs(value).max())


def range_refusal(experiment: Experiment, peaks: Mapping[str, Floats]) -> str:
    """Say which sensors have a range that does not fit the expected peaks; empty if all do.

    Parameters
    ----------
    experiment : Experiment
        With the facts ``sensors.*_range``; 0: not known.
    peaks : mapping
        Of `peaks_by_axis`. Of a range that is too large the axis that uses most of it counts: a
        motion need not drive all axes.
    """
    section = experiment.sections.get("reference_force")
    if section is None or not peaks:
        return ""
    found = []
    for name, unit in zip(CHANNELS, LIMIT_UNITS, strict=False):
        parameter = f"sensors.{name}_range"
        ranges = per_axis(section[parameter], experiment.axes, f"/**: {parameter}")
        if not ranges.all():
            continue
        share = peaks[name] / ranges
        axis = int(share.argmax())
        if not SMALLEST_SHARE <= share[axis] <= LARGEST_SHARE:
            peak, part = f"{peaks[name][axis]:.3g}", f"({100 * share[axis]:.3g} %)"
            found.append(f"{name} {peak} of {ranges[axis]:g} {unit} {part}")
    if not found:
        return ""
    return (
        f"expected peaks use less than {100 * SMALLEST_SHARE:g} % or more than "
        f"{100 * LARGEST_SHARE:g} % of a sensor's range: {', '.join(found)}; change ground_motion: "
        "peak_force, or choose other sensors or ranges of their amplifiers (/**: sensors.*_range)"
    )


@dataclass(frozen=True)
class Actuators:
    """What the actuators of n axes can do, shape (n,) each; infinite where it is not known.

    Attributes
    ----------
    stroke, force_capacity : ndarray
        Displacement in both directions at which the piston meets its stops, m; force at supply
        pressure, N.
    command : ndarray
        Largest valve command, V.
    flow_gain, oil_stiffness, leakage : ndarray
        Piston velocity for one volt, m/s/V; stiffness of the oil column, N/m; rate at which the
        force decays, 1/s.
    """

    stroke: Floats
    force_capacity: Floats
    command: Floats
    flow_gain: Floats
    oil_stiffness: Floats
    leakage: Floats

    @classmethod
    def of_test(cls, experiment: Experiment) -> "Actuators | None":
        """Take those of the simulated rig, else those that are known.

        None: actuators that obey forces have no valve, stroke or capacity. An InputError says if
        parameters contradict each other.
        """
        axes, controller = experiment.axes, experiment.sections.get("force_controller")
        if controller is None or controller["actuator.kind"] in FORCE_DRIVEN:
            return None
        unknown = np.full(len(axes), np.inf)
        command = np.minimum(unknown, controller["limits.command"])
        if controller["actuator.kind"] == POSITION_SERVO:  # its vendor's controller drives it
            command = unknown
        if not is_simulated(experiment):
            known = {
                name: per_axis(controller[f"actuator.{name}"], axes, f"/**: actuator.{name}")
                for name in ("force_capacity", "flow_gain", "oil_stiffness", "leakage")
            }
            leakage = known.pop("leakage")
            given = {name: np.where(value > 0, value, np.inf) for name, value in known.items()}
            return cls(unknown, command=command, leakage=leakage, **given)
        h = Hydraulics.from_parameters(group(experiment["rig"], "simulated.actuator"), axes)
        flow = h.flow_gain, h.oil_stiffness, h.leakage
        if is_imposed(experiment["rig"]):
            return cls(h.stroke, unknown, command, *flow)
        if controller["actuator.kind"] == "servo_hydraulic_linear":
            return cls(unknown, unknown, command, *flow)
        return cls(h.stroke, h.force_capacity, np.minimum(command, h.rated_voltage), *flow)

    def flow(self, response: ReferenceResponse, dt: float) -> Floats:
        """Largest flow that a response needs of each valve, as it would be without load, m/s.

        By Eq. (4) of docs/theory.md: v + (f' + lambda f) / k_oil over the root of the remaining
        supply pressure (Merritt 1967). Where a force leaves none, the force capacity is exceeded,
        which is another matter.
        """
        f = response.force
        filling = (np.gradient(f, dt, axis=0) + self.leakage * f) / self.oil_stiffness
        flow = response.velocity + filling
        left = 1.0 - np.sign(flow) * f / self.force_capacity
        unloaded = np.abs(flow) / np.sqrt(np.where(left > 0.0, left, np.inf))
        return unloaded.max(axis=0)


@dataclass(frozen=True)
class Excess:
    """An expected peak beyond what is allowed: what it is, and whether it is a limit to raise."""

    text: str
    can_be_raised: bool = False


def excesses(experiment: Experiment, response: ReferenceResponse | None) -> list[Excess]:
    """Find expected peaks beyond the limits, the stroke, the force capacity, and the flow.

    Parameters
    ----------
    experiment : Experiment
        With its limits.
    response : ReferenceResponse or None
        See `expected_response`.
    """
    if response is None:
        return []
    peaks, limits = peaks_of(response), group(experiment["supervisor"], "limits")
    highest, one = highest_limits(experiment, peaks), np.ones(len(experiment.axes))
    compared = [
        (name, peaks[name], limits[name] * one, unit, f"/**: limits.{name}")
        for name, unit in zip(CHANNELS, LIMIT_UNITS, strict=False)
    ]
    has = Actuators.of_test(experiment)
    if has is not None:
        flow, most = has.flow(response, experiment.timebase.dt), has.command * has.flow_gain
        capacity = "the actuator's force capacity"
        compared += [
            ("displacement", peaks["displacement"], has.stroke, "m", "the actuator's stroke"),
            ("force", peaks["force"], has.force_capacity, "N", capacity),
            ("flow of the valve", flow, most, "m/s", "that of the fully open valve"),
        ]
    found = []
    for place, (name, peak, most, unit, what) in enumerate(compared):
        share = peak / most
        axis = int(share.argmax())
        if share[axis] > 1.0:
            text = f"expected {name} on axis {experiment.axes[axis]} is {peak[axis]:.4g} {unit}"
            text += f", {100 * share[axis]:.4g} % of {what} ({most[axis]:.5g} {unit})"
            is_limit = place < len(CHANNELS)
            found.append(Excess(text, is_limit and bool(peak.max() < highest.get(name, np.inf))))
    return found


def excess_text(found: Sequence[Excess]) -> str:
    """Say in one line what is exceeded, and how to mend it; empty if nothing is."""
    mend = "lower ground_motion: peak_force"
    if all(excess.can_be_raised for excess in found):
        mend += ", or raise the limit (seft preflight CONFIG --write limits.yaml proposes one)"
    return "; ".join([*(excess.text for excess in found), mend]) if found else ""


LARGEST_STOP = 0.5
"""Part of the stroke that is kept for stopping, at most."""


def highest_limits(experiment: Experiment, peaks: Mapping[str, Floats]) -> dict[str, float]:
    """Find how high the limits of displacement (m) and force (N) may be, where that is known.

    The limit of the displacement must trip before the piston meets its stop. After a trip the valve
    closes at a constant rate, and the piston moves on by half of what its velocity would reach in
    that time; at most this is the largest expected velocity.

    Parameters
    ----------
    experiment : Experiment
        The closing time is that of its rig.
    peaks : mapping
        Of `peaks_by_axis`.
    """
    has = Actuators.of_test(experiment) if peaks else None
    if has is None:
        return {}
    closing = experiment.sections.get("rig", {}).get("safe.close_time", 0.0)
    stop = 0.5 * closing * peaks["velocity"]
    displacement = has.stroke - np.minimum(stop, LARGEST_STOP * has.stroke)
    highest = {"displacement": displacement.min(), "force": has.force_capacity.min()}
    return {name: float(value) for name, value in highest.items() if np.isfinite(value)}
