"""seft on the benchmark's plant: the servo identified, then a test by the offline loop.

What seft is told is laboratory.yaml: the specimen, the sensors' noise, and that the actuator obeys
displacements. The case's computed part replaces the one there.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rths_hardware import BenchmarkRig
from rths_problem import DT, Motion, Plant, Structure
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError
from seft_msgs_py.wire.topics import REFERENCE_FORCE, RigAxes
from seft_plant_sim.hardware.hosted import HostedHardware
from seft_plant_sim.rig import Rig
from seft_ros.bags.recording import Recording
from seft_ros.identification import rig_tests
from seft_ros.identification.identified import facts_of, identify_from_recordings, write_model
from seft_ros.test_run.blocks import Blocks, build_blocks
from seft_ros.test_run.offline import simulate_test
from seft_ros.test_run.parameter_tables import TABLES

BAND_HZ, DURATION = (0.3, 100.0), 120.0
"""Of the excitation, and time of it (s): the defaults of `seft identify`."""
LABORATORY = Path(__file__).with_name("laboratory.yaml")


def experiment(structure: Structure, motion: Path, *identified: Path) -> Experiment:
    """Read the laboratory's file, and change structure and ground motion (a file at `DT`)."""
    mass, damping, stiffness = (matrix.ravel().tolist() for matrix in structure.computed)
    changes: Mapping[str, Mapping[str, Any]] = {
        "ground_motion": {"file": str(motion), "unit": "m/s2", "dt": DT, "peak_force": 0.0},
        "reference_force": {
            "computed.mass": mass,
            "computed.damping": damping,
            "computed.stiffness": stiffness,
        },
    }
    given = [(node, *item) for node, part in changes.items() for item in part.items()]
    return Experiment.load(TABLES, [LABORATORY, *identified], given)


def hosted_blocks(tested: Experiment, device: BenchmarkRig) -> Blocks:
    """Make the blocks of a test whose rig hosts the benchmark's plant."""
    given = tested["rig"], tested.axes, RigAxes.whole(tested.axes), DT
    hosted = HostedHardware(*given, now=lambda: 0.0, device=device)
    rig = Rig(tested["rig"], tested.axes, tested.timebase, hardware=hosted)
    return replace(build_blocks(tested), rig=rig)


def run_product(
    structure: Structure, plant: Plant, identified: Path, ground: Floats, seed: int
) -> Motion:
    """Run a test of `target_motion` and `position_servo`."""
    with TemporaryDirectory() as folder:
        motion = Path(folder) / "motion.txt"
        np.savetxt(motion, ground, "%.9e")
        tested, device = experiment(structure, motion, identified), BenchmarkRig(plant, seed)
        blocks = hosted_blocks(tested, device)
    begun = len(device.displacement)
    recording = simulate_test(tested, blocks)
    return motion_of(structure, recording, np.array(device.displacement[begun:]), ground)


def motion_of(structure: Structure, recording: Recording, true: Floats, ground: Floats) -> Motion:
    """Take from a recording what it moved; the upper floors follow the target of the first one."""
    target = recording.series[REFERENCE_FORCE.name].values[:, :2, 0]
    steps = len(target)
    return Motion(
        recording.measured.values[:, 0, 0],
        true[:steps],
        structure.upper_floors(ground[:steps], target),
        "" if recording.trip is None else recording.trip.reason,
    )


def identify_servo(folder: Path, seed: int) -> Path:
    """Let the actuator of the nominal plant be identified as `seft identify` does.

    Returns
    -------
    Path
        File with what was found, in this folder, for the tests.

    Raises
    ------
    ExperimentError
        If a test trips, or shows nothing but noise.
    """
    laboratory = Experiment.load(TABLES, [LABORATORY])
    motions = rig_tests.Motions(laboratory, BAND_HZ, seed)
    largest = motions.largest_levels(DURATION)
    amplitude = rig_tests.pilot_voltage(laboratory, largest)
    with TemporaryDirectory() as place:
        for name, seconds in (("pilot", motions.of_pilot(DURATION)), ("open_loop", DURATION)):
            motion = motions.write(Path(place) / f"{name}.csv", seconds)
            opened = _identifying(rig_tests.open_loop(laboratory, motion, amplitude), seed)
            amplitude = rig_tests.voltage_after(opened, amplitude, largest)
    found = identify_from_recordings(opened, None, BAND_HZ)
    if found.unusable:
        raise ExperimentError(f"identification: {found.unusable[0]}")
    path = folder / "model.yaml"
    write_model(found, path, LABORATORY.name, facts_of(found, False, DT, 0.0, False))
    return path


def _identifying(tested: Experiment, seed: int) -> Recording:
    recording = simulate_test(tested, hosted_blocks(tested, BenchmarkRig(Plant.nominal(), seed)))
    if recording.trip is not None:
        raise ExperimentError(f"identification tripped: {recording.trip.reason}")
    return recording
