"""The rig as the loop of a test sees it: linear, from its drive to all that is measured."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_plant_sim.continuous_model import Drive
from seft_plant_sim.rig import continuous_model
from seft_plant_sim.specimen import Specimen
from seft_plant_sim.whole_structure import tested_specimen

from seft_ros.force_controller.names import VELOCITY_FEEDFORWARD
from seft_ros.force_controller.velocity_feedforward import VelocityFeedforward
from seft_ros.loop_shaping import Source
from seft_ros.loop_shaping.plant import Plant, choose_plant, small_signal
from seft_ros.loop_shaping.sampling import SampledPlant

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class LoopRig:
    """Actuators, specimen and sensors of n axes.

    Attributes
    ----------
    plant : Plant
        From the drive to (x, v, a, f), each over the n axes: c and d have 4n rows.
    drive : str
        ``valve_command``, or ``reference_force`` of an idealised actuator.
    specimen : Specimen
        What stands on the rig, as far as is known.
    velocity_cutoff : float or None
        Cutoff of the filter that derives the velocity from the displacement, Hz; None: the
        velocity is measured.
    small_signal : bool
        Whether the rig is not linear and this is its limit for small motions.
    swept : bool
        Whether the specimen in it can be another: what is identified as a whole has one.
    """

    plant: Plant
    drive: Drive
    specimen: Specimen
    velocity_cutoff: float | None = None
    small_signal: bool = False
    swept: bool = False

    def sampled(
        self, dt: float, dead_time: float, gain: float = 1.0
    ) -> tuple[Floats, Floats, Floats]:
        """Matrices a, b, c from the drive that answers sample k to (x, v, a, f) of sample k.

        ``dead_time``, in s, stands in place of the plant's own, ``gain`` is a factor on the drive.
        An InputError says if the dead time is many samples long.
        """
        plant = replace(self.plant, b=gain * self.plant.b, d=gain * self.plant.d, delay=dead_time)
        a, b, c = SampledPlant.of(plant, dt).state_space()
        if self.velocity_cutoff is None:
            return a, b, c
        # v = g x + s, s' = p s + g (p - 1) x, as `seft_plant_sim.sensors.Differentiator` runs it
        n, half = plant.axes, np.pi * self.velocity_cutoff * dt
        g, p = 2 * half / dt / (1 + half), (1 - half) / (1 + half)
        position, one = c[:n], np.eye(n)
        a = np.block([[a, np.zeros((len(a), n))], [g * (p - 1) * position, p * one]])
        b = np.vstack([b, np.zeros((n, n))])
        c = np.hstack([c, np.zeros((4 * n, n))])
        c[n : 2 * n] = np.hstack([g * position, one])
        return a, b, c


def choose_rig(
    experiment: Experiment, source: Source = Source.AUTO, stiffness: float = 1.0
) -> LoopRig:
    """Rig that an experiment describes; InputError if it has none.

    Parameters
    ----------
    experiment : Experiment
        Its sections `rig`, `force_controller` and `reference_force`.
    source : str
        ``rig``: the simulated one; ``identified``: `force_controller: plant.*` for the force, and
        the specimen for the motion that follows from it, or `force_controller: actuator.*` with
        the specimen, if the controller is `velocity_feedforward`; ``auto``: the identified plant
        where the experiment gives one and the rig has a valve, else the rig. Beside
        `velocity_feedforward` it is the rig where that is simulated.
    stiffness : float
        Factor on the specimen's stiffness, the actuators being the same.
    """
    section, specimen = experiment.sections.get("rig"), tested_specimen(experiment)
    ideal = section is not None and section["actuator.kind"] in ("ideal", "delay")
    by_motion = experiment["force_controller"].get("method") == VELOCITY_FEEDFORWARD
    if section is not None and (source == "rig" or (source == "auto" and (ideal or by_motion))):
        return _simulated(section, specimen, experiment, stiffness)
    if by_motion:
        told = VelocityFeedforward.told(experiment["force_controller"], experiment.axes)
        swept = replace(specimen, stiffness=stiffness * specimen.stiffness)
        model = small_signal(swept, **{**told, "dead_time": float(told["dead_time"].max())})
        plant = Plant.of_model("identified", model, motion=True)
        return LoopRig(plant, model.drive, specimen, swept=True)
    if section is None and not np.any(experiment["force_controller"]["plant.numerator"]):
        raise InputError(
            "force_controller: plant.numerator is not given and the rig is not simulated here, so "
            "there is no model of it; let seft identify write one"
        )
    plant = choose_plant(experiment, Source.IDENTIFIED if section is None else source)
    if plant.source == "rig" and section is not None:
        return _simulated(section, specimen, experiment, stiffness)
    return LoopRig(_with_specimen(plant, specimen), "valve_command", specimen)


def _simulated(
    section: dict[str, Any], specimen: Specimen, experiment: Experiment, stiffness: float
) -> LoopRig:
    model = continuous_model(section, experiment.axes, stiffness=stiffness)
    derived = section["sensors.velocity"] == "derived"
    return LoopRig(
        Plant.of_model("rig", model, motion=True),
        model.drive,
        specimen,
        velocity_cutoff=section["sensors.velocity_cutoff"] if derived else None,
        small_signal=not model.is_linear,
        swept=True,
    )


def _with_specimen(plant: Plant, specimen: Specimen) -> Plant:
    """Let displacement, velocity and acceleration follow from an identified plant's force."""
    n, size = specimen.axes, len(plant.a)
    moving, by_force = specimen.state_matrices()
    a = np.block([[plant.a, np.zeros((size, 2 * n))], [by_force @ plant.c, moving]])
    b = np.vstack([plant.b, by_force @ plant.d])
    c = np.zeros((4 * n, size + 2 * n))
    c[: 2 * n, size:] = np.eye(2 * n)
    c[2 * n : 3 * n] = a[size + n :]
    c[3 * n :, :size] = plant.c
    d = np.vstack([np.zeros((2 * n, n)), b[size + n :], plant.d])
    return replace(plant, a=a, b=b, c=c, d=d)
