"""The ground motion of a test: its parameters, and all its steps, known before the test starts.

After the end of the test the ground is at rest for the lead time, so that a method with a preview
need not know the end.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.parameter_table import (
    Section,
    Table,
    group,
    mass_matrix,
    parameter_rows,
    per_axis,
)
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import Timebase

from seft_ros.ground_motion.record_file import RecordedMotion, read_record
from seft_ros.ground_motion.synthetic_motion import synthetic_motion

_MAX_STEPS = 50_000_000
"""Longest accepted motion, in steps: a longer one is a mistyped duration or rate."""

MOTION = "motion"
"""Name of `motion_facts` in the description of the node."""

_SNAP = 1e-9  # of a record's step: rounding in k * dt must not move a sample off its knot
_CHUNKS_PER_LEAD = 4

_ROWS = """
    file       | string |     |       |             |
        record to read; empty: make a synthetic motion
    column     | ints   | -1  |       | -1 ..       |
        column of the file, counted from 0; one for all axes, or one per axis; -1: the first that
        is not the time
    unit       | string |     |       | "", g, m/s2, cm/s2 |
        unit of the accelerations in the file; empty: the unit that the file states
    dt         | float  | 0.0 | s     | 0 ..        |
        sampling period of the file; 0: the period that the file states (header, column of time)
    peak_force | float  | 0.0 | N     | 0 ..        |
        scale the motion so that this is the largest |mass * acceleration|; 0: as recorded
    mass       | floats | reference_force:model.mass or 0.0 | kg | |
        mass to which peak_force refers: one for every axis, one per axis, or a matrix row
        by row
    time_scale | float  | 1.0 |       | > 0         |
        factor on the motion's duration: 0.5 is twice as fast
    influence  | floats | 1.0 |       |             |
        influence vector: factor on the ground acceleration, for all axes or per axis
    tail       | float  | 2.0 | s     | 0 ..        | free vibration after the motion
    lead       | float  | 2.0 | s     | > 0 .. 3600 |
        how far ahead of the rig's time the motion is published
"""
_SYNTHETIC_ROWS = """
    seed             | int   | 0     |       | 0 .. | seed of the synthetic motion
    duration         | float | 20.0  | s     | > 0  | its duration
    dt               | float | 0.005 | s     | > 0  | its sampling period
    peak             | float | 3.0   | m/s^2 | > 0  | its peak acceleration
    ground_frequency | float | 2.5   | Hz    | > 0  | frequency of the ground layer (Kanai-Tajimi)
    ground_damping   | float | 0.6   |       | > 0  | its damping ratio
    filter_frequency | float | 0.25  | Hz    | > 0  | frequency of the high-pass (Clough-Penzien)
    filter_damping   | float | 0.6   |       | > 0  | its damping ratio
    rise             | float | 2.0   | s     | 0 .. | end of the envelope's rise
    plateau_end      | float | 8.0   | s     | 0 .. | end of the envelope's plateau
    decay            | float | 0.35  | 1/s   | 0 .. | rate of the envelope's decay
"""

GROUND_MOTION_TABLE = Table(
    "ground_motion",
    (*parameter_rows(_ROWS), *parameter_rows(_SYNTHETIC_ROWS, group="synthetic")),
)
"""Parameters of the node ground_motion."""


class GroundMotion:
    """Ground accelerations of a test at the rate of the loop, and their chunks for publication.

    Parameters
    ----------
    samples : array_like
        Shape (N, n): steps, axes; m/s^2.
    chunk_steps : int
        Steps to a chunk; the last may have less.
    lead_steps : int
        Steps of rest that are known beyond the end.
    facts : dict, optional
        Source of the motion and its changes, see `motion_facts`.

    Attributes
    ----------
    samples : ndarray
        Shape (N, n), read-only.
    known : ndarray
        The samples and then the rest, shape (N + lead_steps, n), read-only.
    steps : int
        N, the tail of free vibration included.
    chunks : list of (int, ndarray)
        The pieces in which ``known`` is published: step of the first sample, and values of shape
        (p, n), m/s^2, read-only.
    """

    def __init__(
        self,
        samples: npt.ArrayLike,
        chunk_steps: int,
        lead_steps: int = 0,
        facts: dict[str, Any] | None = None,
    ) -> None:
        given = np.asarray(samples, dtype=np.float64)
        self.steps = len(given)
        self.known: Floats = np.pad(given, ((0, lead_steps), (0, 0)))
        self.known.flags.writeable = False
        self.samples = self.known[: self.steps]
        firsts = range(0, len(self.known), chunk_steps)
        self.chunks = [(first, self.known[first : first + chunk_steps]) for first in firsts]
        self.facts = facts or {}

    @classmethod
    def from_parameters(
        cls, section: Section, axes: Sequence[str], timebase: Timebase
    ) -> "GroundMotion":
        """Read or make the motion of an experiment.

        Parameters
        ----------
        section : dict
            Values of every parameter in `GROUND_MOTION_TABLE`.
        axes : sequence of str
            Axis names; n of them.
        timebase : Timebase
            Of the loop.

        Raises
        ------
        InputError
            If the file can't be read as a record, or parameters contradict each other.
        """
        influence = per_axis(section["influence"], axes, "ground_motion: influence")
        if section["file"]:
            columns = per_axis(section["column"], axes, "ground_motion: column")
            record = read_record(
                section["file"], [int(c) for c in columns], section["unit"], section["dt"]
            )
        else:
            record = _synthetic(group(section, "synthetic"), len(axes))
        samples = resample(
            record.accelerations, record.dt, timebase, section["time_scale"], section["tail"]
        )
        scale, peak = 1.0, section["peak_force"]
        with np.errstate(over="ignore", invalid="ignore"):
            samples *= influence
            if peak:
                mass = mass_matrix(section["mass"], axes, "ground_motion: mass (for peak_force)")
                largest = float(np.abs(samples @ mass.T).max())
                if not largest > 0:
                    raise InputError(
                        f"ground_motion: a motion of zeros can't be scaled to peak_force {peak:g} "
                        "N; check column and influence, or set peak_force to 0"
                    )
                scale = peak / largest
                samples *= scale
        if not np.isfinite(samples).all():
            raise InputError(
                f"ground_motion: {record.source}: accelerations are not finite; check its "
                "values, influence and peak_force"
            )
        lead_steps = max(1, round(section["lead"] * timebase.rate))
        chunk_steps = max(1, round(lead_steps / _CHUNKS_PER_LEAD))
        facts = motion_facts(section, record, samples, scale)
        return cls(samples, min(chunk_steps, len(samples)), lead_steps, facts)


def motion_facts(
    section: Section, record: RecordedMotion, samples: Floats, scale: float
) -> dict[str, Any]:
    """Give the source of a motion, and its changes in a test; all are JSON values.

    Returns
    -------
    dict
        ``source`` (the file's name, without its folder), ``unit`` (of the file; None: synthetic),
        ``dt_s`` (of the record), ``scale_factor`` (from `peak_force`), ``peak_force_n``
        (0: as recorded), ``time_scale``, ``peak_acceleration`` (of each axis in the test, m/s^2),
        ``duration_s`` (in the test, without the tail) and ``tail_s``.
    """
    return {
        "source": Path(record.source).name,
        "unit": record.unit or None,
        "dt_s": record.dt,
        "scale_factor": scale,
        "peak_force_n": section["peak_force"],
        "time_scale": section["time_scale"],
        "peak_acceleration": np.abs(samples).max(axis=0).tolist(),
        "duration_s": (len(record.accelerations) - 1) * record.dt * section["time_scale"],
        "tail_s": section["tail"],
    }


def _synthetic(values: Section, n: int) -> RecordedMotion:
    """One synthetic motion, the same on all n axes."""
    check_size(values["duration"], 1 / values["dt"], "synthetic.duration, synthetic.dt")
    motion = np.repeat(synthetic_motion(**values)[:, np.newaxis], n, axis=1)
    return RecordedMotion(motion, values["dt"], f"synthetic, seed {values['seed']}", "")


def resample(
    record: Floats,
    record_dt: float,
    timebase: Timebase,
    time_scale: float = 1.0,
    tail: float = 0.0,
) -> Floats:
    """Sample a record at the rate of the loop, and append zeros.

    The record is piecewise linear in time between its samples at
    ``j * record_dt * time_scale``, and is evaluated at ``k * timebase.dt``; nothing is
    filtered. A sample of the record between two steps is lost, also if it is a peak: always
    if the loop's rate is below the record's, sometimes if it is not a multiple of it.

    Parameters
    ----------
    record : ndarray
        Shape (M, c), M at least 2.
    record_dt : float
        Sampling period of the record in s.
    timebase : Timebase
        Of the loop.
    time_scale : float
        Factor on the record's duration; accelerations do not change.
    tail : float
        Duration of the zeros in s.

    Returns
    -------
    ndarray
        Shape (N, c): every step within the record's duration, then the tail.

    Raises
    ------
    InputError
        If that makes more than `_MAX_STEPS` steps, or less than one.
    """
    last = len(record) - 1
    duration = last * record_dt * time_scale
    if duration < timebase.dt:
        raise InputError(
            f"ground_motion: the motion lasts {duration:g} s, less than a step at "
            f"{timebase.rate:g} Hz; check dt and time_scale"
        )
    check_size(duration + tail, timebase.rate, f"time_scale {time_scale:g}, tail {tail:g} s")
    ratio = timebase.dt / (record_dt * time_scale)
    positions = np.arange(int(last / ratio * (1 + 1e-12) + _SNAP) + 1) * ratio
    nearest = np.rint(positions)
    positions = np.where(np.abs(positions - nearest) <= _SNAP, nearest, positions)
    samples = np.zeros((len(positions) + round(tail * timebase.rate), record.shape[1]))
    for column, values in enumerate(record.T):
        samples[: len(positions), column] = np.interp(positions, np.arange(len(record)), values)
    return samples


def check_size(duration: float, rate: float, where: str) -> None:
    """Refuse motions of an implausible length, before memory is reserved for them.

    ``duration`` in s, ``rate`` in Hz; ``where`` names their parameters.

    Raises
    ------
    InputError
        If there would be more than `_MAX_STEPS` steps.
    """
    if not duration * rate <= _MAX_STEPS:
        raise InputError(
            f"ground_motion: {duration:g} s at {rate:g} Hz are more than {_MAX_STEPS:.0e} steps "
            f"({where}); check duration and rate"
        )
