"""Two controllers to compare with, in the benchmark's own loop.

The sample controller of the benchmark: a lead compensator, then a proportional-integral feedback of
the displacement. A conventional inverse: the command is the series of the inverse response up to
the second derivative, of the computed displacement, velocity and acceleration.
"""

from typing import NamedTuple

import numpy as np
from rths_problem import (
    DT,
    FLOORS,
    FORCE,
    NOISE,
    POSITION,
    PROBLEM,
    RATE,
    Motion,
    Plant,
    Structure,
    plant_step,
    quantised,
)
from seft_msgs_py.arrays import Floats
from seft_plant_sim.compiled import compiled
from seft_plant_sim.lti import first_order_hold


class Controller(NamedTuple):
    """A controller of the benchmark's loop.

    Attributes
    ----------
    gains : ndarray
        Of computed displacement, velocity and acceleration, shape (3,): their sum is wanted.
    lead : ndarray
        Filter of the wanted displacement: of its value, of the last one, and of the last result.
    forward, proportional, integral : float
        Gains from it to the command, and from its difference to the measured displacement, the
        last in 1/s.
    """

    gains: Floats
    lead: Floats
    forward: float
    proportional: float
    integral: float


def sample_controller() -> Controller:
    """Make the controller that the benchmark is released with (Tustin's rule)."""
    known = PROBLEM["sample_controller"]
    pole, lead, q = known["pole"], known["lead"], 2.0 * RATE
    filtered = np.array([lead * q + pole, pole - lead * q, q - pole]) / (q + pole)
    return Controller(
        np.array([1.0, 0.0, 0.0]), filtered, 0.0, known["proportional"], known["integral"]
    )


def conventional_inverse(plant: Plant) -> Controller:
    """Invert the known response of the actuator, and the period for half of which it is held."""
    numerator, denominator = plant.command_to_displacement()
    inverse = denominator[::-1][:3] / numerator[0]
    held = np.array([1.0, DT / 2.0, DT**2 / 12.0])  # of s dt / (1 - exp(-s dt))
    gains = np.convolve(inverse, held)[:3]
    return Controller(gains, np.array([1.0, 0.0, 0.0]), 1.0, 0.0, 0.0)


class Loop(NamedTuple):
    """The computed part, sampled: by its state, by the ground motion, and by the force.

    ``acceleration`` is that of the first floor, by state, ground motion and force.
    """

    free: Floats
    ground_start: Floats
    ground_change: Floats
    force: Floats
    acceleration: Floats


def run_benchmark(
    structure: Structure, plant: Plant, controller: Controller, ground: Floats, seed: int
) -> Motion:
    """Run a test with a controller of the benchmark's own loop.

    A command acts at once, and the measured force on the computed part a period later, as there.
    """
    a, b = structure.state_space
    free, start, change = first_order_hold(a, b, DT)
    own = np.ascontiguousarray
    by_motion = np.concatenate([a[FLOORS], b[FLOORS]])
    loop = Loop(free, own(start[:, 0]), own(change[:, 0]), own(start[:, 1]), by_motion)
    rng, n = np.random.default_rng(seed), len(ground)
    noise = np.column_stack([NOISE[name] * rng.standard_normal(n) for name in NOISE])
    numerical, moved = np.zeros((n, 2 * FLOORS)), np.zeros((n, 2))
    _run(loop, plant, controller, ground, noise, np.zeros(5), np.zeros((3, 5)), numerical, moved)
    return Motion(moved[:, 0], moved[:, 1], numerical[:, :FLOORS])


@compiled
def _run(
    loop: Loop,
    plant: Plant,
    controller: Controller,
    ground: Floats,
    noise: Floats,
    z: Floats,
    work: Floats,
    numerical: Floats,
    moved: Floats,
) -> None:
    """Fill numerical states, shape (N, 6), measured and true displacement, shape (N, 2)."""
    late = last = led = error = integral = 0.0
    for k in range(len(ground)):
        moved[k, 0], moved[k, 1] = z[POSITION] + noise[k, 0], z[POSITION]
        force = min(max(z[FORCE], -plant.capacity), plant.capacity) + noise[k, 1]
        y = numerical[k]
        a = loop.acceleration[6] * ground[k] + loop.acceleration[7] * late
        for i in range(6):
            a += loop.acceleration[i] * y[i]
        gains = controller.gains
        wanted = quantised(gains[0] * y[0] + gains[1] * y[3] + gains[2] * a)
        led = controller.lead[0] * wanted + controller.lead[1] * last + controller.lead[2] * led
        last, before = wanted, error
        error = quantised(quantised(led) - moved[k, 0])
        integral += 0.5 * DT * controller.integral * (error + before)
        u = quantised(controller.forward * led + controller.proportional * error + integral)
        if k + 1 == len(ground):
            break
        for i in range(6):
            total = loop.ground_start[i] * ground[k] + loop.force[i] * late
            total += loop.ground_change[i] * (ground[k + 1] - ground[k])
            for j in range(6):
                total += loop.free[i, j] * y[j]
            numerical[k + 1, i] = total
        late = force
        plant_step(plant, z, u, work)
