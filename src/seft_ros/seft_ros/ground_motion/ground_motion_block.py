"""The ground motion of a test: its parameters, and all its steps, known before the test starts.

After the end of the test the ground is at rest for the lead time, so that a method with a preview
need not know the end.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.facts import facts
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

from seft_ros.ground_motion.conditioning import baseline_numbers, check_size, correct, resample
from seft_ros.ground_motion.record_file import RecordedMotion, files_of, given_unit, read_record
from seft_ros.ground_motion.synthetic_motion import synthetic_motion

MOTION = "motion"
"""Name of `motion_facts` in the description of the node."""

OF_RECORD = ("column", "rows", "unit", "dt", "response")
"""Parameters that say how a record is to be read, which do not hold for another record."""

FILES = ("file", "response")
"""Parameters that name files."""

_CHUNKS_PER_LEAD = 4

_ROWS = """
    file       | texts  | "" |       |             |
        record to read, or one for each axis, in the order of axes or as AXIS=FILE; empty: make a
        synthetic motion
    column     | ints   | -1  |       | -1 ..       |
        column of the file, counted from 0; one for all axes, or one per axis; -1: the one whose
        name says that it is an acceleration, or the first that is not the time
    rows       | bool   | false |     |             |
        the file holds one motion in rows of several numbers, and no columns
    unit       | string |     |       |             |
        unit of the accelerations in the file: g, m/s2 or cm/s2 (gal); empty: the unit that the
        file states
    dt         | float  | 0.0 | s     | 0 ..        |
        sampling period of the file; 0: the period that the file states (header, column of time)
    response   | string |     |       |             |
        file of the station's metadata (StationXML), for counts in a SAC or miniSEED file
    correct    | string | none |      | none, offset, baseline |
        correction of the record: offset takes off its mean; baseline also filters by a high-pass,
        and takes off the parabola with which velocity and displacement end at zero
    peak_force | float  | 0.0 | N     | 0 ..        |
        scale the motion so that this is the largest |m a_g|, with the specimen's mass m; 0: as
        recorded
    time_scale | float  | 1.0 |       | > 0         |
        factor on the motion's duration: 0.5 is twice as fast
    influence  | floats | 1.0 |       |             |
        influence vector: factor on the ground acceleration, for all axes or per axis
    tail       | float  | 2.0 | s     | 0 ..        | free vibration after the motion
    lead       | float  | 2.0 | s     | > 0 .. 3600 |
        how far ahead of the rig's time the motion is published
"""
_FILTER_ROWS = """
    corner    | float | 0.1  | Hz | 0 .. | corner of the high-pass (Butterworth); 0: no filter
    order     | int   | 4    |    | 1 .. 10 | its order
    both_ways | bool  | true |    |      | forwards and backwards: no shift of phase
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
    (
        *facts("specimen.mass"),
        *parameter_rows(_ROWS),
        *parameter_rows(_FILTER_ROWS, group="filter"),
        *parameter_rows(_SYNTHETIC_ROWS, group="synthetic"),
    ),
)
"""Parameters of the node ground_motion."""


class GroundMotion:
    """Ground accelerations of a test at the rate of the loop, and their chunks for publication.

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

    Attributes
    ----------
    samples : ndarray
        Shape (N, n): steps, axes; m/s^2, read-only.
    known : ndarray
        The samples and then the rest, shape (N + lead_steps, n), read-only.
    steps : int
        N, the tail of free vibration included.
    chunks : list of (int, ndarray)
        See `chunks_of`; a chunk is a part of the lead time, and read-only.
    facts : dict
        Source of the motion and its changes, see `motion_facts`.
    uncorrected : ndarray or None
        The samples without the correction of their record; None: it was not corrected.
    """

    def __init__(self, section: Section, axes: Sequence[str], timebase: Timebase) -> None:
        influence = per_axis(section["influence"], axes, "ground_motion: influence")
        given_unit(section["unit"])
        if files := files_of(section["file"], axes):
            record = _recorded(section, axes, files)
        else:
            record = _synthetic(group(section, "synthetic"), len(axes))
        method, dt, before = section["correct"], record.dt, record.accelerations
        after = correct(before, dt, method, **group(section, "filter"))
        times = dt, timebase, section["time_scale"], section["tail"]
        resampled, how = resample(after, *times, linear=not files)  # as a synthetic one is
        with np.errstate(over="ignore", invalid="ignore"):
            samples = resampled * influence
            scale = _peak_scale(section, axes, samples)
            samples *= scale
        if not np.isfinite(samples).all():
            mend = "check its values, influence and peak_force"
            raise InputError(
                f"ground_motion: {record.source}: accelerations are not finite; {mend}"
            )
        check_size(section["lead"], timebase.rate, f"lead {section['lead']:g} s")
        lead_steps = max(1, round(section["lead"] * timebase.rate))
        chunk_steps = max(1, round(lead_steps / _CHUNKS_PER_LEAD))
        self.steps = len(samples)
        self.known: Floats = np.pad(samples, ((0, lead_steps), (0, 0)))
        self.known.flags.writeable = False
        self.samples = self.known[: self.steps]
        self.chunks = chunks_of(self.known, min(chunk_steps, self.steps))
        self.facts = motion_facts(section, axes, record, samples, scale)
        self.facts["resampling"] = how
        self.uncorrected: Floats | None = None
        if method != "none":
            numbers = {"before": baseline_numbers(before, dt), "after": baseline_numbers(after, dt)}
            self.facts["correction"] = {"method": _correction(section), **numbers}
            uncorrected, _ = resample(before, *times, linear=not files)
            self.uncorrected = uncorrected * influence * scale


def chunks_of(known: Floats, steps: int) -> list[tuple[int, Floats]]:
    """Cut a motion into pieces of so many steps; give each with the step of its first sample."""
    return [(first, known[first : first + steps]) for first in range(0, len(known), steps)]


def _peak_scale(section: Section, axes: Sequence[str], samples: Floats) -> float:
    """Give the factor that peak_force asks for."""
    peak = section["peak_force"]
    if not peak:
        return 1.0
    mass = mass_matrix(section["specimen.mass"], axes, "/**: specimen.mass")
    largest = float(np.abs(samples @ mass.T).max())
    if not largest > 0:
        raise InputError(
            f"ground_motion: a motion of zeros can't be scaled to peak_force {peak:g} "
            "N; check column and influence, or set peak_force to 0"
        )
    return float(peak / largest)


def _correction(section: Section) -> str:
    """Say in words how the record was corrected."""
    method, corner = str(section["correct"]), section["filter.corner"]
    if method != "baseline" or not corner:
        return method
    ways = "both ways" if section["filter.both_ways"] else "one way"
    return f"{method}, high-pass {corner:g} Hz of order {section['filter.order']}, {ways}"


def motion_facts(
    section: Section, axes: Sequence[str], record: RecordedMotion, samples: Floats, scale: float
) -> dict[str, Any]:
    """Give the source of a motion, and its changes in a test; all are JSON values.

    Returns
    -------
    dict
        ``source`` (names of the files, without their folders), ``unit`` (of the file; None:
        synthetic), ``dt_s`` (of the record), ``channels`` (what was read for each ``axis``, see
        `RecordedMotion`; empty: synthetic), ``correction`` (None, or ``method`` in words and, of
        the record, the numbers ``before`` and ``after``, see `baseline_numbers`),
        ``scale_factor`` (from `peak_force`), ``peak_force_n`` (0: as recorded), ``time_scale``,
        ``peak_acceleration`` (of each axis in the test, m/s^2), ``duration_s`` (in the test,
        without the tail), ``tail_s`` and ``resampling`` (what was done, in words).
    """
    return {
        "source": record.source,
        "unit": record.unit or None,
        "dt_s": record.dt,
        "channels": [
            {"axis": axis, **read} for axis, read in zip(axes, record.channels, strict=False)
        ],
        "correction": None,
        "scale_factor": scale,
        "peak_force_n": section["peak_force"],
        "time_scale": section["time_scale"],
        "peak_acceleration": np.abs(samples).max(axis=0).tolist(),
        "duration_s": (len(record.accelerations) - 1) * record.dt * section["time_scale"],
        "tail_s": section["tail"],
    }


def _recorded(section: Section, axes: Sequence[str], files: Sequence[str]) -> RecordedMotion:
    """Read the records of all axes; zeros follow those that are shorter."""
    if len(files) not in (1, len(axes)):
        raise InputError(
            f"ground_motion: file: {len(files)} records for {len(axes)} axes [{', '.join(axes)}]; "
            "give one, or one for each axis"
        )
    columns = [int(c) for c in per_axis(section["column"], axes, "ground_motion: column")]
    wanted = [(files[0], columns)]
    if len(files) > 1:
        wanted = [(file, [column]) for file, column in zip(files, columns, strict=True)]
    words = {"rows": section["rows"], "response": section["response"]}
    words["corrected"] = section["correct"] != "none"
    found = [
        read_record(file, those, section["unit"], section["dt"], **words) for file, those in wanted
    ]
    return found[0] if len(found) == 1 else _side_by_side(found, axes)


def _side_by_side(found: Sequence[RecordedMotion], axes: Sequence[str]) -> RecordedMotion:
    """Join the records of the axes."""
    first = found[0]
    for axis, one in zip(axes, found, strict=True):
        if one.dt != first.dt:
            raise InputError(
                f"ground_motion: {axis}: {one.source} has a sampling period of {one.dt:g} s, but "
                f"{axes[0]}: {first.source} of {first.dt:g} s; resample one of them"
            )
    motions = [one.accelerations for one in found]
    length = max(map(len, motions))
    joined = np.hstack([np.pad(a, ((0, length - len(a)), (0, 0))) for a in motions])
    channels = [channel for one in found for channel in one.channels]
    source = ", ".join(one.source for one in found)
    return RecordedMotion(joined, first.dt, source, first.unit, channels)


def _synthetic(values: Section, n: int) -> RecordedMotion:
    """One synthetic motion, the same on all n axes."""
    check_size(values["duration"], 1 / values["dt"], "synthetic.duration, synthetic.dt")
    motion = np.repeat(synthetic_motion(**values)[:, np.newaxis], n, axis=1)
    return RecordedMotion(motion, values["dt"], f"synthetic, seed {values['seed']}", "")
