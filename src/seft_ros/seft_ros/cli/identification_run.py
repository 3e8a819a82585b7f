"""The tests of an identification: run one after the other, kept, used again, and evaluated."""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import EVERY_NODE, FORCE_DRIVEN, place_of
from seft_msgs_py.config.parameter_table import Section, Value
from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.wire.outcome import BY_OPERATOR
from seft_msgs_py.wire.topics import GROUND_MOTION
from seft_plant_sim.rig_parameters import common_lag, truth
from seft_plant_sim.simulated.specimen import Specimen

from seft_ros.analysis.assessment import BAD_MISSED
from seft_ros.analysis.calibration_check import effect_of_force
from seft_ros.bags.recording import Recording
from seft_ros.bags.recording_bag import read_bag
from seft_ros.cli import shared
from seft_ros.drawing import style
from seft_ros.drawing.style import Texts
from seft_ros.identification import calibrated, identified, measured_test, rig_tests
from seft_ros.identification.identified_figure import identified_figure
from seft_ros.identification.multisine import (
    PILOT_SECONDS,
    Multisine,
    gains_after,
    multisine_drive,
    with_actuators,
)
from seft_ros.identification.response_fits import fit_specimen

PILOT, OPEN_LOOP, CLOSED_LOOP = "pilot", "open_loop", "closed_loop"
MULTISINE_PILOT, MULTISINE = "multisine_pilot", "multisine"
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
    wanted = rig_tests.ground_of(planned, forces) * planned["ground_motion"]["influence"]
    within = ground.steps < len(wanted)
    same = _alike(ground.values[within, 0], wanted[ground.steps[within]])
    return "" if same else "it had other commands"


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
        return rig_tests.write_forces(path, experiment, forces)
    try:
        known = np.loadtxt(path, delimiter=",", ndmin=2)
    except (OSError, ValueError):
        known = np.zeros((0, 0))
    if not _alike(known, rig_tests.ground_of(experiment, forces)):
        raise InputError(
            f"{path}: is of another rate, specimen.mass, --band, --seed or --duration, or none; "
            "name another folder with --out"
        )
    return path


@dataclass
class IdentificationTests:
    """Runs the tests of an identification, and keeps their recordings.

    The folder may hold recordings of before: one that is whole is used again. One that is not
    stays, and its test is recorded beside it, as ``open_loop_2``.
    """

    experiment: Experiment
    folder: Path
    over_dds: bool
    external: Sequence[str]
    excitation: Floats
    recordings: dict[str, Recording] = field(default_factory=dict)
    bags: dict[str, Path] = field(default_factory=dict)
    reused: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._largest = np.zeros((4, len(self.experiment.axes)))

    def run(self, name: str, test: Experiment, steps: int, forces: Floats | None = None) -> bool:
        """Run a test, or use it again; say whether it drove a valve, to its end.

        Its forces are those of the excitation, or are written first, shape (N, n), N.
        """
        label, played = f"{name}: ", self.excitation if forces is None else forces
        bag, recording = self._kept(name, test, steps, played)
        if recording is None:
            if forces is not None:
                rig_tests.write_forces(self.folder / f"{name}.csv", test, forces)
            recording, bag = self._record(test, bag, steps, label)
            self._look(recording)
        self.recordings[name], self.bags[name] = recording, bag
        if (recording.missed or 0) > BAD_MISSED * steps:
            shared.complain(
                f"{label}{recording.missed} of {steps} steps had no command in time: the rig moved "
                "otherwise than asked, and what it says is poor; take a lower rate, or a host that "
                "keeps this one (docs/realtime.md)"
            )
        return recording.trip is None and rig_tests.has_valve(recording.experiment)

    def _record(
        self, test: Experiment, bag: Path, steps: int, label: str
    ) -> tuple[Recording, Path]:
        if not (self.over_dds or self.external):
            return shared.offline_test(test, bag, label), bag
        try:
            recording, bag = shared.dds_test(test, bag, steps, self.external, label=label)
        except ExperimentError as error:
            raise ExperimentError(f"{error}; {', '.join(shared.STANDS)}") from None
        if recording.stopped:
            raise ExperimentError(f"{label}{BY_OPERATOR}; what was recorded is in {bag}")
        return recording, bag

    def _kept(
        self, name: str, test: Experiment, steps: int, forces: Floats
    ) -> tuple[Path, Recording | None]:
        """Find the whole recording of a test; else None, and the place of the next one."""
        for number in count(1):
            bag = self.folder / (name if number == 1 else f"{name}_{number}")
            if not bag.exists():
                return bag, None
            try:
                recording = read_bag(bag)
            except InputError as error:
                shared.complain(f"{error}; it stays, and is not used")
                continue
            self._look(recording)
            if why := why_cut_off(recording, steps):
                shared.complain(f"{bag}: {why}; it stays, and is not used")
                continue
            if other := other_test(recording, test, forces):
                mend = "name another folder with --out, or move this recording away"
                raise InputError(f"{bag}: is of another test: {other}; {mend}")
            shared.complain(f"{bag}: is used again")
            shared.stands(f"{bag} is whole")
            self.reused.append(name)
            return bag, recording
        raise AssertionError

    def _look(self, recording: Recording) -> None:
        """Note how far a test moved the specimen, with what force."""
        if recording.experiment.axes == self.experiment.axes and len(recording.states.steps):
            self._largest = np.fmax(self._largest, np.abs(recording.states.values).max(axis=0))

    def largest(self, row: int) -> dict[str, float]:
        """Largest magnitude of a quantity in any test, by axis."""
        return dict(zip(self.experiment.axes, self._largest[row].tolist(), strict=True))

    @property
    def tripped(self) -> bool:
        """Whether any test tripped."""
        return any(recording.trip for recording in self.recordings.values())


@dataclass
class Identification:
    """The tests of an identification one after the other, and what they say."""

    tests: IdentificationTests
    motions: rig_tests.Motions
    levels: rig_tests.Levels
    plan: Multisine | None
    motion: Path
    duration: float
    weighed: Sequence[float]

    def __post_init__(self) -> None:
        self._valve = False
        self._multisine: calibrated.MultisineResult | None = None
        self._notes: list[str] = []

    def drive_valves(self, by_pilot: bool) -> None:
        """Run the tests without force feedback, and the multisine test."""
        tests, motions, known = self.tests, self.motions, self.plan is None
        self._valve = rig_tests.has_valve(tests.experiment)
        if self._valve and by_pilot:
            seconds = motions.of_pilot(self.duration)
            short = tests.folder / f"{PILOT}.csv"
            test = rig_tests.open_loop(tests.experiment, short, self.levels.voltage, known)
            self._valve = tests.run(PILOT, test, motions.steps(seconds), motions.unit(seconds))
            if self._valve:
                pilot = tests.recordings[PILOT]
                most = motions.largest_levels(self.duration)
                voltage = rig_tests.voltage_after(pilot, self.levels.voltage, most)
                self.levels = replace(self.levels, voltage=voltage)
        if self._valve:
            test = rig_tests.open_loop(tests.experiment, self.motion, self.levels.voltage, known)
            self._valve = tests.run(OPEN_LOOP, test, motions.steps(self.duration))
        if self._valve and self.plan is not None:
            self._run_multisine(self.plan)

    def _run_multisine(self, plan: Multisine) -> None:
        """Run the multisine test, if the actuators were found; a pilot finds the commands."""
        tests, dt = self.tests, self.tests.experiment.timebase.dt
        opened, band = tests.recordings[OPEN_LOOP], self.motions.band
        filters = calibrated.found_filters(opened, band)
        known = calibrated.rough_calibration(opened, band, filters)
        found = identified.identify_from_recordings(known.corrected(opened), None, band)
        if not (found.valves or found.has_servos):
            return
        plan = with_actuators(plan, found, tests.experiment)
        pilot = multisine_drive(plan, found, dt, seconds=PILOT_SECONDS)
        if not self._run_multisine_test(MULTISINE_PILOT, pilot[0]):
            return
        moved = calibrated.moved_by(tests.recordings[MULTISINE_PILOT], pilot[1])
        commands, sines = multisine_drive(plan, found, dt, gains=gains_after(plan, moved))
        if not self._run_multisine_test(MULTISINE, commands):
            return
        recording = tests.recordings[MULTISINE]
        of_recording = partial(calibrated.MultisineResult.of_recording, plan, recording, sines)
        filters = calibrated.found_filters(opened, band, of_recording(found, known, filters))
        told = filters, self.weighed, calibrated.tilt_in(opened, band, filters)
        known = of_recording(found, known, *told).calibrated
        found = identified.identify_from_recordings(known.corrected(opened), None, band)
        self._multisine = of_recording(found, known, *told)

    def _run_multisine_test(self, name: str, commands: np.ndarray) -> bool:
        tests = self.tests
        test = rig_tests.multisine_test(tests.experiment, tests.folder / f"{name}.csv")
        steps = len(commands) + round(rig_tests.TAIL * tests.experiment.timebase.rate)
        return tests.run(name, test, steps, commands)

    def close_loop(self, by_default: bool) -> None:
        """Run the test with force feedback, where there is one, on channels as found."""
        tests, multisine = self.tests, self._multisine
        experiment = tests.experiment
        followed = rig_tests.has_force_loop(experiment) or not self._valve
        if not followed or tests.tripped:
            return
        if multisine is not None and tests.external and multisine.calibrated.changes:
            self._notes.append(
                "no closed-loop test: the driver has to apply calibration.* of model.yaml "
                "first; give it that file, start it again, and repeat with --params-file model.yaml"
            )
            return
        if multisine is not None and not tests.external:
            known = multisine.calibrated.parameters()
            experiment = experiment.changed({EVERY_NODE: known, "rig": truth(experiment["rig"])})
        if by_default and self._valve and self.motions.cap < math.inf:
            self.levels = replace(self.levels, force=self._force_of_specimen())
        steps = self.motions.steps(self.duration)
        test = rig_tests.closed_loop_test(experiment, self.motion, self.levels.force)
        tests.run(CLOSED_LOOP, test, steps)

    def _force_of_specimen(self) -> float:
        """RMS of the closed loop for the specimen as the open loop shows it, N."""
        opened = self._corrected(self.tests.recordings[OPEN_LOOP])
        test = measured_test.MeasuredTest(opened, self.motions.band)
        if test.incoherent():
            return self.levels.force
        found = fit_specimen([test.motion()])
        specimen = Specimen(found.mass, found.damping, found.stiffness)
        largest = self.motions.largest_levels(self.duration, specimen)
        return rig_tests.default_force(self.tests.experiment, largest)

    def _corrected(self, opened: Recording) -> Recording:
        """Take what the multisine test found, if it was run, out of the open loop."""
        return self._multisine.calibrated.corrected(opened) if self._multisine else opened

    def _identified(self) -> identified.Identified | None:
        """Evaluate the tests that ran to their end, or what a trip left of the open loop."""
        tests, band = self.tests.recordings, self.motions.band
        whole = {name: test for name, test in tests.items() if test.trip is None}
        opened = whole.get(OPEN_LOOP) if self._valve else None
        if opened is not None or CLOSED_LOOP in whole:
            opened = opened and self._corrected(opened)
            return identified.identify_from_recordings(opened, whole.get(CLOSED_LOOP), band)
        tripped = OPEN_LOOP in tests and OPEN_LOOP not in whole
        for name in (OPEN_LOOP, PILOT) if tripped else ():
            test = tests.get(name)
            part = test and measured_test.before_trip(test, band)
            if part is None:
                continue
            with suppress(ExperimentError):
                found = identified.identify_from_recordings(part, None, band)
                which = "its pilot" if part is test else "what it measured before its trip"
                self._notes.append(f"open loop: evaluated from {which}")
                return found
        return None

    def show(self, config: str, specimen: bool, as_json: bool) -> int:
        """Evaluate the tests, write and print; give the exit status."""
        tests, bags = self.tests.recordings, self.tests.bags
        folder = self.tests.folder
        files = {"folder": folder, "excitation": self.motion, **bags}
        trips = {name: test.trip.reason if test.trip else None for name, test in tests.items()}
        summary: dict[str, Any] = {
            "tripped": {OPEN_LOOP: None, CLOSED_LOOP: None, **trips},
            "excitation_rms": asdict(self.levels),
            "reused": self.tests.reused,
            "moved_m": (moved := self.tests.largest(0)),
            "largest_force_n": (forces := self.tests.largest(3)),
        }
        texts: Texts = []
        unusable: list[str] = []
        if found := self._identified():
            unusable = found.unusable
            files |= {"model": folder / "model.yaml", "figure": folder / shared.FIGURE}
            texts, numbers = self._write(found, config, specimen, files)
            summary |= numbers
        summary["files"] = {what: str(path) for what, path in files.items()}
        each = (
            f"{1e3 * x:.3g} mm with {forces[axis]:.3g} N on axis {axis}"
            for axis, x in moved.items()
        )
        lines = [f"the tests moved the specimen by up to {', '.join(each)}"]
        lines += [f"{what + ':':13}{path}" for what, path in files.items()]
        shared.show(summary, as_json, [*texts, *lines])
        for name, test in tests.items():
            if test.trip is not None:
                at = f"{name.replace('_', ' ')} tripped at {test.trip.time_s:.3f} s"
                mend = f"the same command with --out {folder} continues"
                unusable = [f"{at}: {test.trip.reason}; its bag is in {bags[name]}; {mend}"]
                break
        for why in unusable[:1]:
            shared.complain(why)
        return 1 if unusable else 0

    def _unknown_force(self, known: Section) -> list[str]:
        """Say what an error of the load cell would cost, which no motion shows."""
        cost = effect_of_force(self.tests.experiment.changed({EVERY_NODE: known}), 1.01)
        said = f"{style.percent(cost)} of the displacement in the configured test"
        text = f"no motion shows a wrong scale of the force: 1 % of it costs {said}"
        return [] if cost is None else [f"{text}; --known-mass or --known-force tells it"]

    def _write(
        self, found: identified.Identified, config: str, specimen: bool, files: dict[str, Path]
    ) -> tuple[Texts, dict[str, Any]]:
        """Write parameters and figure; give texts and numbers."""
        summary = identified.summarise_identified(found)
        summary["notes"] += self._notes
        texts: Texts = [f"{config} as identified", identified.identified_table(summary)]
        loop, multisine = self.tests.experiment["reference_force"], self._multisine
        dt = self.tests.experiment.timebase.dt
        lag, more = common_lag(loop), {}
        if multisine is not None:
            lag, more = multisine.calibrated.common_lag, multisine.facts()
            summary["multisine"] = multisine.numbers(found.axes)
            summary["notes"] += calibrated.multisine_notes(multisine, found.axes)
            if not multisine.force_scale_error.any():
                summary["notes"] += self._unknown_force(more)
            texts.append(calibrated.multisine_table(multisine, found.axes))
        texts += summary["notes"]
        obeys_force = loop["actuator.kind"] in FORCE_DRIVEN
        known = identified.facts_of(found, specimen, dt, lag, obeys_force) | more
        identified.write_model(found, files["model"], config, known)
        style.save_figure(identified_figure(found, f"seft identify {config}"), files["figure"])
        return texts, summary
