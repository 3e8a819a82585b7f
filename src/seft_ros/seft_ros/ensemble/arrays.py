"""The blocks of a test as arrays, for the compiled loop."""

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view
from seft_msgs_py.topics import VALVE_COMMAND
from seft_plant_sim.nonlinear_plant import NonlinearPlant
from seft_plant_sim.nonlinearity import PistonAndValve, Springs
from seft_plant_sim.plant import LinearPlant
from seft_plant_sim.restoring_force import BilinearSpring, BoucWenSpring, HystereticSpring
from seft_plant_sim.rig import Rig

from seft_ros.ensemble.loop_steps import ControlArrays, ForceArrays, SensorArrays
from seft_ros.ensemble.rig_step import PlantArrays
from seft_ros.force_controller.block import ForceController
from seft_ros.force_controller.interlock import Interlock
from seft_ros.interlock.instability import InstabilityWatch
from seft_ros.interlock.plausibility import PlausibleState
from seft_ros.interlock.protected_force import ProtectedForce
from seft_ros.reference_force.compensation.linear_filter import LinearCompensator

Floats = npt.NDArray[np.float64]


class NotLinearError(Exception):
    """A block can't be put into arrays; the text says which, and why."""


def plant_arrays(rig: Rig) -> PlantArrays:
    """Arrays of a rig's plant.

    Raises
    ------
    NotLinearError
        If it has laws that are not among the compiled ones.
    """
    plant = rig.plant
    none = np.zeros((0, 0))
    if type(plant) is LinearPlant:
        n = plant.matrix.shape[0] - plant.matrix.shape[1]  # s + 4n less s + 3n
        return PlantArrays(
            _c(plant.matrix), (none, none), (none, none), (0, 0), none, np.full(n, np.inf),
            plant.dead_time.whole, int(plant.dead_time.part > 0), np.zeros((0, 6)),
            np.zeros((0, 11)), np.zeros((0, n)), 0,
        )  # fmt: skip
    if type(plant) is not NonlinearPlant:
        raise NotLinearError(f"the plant is a {type(plant).__name__}")
    n = len(plant.output) // 4
    piston, springs, deformation, first = np.zeros((0, 6)), np.zeros((0, 11)), np.zeros((0, n)), 0
    for part in plant.parts:
        if type(part) is PistonAndValve and part is plant.parts[0]:
            piston = part.rows
        elif type(part) is Springs and part is plant.parts[-1]:
            springs = np.array([_spring_row(spring) for spring in part.specimen.springs])
            deformation, first = part.specimen.deformation, part.first_state
        else:
            raise NotLinearError(f"the plant has a part {type(part).__name__}")
    stretches = plant.before, plant.after
    return PlantArrays(
        none,
        (_c(stretches[0].predict), _c(stretches[1].predict)),
        (_c(stretches[0].correct), _c(stretches[1].correct)),
        (stretches[0].steps, stretches[1].steps),
        _c(plant.output),
        plant.drive_limit.astype(np.float64),
        plant.dead_time.whole,
        int(plant.dead_time.part > 0),
        _c(piston),
        springs,
        _c(deformation),
        first,
    )


def sensor_arrays(rig: Rig, steps: int) -> SensorArrays:
    """Arrays of a rig's sensors and limits."""
    sensors, counted = rig.sensors, rig.saturated_time.time
    channels, derived = sensors.channels, sensors.differentiator
    converts = bool(channels.resolution.any())
    return SensorArrays(
        sensors.noise(steps),
        _c(channels.bias),
        _c(channels.range),
        _c(channels.resolution),
        1.0 / channels.resolution if converts else np.zeros_like(channels.resolution),
        converts,
        derived is not None,
        derived.pole if derived else 0.0,
        derived.gain if derived else 0.0,
        _c(rig.limits.limits[:, 0]),
        counted.allowed,
        counted.window,
    )


def force_arrays(block: ProtectedForce, known: Floats, steps: int) -> ForceArrays:
    """Arrays of a reference force under a ground motion.

    Parameters
    ----------
    block : ProtectedForce
        The block.
    known : ndarray
        Ground motion, and what is known beyond its end, shape (N + lead, n).
    steps : int
        N.

    Raises
    ------
    NotLinearError
        If its compensation is not linear, or others than the usual guards watch it.
    """
    compensator = block.reference_force.compensator
    if type(compensator) is not LinearCompensator:
        raise NotLinearError("the compensation changes while the test runs")
    if "step" in vars(compensator):
        raise NotLinearError("the compensation has a step of its own")
    if [type(guard) for guard in block.guards] != [PlausibleState, InstabilityWatch]:
        raise NotLinearError("other guards than the usual watch the reference force")
    watch = block.guards[1]
    assert isinstance(watch, InstabilityWatch)
    own = compensator.linear()
    windows = sliding_window_view(known, 1 + own.preview, axis=0)[:steps].transpose(0, 2, 1)
    driven = windows.reshape(steps, -1) @ np.vstack([own.e, own.h]).T
    return ForceArrays(
        np.block([[own.c, own.d], [own.a, own.b]]),
        driven,
        _c(known[:steps]),
        block.plausible.largest,
        block.plausible.most,
        _c(watch.product),
        watch.average,
        watch.memory,
        watch.patience,
        float(watch.ratio),
        watch.floor**2,
        block.ramp.steps,
    )


def control_arrays(interlock: Interlock, rig: Rig) -> ControlArrays:
    """Arrays of a force controller and its interlock."""
    controller, limited = interlock.controller, interlock.saturated
    if not isinstance(controller, ForceController):
        raise NotLinearError("a force controller of another package")
    return ControlArrays(
        _c(controller.matrix),
        _c(controller.from_drive),
        controller.feedback,
        controller.limit,
        float(interlock.largest),
        limited.allowed,
        limited.window,
        rig.drive == VALVE_COMMAND.name,
    )


def _spring_row(spring: HystereticSpring) -> list[float]:
    common = [spring.stiffness, spring.hardening_ratio, spring.yield_displacement]
    if type(spring) is BilinearSpring:
        return [*common, spring.yield_displacement, *[0.0] * 7]
    if type(spring) is not BoucWenSpring:
        raise NotLinearError(f"the specimen has a {type(spring).__name__}")
    law = [spring.exponent, spring.beta, spring.gamma]
    losses = [spring.amplitude_loss, spring.strength_loss, spring.stiffness_loss]
    return [*common, spring.limit, 1.0, *law, *losses]


def _c(values: npt.NDArray[np.floating]) -> Floats:
    """Contiguous, and one's own: the compiler knows one kind of array alone."""
    return np.array(values, dtype=np.float64, order="C")
