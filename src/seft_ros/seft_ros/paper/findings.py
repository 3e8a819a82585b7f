"""All calculations behind the claims, in parallel."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError

from seft_ros.bags.record import Record
from seft_ros.design import Source, rig_tests
from seft_ros.design.controller import Controller
from seft_ros.design.identified import ClosedLoop, Identified, ValveResponse, identify
from seft_ros.design.plan import Plan
from seft_ros.ground_motion.ground_motion_block import GroundMotion
from seft_ros.paper.paper_tests import (
    BEYOND,
    COMPUTED,
    Key,
    Outcome,
    planned_tests,
    run_test,
    simulations_within,
    uncompensated,
)
from seft_ros.study.workers import parallel_map
from seft_ros.test_run.compiled_loop import build_blocks
from seft_ros.test_run.offline import simulate

Progress = Callable[[str, int], None]

CALCULATIONS = 1 + 5 + 3 * len(COMPUTED) + 3 * len(BEYOND) + 2 * len(COMPUTED)
"""Identification, tests on the rig, with the delay and with compensation, beyond the paper, and
with the delay within the identified bandwidth: what `find` counts to."""

DURATION = 120.0
"""Of each test that identifies the rig, as `seft identify` takes it, s."""

_BAND = (0.3, 200.0)  # Hz
_SEED = 1


@dataclass(frozen=True)
class Findings:
    """Everything that was calculated.

    Attributes
    ----------
    experiment : Experiment
        The rig, uncompensated, under the motion that was used.
    source : str
        Where the motion comes from.
    peak_force : float
        Largest |m a_g|, N.
    identified : Identified
        The rig by spectral identification.
    tests : dict
        ``rig``, ``eft``, ``delay`` (pure, the paper's), ``banded`` (the same within the force
        loop's bandwidth), ``own`` (that with the rig's own delay), ``model`` and ``model_tau``
        (compensated for the whole delay and for tau alone), ``plain``, ``target`` and
        ``target_full`` (beyond the paper), each with its mass ratio.
    plans : dict
        Closed loops of the tests ``rig``, ``delay`` and ``banded``, for their eigenvalues.
    """

    experiment: Experiment
    source: str
    peak_force: float
    identified: Identified
    tests: dict[Key, Outcome]
    plans: dict[Key, Plan]

    @property
    def valve(self) -> ValveResponse:
        """Valve to force, and the force loop of its model with the experiment's controller."""
        return self.identified.valves[0]

    @property
    def closed(self) -> ClosedLoop:
        """Reference force to force."""
        return self.identified.closed_loops[0]

    @property
    def zero_hz(self) -> float:
        """Zero of the model's plant; NaN if it has none."""
        root = self.valve.loop.plant.antiresonance()
        return root.hz if root else float("nan")

    @property
    def pole_hz(self) -> float:
        """Oil column of the model's plant; NaN if it has none."""
        root = self.valve.loop.plant.oil_column()
        return root.hz if root else float("nan")

    @property
    def natural_hz(self) -> float:
        """Natural frequency of the specimen, by its own motion."""
        return self.identified.specimen.axis_root(0).hz

    @property
    def own_delay(self) -> float:
        """Identified delay from reference force to measured force, s; NaN if there is none."""
        found = self.closed.tracking.delay_s
        return float("nan") if found is None else found


def find(experiment: Experiment, workers: int, progress: Progress) -> Findings:
    """Calculate everything.

    Parameters
    ----------
    experiment : Experiment
        One that `seft_ros.paper.paper_tests.check_rig` accepts.
    workers : int
        Number of processes; the results do not depend on it.
    progress : callable
        Called with a few words and how much is done, up to `CALCULATIONS`.

    Raises
    ------
    InputError
        If the motion can't be read, or parameters make no sense.
    ExperimentError
        If a test could not be calculated.
    """
    motion = GroundMotion.from_parameters(
        experiment["ground_motion"], experiment.axes, experiment.timebase
    )
    mass = float(np.atleast_1d(experiment["reference_force"]["model.mass"])[0])
    peak_force = mass * float(np.abs(motion.samples).max())
    planned = planned_tests(experiment, peak_force)
    tests: dict[Key, Outcome] = {}

    with parallel_map(workers) as map_:

        def run(plans: Mapping[Key, Experiment], before: int) -> None:
            keys = list(plans)
            for place, test in map_(run_test, plans.values()):
                key = keys[place]
                tests[key] = test
                progress(f"{key[0]} test, mass ratio {key[1]:g}", before + len(tests))

        progress("identification, and tests", 0)
        identifying = map_(identify_rig, [experiment])  # first: it takes longest
        run(planned, 0)
        ((_, identified),) = identifying
        progress("identification", len(tests) + 1)
        tracking = identified.closed_loops[0].tracking
        # what was identified, from f_r of a step to f of the same, has the sampling period in it
        own = max((tracking.delay_s or 0.0) - experiment.timebase.dt, 0.0)
        within = simulations_within(experiment, tracking.bandwidth_hz or 0.0, own)
        planned |= within
        run(within, 1)
    plans = {
        key: Plan(test, Source.RIG)
        for key, test in planned.items()
        if key[0] in ("rig", "delay", "banded")
    }
    plain = uncompensated(experiment, 0.0)
    return Findings(plain, motion.facts["source"], peak_force, identified, tests, plans)


def identify_rig(experiment: Experiment) -> Identified:
    """Drive the simulated rig by noise, valve and closed loop, and fit what it answers.

    Raises
    ------
    ExperimentError
        If a test trips, or shows nothing but noise.
    """
    controller = Controller.from_parameters(experiment["force_controller"])
    band = (_BAND[0], min(0.45 * experiment.timebase.rate, _BAND[1]))
    voltage = rig_tests.pilot_voltage(experiment)
    force = rig_tests.default_force(experiment, "random")
    motions = rig_tests.Motions(experiment, force, "random", band, _SEED)
    with TemporaryDirectory() as folder:
        short = motions.write(Path(folder) / "pilot.csv", rig_tests.PILOT_DURATION)
        levels = rig_tests.Levels(voltage, force)
        pilot = _identification(rig_tests.open_loop(experiment, short, levels), "pilot")
        levels = rig_tests.Levels(rig_tests.voltage_after(pilot, voltage), force)
        motion = motions.write(Path(folder) / "excitation.csv", DURATION)
        opened = _identification(rig_tests.open_loop(experiment, motion, levels), "open loop")
        closed = _identification(rig_tests.closed_loop(experiment, motion), "closed loop")
    found = identify(opened, closed, band, controller)
    if found.unusable:
        raise ExperimentError(f"identification: {found.unusable[0]}")
    return found


def _identification(experiment: Experiment, name: str) -> Record:
    record = simulate(experiment, build_blocks(experiment))
    if record.trip is not None:
        raise ExperimentError(
            f"identification, {name}: tripped at {record.trip.time_s:.3f} s: {record.trip.reason}"
        )
    return record
