"""What a test is expected to reach, and limits that fit it."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_plant_sim.limits import NAMES, UNITS
from seft_plant_sim.whole_structure import reference_response

from seft_ros.ground_motion.block import GroundMotion

Floats = npt.NDArray[np.float64]

FACTORS = {"displacement": 1.5, "velocity": 2.0, "acceleration": 2.0, "force": 1.5}
"""Proposed limit over the expected peak: oil that rings moves the piston little, but fast."""
FAR = 4.0
"""Limit over the expected peak from which on it protects little."""


def expected_peaks(experiment: Experiment) -> dict[str, float]:
    """Find the largest value of each quantity on any axis in the exact response of a test.

    Parameters
    ----------
    experiment : Experiment
        Where its rig is simulated, the specimen is that of the rig, else the model's.

    Returns
    -------
    dict
        Displacement (m), velocity (m/s), acceleration (m/s^2) and force (N). Empty where they are
        not known here, as the ground motion or another node runs elsewhere.

    Raises
    ------
    InputError
        If the record of the ground motion can't be read, or the structure makes no sense.
    """
    if not {"ground_motion", "reference_force", "supervisor"} <= set(experiment.sections):
        return {}
    section, timebase = experiment["ground_motion"], experiment.timebase
    motion = GroundMotion.from_parameters(section, experiment.axes, timebase).samples
    exact = reference_response(experiment, motion)
    return {name: float(np.abs(getattr(exact, name)).max()) for name in NAMES}


def proposed_limits(peaks: dict[str, float]) -> dict[str, float]:
    """Give limits that fit expected peaks, to two digits, rounded up."""
    return {name: _round_up(FACTORS[name] * peak) for name, peak in peaks.items()}


def limit_warning(experiment: Experiment, peaks: dict[str, float]) -> str:
    """Say which limits are far beyond what a test is expected to reach; empty if none is."""
    far = [
        f"{name} {limit:g} {unit} (expected: {peak:.3g})"
        for (name, peak), unit in zip(peaks.items(), UNITS, strict=False)
        if (limit := experiment["supervisor"][f"limits.{name}"]) > FAR * peak > 0.0
    ]
    if not far:
        return ""
    return (
        f"limits are more than {FAR:g} times what this test is expected to reach: "
        f"{', '.join(far)}; seft preflight CONFIG --write limits.yaml proposes others"
    )


def limit_rows(experiment: Experiment, peaks: dict[str, float]) -> list[list[Any]]:
    """Tabulate quantity, unit, expected peak, configured limit and proposed one."""
    rows = []
    for (name, limit), unit in zip(proposed_limits(peaks).items(), UNITS, strict=False):
        configured = experiment["supervisor"][f"limits.{name}"]
        rows.append([name, unit, f"{peaks[name]:.3g}", f"{configured:g}", f"{limit:g}"])
    return rows


def write_limits(file: Path, limits: dict[str, float]) -> None:
    """Write limits as a parameter file.

    Raises
    ------
    InputError
        If it can't be written, or there are none.
    """
    if not limits:
        raise InputError(f"{file}: no limits to write: a node that runs elsewhere has the motion")
    lines = "".join(f"    limits.{name}: {value!r}\n" for name, value in limits.items())
    text = (
        "# by seft preflight: 1.5 times the expected peaks of displacement and force, 2 times\n"
        f"# those of velocity and acceleration\nsupervisor:\n  ros__parameters:\n{lines}"
    )
    try:
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{file}: can't be written: {error.strerror}") from None


def _round_up(value: float) -> float:
    if value <= 0.0:
        return value
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(f"{np.ceil(value / unit - 1e-9) * unit:.6g}")
