"""The ground motions of one identification: an excitation, scaled to a reference force."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_plant_sim.rig.rig import Rig

from seft_ros.force_controller.methods import force_control
from seft_ros.ground_motion.resample import check_size
from seft_ros.identification.excitation import excitation, shortest_duration, write_excitation
from seft_ros.identification.experiments import TAIL, ground_accelerations, has_force_loop
from seft_ros.reference_force.block import ReferenceForce

Floats = npt.NDArray[np.float64]


class Motions:
    """Ground motions of any duration for the tests of one identification.

    Parameters
    ----------
    experiment : Experiment
        What is identified.
    force : float
        RMS of the reference force, N.
    signal, band, seed : str, tuple of float, int
        As `seft_ros.identification.excitation.excitation` takes them.
    """

    def __init__(
        self,
        experiment: Experiment,
        force: float,
        signal: str,
        band: tuple[float, float],
        seed: int,
    ) -> None:
        self._experiment, self._force = experiment, force
        self._signal, self._band, self._seed = signal, band, seed
        self._axes, self._timebase = experiment.axes, experiment.timebase

    @property
    def shortest(self) -> float:
        """Shortest duration that the band makes sense for, s."""
        return shortest_duration(self._signal, len(self._axes), self._band)

    def check(self, duration: float) -> None:
        """See that the tests can be made, before anything is written or moves.

        Raises
        ------
        InputError
            If excitation or experiment make no sense.
        """
        self._unit(duration)
        sections, axes = self._experiment.sections, self._axes
        ReferenceForce.from_parameters(sections["reference_force"], axes, self._timebase)
        if has_force_loop(self._experiment):
            force_control(sections["force_controller"], axes, self._timebase)
        if "rig" in sections:
            Rig.from_parameters(sections["rig"], axes, self._timebase)

    def write(self, path: Path, duration: float) -> Path:
        """Write the motion of a test as a record, in a folder that is made if need be.

        Raises
        ------
        InputError
            If it can't be written.
        """
        accelerations = ground_accelerations(self._experiment, self._force * self._unit(duration))
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{path.parent}: {error.strerror or error}") from None
        write_excitation(path, accelerations, self._axes)
        return path

    def steps(self, duration: float) -> int:
        """Count the steps of a test with such a motion."""
        return round((duration + TAIL) * self._timebase.rate)

    def _unit(self, duration: float) -> Floats:
        check_size(duration, self._timebase.rate, "--duration")
        steps, dt = round(duration * self._timebase.rate), self._timebase.dt
        return excitation(self._signal, steps, len(self._axes), dt, self._band, self._seed)
