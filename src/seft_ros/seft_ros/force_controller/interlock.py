"""Interlock of the force control: it keeps out implausible values, and trips at faults."""

import math
from collections.abc import Hashable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import mass_matrix, per_axis, symmetric_matrix
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RigAxes, Timebase
from seft_plant_sim.compiled import entry_point, kind_of
from seft_plant_sim.limits import event_ring
from seft_plant_sim.rig_parameters import LIMIT_NAMES
from seft_plant_sim.sensors import CHANNELS

from seft_ros.force_controller.force_control import ForceControl
from seft_ros.force_controller.interlock_step import (
    DETECTED,
    FAULT,
    IMPLAUSIBLE,
    NOTHING,
    ODD_DRIVE,
    OUTSIDE,
    SATURATION,
    STEP,
    TRIP,
    InterlockParameters,
    InterlockState,
    begin_control,
    begin_interlock,
    end_control,
)
from seft_ros.force_controller.methods import force_control
from seft_ros.force_controller.valve_model import valve_models
from seft_ros.force_controller.velocity_feedforward import ACTUATOR
from seft_ros.protection.detector_step import begin_detectors, detect_all
from seft_ros.protection.detectors import (
    ALL,
    DETECTORS,
    DetectorParameters,
    DetectorState,
    describe,
    detector_arrays,
)
from seft_ros.reference_force.force_command import FORCE_DRIVEN

WHERE = "force_controller: "


def detectors_of(
    section: dict[str, Any], axes: tuple[str, ...], dt: float, places: Sequence[int]
) -> tuple[DetectorParameters, DetectorState]:
    """Put the detectors of some of the axes into arrays.

    Parameters
    ----------
    section : dict
        Of the force controller, for all axes.
    axes : tuple of str
        Names of all axes.
    dt : float
        Sampling period, s.
    places : sequence of int
        Of the watched axes.

    Raises
    ------
    InputError
        If assumed values do not fit the axes, or there is no detector of a given name.
    """
    own = list(places)
    warn_only = section["detectors.warn_only"].replace(",", " ").split()
    if warn_only == [ALL]:
        warn_only = [one.name for one in DETECTORS]
    unknown = set(warn_only) - {one.name for one in DETECTORS}
    if unknown:
        raise InputError(
            f"{WHERE}detectors.warn_only: no detector {sorted(unknown)[0]!r}; there are "
            + ", ".join(one.name for one in DETECTORS)
        )
    actuator = {
        name: per_axis(section[f"actuator.{name}"], axes, f"{WHERE}actuator.{name}")[own]
        for name in (*ACTUATOR, "valve_frequency", "valve_damping", "dead_time")
    }
    is_known = actuator["valve_frequency"] > 0.0
    if section["detectors.actuator_kind"] in FORCE_DRIVEN:  # there is no valve
        is_known[:] = False
    actuator["flow_gain"] = np.where(is_known, actuator["flow_gain"], 0.0)
    actuator["valve_frequency"] = np.where(is_known, actuator["valve_frequency"], 1.0 / dt)
    name, ratio = "detectors.specimen_stiffness", section["detectors.mass_ratio"]
    stiffness = symmetric_matrix(section[name], axes, WHERE + name)[np.ix_(own, own)]
    mass = np.zeros_like(stiffness)
    if np.any(section["detectors.specimen_mass"]):
        name = "detectors.specimen_mass"
        mass = mass_matrix(section[name], axes, WHERE + name)[np.ix_(own, own)]
    if section["detectors.test"] == "eft":  # the specimen carries all of the mass
        mass, ratio = (1.0 + ratio) * mass, 0.0
    valves = valve_models(actuator, dt)
    noise = [f"noise.{channel}" for channel in CHANNELS]
    ranges = [f"detectors.{channel}_range" for channel in CHANNELS]
    return detector_arrays(
        np.array([per_axis(section[n], axes, WHERE + n)[own] for n in noise]),
        np.array([section[f"limits.{name}"] for name in LIMIT_NAMES]),
        np.array([per_axis(section[n], axes, WHERE + n)[own] for n in ranges]),
        section["noise.velocity_source"] == "derived",
        np.transpose([actuator[name] for name in ACTUATOR]),
        np.array([[valve.past() for valve in valves], [valve.later() for valve in valves]]),
        np.ascontiguousarray(mass),
        np.ascontiguousarray(stiffness),
        np.ascontiguousarray(ratio * mass),
        warn_only,
        section["watchdog.state_timeout"],
        dt,
    )


def detector_shares(
    experiment: Experiment, steps: Ints, points: Floats, states: Floats, commands: Floats
) -> dict[str, float]:
    """Give the largest value of each detector in a test, over its threshold.

    Parameters
    ----------
    experiment : Experiment
        Of the test.
    steps : ndarray
        Of the N answered samples, shape (N,).
    points, states, commands : ndarray
        Reference force, state and valve command at these, shapes (N, q, n), (N, 4, n) and (N, n).

    Returns
    -------
    dict
        The largest share on any axis, by the detector's name.
    """
    section, axes, dt = experiment["force_controller"], experiment.axes, experiment.timebase.dt
    shares = np.zeros(len(DETECTORS))
    for rig in experiment.rigs:
        parameters, state = detectors_of(section, axes, dt, rig.places)
        own = list(rig.places)
        begin_detectors(state)
        detect_all(
            parameters,
            state,
            steps,
            np.ascontiguousarray(points[..., own]),
            np.ascontiguousarray(states[..., own]),
            np.ascontiguousarray(commands[..., own]),
            section["voltage_limit"],
        )
        shares = np.maximum(shares, state.shares.max(axis=1))
    return {one.name: share for one, share in zip(DETECTORS, shares.tolist(), strict=True)}


_MEASURED = ("force", "displacement", "velocity", "acceleration")


class Interlock:
    """A `ForceControl` that refuses implausible values, and does not stay at its limit for long.

    After a trip it closes the valve, and then answers 0 V until the next test.

    Parameters
    ----------
    controller : ForceControl
        Computes the valve drive.
    axes : sequence of str
        Names of the n axes.
    largest_force : float
        Magnitude of the reference force beyond which it is implausible, N.
    longest_saturation : float
        Time within one second that the valve drive may be at its limit, s.
    close_time : float
        Time in which it closes the valve, s.
    detectors : tuple of DetectorParameters and DetectorState
        Of faults, see `detector_arrays`.

    Attributes
    ----------
    controller : ForceControl
        As given.
    parameters, state : InterlockParameters, InterlockState
        Arguments of `begin_control` and `end_control`, here and in a compiled loop.
    """

    def __init__(
        self,
        controller: ForceControl,
        axes: Sequence[str],
        largest_force: float,
        longest_saturation: float,
        close_time: float,
        detectors: tuple[DetectorParameters, DetectorState],
    ) -> None:
        self.controller = controller
        self._axes, n = tuple(axes), len(axes)
        dt = detectors[0].dt
        self._longest, (saturated, window) = longest_saturation, event_ring(longest_saturation, dt)
        self.parameters = InterlockParameters(
            float(largest_force), window, close_time / dt, detectors[0]
        )
        self.state = InterlockState(
            flags=np.zeros(4, dtype=np.int64),
            saturated=saturated,
            force=np.zeros(n),
            measured=np.zeros((4, n)),
            odd=np.zeros(n),
            drive=np.zeros(n),
            plan=np.zeros((*controller.shape, n)),
            sample=np.zeros((4, n)),
            detectors=detectors[1],
        )
        both, drive = (self.parameters, self.state), self.state.drive
        points = np.zeros((1, 1, n))
        self._reset = entry_point(begin_interlock, self.state)
        self._begin = entry_point(begin_control, *both, 0, points, self.state.measured, drive)
        self._end = entry_point(end_control, *both, 0, False, drive)
        self.reset()

    @classmethod
    def from_parameters(
        cls,
        controller: ForceControl,
        section: dict[str, Any],
        axes: tuple[str, ...],
        timebase: Timebase,
        rig: RigAxes | None = None,
    ) -> "Interlock":
        """Make it from the force controller's section of an experiment, which is for all axes.

        Parameters
        ----------
        controller : ForceControl
            Of the rig's axes.
        section, axes, timebase
            Of the experiment.
        rig : RigAxes, optional
            With several rigs, the one that it controls; default all axes.

        Raises
        ------
        InputError
            If the assumed actuator or specimen does not fit the axes.
        """
        own = rig or RigAxes.whole(axes)
        names = ("limits.force", "watchdog.saturation_time", "watchdog.close_time")
        detectors = detectors_of(section, axes, timebase.dt, own.places)
        force, saturation, closing = (section[name] for name in names)
        return cls(controller, own.axes, force, saturation, closing, detectors)

    @cached_property
    def kind(self) -> Hashable:
        """`kind_of` the arguments of a compiled loop: its own, and its controller's."""
        of: Any = self.controller
        return kind_of((self.parameters, self.state, of.parameters, of.state))

    @property
    def reason(self) -> str:
        """Reason of its trip, one line; empty without a trip."""
        return self._outside or self._found()

    @property
    def step_index(self) -> int:
        """Step of its trip; -1 without a trip."""
        return int(self.state.flags[STEP]) if self.state.flags[TRIP] else -1

    @property
    def nearest(self) -> tuple[str, float]:
        """The detector nearest to its threshold in this test, and its value over the threshold."""
        shares = self.state.detectors.shares.max(axis=1)
        row = int(shares.argmax())
        return DETECTORS[row].name, float(shares[row])

    def reset(self) -> None:
        """Begin a new test; also after a trip."""
        self.controller.reset()
        self._reset(self.state)
        self._outside = ""

    def step(self, index: int, points: Floats, state: Floats) -> Floats:
        """Compute the valve drive of one step.

        Parameters
        ----------
        index : int
            The step.
        points : ndarray
            See `ForceControl.step`.
        state : ndarray
            Measured displacement, velocity, acceleration and force, shape (4, n).

        Returns
        -------
        ndarray
            Valve drive, shape (n,), V.
        """
        points, state = (np.ascontiguousarray(values, np.float64) for values in (points, state))
        command = np.empty(len(self._axes))
        if self._begin(self.parameters, self.state, index, points, state, command):
            command[:] = self.controller.step(self.state.plan, self.state.sample)
            limited = self.controller.limited
            self._end(self.parameters, self.state, index, limited, command)
        return command

    def trip(self, index: int, reason: str) -> None:
        """Close the valve from now on; the first reason is kept."""
        if not self.reason:
            self._outside, self.state.flags[TRIP], self.state.flags[STEP] = reason, OUTSIDE, index

    def _found(self) -> str:
        """Describe the finding of the step of the trip."""
        code, state = self.state.flags[TRIP], self.state
        if code == NOTHING:
            return ""
        if code == ODD_DRIVE:
            return self._not_a_number("valve command", state.odd)
        if code == IMPLAUSIBLE:
            measured = zip(_MEASURED, state.measured[[3, 0, 1, 2]], strict=True)
            found = (self._not_a_number(f"measured {name}", values) for name, values in measured)
            return self.implausible(state.force) or next(filter(None, found))
        if code == FAULT:
            detectors = state.detectors
            return describe(int(state.flags[DETECTED]), detectors.found, self._axes)
        assert code == SATURATION
        return (
            f"the valve command is at its limit for more than {self._longest:g} s within one "
            "second: the force is out of control"
        )

    def implausible(self, reference_force: Floats) -> str:
        """Say what is wrong with a reference force, shape (n,); empty if nothing is."""
        for axis, value in zip(self._axes, reference_force.tolist(), strict=True):
            if abs(value) > self.parameters.largest:
                return (
                    f"reference force {value:.5g} N on axis {axis} is beyond the limit of "
                    f"{self.parameters.largest:g} N"
                )
        return self._not_a_number("reference force", reference_force)

    def _not_a_number(self, name: str, values: Floats) -> str:
        for axis, value in zip(self._axes, values.tolist(), strict=True):
            if not math.isfinite(value):
                return f"{name} on axis {axis} is {value}"
        return ""


class Interlocks:
    """The `Interlock` of each rig of a test, as the offline loop steps them.

    Parameters
    ----------
    rigs : sequence of (RigAxes, Interlock)
        The axes of each rig, and its interlock.
    """

    def __init__(self, rigs: Sequence[tuple[RigAxes, Interlock]]) -> None:
        self._rigs = [(list(of.places), interlock) for of, interlock in rigs]

    @property
    def reason(self) -> str:
        """Reason of the first of them that has tripped; empty without a trip."""
        return next((one.reason for _, one in self._rigs if one.reason), "")

    def reset(self) -> None:
        """Begin a new test; also after a trip."""
        for _, interlock in self._rigs:
            interlock.reset()

    def step(self, index: int, points: Floats, state: Floats) -> Floats:
        """Compute the valve drives of one step, see `Interlock.step`."""
        drive = np.empty(state.shape[1])
        for places, interlock in self._rigs:
            drive[places] = interlock.step(index, points[:, :, places], state[:, places])
        return drive


def interlock_of(experiment: Experiment) -> Interlock | Interlocks:
    """Make the interlock of a test, which has those of all rigs.

    Raises
    ------
    InputError
        If the force controller of a rig can't be made.
    """
    section, axes, timebase = experiment["force_controller"], experiment.axes, experiment.timebase
    made = []
    for rig in experiment.rigs:
        controller = force_control(section, axes, timebase, rig)
        made.append((rig, Interlock.from_parameters(controller, section, axes, timebase, rig)))
    return made[0][1] if len(made) == 1 else Interlocks(made)
