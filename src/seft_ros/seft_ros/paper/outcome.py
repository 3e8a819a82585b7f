"""One simulated test of the paper: its signals, and what the paper judges in them by eye."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.signal
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire.outcome import Trip
from seft_msgs_py.wire.topics import GROUND_MOTION, RIG_STATE

from seft_ros.analysis.metrics import Agreement, agreement
from seft_ros.analysis.summary import COMPARED, reference_of
from seft_ros.design.loop_margins import BAND_HZ
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate

Floats = npt.NDArray[np.float64]

VIBRATION_HZ = BAND_HZ
"""Vibration is what lies above, Hz: up to here the paper controls force (section 3.2), and the
structures of the paper, at 10 Hz and less, do not answer there."""

_SEGMENT = 2.0  # s of Welch's segments: 0.5 Hz
_AROUND = (0.7, 1.3)  # of a natural frequency
_MOVED = 0.05  # of the largest power in the band: below, a phase says nothing
_ORDER = 4


class Vibration(NamedTuple):
    """What of a signal lies above `VIBRATION_HZ`.

    Level in the signal's unit, share of the signal's energy (0 to 1), and the frequency at which
    it is strongest.
    """

    rms: float
    share: float
    peak_hz: float


@dataclass(frozen=True)
class Outcome:
    """Signals of a test up to its end or trip, and its exact response.

    Attributes
    ----------
    dt : float
        Sampling period, s.
    measured, exact : dict
        displacement (m), acceleration (m/s^2), force (N) -> shape (N,).
    trip : Trip or None
        Where a limit ended it.
    saturated : tuple of str
        What was at the end of its range, as the rig names it.
    input_peak : float
        Largest |m a_g|, N.
    """

    dt: float
    measured: dict[str, Floats]
    exact: dict[str, Floats]
    trip: Trip | None = None
    saturated: tuple[str, ...] = ()
    input_peak: float = 0.0

    @property
    def stable(self) -> bool:
        """Whether it ran to its end."""
        return self.trip is None and all(np.isfinite(y).all() for y in self.measured.values())

    @cached_property
    def time(self) -> Floats:
        """Shape (N,), s."""
        return self.dt * np.arange(len(self.measured["displacement"]), dtype=np.float64)

    def agreement(
        self, name: str, reference: "Outcome | None" = None, *, controlled: bool = False
    ) -> Agreement:
        """Hold a quantity against its exact response, or against another test of the motion.

        A test that ended early agrees over what there is of it; ``controlled``: below the
        vibration, where force is controlled.
        """
        y = self.measured[name]
        other = self.exact[name] if reference is None else reference.measured[name]
        count = min(len(y), len(other))
        y, other = y[:count], other[:count]
        if controlled:
            y, other = (without_vibration(part, 1.0 / self.dt) for part in (y, other))
        return agreement(y, other, self.dt)

    def vibrations(self, name: str) -> tuple[Vibration, Vibration]:
        """Find the vibration of a quantity as measured, and of its exact response."""
        rate = 1.0 / self.dt
        return vibration(self.measured[name], rate), vibration(self.exact[name], rate)


def run_test(experiment: Experiment) -> Outcome:
    """Run a test offline, on the first axis."""
    record = simulate(experiment, build_blocks(experiment))
    reference = reference_of(record)
    assert reference is not None
    states = record.series[RIG_STATE.name].values
    mass = float(np.atleast_1d(experiment["reference_force"]["model.mass"])[0])
    motion = record.series[GROUND_MOTION.name].values
    return Outcome(
        experiment.timebase.dt,
        {name: states[:, row, 0] for name, row in COMPARED.items()},
        {name: getattr(reference, name)[:, 0] for name in COMPARED},
        record.trip,
        tuple(sorted(record.saturation.samples)),
        mass * float(np.abs(motion).max()),
    )


def vibration(y: Floats, rate: float) -> Vibration:
    """Find the high-frequency vibration of a signal, shape (N,), by Welch's method."""
    segment = min(len(y), int(_SEGMENT * rate))
    f, density = scipy.signal.welch(y, rate, nperseg=segment)
    high = f > VIBRATION_HZ
    energy, total = float(density[high].sum()), float(density.sum())
    return Vibration(
        rms=float(np.sqrt(energy * rate / segment)),
        share=energy / total if total > 0 else float("nan"),
        peak_hz=float(f[high][density[high].argmax()]) if high.any() else float("nan"),
    )


def without_vibration(y: Floats, rate: float) -> Floats:
    """Keep what lies below `VIBRATION_HZ`, without shifting it; shape (N,) as given."""
    low_pass = scipy.signal.butter(_ORDER, VIBRATION_HZ, fs=rate, output="sos")
    edge = min(6 * _ORDER, len(y) - 1)  # what a test that tripped at once has room for
    kept: Floats = scipy.signal.sosfiltfilt(low_pass, y, padlen=edge)
    return kept


def magnitude_and_phase(
    y: Floats, reference: Floats, rate: float, natural_hz: float, delay: float
) -> tuple[float, float]:
    """Compare a response with its reference from 0.7 to 1.3 times a natural frequency.

    Parameters
    ----------
    y, reference : ndarray
        Shape (N,).
    rate, natural_hz : float
        Of sampling, and of the whole structure, Hz.
    delay : float
        Taken out of y first, s.

    Returns
    -------
    magnitude : float
        |y / reference| over the band.
    phase : float
        Largest phase between them in the band, either way, degrees. Both are NaN where the
        signals are too short to tell.
    """
    segment = min(len(y), int(_SEGMENT * rate))
    f, cross = scipy.signal.csd(reference, y, rate, nperseg=segment)
    _, power = scipy.signal.welch(reference, rate, nperseg=segment)
    band = (f > _AROUND[0] * natural_hz) & (f < _AROUND[1] * natural_hz)
    if not band.any() or not power[band].max() > 0:  # a test that tripped at once
        return float("nan"), float("nan")
    found = cross[band] * np.exp(2j * np.pi * f[band] * delay)
    magnitude = float(abs(found.sum()) / power[band].sum())
    moved = power[band] >= _MOVED * power[band].max()
    return magnitude, float(np.abs(np.angle(found[moved], deg=True)).max())


def explained(simulation: Outcome, rig: Outcome) -> float:
    """Share of the rig's error energy in displacement that a simulation has too, at most 1."""
    count = min(len(simulation.time), len(rig.time))
    y, x, exact = (
        part["displacement"][:count] for part in (rig.measured, simulation.measured, rig.exact)
    )
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return float(1.0 - np.sum((y - x) ** 2) / np.sum((y - exact) ** 2))
