"""Whether the numbers of a planned test can be right: units that were mixed up."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS, EVERY_NODE
from seft_msgs_py.config.parameter_table import Section, group
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


@dataclass(frozen=True)
class _Units:
    """Factors by which a specimen's values may have been given too small, and their units then."""

    stiffness: float
    damping: float
    mass: float
    stiffness_unit: str
    mass_unit: str


_MIXED_UP = (
    _Units(1e3, 1.0, 1.0, "kN/m", ""),
    _Units(1e3, 1e3, 1.0, "kN/m", ""),
    _Units(1e3, 1.0, 1e3, "kN/m", "t"),
    _Units(1e3, 1e3, 1e3, "kN/m", "t"),
    _Units(1.0, 1.0, 1e3, "", "t"),
    _Units(1e6, 1.0, 1.0, "kN/mm", ""),
)
"""In this order: who gives a mass in t gives a stiffness in kN/m, if the other fits, too."""


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


@dataclass(frozen=True)
class _Fit:
    """How a specimen fits the test.

    ``misfit`` says what does not, empty if nothing; ``too_light`` and ``too_soft`` whether a mass
    or a stiffness that was given too small explains it.
    """

    hz: float
    damping: float
    misfit: str = ""
    too_light: bool = False
    too_soft: bool = False


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
    known = group(experiment["reference_force"], "specimen")
    if not is_simulated(experiment):
        yield EVERY_NODE, "specimen", experiment
        return
    true = group(experiment["rig"], "simulated.specimen")
    if all(true[name] == known[name] for name in ("mass", "damping", "stiffness")):
        yield EVERY_NODE, "specimen", experiment
        return
    yield "rig", "simulated.specimen", experiment
    others = {node: own for node, own in experiment.sections.items() if node != "rig"}
    yield EVERY_NODE, "specimen", Experiment(others)


def _mixed_up(
    experiment: Experiment,
    place: str,
    prefix: str,
    planned: GroundMotion,
    peaks: Mapping[str, Floats],
) -> str:
    now = _fit(experiment, planned, peaks)
    if not now.misfit:
        return ""
    given = _given(experiment, place, prefix)
    rate, dt = experiment.timebase.rate, experiment.timebase.dt
    slow, fast = 1.0 / (planned.steps * dt), rate / CONTROLLED
    for units in _MIXED_UP:
        if not (now.too_light if units.mass > 1.0 else now.too_soft):
            continue
        changed = _scaled(experiment, place, prefix, units)
        hz, damping = _first_mode(tested_specimen(changed))
        if not slow < hz < fast or damping > USUAL_DAMPING:
            continue
        section, axes, timebase = changed["ground_motion"], changed.axes, changed.timebase
        motion = GroundMotion.from_parameters(section, axes, timebase)
        if _fit(changed, motion, peaks_by_axis(changed, motion)).misfit:
            continue
        fitting = [
            f"a {name} of {_largest(given[name]) * factor:.6g} {si} ({unit}?)"
            for name, factor, si, unit in (
                ("stiffness", units.stiffness, "N/m", units.stiffness_unit),
                ("mass", units.mass, "kg", units.mass_unit),
            )
            if unit
        ]
        return (
            f"{place}: {prefix}: stiffness {_largest(given['stiffness']):.6g} N/m and mass "
            f"{_largest(given['mass']):.6g} kg give a natural frequency of {now.hz:.3g} Hz, "
            f"{now.misfit}; {' and '.join(fitting)} would give {hz:.3g} Hz and fit"
        )
    return ""


def _fit(experiment: Experiment, planned: GroundMotion, peaks: Mapping[str, Floats]) -> _Fit:
    hz, damping = _first_mode(tested_specimen(experiment))
    if not hz:  # nothing that a unit could change
        return _Fit(hz, damping)
    rate, limits = experiment.timebase.rate, group(experiment["supervisor"], "limits")
    if hz * PER_PERIOD > rate:
        fast = f"less than {PER_PERIOD:g} samples in a period at {rate:g} Hz"
        return _Fit(hz, damping, fast, too_light=True)
    ground = float(np.abs(planned.samples).max())
    if ground > FACTORS["acceleration"] * limits["acceleration"]:
        limit = f"(limit: {limits['acceleration']:g})"
        strong = f"and a ground acceleration of {ground:.2g} m/s^2 {limit}"
        return _Fit(hz, damping, strong, too_light=True)
    highest = {name: float(peak.max()) for name, peak in peaks.items()}
    farthest, limit = highest["displacement"], limits["displacement"]
    text = f"and a peak displacement of {farthest:.2g} m (limit: {limit:g})"
    if farthest > FACTORS["displacement"] * limit:
        return _Fit(hz, damping, text, too_soft=True)
    if all(highest[name] < SMALLEST_SHARE * limits[name] for name in highest if name != "force"):
        return _Fit(hz, damping, text, too_light=True)
    if damping > 1.0:
        return _Fit(hz, damping, f"and {damping:.3g} times the critical damping", too_soft=True)
    return _Fit(hz, damping)


def _first_mode(specimen: Specimen) -> tuple[float, float]:
    """Frequency in Hz and damping ratio of a specimen's slowest mode; 0 Hz without stiffness."""
    hz, damping = specimen.modes()
    return (float(hz[0]), float(damping[0])) if len(hz) == specimen.axes else (0.0, 0.0)


def _given(experiment: Experiment, place: str, prefix: str) -> Section:
    return group(experiment["reference_force" if place == EVERY_NODE else place], prefix)


def _scaled(experiment: Experiment, place: str, prefix: str, units: _Units) -> Experiment:
    """Give the experiment with the specimen in other units."""

    def times(value: Any, factor: float) -> Any:
        return (np.asarray(value) * factor).tolist()

    values = _given(experiment, place, prefix)
    factors = (
        ("stiffness", units.stiffness),
        ("damping", units.damping),
        ("mass", units.mass),
    )
    scaled = {name: times(values[name], factor) for name, factor in factors}
    changes = {place: {f"{prefix}.{name}": value for name, value in scaled.items()}}
    if place == EVERY_NODE and is_simulated(experiment):
        changes["rig"] = {f"simulated.{prefix}.{name}": value for name, value in scaled.items()}
    return experiment.changed(changes)


def _largest(value: Any) -> float:
    return float(np.abs(value).max())
