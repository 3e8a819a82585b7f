"""The experiment in one process, without ROS: the same blocks, called in turn.

If all of them are compiled, so is the loop over the steps where that pays: of an ensemble, of many
steps, and where its code is on the disk. Tests of an ensemble with equal ground motion, reference
force or force controller share these.
"""

import os
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterator
from functools import cached_property
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire import topics
from seft_msgs_py.wire.outcome import Trip
from seft_msgs_py.wire.topics import Timebase
from seft_plant_sim.command import KEPT_STOPS, stop_period
from seft_plant_sim.rig import Rig
from seft_plant_sim.simulated.sensors import BLOCK
from seft_plant_sim.whole_structure import ReferenceResponse, reference_response

from seft_ros.bags import recording
from seft_ros.bags.recording import Estimates, Recording, Series, require_names
from seft_ros.force_controller.interlock import Interlock, Interlocks
from seft_ros.reference_force.reference_force_block import sampling_period
from seft_ros.test_run.blocks import Blocks, build_blocks
from seft_ros.test_run.compiled_loop import LoopSamples, is_compiled, run_compiled, why_not_compiled
from seft_ros.test_run.state_machine import while_ramping_down

PLAIN_STEPS = 500_000
"""Steps that the plain loop runs in about the time of a compilation of the loop (10 s)."""
_BYTES = 460
"""Of a step of each axis in a test and its summary, measured."""
_run_so_far: Counter[Hashable] = Counter()
"""Steps of this process, by the kind of loop."""


def _check_memory(steps: int, axes: int) -> None:
    """Refuse a test that this machine has no memory for, before it is taken."""
    there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if (needed := _BYTES * steps * axes) > there:
        has = f"this machine has {there / 1e9:.1f} GB; check rate and duration"
        need = f"{steps} steps of {axes} axes need some {needed / 1e9:.1f} GB"
        raise InputError(f"{need}, and {has}")


def simulate_test(
    experiment: Experiment,
    blocks: Blocks,
    progress: Callable[[int], None] | None = None,
    environment: dict[str, Any] | None = None,
    *,
    compiles: bool = False,
) -> Recording:
    """Run a test offline.

    Parameters
    ----------
    experiment : Experiment
        Its resolved configuration.
    blocks : Blocks
        Made of it by `build_blocks`.
    progress : callable, optional
        Called at intervals with the number of steps done.
    environment : dict, optional
        Of the recording; default that of this process.
    compiles : bool
        Whether the loop is compiled at once, if it can be; default only when this process has more
        than `PLAIN_STEPS` of its kind to run, or its code is on the disk. The steps are compiled in
        any case.

    Returns
    -------
    Record
        Bit for bit that of nodes over DDS if no command is missed.

    Raises
    ------
    InputError
        If this machine has not the memory for it and its summary.
    """
    motion, force = blocks.ground_motion.samples, blocks.reference_force
    (total, axes), quantities = motion.shape, force.reference_force.shape[1]
    _check_memory(total, axes)
    force.reset()
    blocks.force_controller.reset()
    estimated = force.estimates()
    period = sampling_period(experiment.timebase, force.reference_force.is_modelled)
    samples = LoopSamples(
        np.empty((total, len(topics.RIG_STATE.quantities), axes)),
        np.empty((total, len(topics.MEASURED.quantities), axes)),
        np.empty((total, quantities, axes)),
        np.empty((total, axes)),
        np.empty(total, dtype=np.int64),
        np.empty(total),
        np.empty((-(-total // period), len(estimated), axes)),
    )
    environment = environment or recording.describe_environment("simulate")
    parts = blocks, samples, experiment["reference_force"]["loop_delay"], period
    runs = run_compiled if _compiles(*parts, compiles) else run_plain
    loop = runs(*parts)
    steps, start = next(loop), time.perf_counter()
    for steps in loop:
        if progress is not None:
            progress(steps)
    wall = time.perf_counter() - start
    violation = blocks.rig.violation or blocks.force_controller.reason  # as `hard_trip` chooses
    ramped = steps - force.ramp.taken
    trip = _trip_of(violation, force.cause, steps - 1, ramped, experiment.timebase)
    begun = ramped if force.cause else steps - 1
    rig: Any = blocks.rig
    stop: tuple[Any, ...] = ()
    if violation and rig.drive == topics.VALVE_COMMAND.name:
        trusted, last = rig.trusted if rig.violation else steps - 1, steps - 1
        stop = _stop_of(trusted, last, experiment.timebase.dt, runs, *parts)
    rig.stop(*stop)
    estimates = None
    if estimated:
        sampled = np.arange(0, steps, period, dtype=np.int64)
        estimates = Estimates(sampled, samples.estimates[: len(sampled)], tuple(estimated))
    return Recording(
        experiment=experiment,
        series=loop_series(motion, samples, steps),
        estimates=estimates,
        trip=trip,
        saturation=blocks.rig.saturation,
        simulated=blocks.rig.simulated(begun),
        wall_s=wall,
        environment=environment,
    )


def _stop_of(
    trusted: int,
    last: int,
    dt: float,
    runs: Callable[..., Iterator[int]],
    blocks: Blocks,
    samples: LoopSamples,
    *known: int,
) -> tuple[Any, ...]:
    """Give the stop after a trusted step, from the last step on, as arguments of the rig's `stop`.

    With a later step than that, it is the fallback stop that the rig has kept: the test runs up to
    there, and to its end, once more.
    """
    interlock: Any = blocks.force_controller
    every, at = stop_period(dt), last
    if trusted < last:
        at = trusted // every * every
        if trusted < 0 or at <= ((last - 1) // every - KEPT_STOPS) * every:
            return ()

    def run(steps: int) -> None:
        blocks.reference_force.reset()
        interlock.reset()
        of_these: Any = (each[:steps] for each in samples)
        deque(runs(blocks, LoopSamples(*of_these), *known), maxlen=0)

    if at < last:
        run(at + 1)
    stops, age = interlock.stop(at), last - at
    if at < last:
        run(last + 1)
    of_all = stops if isinstance(interlock, Interlocks) else [stops]
    plans = [(each[age:], each[age - 1] if 0 < age <= len(each) else None) for each in of_all]
    return tuple(plans if isinstance(interlock, Interlocks) else plans[0])


def _compiles(
    blocks: Blocks, samples: LoopSamples, loop_delay: int, period: int, at_once: bool
) -> bool:
    """Say whether a test is run in the compiled loop."""
    if why_not_compiled(blocks):
        return False
    rig, interlock = blocks.rig, blocks.force_controller
    assert isinstance(rig, Rig) and isinstance(interlock, Interlock)
    total, axes = samples.commands.shape
    kind = rig.kind, blocks.reference_force.kind, interlock.kind, axes
    _run_so_far[kind] += total
    pays = at_once or _run_so_far[kind] > PLAIN_STEPS
    return pays or is_compiled(blocks, samples, loop_delay, period)


def run_plain(blocks: Blocks, samples: LoopSamples, loop_delay: int, period: int) -> Iterator[int]:
    """Run a test as `run_compiled` does, with any blocks."""
    rig, reference_force, interlock = blocks.rig, blocks.reference_force, blocks.force_controller
    total, axes = samples.commands.shape
    known, window = blocks.ground_motion.known, 1 + reference_force.preview
    force_step, valve_step = reference_force.step, interlock.step
    in_flight = deque([np.zeros((1 + loop_delay, 1, axes))] * loop_delay)
    valve_driven, names = rig.drive == topics.VALVE_COMMAND.name, tuple(reference_force.estimates())
    yield 0
    state = rig.reset()
    with np.errstate(over="ignore", invalid="ignore"):  # the limits see what is not finite
        for step in range(total):
            samples.states[step], samples.measured[step] = state, rig.measured
            interlock.look(step, state)
            points = force_step(known[step : step + window], state[: len(CHANNELS)])
            samples.forces[step] = points[0]
            if loop_delay:
                in_flight.append(points)
                points = in_flight.popleft()[loop_delay:]
            command = samples.commands[step] = valve_step(step, points, state)
            if step % period == 0 and samples.estimates.size:
                estimates = reference_force.estimates()
                require_names(step, estimates, names)
                samples.estimates[step // period] = list(estimates.values())
            if rig.violation is not None or interlock.reason or reference_force.ramp.finished:
                yield step + 1
                return
            if (step + 1) % BLOCK == 0:
                yield step + 1
            if step + 1 < total:
                state = rig.step(command if valve_driven else points[0, -1])
    yield total


def loop_series(motion: Floats, samples: LoopSamples, steps: int) -> dict[str, Series]:
    """Arrange the samples of the first steps of a test by topic."""
    numbers = np.arange(steps, dtype=np.int64)
    values = {
        topics.GROUND_MOTION.name: motion[:steps, np.newaxis],
        topics.RIG_STATE.name: samples.states[:steps],
        topics.MEASURED.name: samples.measured[:steps],
        topics.REFERENCE_FORCE.name: samples.forces[:steps],
        topics.VALVE_COMMAND.name: samples.commands[:steps, np.newaxis],
    }
    return {name: Series(numbers, each) for name, each in values.items()}


def _trip_of(
    violation: str | None, cause: str | None, last: int, begun: int, timebase: Timebase
) -> Trip | None:
    """Say what ended a test before the end of its record, as supervisor and rig would.

    Parameters
    ----------
    violation : str or None
        Why rig or force controller ended it at once; empty or None if not.
    cause : str or None
        Why the reference force was ramped down.
    last, begun : int
        The last step, and the one at which the ramp began.
    timebase : Timebase
        Sampling clock.
    """
    if violation:
        reason = violation if cause is None else while_ramping_down(violation, cause)
        return Trip(reason, last, timebase.stamp_ns(last) / 1e9)
    return None if cause is None else Trip(cause, begun, timebase.stamp_ns(begun) / 1e9)


class BlockCache:
    """Prepares and runs the tests of an ensemble; each thread has its own blocks."""

    def __init__(self) -> None:
        self._of_thread, self._last = threading.local(), threading.local()

    @cached_property
    def _environment(self) -> dict[str, Any]:
        return recording.describe_environment("ensemble")

    def run(self, experiment: Experiment) -> Recording:
        """Run a test, see `simulate_test`.

        Raises
        ------
        InputError
            As `build_blocks`.
        """
        blocks = self.blocks(experiment)
        vars(self._last).pop("made", None)  # a rig runs once
        return simulate_test(experiment, blocks, environment=self._environment, compiles=True)

    def why_not_compiled(self, experiment: Experiment) -> str:
        """See `seft_ros.test_run.compiled_loop.why_not_compiled`."""
        return why_not_compiled(self.blocks(experiment))

    def reference(self, experiment: Experiment) -> ReferenceResponse:
        """Calculate the exact response of a test; that of the test before if it is the same."""
        force = experiment["reference_force"].items()
        structure = {name: value for name, value in force if not name.startswith("compensation.")}
        key = [structure, experiment["rig"], experiment["ground_motion"]]
        last = vars(self._last)
        if last.get("structure") != key:
            motion = self.blocks(experiment).ground_motion.samples
            last.update(structure=key, response=reference_response(experiment, motion))
        response: ReferenceResponse = last["response"]
        return response

    def blocks(self, experiment: Experiment) -> Blocks:
        """Make the blocks of a test, or find them among those of this thread's earlier tests."""
        last = vars(self._last)
        if last.get("made", (None,))[0] is not experiment:
            last["made"] = experiment, build_blocks(experiment, vars(self._of_thread))
        blocks: Blocks = last["made"][1]
        return blocks
