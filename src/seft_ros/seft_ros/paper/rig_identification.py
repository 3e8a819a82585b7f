"""Spectral identification of the rig, as the paper did it: by tests of its own."""

from pathlib import Path
from tempfile import TemporaryDirectory

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError

from seft_ros.experiment.blocks import build_blocks
from seft_ros.experiment.offline import simulate
from seft_ros.identification.experiments import (
    PILOT_DURATION,
    Levels,
    closed_loop,
    default_force,
    open_loop,
    pilot_voltage,
    voltage_after,
)
from seft_ros.identification.identified import Identified, identify
from seft_ros.identification.motions import Motions
from seft_ros.loop_shaping.controller import Controller
from seft_ros.recording.record import Record

DURATION = 120.0  # s of each test, as `seft identify` takes it
_BAND = (0.3, 200.0)  # Hz
_SEED = 1


def identify_rig(experiment: Experiment) -> Identified:
    """Drive the simulated rig by noise, valve and closed loop, and fit what it answers.

    Raises
    ------
    ExperimentError
        If a test trips, or shows nothing but noise.
    """
    controller = Controller.from_parameters(experiment["force_controller"])
    band = (_BAND[0], min(0.45 * experiment.timebase.rate, _BAND[1]))
    levels = Levels(pilot_voltage(experiment), default_force(experiment, "random"))
    motions = Motions(experiment, levels.force, "random", band, _SEED)
    with TemporaryDirectory() as folder:
        short = motions.write(Path(folder) / "pilot.csv", PILOT_DURATION)
        pilot = _run(open_loop(experiment, short, levels), "pilot")
        levels = Levels(voltage_after(pilot, levels.voltage), levels.force)
        motion = motions.write(Path(folder) / "excitation.csv", DURATION)
        opened = _run(open_loop(experiment, motion, levels), "open loop")
        closed = _run(closed_loop(experiment, motion), "closed loop")
    found = identify(opened, closed, band, controller)
    if found.unusable:
        raise ExperimentError(f"identification: {found.unusable[0]}")
    return found


def _run(experiment: Experiment, name: str) -> Record:
    record = simulate(experiment, build_blocks(experiment))
    if record.trip is not None:
        raise ExperimentError(
            f"identification, {name}: tripped at {record.trip.time_s:.3f} s: {record.trip.reason}"
        )
    return record
