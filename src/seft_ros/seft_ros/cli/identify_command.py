"""``seft identify``: actuators and force loop of a rig; by a multisine test mass and channels."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Optional

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import EVERY_NODE, FORCE_DRIVEN
from seft_msgs_py.errors import InputError
from seft_plant_sim.rig_parameters import common_lag, truth

from seft_ros.bags.recording import Recording
from seft_ros.cli import shared
from seft_ros.cli.shared import option
from seft_ros.drawing.table import Texts

if TYPE_CHECKING:
    from seft_ros.identification.calibrated import MultisineResult
    from seft_ros.identification.identified import Identified
    from seft_ros.identification.multisine import Multisine
    from seft_ros.identification.rig_tests import Levels, Motions

PILOT, OPEN_LOOP, CLOSED_LOOP = "pilot", "open_loop", "closed_loop"
MULTISINE_PILOT, MULTISINE = "multisine_pilot", "multisine"
_BY_RATE = (math.nan, math.nan)


def identify(
    config: shared.Config,
    param: shared.Params = None,
    params_file: shared.Files = None,
    over_dds: bool = option(False, "Run nodes over DDS, or one process.", "--over-dds/--offline"),
    external: shared.External = None,
    seed: int = option(1, "Seed of the excitation, Gaussian noise.", min=0),
    band: tuple[float, float] = option(
        _BY_RATE, "Band of the excitation in Hz; default by the rate.", "LO HI", show_default=False
    ),
    duration: float = option(120.0, "Duration of each test in s.", "S"),
    amplitude: Optional[float] = option(None, "RMS of the valve drive, open loop.", "V"),
    force: Optional[float] = option(None, "RMS of the reference force, closed loop.", "N"),
    out: Optional[Path] = option(None, "New folder of the results; default by the time.", "DIR"),
    specimen: bool = option(False, "Multisine test: mass and channels, too.", "--specimen"),
    travel: Optional[float] = option(
        None, "Displacement of the multisine test; default by the sensors' noise.", "M"
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
    They correct the open loop's test.

    Closed loop: the excitation is the reference force, where the force controller follows one. Its
    RMS is 5 m/s^2 times the mass, at most a 20th of the force limit, and peaks and changes are
    within half of the limits, unless --force gives another. The result describes the force loop
    with this specimen, which the other methods need. Rigs without a valve (actuator.kind ideal or
    delay) have this test only.

    The folder then holds the excitation, the bags, a figure, and model.yaml: what was found, as
    facts under /**, for --params-file of every command and node. With --specimen they include
    mass, damping and stiffness of the specimen, the mass's standard error, and calibration.*.

    Examples:

        seft identify config/jhu.yaml --out identified

        seft simulate config/jhu.yaml --params-file identified/model.yaml

        seft identify config/jhu.yaml --specimen --travel 1e-4

        seft identify config/jhu.yaml --over-dds -p rig:pace:=lockstep --json

        seft identify config/lab.yaml --external rig --duration 300
    """
    from seft_ros.identification import rig_tests
    from seft_ros.identification.multisine import plan_multisine

    if set(external or ()) - {"rig"}:
        raise InputError(
            "--external: only the rig may be external; the other nodes are set up here"
        )
    if travel is not None and not specimen:
        raise InputError("--travel is that of the multisine test: give --specimen, too")
    experiment = shared.load_experiment(config, param, params_file, external)
    if all(map(math.isnan, band)):
        band = (0.3, min(0.45 * experiment.timebase.rate, 200.0))
    motions = rig_tests.Motions(experiment, band, seed)
    motions.check(duration)
    largest = motions.largest_levels(duration)
    levels = rig_tests.Levels(
        rig_tests.pilot_voltage(experiment) if amplitude is None else amplitude,
        rig_tests.default_force(experiment, largest) if force is None else force,
    )
    largest.check(levels)
    folder = out or Path(datetime.now().strftime("identify_%Y-%m-%d_%H-%M-%S"))
    plan = None
    if specimen and rig_tests.has_valve(experiment):
        plan = plan_multisine(experiment, travel)
        shared.complain(plan.text())
    shared.check_out(folder)
    motion = motions.write(folder / "excitation.csv", duration)
    shared.stands(f"{folder} has the excitation")
    tests = _Tests(experiment, folder, over_dds, external or ())
    run = _Identification(tests, motions, levels, plan, motion, duration)
    run.drive_valves(by_pilot=amplitude is None)
    run.close_loop()
    return run.show(str(config), specimen, as_json=json)


@dataclass
class _Tests:
    """Runs the tests of an identification, and keeps their recordings."""

    experiment: Experiment
    folder: Path
    over_dds: bool
    external: Sequence[str]
    recordings: dict[str, Recording] = field(default_factory=dict)

    def run(self, name: str, test: Experiment, steps: int) -> bool:
        """Run a test; say whether it drove a valve, to its end."""
        from seft_ros.analysis.assessment import BAD_MISSED
        from seft_ros.identification.rig_tests import has_valve

        bag, label = self.folder / name, f"{name}: "
        if self.over_dds or self.external:
            recording = shared.dds_test(test, bag, steps, self.external, label=label)[0]
        else:
            recording = shared.offline_test(test, bag, label)
        self.recordings[name] = recording
        if (recording.missed or 0) > BAD_MISSED * steps:
            shared.complain(
                f"{label}{recording.missed} of {steps} steps had no command in time: the rig moved "
                "otherwise than asked, and what it says is poor; take a lower rate, or a host that "
                "keeps this one (docs/realtime.md)"
            )
        return recording.trip is None and has_valve(recording.experiment)

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
    ) -> None:
        self._tests, self._motions, self._levels, self._plan = tests, motions, levels, plan
        self._motion, self._duration = motion, duration
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
            short = motions.write(tests.folder / f"{PILOT}.csv", seconds)
            test = rig_tests.open_loop(tests.experiment, short, self._levels.voltage, known)
            self._valve = tests.run(PILOT, test, motions.steps(seconds))
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
        from seft_ros.identification.calibrated import MultisineResult, moved_by, rough_calibration
        from seft_ros.identification.identified import identify_from_recordings

        tests, dt = self._tests, self._tests.experiment.timebase.dt
        opened, band = tests.recordings[OPEN_LOOP], self._motions.band
        known = rough_calibration(opened, band)
        found = identify_from_recordings(known.corrected(opened), None, band)
        if not found.valves:
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
        known = MultisineResult.of_recording(plan, recording, sines, found, known).calibrated
        found = identify_from_recordings(known.corrected(opened), None, band)
        self._multisine = MultisineResult.of_recording(plan, recording, sines, found, known)

    def _run_multisine_test(self, name: str, commands: np.ndarray) -> bool:
        from seft_ros.identification import rig_tests

        tests = self._tests
        path = rig_tests.write_forces(tests.folder / f"{name}.csv", tests.experiment, commands)
        steps = len(commands) + round(rig_tests.TAIL * tests.experiment.timebase.rate)
        return tests.run(name, rig_tests.multisine_test(tests.experiment, path), steps)

    def close_loop(self) -> None:
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
        steps = self._motions.steps(self._duration)
        test = rig_tests.closed_loop_test(experiment, self._motion, self._levels.force)
        tests.run(CLOSED_LOOP, test, steps)

    def show(self, config: str, specimen: bool, as_json: bool) -> int:
        """Evaluate the tests, write and print; give the exit status."""
        tests = self._tests.recordings
        whole = {name: test for name, test in tests.items() if test.trip is None}
        opened = whole.get(OPEN_LOOP) if self._valve else None
        if opened is not None and self._multisine is not None:
            opened = self._multisine.calibrated.corrected(opened)
        folder = self._tests.folder
        files = {"folder": folder, "excitation": self._motion}
        files |= {name: folder / name for name in tests}
        trips = {name: test.trip.reason if test.trip else None for name, test in tests.items()}
        summary: dict[str, Any] = {
            "tripped": {OPEN_LOOP: None, CLOSED_LOOP: None, **trips},
            "excitation_rms": asdict(self._levels),
        }
        texts: Texts = []
        unusable: list[str] = []
        if opened is not None or CLOSED_LOOP in whole:
            from seft_ros.identification import identified

            found = identified.identify_from_recordings(
                opened, whole.get(CLOSED_LOOP), self._motions.band
            )
            unusable = found.unusable
            files |= {"model": folder / "model.yaml", "figure": folder / shared.FIGURE}
            texts, numbers = self._write(found, config, specimen, files)
            summary |= numbers
        summary["files"] = {what: str(path) for what, path in files.items()}
        lines = [f"{what + ':':13}{path}" for what, path in files.items()]
        shared.show(summary, as_json, [*texts, *lines])
        for name, test in tests.items():
            if test.trip is not None:
                at = f"{name.replace('_', ' ')} tripped at {test.trip.time_s:.3f} s"
                shared.complain(f"{at}: {test.trip.reason}; its bag is in {folder / name}")
                return 1
        if unusable:
            shared.complain(unusable[0])
            return 1
        return 0

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
            summary["multisine"] = multisine.numbers(found.axes)
            summary["notes"] += calibrated.multisine_notes(multisine, found.axes)
            texts.append(calibrated.multisine_table(multisine, found.axes))
        texts += summary["notes"]
        obeys_force = loop["actuator.kind"] in FORCE_DRIVEN
        known = identified.facts_of(found, specimen, dt, lag, obeys_force) | more
        identified.write_model(found, files["model"], config, known)
        save_figure(identified_figure(found, f"seft identify {config}"), files["figure"])
        return texts, summary
