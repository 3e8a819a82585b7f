"""Reference force that the actuators are to apply; sampling of what is identified on line."""

from typing import Any, Protocol

import numpy as np
from seft_msgs_py.config.parameter_table import Floats, mass_matrix, symmetric_matrix
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import NANOSECONDS_PER_SECOND, Timebase
from seft_plant_sim.computed_substructure import ComputedSubstructure
from seft_plant_sim.specimen import deformations

from seft_ros.reference_force.compensation_methods import METHODS
from seft_ros.reference_force.compensator import Compensator, Knowledge, tells_motion
from seft_ros.reference_force.reference_force_parameters import TARGET_MOTION
from seft_ros.reference_force.substructure import with_substructure


class ReferenceForce:
    """Reference force of a test over n axes, as a compensation method computes it.

    All methods approximate

    - ``eft``:  f_r = -(M_e + M_c) a_g                  (paper Eq. 2.3)
    - ``seft``: f_r = -(M_e + M_c) a_g - M_c a          (paper Eq. 2.5)

    with M_c = mass_ratio M_e and a the acceleration that this force causes.

    Parameters
    ----------
    compensator : Compensator
        The method.

    Attributes
    ----------
    preview : int
        Number of later steps whose ground motion `step` needs.
    tells_motion : bool
        Whether it gives the motion of a target, and not the force alone.
    shape : (int, int)
        Points and quantities that `step` gives.
    compensator : Compensator
        As given.
    """

    def __init__(self, compensator: Compensator) -> None:
        self.preview = compensator.preview
        self.tells_motion = tells_motion(compensator)
        self.shape = (1 + self.preview, 3) if self.tells_motion else (1, 1)
        self.compensator = compensator

    @classmethod
    def from_parameters(
        cls, section: dict[str, Any], axes: tuple[str, ...], timebase: Timebase
    ) -> "ReferenceForce":
        """Make it of its section of an experiment.

        Raises
        ------
        InputError
            If the model's sizes do not fit the axes, its mass is not positive, or the method
            lacks something.
        """
        known = knowledge(section, axes, timebase)
        return cls(compensator(section["compensation.method"], known))

    @property
    def is_modelled(self) -> bool:
        """Whether a computed model is part of it."""
        return getattr(self.compensator, "model", None) is not None

    def reset(self) -> None:
        """Forget the test so far."""
        self.compensator.reset()

    def step(self, ground_motion: Floats, state: Floats, pace: float = 1.0) -> Floats:
        """Compute the reference force of one step.

        Parameters
        ----------
        ground_motion : ndarray
            Ground acceleration of each axis, of this step and the later ones, shape
            (1 + preview, n), m/s^2.
        state : ndarray
            Measured displacement, velocity, acceleration and force, shape (4, n).
        pace : float
            Of a target: 1 in a test, on the way to rest it goes to 0.

        Returns
        -------
        ndarray
            Points of this step and later ones, shape (p, q, n). The last quantity is the force,
            N; those of a target are displacement, velocity and force.
        """
        if not self.tells_motion:
            return self.compensator.step(ground_motion, state)[np.newaxis, np.newaxis]
        self.compensator.pace = pace  # type: ignore[attr-defined]
        return self.compensator.step(ground_motion, state)

    def estimates(self) -> dict[str, Floats]:
        """Estimate of each quantity that the method identifies on line, shape (n,) each."""
        return self.compensator.estimates()


def compensator(method: str, known: Knowledge) -> Compensator:
    """Make a compensation method of what is known of a test; InputError if it lacks something."""
    computed = known.computed
    for name, given in (("model", computed.model), ("influence of axes", computed.on_axes)):
        if given is not None and method != TARGET_MOTION:
            raise InputError(
                f"reference_force: computed.{name} acts on the motion of a target, which "
                f"compensation.method {method} does not compute; make that {TARGET_MOTION}"
            )
    made = METHODS[method](known)
    return made if tells_motion(made) else with_substructure(made, known)


def knowledge(section: dict[str, Any], axes: tuple[str, ...], timebase: Timebase) -> Knowledge:
    """Gather what a compensation method may know of a test.

    Raises
    ------
    InputError
        If the model's sizes do not fit the axes, its mass is not positive, or the loop's delay
        is not known.
    """
    where, n = "reference_force: model", len(axes)
    mass = mass_matrix(section["model.mass"], axes, f"{where}.mass")
    damping, stiffness = (
        symmetric_matrix(section[f"model.{name}"], axes, f"{where}.{name}")
        for name in ("damping", "stiffness")
    )
    if section["method"] == "eft" and section["computed.model"]:
        raise InputError(
            "reference_force: computed.model is given, but with method eft nothing is computed; "
            "make that seft"
        )
    if section["method"] == "eft":  # the specimen carries all of the mass (Eq. 2.2)
        mass = mass + section["mass_ratio"] * mass
        computed = ComputedSubstructure.none(n)
    else:
        computed = ComputedSubstructure.from_parameters(section, axes).without_inertial_coupling()
    total = mass + computed.mass[:n, :n]
    if np.linalg.eigvalsh(total)[0] <= 0.0:
        raise InputError(
            "reference_force: computed.mass and model.mass add up to a mass on the axes that is "
            f"not positive (definite): {total.tolist()}"
        )
    loop_delay: int = section["loop_delay"]
    if loop_delay < 0:
        raise InputError(
            "reference_force: loop_delay is to be measured, which only seft run does; measure it "
            "with seft link, and give it with -p reference_force:loop_delay:=STEPS"
        )
    prefixes = ("compensation.", "tracking.")
    options = {name: value for name, value in section.items() if name.startswith(prefixes)}
    late = loop_delay * timebase.dt  # delays that are given are those of the force loop alone
    for name in ("compensation.delay", "tracking.dead_time"):
        if options[name] > 0:
            options[name] += late
    bounds = np.atleast_1d(options["compensation.delay_range"])
    options["compensation.delay_range"] = (bounds + late).tolist()
    springs = deformations(section.get("model.springs", 0.0), axes, where)
    return Knowledge(mass, computed, damping, stiffness, timebase.dt, options, loop_delay, springs)


PERIOD_NS = NANOSECONDS_PER_SECOND // 10
MODEL_PERIOD_NS = NANOSECONDS_PER_SECOND // 100
"""Experiment time between two samples, and with a computed model, whose hysteresis they draw."""


class Estimating(Protocol):
    """A reference force, protected or not."""

    @property
    def is_modelled(self) -> bool:
        """Whether it has a computed model."""

    def estimates(self) -> dict[str, Floats]:
        """Estimate of each quantity, shape (n,) each."""


def sampling_period(timebase: Timebase, is_modelled: bool) -> int:
    """Count the steps from one sample to the next."""
    return max(1, round((MODEL_PERIOD_NS if is_modelled else PERIOD_NS) / timebase.period_ns))


class EstimateSampler:
    """Samples the estimates of a reference force at step 0 and every `sampling_period` from there.

    Where the step that is due was lost, the next one counts. Sampling is left to the caller,
    for whom it must cost nothing to ask at every step: ``if step >= sampler.due``.

    Parameters
    ----------
    reference_force : Estimating
        Whose estimates.
    timebase : Timebase
        Sampling clock of the test.

    Attributes
    ----------
    due : int
        Step at which, or after which, to call `sample`.
    """

    def __init__(self, reference_force: Estimating, timebase: Timebase) -> None:
        self.due = 0
        self._estimates = reference_force.estimates
        self._every = sampling_period(timebase, reference_force.is_modelled)

    def reset(self) -> None:
        """Begin a new test."""
        self.due = 0

    def sample(self, step: int) -> dict[str, Floats]:
        """Copy the estimates as they are after a step.

        Parameters
        ----------
        step : int
            Step of the last reference force.

        Returns
        -------
        dict of str to ndarray
            Name -> estimate of each axis, shape (n,), SI units; empty where the method
            identifies nothing.
        """
        self.due = step - step % self._every + self._every
        return {name: np.array(value) for name, value in self._estimates().items()}
