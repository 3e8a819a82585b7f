"""``seft identify``: actuators and force loop of a rig; by a multisine test mass and channels."""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Optional

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import EVERY_NODE, FORCE_DRIVEN
from seft_msgs_py.config.parameter_table import Section
from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.wire.outcome import BY_OPERATOR
from seft_plant_sim.rig_parameters import as_simulated, common_lag, truth

from seft_ros.bags.recording import Recording
from seft_ros.cli import shared
from seft_ros.cli.shared import option
from seft_ros.drawing.style import Texts

if TYPE_CHECKING:
    from seft_ros.identification.calibrated import MultisineResult
    from seft_ros.identification.identified import Identified
    from seft_ros.identification.multisine import Multisine
    from seft_ros.identification.rig_tests import Levels, Motions

PILOT, OPEN_LOOP, CLOSED_LOOP = "pilot", "open_loop", "closed_loop"
MULTISINE_PILOT, MULTISINE = "multisine_pilot", "multisine"
_NOT_GIVEN = (math.nan, math.nan)


def identify(
    config: shared.Config,
    param: shared.Params = None,
    params_file: shared.Files = None,
    over_dds: Optional[bool] = option(
        None,
        "Run nodes over DDS, or simulate in one process; default by rig: hardware.",
        "--over-dds/--offline",
        show_default=False,
    ),
    external: shared.External = None,
    seed: int = option(1, "Seed of the excitation, Gaussian noise.", min=0),
    band: tuple[float, float] = option(
        _NOT_GIVEN,
        "Band of the excitation in Hz; default by the rate.",
        "LO HI",
        show_default=False,
    ),
    duration: float = option(120.0, "Duration of each test in s.", "S"),
    amplitude: Optional[float] = option(None, "RMS of the valve drive, open loop.", "V"),
    force: Optional[float] = option(None, "RMS of the reference force, closed loop.", "N"),
    out: Optional[Path] = option(
        None, "Folder of the results, new or to continue; default by the time.", "DIR"
    ),
    specimen: bool = option(False, "Multisine test: mass and channels, too.", "--specimen"),
    travel: Optional[float] = option(
        None, "Displacement of the multisine test; default by the sensors' noise.", "M"
    ),
    known_mass: Optional[list[float]] = option(
        None, "Weighed mass of the specimen; for several axes once for each.", "KG"
    ),
    known_force: tuple[float, float] = option(
        _NOT_GIVEN,
        "Load that was hung on the load cell, and what this showed then beyond rest.",
        "N N",
        show_default=False,
    ),
    max_displacement: float = option(
        math.inf, "Largest displacement; default by the limits.", "M", show_default=False
    ),
    json: shared.Json = False,
) -> int:
    """Identify a rig: its actuators, and its force loop with this specimen.

    Runs ordinary tests, with all limits, and records each. The band of the excitation is 0.3 Hz to
    0.45 times the rate, 200 Hz at most, unless --band names another.

    Open loop: the excitation drives the valves, and force_controller's feedback is off. A short
    pilot test at a low level finds the amplitude, so that the rig uses up to a fifth of its
    limits; --amplitude gives it instead. The result describes the actuators, which
    velocity_feedforward needs. It holds for any specimen.

    Multisine test, with --specimen: six sines of the same displacement, some 0.2 mm, on each axis
    for 20 s, after a pilot of 4 s. What it will reach is shown before anything moves, within half
    of all limits. It finds the mass, and scale, lag and bias of each channel, with standard errors.
    They correct the open loop's test. No motion tells a wrong scale of the force from a wrong
    mass: the result says what 1 % of it costs. --known-mass or --known-force tells it.

    Closed loop: the excitation is the reference force, where the force controller follows one. Its
    RMS is 5 m/s^2 times the mass, at most a 20th of the force limit, and peaks and changes are
    within half of the limits, unless --force gives another. The result describes the force loop
    with this specimen, which the other methods need. Rigs without a valve (actuator.kind ideal or
    delay) have this test only.

    With --max-displacement every test is planned for half of it at most, by what is known of rig
    and specimen, and by the pilots. It is the limit of the displacement, too, which ends a test
    that goes farther. The result says how far all tests moved the specimen.

    After a trip or an interruption the same command with the same --out continues: it uses the
    tests again that ran to their end, which must be of the same configuration. A tripped test
    stays, too, and model.yaml has what was found before. Smaller --force, --travel or --amplitude
    may continue after the trip of the test that they are for.

    The folder then holds the excitation, the bags, a figure, and model.yaml: what was found, as
    facts under /**, for --params-file of every command and node. With --specimen they include
    mass, damping and stiffness of the specimen, the mass's standard error, and calibration.*.

    Examples:

        seft identify config/jhu.yaml --out identified

        seft simulate config/jhu.yaml --params-file identified/model.yaml

        seft identify config/jhu.yaml --specimen --max-displacement 0.001

        seft identify config/jhu.yaml --over-dds -p rig:pace:=lockstep --json

        seft identify config/lab.yaml --external rig --duration 300
    """
    # beyond 60 lines: half are its options, half its help
    from seft_ros.identification import rig_tests
    from seft_ros.identification.kept_tests import kept_excitation
    from seft_ros.identification.multisine import plan_multisine

    if set(external or ()) - {"rig"}:
        raise InputError(
            "--external: only the rig may be external; the other nodes are set up here"
        )
    has_hung = not all(map(math.isnan, known_force))
    given = {"--known-mass": known_mass, "--known-force": has_hung, "--travel": travel is not None}
    if not specimen and any(given.values()):
        one = next(name for name, is_given in given.items() if is_given)
        raise InputError(f"{one} is that of the multisine test: give --specimen, too")
    experiment = shared.load_experiment(config, param, params_file, external)
    if known_mass and (len(known_mass) != len(experiment.axes) or not min(known_mass) > 0.0):
        raise InputError(
            f"--known-mass is {known_mass}, but must be positive, once for each of the axes "
            f"{', '.join(experiment.axes)}"
        )
    if has_hung:
        experiment = _with_force(experiment, *known_force)
    if max_displacement != math.inf:
        experiment, max_displacement = _capped(experiment, max_displacement)
    if all(map(math.isnan, band)):
        highest = 100.0 if rig_tests.obeys_displacement(experiment) else 200.0
        band = (0.3, min(0.45 * experiment.timebase.rate, highest))
    motions = rig_tests.Motions(experiment, band, seed, max_displacement)
    motions.check(duration)
    largest = motions.largest_levels(duration)
    levels = rig_tests.Levels(
        rig_tests.pilot_voltage(experiment, largest) if amplitude is None else amplitude,
        rig_tests.default_force(experiment, largest) if force is None else force,
    )
    largest.check(levels)
    folder = out or Path(datetime.now().strftime("identify_%Y-%m-%d_%H-%M-%S"))
    plan = None
    if specimen and rig_tests.has_valve(experiment):
        plan = plan_multisine(experiment, travel, max_displacement)
        shared.complain(plan.text())
    motion = folder / "excitation.csv"
    if not motion.exists():
        shared.check_out(folder)
    kept_excitation(motion, experiment, excitation := motions.unit(duration))
    shared.stands(f"the same command with --out {folder} continues, {folder} has the excitation")
    if over_dds is None:
        over_dds = as_simulated(experiment) is not experiment
    tests = _Tests(experiment, folder, over_dds, external or (), excitation)
    run = _Identification(tests, motions, levels, plan, motion, duration, known_mass or ())
    run.drive_valves(by_pilot=amplitude is None)
    run.close_loop(by_default=force is None)
    return run.show(str(config), specimen, as_json=json)


def _with_force(experiment: Experiment, load: float, shown: float) -> Experiment:
    """Correct the scale of the load cell by a load that hangs on it, and what it shows of that."""
    if len(experiment.axes) > 1:
        raise InputError(
            "--known-force is for one load cell; for several axes give /**: "
            "calibration.force_scale, what each shows over the load"
        )
    ratio = shown / load if load else math.nan
    if not 0.0 < ratio < math.inf:
        raise InputError(
            f"--known-force is {load:g} {shown:g}, but the load cell must show a load of the same "
            "sign; give calibration.force_scale: -1 if it shows a pull as a push"
        )
    from seft_plant_sim.channels import FORCE, least_noise

    section = experiment["reference_force"]
    scale = ratio * np.atleast_1d(section["calibration.force_scale"])
    error = least_noise(section, experiment.axes)[FORCE] / abs(shown)  # of one reading
    told = {"calibration.force_scale": scale, "calibration.force_scale_error": error}
    told = {name: value.tolist() for name, value in told.items()}
    return experiment.changed({EVERY_NODE: told, "rig": truth(experiment["rig"])})


def _capped(experiment: Experiment, cap: float) -> tuple[Experiment, float]:
    """Lower the limit of the displacement to a cap, m; give the smaller of both, too."""
    if not cap > 0:
        raise InputError(f"--max-displacement is {cap:g} m, but must be positive")
    cap = min(cap, experiment["supervisor"]["limits.displacement"])
    return experiment.changed({EVERY_NODE: {"limits.displacement": cap}}), cap


@dataclass
class _Tests:
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
        from seft_ros.analysis.assessment import BAD_MISSED
        from seft_ros.identification.rig_tests import has_valve, write_forces

        label = f"{name}: "
        bag, recording = self._kept(
            name, test, steps, self.excitation if forces is None else forces
        )
        if recording is None:
            if forces is not None:
                write_forces(self.folder / f"{name}.csv", test, forces)
            recording, bag = self._record(test, bag, steps, label)
            self._look(recording)
        self.recordings[name], self.bags[name] = recording, bag
        if (recording.missed or 0) > BAD_MISSED * steps:
            shared.complain(
                f"{label}{recording.missed} of {steps} steps had no command in time: the rig moved "
                "otherwise than asked, and what it says is poor; take a lower rate, or a host that "
                "keeps this one (docs/realtime.md)"
            )
        return recording.trip is None and has_valve(recording.experiment)

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
        from seft_ros.bags.recording_bag import read_bag
        from seft_ros.identification.kept_tests import other_test, why_cut_off

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
                raise InputError(
                    f"{bag}: is of another test: {other}; name another folder with --out, or "
                    "move this recording away"
                )
            shared.complain(f"{bag}: is used again")
            shared.stands(f"{bag} is whole")
            self.reused.append(name)
            return bag, recording
        raise AssertionError

    def _look(self, recording: Recording) -> None:
        """Note how far a test moved the specimen, with what force."""
        if recording.experiment.axes == self.experiment.axes and len(recording.states.steps):
            moved = np.abs(recording.states.values).max(axis=0)
            self._largest = np.fmax(self._largest, moved)

    def largest(self, row: int) -> dict[str, float]:
        """Largest magnitude of a quantity in any test, by axis."""
        return dict(zip(self.experiment.axes, self._largest[row].tolist(), strict=True))

    @property
    def tripped(self) -> bool:
        return any(recording.trip for recording in self.recordings.values())


class _Identification:
    """The tests of an identification one after the other, and what they say."""

    def __init__(
        self,
        tests: _Tests,
        motions: "Motions",
        levels: "Levels",
        plan: "Multisine | None",
        motion: Path,
        duration: float,
        weighed: Sequence[float],
    ) -> None:
        self._tests, self._motions, self._levels, self._plan = tests, motions, levels, plan
        self._motion, self._duration, self._weighed = motion, duration, weighed
        self._valve = False
        self._multisine: MultisineResult | None = None
        self._notes: list[str] = []

    def drive_valves(self, by_pilot: bool) -> None:
        """Run the tests without force feedback, and the multisine test."""
        from seft_ros.identification import rig_tests

        tests, motions, known = self._tests, self._motions, self._plan is None
        self._valve = rig_tests.has_valve(tests.experiment)
        if self._valve and by_pilot:
            seconds = motions.of_pilot(self._duration)
            short = tests.folder / f"{PILOT}.csv"
            test = rig_tests.open_loop(tests.experiment, short, self._levels.voltage, known)
            self._valve = tests.run(PILOT, test, motions.steps(seconds), motions.unit(seconds))
            if self._valve:
                pilot = tests.recordings[PILOT]
                most = motions.largest_levels(self._duration)
                voltage = rig_tests.voltage_after(pilot, self._levels.voltage, most)
                self._levels = replace(self._levels, voltage=voltage)
        if self._valve:
            test = rig_tests.open_loop(tests.experiment, self._motion, self._levels.voltage, known)
            self._valve = tests.run(OPEN_LOOP, test, motions.steps(self._duration))
        if self._valve and self._plan is not None:
            self._run_multisine(self._plan)

    def _run_multisine(self, plan: "Multisine") -> None:
        """Run the multisine test, if the actuators were found; a pilot finds the commands."""
        from seft_ros.identification import multisine
        from seft_ros.identification.calibrated import (
            MultisineResult,
            found_filters,
            moved_by,
            rough_calibration,
        )
        from seft_ros.identification.identified import identify_from_recordings

        tests, dt = self._tests, self._tests.experiment.timebase.dt
        opened, band = tests.recordings[OPEN_LOOP], self._motions.band
        filters = found_filters(opened, band)
        known = rough_calibration(opened, band, filters)
        found = identify_from_recordings(known.corrected(opened), None, band)
        if not (found.valves or found.has_servos):
            return
        plan = multisine.with_actuators(plan, found, tests.experiment)
        pilot = multisine.multisine_drive(plan, found, dt, seconds=multisine.PILOT_SECONDS)
        if not self._run_multisine_test(MULTISINE_PILOT, pilot[0]):
            return
        moved = moved_by(tests.recordings[MULTISINE_PILOT], pilot[1])
        commands, sines = multisine.multisine_drive(
            plan, found, dt, gains=multisine.gains_after(plan, moved)
        )
        if not self._run_multisine_test(MULTISINE, commands):
            return
        recording = tests.recordings[MULTISINE]
        of_recording = partial(MultisineResult.of_recording, plan, recording, sines)
        first = of_recording(found, known, filters)
        filters = found_filters(opened, band, first)
        known = of_recording(found, known, filters, self._weighed).calibrated
        found = identify_from_recordings(known.corrected(opened), None, band)
        self._multisine = of_recording(found, known, filters, self._weighed)

    def _run_multisine_test(self, name: str, commands: np.ndarray) -> bool:
        from seft_ros.identification import rig_tests

        tests = self._tests
        test = rig_tests.multisine_test(tests.experiment, tests.folder / f"{name}.csv")
        steps = len(commands) + round(rig_tests.TAIL * tests.experiment.timebase.rate)
        return tests.run(name, test, steps, commands)

    def close_loop(self, by_default: bool) -> None:
        """Run the test with force feedback, where there is one, on channels as found."""
        from seft_ros.identification import rig_tests

        tests, multisine = self._tests, self._multisine
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
            experiment = experiment.changed(
                {EVERY_NODE: multisine.calibrated.parameters(), "rig": truth(experiment["rig"])}
            )
        if by_default and self._valve and self._motions.cap < math.inf:
            self._levels = replace(self._levels, force=self._force_of_specimen())
        steps = self._motions.steps(self._duration)
        test = rig_tests.closed_loop_test(experiment, self._motion, self._levels.force)
        tests.run(CLOSED_LOOP, test, steps)

    def _force_of_specimen(self) -> float:
        """RMS of the closed loop for the specimen as the open loop shows it, N."""
        from seft_plant_sim.simulated.specimen import Specimen

        from seft_ros.identification import rig_tests
        from seft_ros.identification.response_fits import fit_specimen

        opened = self._corrected(self._tests.recordings[OPEN_LOOP])
        test = rig_tests.MeasuredTest(opened, self._motions.band)
        if test.incoherent():
            return self._levels.force
        found = fit_specimen([test.motion()])
        specimen = Specimen(found.mass, found.damping, found.stiffness)
        largest = self._motions.largest_levels(self._duration, specimen)
        return rig_tests.default_force(self._tests.experiment, largest)

    def _corrected(self, opened: Recording) -> Recording:
        """Take what the multisine test found, if it was run, out of the open loop."""
        return self._multisine.calibrated.corrected(opened) if self._multisine else opened

    def _identified(self) -> "Identified | None":
        """Evaluate the tests that ran to their end, or what a trip left of the open loop."""
        from seft_ros.identification import identified, rig_tests

        tests, band = self._tests.recordings, self._motions.band
        whole = {name: test for name, test in tests.items() if test.trip is None}
        opened = whole.get(OPEN_LOOP) if self._valve else None
        if opened is not None or CLOSED_LOOP in whole:
            opened = opened and self._corrected(opened)
            return identified.identify_from_recordings(opened, whole.get(CLOSED_LOOP), band)
        tripped = OPEN_LOOP in tests and OPEN_LOOP not in whole
        for name in (OPEN_LOOP, PILOT) if tripped else ():
            test = tests.get(name)
            part = test and rig_tests.before_trip(test, band)
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
        tests, bags = self._tests.recordings, self._tests.bags
        folder = self._tests.folder
        files = {"folder": folder, "excitation": self._motion, **bags}
        trips = {name: test.trip.reason if test.trip else None for name, test in tests.items()}
        summary: dict[str, Any] = {
            "tripped": {OPEN_LOOP: None, CLOSED_LOOP: None, **trips},
            "excitation_rms": asdict(self._levels),
            "reused": self._tests.reused,
            "moved_m": (moved := self._tests.largest(0)),
            "largest_force_n": (forces := self._tests.largest(3)),
        }
        texts: Texts = []
        unusable: list[str] = []
        if found := self._identified():
            unusable = found.unusable
            files |= {"model": folder / "model.yaml", "figure": folder / shared.FIGURE}
            texts, numbers = self._write(found, config, specimen, files)
            summary |= numbers
        summary["files"] = {what: str(path) for what, path in files.items()}
        each = [
            f"{1e3 * moved[axis]:.3g} mm with {forces[axis]:.3g} N on axis {axis}" for axis in moved
        ]
        lines = [f"the tests moved the specimen by up to {', '.join(each)}"]
        lines += [f"{what + ':':13}{path}" for what, path in files.items()]
        shared.show(summary, as_json, [*texts, *lines])
        for name, test in tests.items():
            if test.trip is not None:
                at = f"{name.replace('_', ' ')} tripped at {test.trip.time_s:.3f} s"
                shared.complain(
                    f"{at}: {test.trip.reason}; its bag is in {bags[name]}; the same command with "
                    f"--out {folder} continues"
                )
                return 1
        if unusable:
            shared.complain(unusable[0])
            return 1
        return 0

    def _unknown_force(self, known: Section) -> list[str]:
        """Say what an error of the load cell would cost, which no motion shows."""
        from seft_ros.analysis.calibration_check import effect_of_force
        from seft_ros.drawing.style import percent

        experiment = self._tests.experiment.changed({EVERY_NODE: known})
        cost = effect_of_force(experiment, 1.01)
        if cost is None:
            return []
        return [
            "no motion shows a wrong scale of the force: 1 % of it costs "
            f"{percent(cost)} of the displacement in the configured test; --known-mass or "
            "--known-force tells it"
        ]

    def _write(
        self, found: "Identified", config: str, specimen: bool, files: dict[str, Path]
    ) -> tuple[Texts, dict[str, Any]]:
        """Write parameters and figure; give texts and numbers."""
        from seft_ros.drawing.style import save_figure
        from seft_ros.identification import calibrated, identified
        from seft_ros.identification.identified_figure import identified_figure

        summary = identified.summarise_identified(found)
        summary["notes"] += self._notes
        texts: Texts = [f"{config} as identified", identified.identified_table(summary)]
        loop, multisine = self._tests.experiment["reference_force"], self._multisine
        dt = self._tests.experiment.timebase.dt
        lag, more = common_lag(loop), {}
        if multisine is not None:
            lag, more = multisine.calibrated.common_lag, multisine.facts()
            summary["multisine"] = multisine.numbers()
            summary["notes"] += calibrated.multisine_notes(multisine, found.axes)
            if not multisine.force_scale_error.any():
                summary["notes"] += self._unknown_force(more)
            texts.append(calibrated.multisine_table(multisine, found.axes))
        texts += summary["notes"]
        obeys_force = loop["actuator.kind"] in FORCE_DRIVEN
        known = identified.facts_of(found, specimen, dt, lag, obeys_force) | more
        identified.write_model(found, files["model"], config, known)
        save_figure(identified_figure(found, f"seft identify {config}"), files["figure"])
        return texts, summary
