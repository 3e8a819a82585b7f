"""Excitations for identification: band-limited, seeded, from rest to rest; as ground motions."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_plant_sim.rig import Rig

from seft_ros.force_controller.methods import force_control
from seft_ros.ground_motion.resample import check_size
from seft_ros.identification.rig_tests import TAIL, ground_accelerations, has_force_loop
from seft_ros.reference_force.reference_force_block import ReferenceForce

Floats = npt.NDArray[np.float64]

SIGNALS = ("random", "chirp")
_EDGE = 1.25  # beyond the band the spectrum falls to zero within this factor
_RAMP = 0.02  # of the duration, at either end
_LONGEST_RAMP = 2.0  # s
_FEWEST_PERIODS = 4  # of the band's lowest frequency


def excitation(
    signal: str, steps: int, axes: int, dt: float, band: tuple[float, float], seed: int
) -> Floats:
    """Make an excitation of unit RMS on every axis.

    Below its band it has next to nothing, so that a valve, which integrates to displacement,
    does not let the piston drift.

    Parameters
    ----------
    signal : str
        ``random``: Gaussian noise with a flat spectrum, independent on each axis, by ``seed``;
        ``chirp``: one logarithmic sweep up for each axis, one axis after the other.
    steps, axes : int
        N and n.
    dt : float
        Sampling period, s.
    band : tuple of float
        Lowest and highest frequency, Hz.

    Returns
    -------
    ndarray
        Shape (N, n), first and last sample zero, mean zero.

    Raises
    ------
    InputError
        If the signal is unknown, or the band does not fit rate and duration.
    """
    if signal not in SIGNALS:
        raise InputError(f"--signal is {signal}, but must be one of {', '.join(SIGNALS)}")
    low, high = band
    if not 0 < low < high < 0.5 / dt:
        raise InputError(
            f"--band is {low:g} to {high:g} Hz, but must rise, and lie within 0 and half the "
            f"rate, {0.5 / dt:g} Hz"
        )
    shortest = shortest_duration(signal, axes, band)
    if steps * dt < shortest - dt:
        raise InputError(
            f"--duration is {steps * dt:g} s, but a {signal} signal from {low:g} Hz on needs "
            f"{shortest:g} s; raise it, or the band's lower end"
        )
    if signal == "random":
        raw = _random(steps, axes, dt, band, seed)
    else:
        raw = _sweeps(steps, axes, dt, band)
    window = np.hanning(steps)[:, np.newaxis]
    centred = raw - window * (raw.mean(axis=0) / window.mean())  # the ends still at rest
    unit: Floats = centred / np.sqrt(np.mean(centred**2, axis=0))
    return unit


def shortest_duration(signal: str, axes: int, band: tuple[float, float]) -> float:
    """Shortest duration of an excitation that its band makes sense for, s."""
    return _FEWEST_PERIODS / band[0] * (axes if signal == "chirp" else 1)


def write_excitation(path: Path, accelerations: Floats, axes: Sequence[str]) -> None:
    """Write ground accelerations (N, n) in m/s^2 as a record that ground_motion reads exactly.

    The folder is made if need be. An InputError says if it can't be written.
    """
    rows = [",".join(map(repr, row)) for row in accelerations.tolist()]
    names = ",".join(f"axis {index + 1} (m/s2)" for index in range(len(axes)))
    place = path.parent
    try:
        place.mkdir(parents=True, exist_ok=True)
        place = path
        path.write_text("\n".join([f"# {names}", *rows, ""]), encoding="utf-8")
    except OSError as error:
        raise InputError(f"{place}: {error.strerror or error}") from None


@dataclass(frozen=True)
class Motions:
    """Ground motions of any duration for the tests of one identification.

    Attributes
    ----------
    experiment : Experiment
        What is identified.
    force : float
        RMS of the reference force, N.
    signal, band, seed : str, tuple of float, int
        As `excitation` takes them.
    """

    experiment: Experiment
    force: float
    signal: str
    band: tuple[float, float]
    seed: int

    @property
    def shortest(self) -> float:
        """Shortest duration that the band makes sense for, s."""
        return shortest_duration(self.signal, len(self.experiment.axes), self.band)

    def check(self, duration: float) -> None:
        """See by an InputError that tests can be made, before anything is written or moves."""
        self._unit(duration)
        sections = self.experiment.sections
        made = self.experiment.axes, self.experiment.timebase
        ReferenceForce.from_parameters(sections["reference_force"], *made)
        if has_force_loop(self.experiment):
            force_control(sections["force_controller"], *made)
        if "rig" in sections:
            Rig.from_parameters(sections["rig"], *made)

    def write(self, path: Path, duration: float) -> Path:
        """Write the motion of a test as a record, see `write_excitation`."""
        accelerations = ground_accelerations(self.experiment, self.force * self._unit(duration))
        write_excitation(path, accelerations, self.experiment.axes)
        return path

    def steps(self, duration: float) -> int:
        """Count the steps of a test with such a motion."""
        return round((duration + TAIL) * self.experiment.timebase.rate)

    def _unit(self, duration: float) -> Floats:
        time, axes = self.experiment.timebase, len(self.experiment.axes)
        check_size(duration, time.rate, "--duration")
        steps = round(duration * time.rate)
        return excitation(self.signal, steps, axes, time.dt, self.band, self.seed)


def _random(steps: int, axes: int, dt: float, band: tuple[float, float], seed: int) -> Floats:
    frequencies, (low, high) = np.fft.rfftfreq(steps, dt), band
    upper = min(high * _EDGE, 0.5 / dt)
    passed = _rise(frequencies, low / _EDGE, low) * (1.0 - _rise(frequencies, high, upper))
    columns = []
    for axis in range(axes):
        white = np.random.default_rng([seed, axis]).standard_normal(steps)
        columns.append(np.fft.irfft(np.fft.rfft(white) * passed, steps))
    return np.stack(columns, axis=1) * _ramp(steps, dt)[:, np.newaxis]


def _sweeps(steps: int, axes: int, dt: float, band: tuple[float, float]) -> Floats:
    low, high = band
    raw = np.zeros((steps, axes))
    length = steps // axes
    duration = length * dt
    time = dt * np.arange(length)
    growth = np.log(high / low)
    phase = 2 * np.pi * low * duration / growth * np.expm1(growth * time / duration)
    for axis in range(axes):
        raw[axis * length : (axis + 1) * length, axis] = np.sin(phase) * _ramp(length, dt)
    return raw


def _ramp(steps: int, dt: float) -> Floats:
    """One, with half a cosine from zero at the start and to zero at the end."""
    length = min(_RAMP * steps * dt, _LONGEST_RAMP)
    distance = dt * np.minimum(np.arange(steps), np.arange(steps)[::-1])
    return _rise(distance, 0.0, length)


def _rise(x: Floats, start: float, end: float) -> Floats:
    """Half a cosine from zero at ``start`` to one at ``end``."""
    return 0.5 - 0.5 * np.cos(np.pi * np.clip((x - start) / (end - start), 0.0, 1.0))
