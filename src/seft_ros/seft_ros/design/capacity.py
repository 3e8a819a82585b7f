"""Whether sensors, limits and actuators allow what a planned test is expected to need of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS, FORCE_DRIVEN, POSITION_SERVO
from seft_msgs_py.config.parameter_table import group, per_axis
from seft_plant_sim.rig_parameters import LIMIT_UNITS, is_imposed
from seft_plant_sim.simulated.actuator import Hydraulics
from seft_plant_sim.whole_structure import ReferenceResponse, is_simulated

from seft_ros.design.plausibility import LARGEST_SHARE, SMALLEST_SHARE, peaks_of


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
            found.append(
                f"{name} {peaks[name][axis]:.3g} of {ranges[axis]:g} {unit} "
                f"({100 * share[axis]:.3g} %)"
            )
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
        flow = response.velocity
        flow = flow + (np.gradient(f, dt, axis=0) + self.leakage * f) / self.oil_stiffness
        left = 1.0 - np.sign(flow) * f / self.force_capacity
        unloaded = np.abs(flow) / np.sqrt(np.where(left > 0.0, left, np.inf))
        largest: Floats = unloaded.max(axis=0)
        return largest


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
            text = (
                f"expected {name} on axis {experiment.axes[axis]} is {peak[axis]:.4g} {unit}, "
                f"{100 * share[axis]:.4g} % of {what} ({most[axis]:.5g} {unit})"
            )
            is_limit = place < len(CHANNELS)
            found.append(Excess(text, is_limit and bool(peak.max() < highest.get(name, np.inf))))
    return found


def excess_text(found: Sequence[Excess]) -> str:
    """Say in one line what is exceeded, and how to mend it; empty if nothing is."""
    if not found:
        return ""
    mend = "lower ground_motion: peak_force"
    if all(excess.can_be_raised for excess in found):
        mend += ", or raise the limit (seft preflight CONFIG --write limits.yaml proposes one)"
    return f"{'; '.join(excess.text for excess in found)}; {mend}"


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
