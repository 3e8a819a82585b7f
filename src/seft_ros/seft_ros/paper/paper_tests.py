"""The tests that reproduce the paper: each a change of one experiment, and its outcome."""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy.signal
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.outcome import Trip
from seft_msgs_py.wire.topics import GROUND_MOTION, RIG_STATE

import seft_ros
from seft_ros.analysis.metrics import Agreement, agreement
from seft_ros.analysis.summary import COMPARED, reference_of
from seft_ros.design.loop_margins import BAND_HZ
from seft_ros.design.rig_tests import changed, has_valve
from seft_ros.reference_force.reference_force_parameters import TARGET_MOTION
from seft_ros.test_run.compiled_loop import build_blocks, with_method
from seft_ros.test_run.offline import simulate

COMPUTED = (0.5, 1.0)
"""Mass ratios at which the paper shows tests with a computed mass."""

BEYOND = (0.5, 1.0, 1.5)
"""Mass ratios of the tests beyond the paper."""

Key = tuple[str, float]
"""A kind of test and its mass ratio."""

DELAY = 0.01
"""Delay of the actuator that the paper identified and simulates with (section 5.2), s."""

BEYOND_SHARE = 0.4
"""Of the motion's amplitude, beyond the paper: what the valve can serve at a mass ratio of 1.5."""

LEAST_RATE = 200.0
"""Sampling rate that shows the vibration, at 30 to 45 Hz, Hz."""

VIBRATION_HZ = BAND_HZ
"""Frequency above which motion is vibration, Hz: up to here the paper controls force (section
3.2), and the paper's structures, at 10 Hz and less, do not respond above it."""

SEGMENT = 2.0  # s of Welch's segments: 0.5 Hz
_ORDER = 4
_CONFIG = "jhu.yaml"
_QUANTITIES = ("position", "velocity", "acceleration", "force")
_FAR = {"displacement": 1e3, "velocity": 1e3, "acceleration": 1e4, "force": 1e6}
_FAR |= {f"{name}_rate": 1e6 * value for name, value in _FAR.items()}


def default_config() -> Path:
    """Find config/jhu.yaml: in the source tree, or under share of what pip or colcon installed.

    Raises
    ------
    InputError
        If it is not there.
    """
    assert seft_ros.__file__ is not None
    package = Path(seft_ros.__file__).parent
    for place in (package, package.resolve()):  # colcon --symlink-install links to the source
        sources = place.parent / "config"
        shares = (prefix / "share" / "seft_ros" / "config" for prefix in place.parents)
        for folder in (sources, *shares):
            if (folder / _CONFIG).is_file():
                return folder / _CONFIG
    raise InputError(
        f"{_CONFIG}: the paper's rig was not installed with seft_ros; name an experiment: "
        "seft paper config/jhu.yaml"
    )


def check_rig(experiment: Experiment) -> None:
    """See that an experiment is one of the paper's kind.

    Raises
    ------
    InputError
        If parameters make no sense, the record can't be read, or the experiment has several
        axes, no valve, a low rate, or another reference force than the paper's.
    """
    if len(experiment.axes) != 1:
        raise InputError(
            f"/**: axes are [{', '.join(experiment.axes)}], but the paper's rig has one axis"
        )
    if not has_valve(experiment):
        kind = experiment["rig"]["actuator.kind"]
        raise InputError(
            f"rig: actuator.kind is {kind}, but the paper's experiment needs servo_hydraulic; its "
            "simulations with a delay are made of it"
        )
    if experiment.timebase.rate < LEAST_RATE:
        raise InputError(
            f"/**: rate is {experiment.timebase.rate:g} Hz, but the paper's vibration needs at "
            f"least {LEAST_RATE:g} Hz to be seen"
        )
    if experiment["reference_force"]["method"] != "seft":
        raise InputError("reference_force: method is eft, but the paper's experiment needs seft")
    build_blocks(uncompensated(experiment, 0.0))


def uncompensated(experiment: Experiment, mass_ratio: float) -> Experiment:
    """Test on the rig by Eq. 2.5 (paper, section 4); as there, nobody looks for instability."""
    force = {"mass_ratio": mass_ratio, "instability.ratio": 0.0}
    return changed(with_method(experiment, "none"), {"reference_force": force})


def delayed(
    experiment: Experiment, mass_ratio: float, delay: float, bandwidth_hz: float = 0.0
) -> Experiment:
    """Numerical simulation with a delayed actuator, without sensors' errors (Eq. 5.4).

    The loop adds its sampling period, the Delta t of the equation.

    Parameters
    ----------
    experiment : Experiment
        Specimen, motion and sampling.
    mass_ratio : float
        alpha.
    delay : float
        tau of the actuator at low frequency, s.
    bandwidth_hz : float
        Where its force falls off (-3 dB of a second-order Butterworth low-pass, whose own lag
        is part of ``delay``), Hz; 0: a pure delay, as Eq. 5.2 has it.
    """
    lag = math.sqrt(2) / (2 * math.pi * bandwidth_hz) if bandwidth_hz else 0.0
    rig: dict[str, Any] = {"actuator.kind": "delay", "actuator.delay": max(delay - lag, 0.0)}
    for name in _QUANTITIES:
        rig |= {f"sensors.{name}_{what}": [0.0] for what in ("noise", "bias", "range")}
    # all of it is linear: a low-pass on every measured signal is one on the actuator's force
    rig |= {"sensors.adc_bits": 0, "sensors.anti_alias": bandwidth_hz}
    rig |= {f"limits.{name}": value for name, value in _FAR.items()}  # calculated, nothing breaks
    force = {"limits.force": math.inf, "limits.force_rate": math.inf}
    simulated = uncompensated(experiment, mass_ratio)
    return changed(simulated, {"rig": rig, "reference_force": force})


def model_compensated(experiment: Experiment, mass_ratio: float, delay: float) -> Experiment:
    """Simulate the pure delay with the paper's compensation for a delay in s (section 6)."""
    force = {"compensation.method": "model", "compensation.delay": delay}
    return changed(delayed(experiment, mass_ratio, DELAY), {"reference_force": force})


def whole_delay(experiment: Experiment) -> float:
    """Whole delay of the simulated loop: tau, the sampling period of Eq. 5.4, half a one held."""
    return DELAY + 1.5 * experiment.timebase.dt


def recommended(experiment: Experiment, mass_ratio: float) -> Experiment:
    """Test on the rig with the method that docs/compensation.md recommends."""
    force = {"mass_ratio": mass_ratio}
    return changed(with_method(experiment, TARGET_MOTION), {"reference_force": force})


def planned_tests(experiment: Experiment, peak_force: float) -> dict[Key, Experiment]:
    """Plan all tests that need nothing of the identification; ``peak_force`` is the motion's, N."""
    less, full = (
        changed(experiment, {"ground_motion": {"peak_force": share * peak_force}})
        for share in (BEYOND_SHARE, 1.0)
    )
    planned = {("rig", ratio): uncompensated(experiment, ratio) for ratio in (0.0, 0.5, 1.0, 1.5)}
    conventional = {"reference_force": {"method": "eft"}}  # of the specimen alone (Eq. 2.3)
    planned["eft", 0.0] = changed(uncompensated(experiment, 0.0), conventional)
    for ratio in COMPUTED:
        planned["delay", ratio] = delayed(experiment, ratio, DELAY)
        planned["model", ratio] = model_compensated(experiment, ratio, whole_delay(experiment))
        planned["model_tau", ratio] = model_compensated(experiment, ratio, DELAY)
    for ratio in BEYOND:
        planned["plain", ratio] = uncompensated(less, ratio)
        planned["target", ratio] = recommended(less, ratio)
        planned["target_full", ratio] = recommended(full, ratio)
    return planned


def simulations_within(
    experiment: Experiment, bandwidth_hz: float, own_delay: float
) -> dict[Key, Experiment]:
    """Plan simulations with the paper's and the rig's own delay (s) within a bandwidth."""
    delays = {"banded": DELAY, "own": own_delay}
    return {
        (kind, ratio): delayed(experiment, ratio, delay, bandwidth_hz)
        for ratio in COMPUTED
        for kind, delay in delays.items()
    }


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
    """Signals of a test up to its end or trip, and its reference response.

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
        """Compare a quantity with its reference response, or with another test of the motion.

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
        """Find the vibration of a quantity as measured, and of its reference response."""
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
        tuple(sorted(record.saturation)),
        mass * float(np.abs(motion).max()),
    )


def vibration(y: Floats, rate: float) -> Vibration:
    """Find the high-frequency vibration of a signal, shape (N,), by Welch's method."""
    segment = min(len(y), int(SEGMENT * rate))
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
    return scipy.signal.sosfiltfilt(low_pass, y, padlen=edge)
