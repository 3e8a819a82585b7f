"""Tests that an identification has recorded before: which of them it uses again."""

from pathlib import Path

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import place_of
from seft_msgs_py.config.parameter_table import Value
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import GROUND_MOTION

from seft_ros.bags.recording import Recording
from seft_ros.identification.rig_tests import ground_of, write_forces

_CLOSE = 1e-6
"""Relative: another computer's arithmetic changes less, and another level more."""
_OF_A_RUN = {"directory", "name", "keep_awake", "file"}
"""Parameters that say where a test was run, recorded and written, not which it was."""


def why_cut_off(recording: Recording, steps: int) -> str:
    """Say why a test of so many steps is not whole; empty if it is."""
    states = recording.states.steps
    done = int(states[-1]) + 1 if len(states) else 0
    if recording.trip is not None:
        return f"tripped at {recording.trip.time_s:.3f} s"
    return "" if done >= steps and recording.complete else f"ends after {done} of {steps} steps"


def other_test(recording: Recording, planned: Experiment, forces: Floats) -> str:
    """Say how a recording differs from a planned test, whose forces (N) are given; empty if not.

    Of nodes that are external, which the plan does not know, nothing is compared.
    """
    recorded = recording.experiment.sections
    others = [
        (name, f"{place_of(name, node)}: {name} was {known}, and is {value}")
        for node, section in planned.sections.items()
        for name, value in section.items()
        if name not in _OF_A_RUN and not _alike(known := recorded.get(node, {}).get(name), value)
    ]
    if others:  # limits first: they stand for the noise of channels that are not known
        return min(others, key=lambda other: not other[0].startswith("limits."))[1]
    ground = recording.series[GROUND_MOTION.name]
    wanted = ground_of(planned, forces) * planned["ground_motion"]["influence"]
    within = ground.steps < len(wanted)
    if not _alike(ground.values[within, 0], wanted[ground.steps[within]]):
        return "it had other commands"
    return ""


def _alike(one: Value, other: Value) -> bool:
    try:
        first, second = (np.asarray(value, dtype=np.float64) for value in (one, other))
    except (TypeError, ValueError):
        return bool(one == other)
    if first.shape != second.shape:
        return False
    largest = np.abs(second).max(initial=0.0)
    return bool(np.allclose(first, second, rtol=_CLOSE, atol=_CLOSE * largest * (first.ndim > 1)))


def kept_excitation(path: Path, experiment: Experiment, forces: Floats) -> Path:
    """Write an excitation, shape (N, n), N, where there is none; give its path.

    Raises
    ------
    InputError
        If another stands there.
    """
    if not path.exists():
        return write_forces(path, experiment, forces)
    try:
        known = np.loadtxt(path, delimiter=",", ndmin=2)
    except (OSError, ValueError):
        known = np.zeros((0, 0))
    if not _alike(known, ground_of(experiment, forces)):
        raise InputError(
            f"{path}: is of another rate, specimen.mass, --band, --seed or --duration, or none; "
            "name another folder with --out"
        )
    return path
