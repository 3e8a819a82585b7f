"""Reference force of the actuators; the gathered states and ground motion; its estimates."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.facts import FORCE_DRIVEN
from seft_msgs_py.config.parameter_table import mass_matrix, per_axis, symmetric_matrix
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.topics import RigAxes, Timebase
from seft_plant_sim.computed.computed_substructure import ComputedSubstructure
from seft_plant_sim.rig_parameters import common_lag
from seft_plant_sim.simulated.specimen import deformations

from seft_ros.reference_force.compensation_methods import COMPENSATION_METHODS, with_substructure
from seft_ros.reference_force.compensator import (
    Compensator,
    MethodInputs,
    has_computed_model,
    provides_target,
)
from seft_ros.reference_force.reference_force_parameters import TARGET_MOTION


class StateGathering:
    """Keeps the states of several rigs until all have sent the same step.

    Parameters
    ----------
    rigs : sequence of RigAxes
        The rigs of the test, with n axes together.
    patience : float
        Longest time for which the state of a rig may be missing after another's has arrived, s.
    """

    def __init__(self, rigs: Sequence[RigAxes], patience: float) -> None:
        self._rigs = tuple(rigs)
        self._places = [list(rig.places) for rig in rigs]
        self._axes = sum(len(rig.axes) for rig in rigs)
        self._patience = patience
        self.reset()

    def reset(self) -> None:
        """Begin a new test."""
        self._newest = [-1] * len(self._rigs)
        # the state of all axes at a step, and the rigs that have sent theirs
        self._parts: dict[int, tuple[Floats, set[int]]] = {}
        self._since = math.inf  # arrival of the first state that waits for another rig's

    def take(self, rig: int, step: int, state: Floats, now: float) -> Floats | None:
        """Take the state of a rig.

        Parameters
        ----------
        rig : int
            Its number.
        step : int
            Step of the sample.
        state : ndarray
            Of its axes, shape (4, its number of axes).
        now : float
            The time, s, monotonic.

        Returns
        -------
        ndarray or None
            State of all axes at that step, shape (4, n), when all rigs have sent theirs; earlier
            steps are dropped then.

        Raises
        ------
        WireError
            If the rig has sent a state of this step before.
        """
        whole, arrived = self._parts.setdefault(step, (np.empty((4, self._axes)), set()))
        if rig in arrived:
            raise WireError(f"state of step {step} of {self._rigs[rig].name} a second time")
        whole[:, self._places[rig]] = state
        arrived.add(rig)
        self._newest[rig] = max(self._newest[rig], step)
        if len(arrived) < len(self._rigs):
            self._since = min(self._since, now)
            return None
        self._since = math.inf
        self._parts = {later: part for later, part in self._parts.items() if later > step}
        return whole

    @property
    def is_waiting(self) -> bool:
        """Whether the state of one rig has arrived and that of another has not."""
        return self._since < math.inf

    def lost(self, now: float) -> str:
        """Name a rig with late states, at a time in s, monotonic; empty if there is none."""
        if now - self._since <= self._patience:
            return ""
        first, last = max(self._newest), min(self._newest)
        name, ahead = (self._rigs[self._newest.index(step)].name for step in (last, first))
        known = f"the last is of step {last}" if last >= 0 else "none has arrived"
        others = f"{known}; {ahead} is at step {first}"
        return f"no rig/state of {name} for {self._patience:g} s ({others})"


class MotionBuffer:
    """Ground accelerations of n axes by step, from the first step that is still needed.

    Parameters
    ----------
    axes : int
        n.
    """

    def __init__(self, axes: int) -> None:
        self._values = np.empty((0, axes))
        self._first = 0

    def add(self, first: int, values: Floats) -> bool:
        """Append a piece of the motion; a piece that begins at step 0 begins a new motion.

        Parameters
        ----------
        first : int
            Step of its first sample.
        values : ndarray
            Shape (p, n), m/s^2.

        Returns
        -------
        bool
            False if steps before it are missing; then it is left out.
        """
        if first == 0 or not len(self._values):
            self._first, self._values = first, values.copy()
            return True
        known = self.end - first
        if known < 0:
            return False
        self._values = np.concatenate([self._values, values[known:]])
        return True

    @property
    def end(self) -> int:
        """One beyond the last step."""
        return self._first + len(self._values)

    def window(self, step: int, count: int) -> Floats | None:
        """Accelerations of ``count`` steps from ``step`` on, shape (count, n); None if missing."""
        start = step - self._first
        if start < 0 or start + count > len(self._values):
            return None
        return self._values[start : start + count]

    def drop_before(self, step: int) -> None:
        """Forget the steps before one."""
        passed = min(max(step - self._first, 0), len(self._values))
        self._values = self._values[passed:]
        self._first += passed


class ReferenceForce:
    """Reference force of a test over n axes, computed by a compensation method.

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
    provides_target : bool
        Whether it gives the motion of a target in addition to the force.
    shape : (int, int)
        Number of points and quantities of `step`.
    compensator : Compensator
        As given.
    """

    def __init__(self, compensator: Compensator) -> None:
        self.preview = compensator.preview
        self.provides_target = provides_target(compensator)
        self.shape = (1 + self.preview, 3) if self.provides_target else (1, 1)
        self.compensator = compensator

    @classmethod
    def from_parameters(
        cls, section: dict[str, Any], axes: tuple[str, ...], timebase: Timebase
    ) -> "ReferenceForce":
        """Make it from its section of an experiment.

        Raises
        ------
        InputError
            If the model's sizes do not fit the axes, its mass is not positive, or the method needs
            more parameters.
        """
        known = method_inputs(section, axes, timebase)
        return cls(compensator(section["compensation.method"], known))

    @property
    def is_modelled(self) -> bool:
        """Whether it has a computed model."""
        return has_computed_model(self.compensator) and self.compensator.model is not None

    def reset(self) -> None:
        """Forget the test so far."""
        self.compensator.reset()

    def step(self, ground_motion: Floats, state: Floats, progress: float = 1.0) -> Floats:
        """Compute the reference force of one step.

        Parameters
        ----------
        ground_motion : ndarray
            Ground acceleration of each axis, of this step and the later ones, shape
            (1 + preview, n), m/s^2.
        state : ndarray
            Measured displacement, velocity, acceleration and force, shape (4, n).
        progress : float
            Of a target: 1 in a test; in the ramp it falls to 0.

        Returns
        -------
        ndarray
            Points of this step and later ones, shape (p, q, n). The last quantity is the force,
            N; those of a target are displacement, velocity and force.
        """
        if not self.provides_target:
            return self.compensator.step(ground_motion, state)[np.newaxis, np.newaxis]
        self.compensator.progress = progress  # type: ignore[attr-defined]
        return self.compensator.step(ground_motion, state)

    def estimates(self) -> dict[str, Floats]:
        """Estimate of each quantity that the method identifies on line, shape (n,) each."""
        return self.compensator.estimates()


def compensator(method: str, known: MethodInputs) -> Compensator:
    """Make a compensation method from the known data of a test; InputError if some are missing."""
    computed = known.computed
    for name, given in (("model", computed.model), ("influence of axes", computed.on_axes)):
        if given is not None and method != TARGET_MOTION:
            lacks = f"compensation.method {method} does not compute; make that {TARGET_MOTION}"
            text = f"computed.{name} acts on the motion of a target"
            raise InputError(f"reference_force: {text}, which {lacks}")
    made = COMPENSATION_METHODS[method](known)
    return made if provides_target(made) else with_substructure(made, known)


def method_inputs(
    section: dict[str, Any], axes: tuple[str, ...], timebase: Timebase
) -> MethodInputs:
    """Gather the known data of a test for a compensation method.

    Raises
    ------
    InputError
        If the model's sizes do not fit the axes, its mass is not positive, or the loop's delay
        is not known.
    """
    where, n = "/**: specimen", len(axes)
    mass = mass_matrix(section["specimen.mass"], axes, f"{where}.mass")
    damping = symmetric_matrix(section["specimen.damping"], axes, f"{where}.damping")
    stiffness = symmetric_matrix(section["specimen.stiffness"], axes, f"{where}.stiffness")
    of_calibration = (f"calibration.force_{what}_error" for what in ("lag", "scale"))
    for name in ("specimen.mass_error", *of_calibration):
        per_axis(section[name], axes, f"/**: {name}")
    if section["method"] == "eft":  # the specimen has all of the mass (Eq. 2.2)
        if computing := [name for name in ("mass_ratio", "computed.model") if section[name]]:
            given = f"reference_force: {computing[0]} is {section[computing[0]]}"
            mend = "make that seft, or leave it out"
            raise InputError(f"{given}, but with method eft nothing is computed; {mend}")
        computed = ComputedSubstructure.lumped(np.zeros_like(mass))
    else:
        computed = ComputedSubstructure.from_parameters(section, axes).without_inertial_coupling()
    total = mass + computed.mass[:n, :n]
    if np.linalg.eigvalsh(total)[0] <= 0.0:
        text = "computed.mass and specimen.mass add up to a mass on the axes that is not positive"
        raise InputError(f"reference_force: {text} (definite): {total.tolist()}")
    loop_delay: int = section["loop_delay"]
    if loop_delay < 0:
        mend = "measure it with seft link, and give it with -p loop_delay:=STEPS"
        raise InputError(f"/**: loop_delay is -1, and only seft run measures it; {mend}")
    late = loop_delay * timebase.dt
    if section["actuator.kind"] in FORCE_DRIVEN:  # nothing feeds the force back
        late += common_lag(section)
    springs = deformations(section["specimen.springs"], axes, where)
    structure = mass, computed, damping, stiffness
    return MethodInputs(*structure, timebase.dt, section, late, loop_delay, springs)


SAMPLES_PER_SECOND, MODEL_SAMPLES_PER_SECOND = 10, 100
"""Of the estimates; the second with a computed model, because a plot of its hysteresis needs it."""


def sampling_period(timebase: Timebase, is_modelled: bool) -> int:
    """Count the steps from one sample to the next."""
    wanted = MODEL_SAMPLES_PER_SECOND if is_modelled else SAMPLES_PER_SECOND
    return max(1, round(timebase.rate / wanted))


class EstimateSampler:
    """Samples the estimates of a reference force at step 0 and every `sampling_period` from there.

    If the due step was lost, the next one is sampled. The caller decides by a comparison that takes
    no time at each step: ``if step >= sampler.due``.

    Parameters
    ----------
    reference_force : ReferenceForce
        Has the estimates.
    timebase : Timebase
        Sampling clock of the test.

    Attributes
    ----------
    due : int
        Step at which, or after which, to call `sample`.
    """

    def __init__(self, reference_force: ReferenceForce, timebase: Timebase) -> None:
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
            Name -> estimate of each axis, shape (n,), SI units; empty if the method identifies
            nothing.
        """
        self.due = step - step % self._every + self._every
        return {name: np.array(value) for name, value in self._estimates().items()}
