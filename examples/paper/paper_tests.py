"""The tests that reproduce the paper: each a change of config/jhu.yaml, and its outcome."""

import math
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import scipy.signal
from force_loop import ForceLoop, close_loop, controller_of
from rich.console import Console
from rich.progress import track
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.errors import ExperimentError
from seft_msgs_py.wire.outcome import Trip
from seft_msgs_py.wire.topics import GROUND_MOTION
from seft_ros.analysis.metrics import Agreement, agreement
from seft_ros.analysis.summary import COMPARED, reference_of
from seft_ros.bags.recording import Recording
from seft_ros.design.planned_tests import PlannedTest
from seft_ros.identification import rig_tests
from seft_ros.identification.identified import Identified, identify_from_recordings
from seft_ros.identification.measured_test import BAND_HZ
from seft_ros.reference_force.compensator import OF_THE_LOOP
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test
from seft_ros.test_run.parameter_tables import TABLES

CONFIG = Path(__file__).parents[2] / "config" / "jhu.yaml"
COMPUTED = (0.5, 1.0)
"""Mass ratios at which the paper shows tests with a computed mass."""
BEYOND = (0.5, 1.0, 1.5)
"""Mass ratios of the tests beyond the paper."""
BEYOND_SHARE = 0.4
"""Of the motion's amplitude, beyond the paper: what the valve can serve at a mass ratio of 1.5."""
TAU = 0.01
"""Delay of the actuator that the paper identified and simulates with (section 5.2), s."""
DURATION, SEED = 120.0, 1
"""Of each test that identifies the rig, s."""
EXCITED_HZ = (0.3, 200.0)
ORDER = 4

Key = tuple[str, float]
"""A kind of test and its mass ratio."""
Changes = Mapping[str, Mapping[str, Any]]
"""Node -> parameter -> value."""


def planned(*changes: Changes) -> Experiment:
    """Read the paper's experiment with other values; what follows from them follows."""
    given = [(node, *item) for part in changes for node in part for item in part[node].items()]
    return Experiment.load(TABLES, [CONFIG], given)


def uncompensated(mass_ratio: float) -> Changes:
    """Test by Eq. 2.5 (paper, section 4); as there, nobody looks for instability."""
    return {"reference_force": {"mass_ratio": mass_ratio, "instability.ratio": 0.0}}


def delayed(delay: float, bandwidth_hz: float = 0.0) -> Changes:
    """Simulate with a delayed actuator, and sensors without errors (Eq. 5.4).

    The loop adds its sampling period, the Delta t of the equation. With a bandwidth in Hz the
    actuator's force falls off there (-3 dB of a second-order Butterworth low-pass, whose lag is
    part of the delay, in s); without, it is the pure delay of Eq. 5.2.
    """
    lag = math.sqrt(2) / (2 * math.pi * bandwidth_hz) if bandwidth_hz else 0.0
    known: dict[str, Any] = {"actuator.kind": "delay", "sensors.adc_bits": 0}
    true: dict[str, Any] = {"actuator.delay": max(delay - lag, 0.0)}
    for name in CHANNELS:
        known |= {f"sensors.{name}_{what}": 0.0 for what in ("noise", "range")}
        known |= {f"limits.{name}": 1e6, f"limits.{name}_rate": 1e12}  # nothing breaks
        # all of it is linear: a low-pass on every measured signal is one on the actuator's force
        true[f"sensors.{name}_filter"] = bandwidth_hz
    return {"/**": known, "rig": {f"simulated.{name}": value for name, value in true.items()}}


def compensated(mass_ratio: float, delay: float) -> Changes:
    """Simulate the pure delay with the paper's compensation (section 6).

    It is for a delay of the actuator in s, and for that of the loop.
    """
    method = {"compensation.method": "model", **uncompensated(mass_ratio)["reference_force"]}
    return {"/**": {"actuator.delay": delay}, "reference_force": method}


def recommended(mass_ratio: float, peak_force: float) -> Changes:
    """Test on the rig with the method that docs/compensation.md recommends."""
    return {
        "reference_force": {"mass_ratio": mass_ratio, "compensation.method": "target_motion"},
        "force_controller": {"method": "velocity_feedforward"},
        "ground_motion": {"peak_force": peak_force},
    }


def plan_tests(motion: Changes) -> dict[Key, Experiment]:
    """Plan all tests that need nothing of the identification."""
    rig = planned(motion)
    full, of_the_loop = rig["ground_motion"]["peak_force"], OF_THE_LOOP * rig.timebase.dt
    tests = {("rig", ratio): planned(motion, uncompensated(ratio)) for ratio in (0.0, *BEYOND)}
    conventional = {"reference_force": {"method": "eft"}}  # of the specimen alone (Eq. 2.3)
    tests["eft", 0.0] = planned(motion, uncompensated(0.0), conventional)
    for ratio in COMPUTED:
        pure = motion, delayed(TAU)
        tests["delay", ratio] = planned(*pure, uncompensated(ratio))
        tests["model", ratio] = planned(*pure, compensated(ratio, TAU))
        tests["model_tau", ratio] = planned(*pure, compensated(ratio, TAU - of_the_loop))
    for ratio in BEYOND:
        tests["target", ratio] = planned(motion, recommended(ratio, BEYOND_SHARE * full))
    return tests


def whole_delay(experiment: Experiment) -> float:
    """Whole delay of the simulated loop: tau, the sampling period of Eq. 5.4, half a one held."""
    return TAU + OF_THE_LOOP * experiment.timebase.dt


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

    @property
    def time(self) -> Floats:
        """Shape (N,), s."""
        return self.dt * np.arange(len(self.measured["displacement"]), dtype=np.float64)

    def agreement(
        self, name: str, other: "Outcome | None" = None, *, controlled: bool = False
    ) -> Agreement:
        """Compare a quantity with its reference response, or another test, over what there is.

        ``controlled``: up to `BAND_HZ` only, where force is controlled.
        """
        y, exact = self.measured[name], self.exact[name] if other is None else other.measured[name]
        count = min(len(y), len(exact))
        y, exact = y[:count], exact[:count]
        if controlled:
            low_pass = scipy.signal.butter(ORDER, BAND_HZ, fs=1.0 / self.dt, output="sos")
            edge = min(6 * ORDER, count - 1)  # what a test that tripped at once has room for
            y, exact = (scipy.signal.sosfiltfilt(low_pass, s, padlen=edge) for s in (y, exact))
        return agreement(y, exact, self.dt)


def run_test(experiment: Experiment) -> Outcome:
    """Run a test offline."""
    recording = simulate_test(experiment, build_blocks(experiment))
    reference = reference_of(recording)
    assert reference is not None
    states, motion = recording.measured.values, recording.series[GROUND_MOTION.name].values
    mass = float(np.ravel(experiment["reference_force"]["specimen.mass"])[0])
    return Outcome(
        experiment.timebase.dt,
        {name: states[:, row, 0] for name, row in COMPARED.items()},
        {name: getattr(reference, name)[:, 0] for name in COMPARED},
        recording.trip,
        tuple(sorted(recording.saturation)),
        mass * float(np.abs(motion).max()),
    )


def identify_rig(experiment: Experiment, duration: float) -> Identified:
    """Drive the rig by noise, valve and closed loop, as `seft identify` does.

    An ExperimentError says if a test trips, or shows nothing but noise.
    """
    band = EXCITED_HZ[0], min(0.45 * experiment.timebase.rate, EXCITED_HZ[1])
    motions = rig_tests.Motions(experiment, band, SEED)
    largest = motions.largest_levels(duration)
    voltage = rig_tests.pilot_voltage(experiment, largest)
    force = rig_tests.default_force(experiment, largest)
    with TemporaryDirectory() as folder:
        short = motions.write(Path(folder) / "pilot.csv", rig_tests.PILOT_DURATION)
        motion = motions.write(Path(folder) / "excitation.csv", duration)
        pilot = _identifying(rig_tests.open_loop(experiment, short, voltage))
        voltage = rig_tests.voltage_after(pilot, voltage, largest)
        opened = _identifying(rig_tests.open_loop(experiment, motion, voltage))
        closed = _identifying(rig_tests.closed_loop_test(experiment, motion, force))
    found = identify_from_recordings(opened, closed, band)
    if found.unusable:
        raise ExperimentError(f"identification: {found.unusable[0]}")
    return found


def _identifying(experiment: Experiment) -> Recording:
    recording = simulate_test(experiment, build_blocks(experiment))
    if recording.trip is not None:
        raise ExperimentError(f"identification tripped: {recording.trip.reason}")
    return recording


@dataclass(frozen=True)
class Findings:
    """Everything that was calculated.

    Attributes
    ----------
    experiment : Experiment
        The rig, uncompensated, under the motion that was used.
    source : str
        Where the motion comes from.
    identified : Identified
        The rig by spectral identification.
    tests : dict
        ``rig``, ``eft``, ``delay`` (pure, the paper's), ``banded`` (the same within the force
        loop's bandwidth), ``own`` (that with the rig's own delay), ``model`` and ``model_tau``
        (compensated for the whole delay and for tau alone), and ``target`` (beyond the paper), each
        with its mass ratio.
    plans : dict
        Closed loops of the tests ``rig`` and ``delay``, for their eigenvalues.
    """

    experiment: Experiment
    source: str
    identified: Identified
    tests: dict[Key, Outcome]
    plans: dict[Key, PlannedTest]

    @cached_property
    def loop(self) -> ForceLoop:
        """Force loop of the identified plant with the experiment's controller."""
        controller = controller_of(self.experiment)
        dt = self.experiment.timebase.dt
        return close_loop(self.identified.valves[0].plant, controller, dt)

    @property
    def natural_hz(self) -> float:
        """Natural frequency of the specimen, by its own motion."""
        specimen = self.identified.specimen
        return float(np.sqrt(specimen.stiffness[0, 0] / specimen.mass[0, 0]) / (2 * np.pi))

    @property
    def own_delay(self) -> float:
        """Identified delay from reference force to measured force, s; NaN if there is none."""
        found = self.identified.closed_loops[0].tracking.delay_s
        return math.nan if found is None else found


def find(motion: Changes, duration: float = DURATION) -> Findings:
    """Calculate everything, on all cores.

    Raises
    ------
    InputError
        If the motion can't be read, or parameters make no sense.
    ExperimentError
        If the rig can't be identified.
    """
    rig, tests = planned(motion, uncompensated(0.0)), plan_tests(motion)
    source = build_blocks(rig).ground_motion.facts["source"]
    err = Console(stderr=True)
    with ThreadPoolExecutor() as pool:
        identifying = pool.submit(identify_rig, planned(motion), duration)  # it takes longest
        done = pool.map(run_test, tests.values())
        outcomes = [*track(done, "tests", total=len(tests), console=err)]
        identified = identifying.result()
        tracking = identified.closed_loops[0].tracking
        # what was identified, from f_r of a step to f of the same, has the sampling period in it
        own = max((tracking.delay_s or 0.0) - rig.timebase.dt, 0.0)
        delays = {"banded": TAU, "own": own}
        within = {
            (kind, a): planned(motion, delayed(tau, tracking.bandwidth_hz or 0.0), uncompensated(a))
            for a, (kind, tau) in product(COMPUTED, delays.items())
        }
        outcomes += pool.map(run_test, within.values())
    plans = {k: PlannedTest(test) for k, test in tests.items() if k[0] in ("rig", "delay")}
    found = dict(zip([*tests, *within], outcomes, strict=True))
    return Findings(rig, source, identified, found, plans)
