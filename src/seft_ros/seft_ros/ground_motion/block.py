"""The ground motion of a test: every step of it, known before the test starts.

Beyond the end of the test the ground is known to be at rest, as far as the motion is published
ahead: who looks ahead need not know where the end is.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.arrays import mass_matrix, per_axis
from seft_msgs_py.config.parameter_table import Section, group
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.timebase import Timebase

from seft_ros.ground_motion.record_file import RecordedMotion, read_record
from seft_ros.ground_motion.resample import check_size, resample
from seft_ros.ground_motion.scaling import force_scale
from seft_ros.ground_motion.synthetic import synthetic_motion

_CHUNKS_PER_LEAD = 4


class GroundMotion:
    """Ground accelerations of a test at the rate of the loop, and the chunks they are sent in.

    Parameters
    ----------
    samples : array_like
        Shape (N, n): steps, axes; m/s^2.
    timebase : Timebase
        Of the loop.
    chunk_steps : int
        Steps to a chunk.
    lead_steps : int
        Steps of rest that are known beyond the end.
    source : str
        Where the motion comes from, for people to read.

    Attributes
    ----------
    samples : ndarray
        Shape (N, n), read-only.
    known : ndarray
        The samples and then the rest, shape (N + lead_steps, n), read-only.
    steps : int
        N, the tail of free vibration included.
    chunk_steps : int
        Steps to a chunk; the last may have less.
    chunks : int
        Number of chunks of what is known.
    """

    def __init__(
        self,
        samples: npt.ArrayLike,
        timebase: Timebase,
        chunk_steps: int,
        lead_steps: int = 0,
        source: str = "",
    ) -> None:
        given = np.asarray(samples, dtype=np.float64)
        if given.ndim != 2 or not given.size:
            raise ValueError(f"samples must have shape (N, n), not {given.shape}")
        if chunk_steps < 1:
            raise ValueError(f"a chunk holds at least one step, not {chunk_steps}")
        self.steps = len(given)
        self.known: npt.NDArray[np.float64] = np.zeros((self.steps + lead_steps, given.shape[1]))
        self.known[: self.steps] = given
        self.known.flags.writeable = False
        self.samples = self.known[: self.steps]
        self.timebase = timebase
        self.chunk_steps = chunk_steps
        self.chunks = -(-len(self.known) // chunk_steps)
        self.source = source

    @classmethod
    def from_parameters(
        cls, section: Section, axes: Sequence[str], timebase: Timebase
    ) -> "GroundMotion":
        """Read or make the motion that an experiment asks for.

        Parameters
        ----------
        section : dict
            Values of every parameter in `seft_ros.ground_motion.parameters.TABLE`.
        axes : sequence of str
            Axis names; n of them.
        timebase : Timebase
            Of the loop.

        Raises
        ------
        InputError
            If the file can't be read as a record, or parameters contradict each other.
        """
        n = len(axes)
        influence = per_axis(section["influence"], axes, "ground_motion: influence")
        record = _recorded(section, axes) if section["file"] else _synthetic(section, n)
        samples = resample(
            record.accelerations, record.dt, timebase, section["time_scale"], section["tail"]
        )
        with np.errstate(over="ignore", invalid="ignore"):
            samples *= influence
            if section["peak_force"]:
                mass = mass_matrix(section["mass"], axes, "ground_motion: mass (for peak_force)")
                samples *= force_scale(samples, mass, section["peak_force"])
        if not np.isfinite(samples).all():
            raise InputError(
                f"ground_motion: {record.source}: accelerations beyond all numbers; check its "
                "values, influence and peak_force"
            )
        lead_steps = max(1, round(section["lead"] * timebase.rate))
        chunk_steps = max(1, round(lead_steps / _CHUNKS_PER_LEAD))
        return cls(samples, timebase, min(chunk_steps, len(samples)), lead_steps, record.source)

    def chunk(self, index: int) -> tuple[int, npt.NDArray[np.float64]]:
        """One of the pieces the motion is published in.

        Parameters
        ----------
        index : int
            From 0 to ``chunks - 1``.

        Returns
        -------
        first_step : int
            Step of the first sample.
        values : ndarray
            Shape (p, n), m/s^2, read-only; p is `chunk_steps`, in the last chunk maybe less.
        """
        if not 0 <= index < self.chunks:
            raise IndexError(f"there is no chunk {index}; the motion has {self.chunks}")
        first = index * self.chunk_steps
        return first, self.known[first : first + self.chunk_steps]


def _recorded(section: Section, axes: Sequence[str]) -> RecordedMotion:
    columns = per_axis(section["column"], axes, "ground_motion: column")
    return read_record(section["file"], [int(c) for c in columns], section["unit"], section["dt"])


def _synthetic(section: Section, n: int) -> RecordedMotion:
    """One synthetic motion, the same on every axis."""
    values = group(section, "synthetic")
    check_size(values["duration"], 1 / values["dt"], "synthetic.duration, synthetic.dt")
    motion = synthetic_motion(**values)
    source = f"synthetic, seed {values['seed']}"
    return RecordedMotion(np.repeat(motion[:, np.newaxis], n, axis=1), values["dt"], source)
