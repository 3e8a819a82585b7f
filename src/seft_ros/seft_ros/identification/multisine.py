"""The multisine test: sines of one displacement, one after the other; plan and drive.

At one amplitude the restoring force of a specimen that does not depend on rate has the same
complex stiffness at all frequencies, whatever its law is. What changes with the frequency is the
inertia. So the multisine test shows the mass, and the channels against each other
(`seft_ros.identification.multisine_estimates`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from seft_msgs_py.arrays import Complexes, Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS, FACTS, command_unit
from seft_msgs_py.config.parameter_table import group, symmetric_matrix
from seft_msgs_py.errors import InputError
from seft_plant_sim import lti
from seft_plant_sim.channels import per_channel
from seft_plant_sim.judge.known_rig import command_limit
from seft_plant_sim.limits import largest_force_rate
from seft_plant_sim.rig_parameters import LIMIT_ROWS

from seft_ros.design.plant import Plant, held_relations
from seft_ros.identification.identified import Identified, fitted_plant
from seft_ros.identification.rig_tests import PEAK_SHARE, known_mass

SINES = 6
"""On each axis: twice as many equations as the five unknowns of an axis leave some to check by."""
FREQUENCY_SPAN = 5.6
"""Highest over lowest frequency: the inertia, which tells the mass, differs 30 times."""
ORDER = (1, 5, 3, 2, 0, 4)
"""Of the frequencies, lowest 0: neither w nor w^2 is correlated with time or its square (0.03), so
that a specimen that degrades meanwhile is not taken for inertia."""
SECONDS = 20.0
"""Of the multisine test of an axis."""
PILOT_SECONDS = 4.0
"""Of the short multisine test that finds the commands."""
FEWEST_CYCLES = 8
"""Of each sine, where that takes longer."""
ACCURACY = 4e-4
"""Standard error of a scale, which determines the displacement by the noise. A scale that is wrong
by 1 % costs up to 3.3 % of the displacement (docs/rig.md), so this costs 0.1 %."""
OF_RATE = 0.097
"""Highest frequency over the rate: what held commands fold down to it is small (see
`fault_free_relations`). With 1/10 the 9th and the 11th overtone, which friction makes, would fold
down to the sine itself: at 250 Hz the mass was 2 % wrong with 50 N of friction."""
OF_ACTUATOR = 0.6
"""Highest frequency over that of the valve and of the oil column: there the piston still follows
without a resonance."""
LOWEST_TOP = 2.0
"""Least highest frequency, Hz; the multisine test is refused below: an axis takes a minute
there."""
RISE = 0.08
"""Part of a sine's time in which it rises, and in which it falls."""
SETTLED_SHARE = 0.16
"""Part of a sine's time after which it is evaluated, and before the end of which: what the rise
has excited has decayed."""
_QUANTISED = 12.0**-0.5  # RMS of the error of a converter, over its step


@dataclass(frozen=True)
class Multisine:
    """Plan of a multisine test.

    Attributes
    ----------
    travel : float
        Amplitude of the displacement of each sine, m.
    top : float
        Highest frequency, Hz; the lowest is `FREQUENCY_SPAN` times less.
    peaks : dict
        Largest expected ``displacement`` (m), ``velocity`` (m/s), ``acceleration`` (m/s^2) and
        ``force`` (N) of any axis, with the model that the test knows.
    """

    travel: float
    top: float
    peaks: dict[str, float]

    @property
    def frequencies(self) -> Floats:
        """Frequencies, lowest first, shape (`SINES`,), Hz."""
        return np.linspace(self.top / FREQUENCY_SPAN, self.top, SINES)

    def text(self) -> str:
        """Say what will be reached, in one line."""
        peaks = self.peaks
        sines = f"{SINES} sines of {1e3 * self.travel:.3g} mm on each axis, up to {self.top:.3g} Hz"
        v, a = f"{1e3 * peaks['velocity']:.3g} mm/s", f"{peaks['acceleration']:.3g} m/s²"
        return f"multisine: {sines}; peaks up to {v}, {a}, {peaks['force']:.3g} N"


def plan_multisine(
    experiment: Experiment, travel: float | None = None, cap: float = math.inf
) -> Multisine:
    """Plan a multisine test before anything moves.

    The displacement follows from the noise of the sensors (``sensors.*_noise``, and the steps
    of the simulated rig's converter): the sines of an axis together tell scale and mass with a
    standard error of `ACCURACY`. The highest frequency is `OF_RATE` times the rate, or less, so
    that peaks reach half of the limits and of the sensors' ranges at most.

    Parameters
    ----------
    experiment : Experiment
        Its ``specimen.*`` say which forces to expect.
    travel : float, optional
        Displacement, m, in place of the one that follows from the noise.
    cap : float
        That no axis shall exceed, m. The one that follows from the noise is a quarter of it at
        most: the sines of the pilot may be twice as large as planned, see `gains_after`.

    Raises
    ------
    InputError
        If no frequency is within the limits, or the noise is not known.
    """
    rate, axes = experiment.timebase.rate, experiment.axes
    section = experiment["reference_force"]
    mass, where = known_mass(experiment), "/**: specimen.stiffness"
    stiffness = symmetric_matrix(section["specimen.stiffness"], axes, where)
    noise = _noise(experiment)
    if travel is None and not noise["displacement"].any():
        text = "but the displacement of the multisine test follows from it"
        mend = "enter the sensor's noise, or give --travel"
        raise InputError(f"/**: sensors.displacement_noise is 0, {text}; {mend}")
    if travel is not None and not 0 < travel < float("inf"):
        raise InputError(f"--travel is {travel:g} m, but must be positive")
    allowed = _allowed(experiment)
    steps = math.ceil(math.log(OF_RATE * rate / LOWEST_TOP) / math.log(1.05))
    for top in np.geomspace(OF_RATE * rate, LOWEST_TOP, steps + 1):
        needed = travel
        if needed is None:
            needed = min(_needed(noise, mass, stiffness, top, rate), PEAK_SHARE**2 * cap)
        multisine = Multisine(needed, float(top), _peaks(needed, top, mass, stiffness))
        if not (over := _over(multisine, allowed)):
            return multisine
    how = "give a smaller --travel" if travel is not None else "raise it, or give --travel"
    raise InputError(f"the multisine test would reach {over}; {how}")


def _noise(experiment: Experiment) -> dict[str, Floats]:
    """RMS noise of each channel, with that of the converter, by axis."""
    section, found = experiment["reference_force"], {}
    every = per_channel(section, experiment.axes, "sensors.{}_noise")
    for name, noise in zip(CHANNELS, every, strict=True):
        bits = section["sensors.adc_bits"]
        step = 2.0 * np.max(section[f"sensors.{name}_range"]) / 2**bits if bits else 0.0
        found[name] = np.hypot(noise, _QUANTISED * step)
    return found


def _needed(
    noise: Mapping[str, Floats], mass: Floats, stiffness: Floats, top: float, rate: float
) -> float:
    """Displacement that tells scale and mass to `ACCURACY` on every axis, m."""
    w = 2 * np.pi * top
    inertia = np.diag(mass) * w * w
    of_x = noise["displacement"] * np.maximum(1.0, np.abs(np.diag(stiffness)) / inertia)
    per_sample = np.maximum.reduce([of_x, noise["acceleration"] / w**2, noise["force"] / inertia])
    return float(per_sample.max() / ACCURACY * np.sqrt(2.0 / (SECONDS * rate)))


def _peaks(travel: float, top: float, mass: Floats, stiffness: Floats) -> dict[str, float]:
    """Largest magnitudes at the highest frequency; the force is an upper bound."""
    w = 2 * np.pi * top
    force = float((np.abs(stiffness) + w * w * np.abs(mass)).max()) * travel
    return dict(zip(CHANNELS, (travel, w * travel, w * w * travel, force), strict=True))


def _allowed(experiment: Experiment) -> dict[str, tuple[float, str]]:
    """Largest peak of each quantity and rate of change, and the parameter that says so."""
    limits = group(experiment["supervisor"], "limits")
    limits["force_rate"] = largest_force_rate(limits)
    allowed = {name: (float(limits[name]), f"/**: limits.{name}") for name in LIMIT_ROWS}
    for name in CHANNELS:
        ranges = np.ravel(experiment["reference_force"][f"sensors.{name}_range"])
        if ranges.any():
            smallest = float(ranges[ranges > 0.0].min())
            allowed[name] = min(allowed[name], (smallest, f"/**: sensors.{name}_range"))
    return allowed


def _over(multisine: Multisine, allowed: Mapping[str, tuple[float, str]]) -> str:
    """Say which peak is too large, if any."""
    w = 2 * np.pi * multisine.top
    for name, (limit, where) in allowed.items():
        peak = multisine.peaks.get(name, w * multisine.peaks.get(name.removesuffix("_rate"), 0.0))
        if peak > PEAK_SHARE * limit:
            unit = FACTS[f"limits.{name}"].unit
            sine = f"{1e3 * multisine.travel:.3g} mm at {multisine.top:.3g} Hz"
            return f"{peak:.3g} {unit} with {sine}, more than half of {where}, {limit:g} {unit}"
    return ""


@dataclass(frozen=True)
class Sine:
    """One sine of the test: axis, frequency in Hz, first and last step that are evaluated."""

    axis: int
    frequency: float
    first: int
    end: int


def with_actuators(multisine: Multisine, found: Identified, experiment: Experiment) -> Multisine:
    """Fit a multisine test to the actuators: its highest frequency is lowered where need be.

    To `OF_ACTUATOR` times that of valve and oil column, and so far that commands reach half of the
    voltage limit at most.

    Raises
    ------
    InputError
        If the lowest frequency needs more.
    """
    valves = [valve.actuator.valve_frequency for valve in found.valves]
    oil = [column.hz for valve in found.valves if (column := valve.plant.oil_column())]
    servos = [bandwidth for each in found.closed_loops if (bandwidth := each.tracking.bandwidth_hz)]
    followed = servos if found.has_servos else valves + oil
    top = min([multisine.top, *(OF_ACTUATOR * each for each in followed)])
    limit = command_limit(experiment["force_controller"])
    frequencies = np.geomspace(top / FREQUENCY_SPAN, top, 33)
    voltage = multisine.travel / _moved(found, frequencies).min(axis=1)
    within = np.maximum.accumulate(voltage) <= PEAK_SHARE * limit
    unit = command_unit(experiment["force_controller"]["actuator.kind"])
    if not within[0]:
        sine = f"{1e3 * multisine.travel:.3g} mm at {frequencies[0]:.3g} Hz"
        half = f"half of /**: limits.command, {limit:g} {unit}; give a smaller --travel"
        needs = f"the multisine test would need {voltage[0]:.3g} {unit} with {sine}"
        raise InputError(f"{needs}, more than {half}")
    return replace(multisine, top=float(frequencies[within][-1]))


def _moved(found: Identified, frequencies: Floats) -> Floats:
    """Displacement of each axis per command, at m frequencies, shape (m, n), m/V or 1."""
    if found.has_servos:
        servos = [loop.fit.model.response(frequencies) for loop in found.closed_loops]
        return np.asarray(np.abs(servos).T)
    plant, n = _plant(found), len(found.axes)
    points = np.asarray(2j * np.pi * frequencies, dtype=np.complex128)
    response = lti.state_space_response(plant.a, plant.b, plant.c, plant.d, points)
    moved: Floats = np.abs(np.diagonal(response[:, :n], axis1=1, axis2=2))
    return moved


def _plant(found: Identified) -> Plant:
    return fitted_plant(found.specimen, [valve.actuator for valve in found.valves], motion=True)


def multisine_drive(
    multisine: Multisine,
    found: Identified,
    dt: float,
    seconds: float = SECONDS,
    gains: Floats | None = None,
) -> tuple[Floats, list[Sine]]:
    """Valve commands of a multisine test.

    Parameters
    ----------
    multisine : Multisine
        Its plan, see `with_actuators`.
    found : Identified
        The rig, which tells the commands for the displacement.
    dt : float
        Sampling period, s.
    seconds : float
        Of each axis.
    gains : ndarray, optional
        Factor on each sine, shape (m,), see `gains_after`.

    Returns
    -------
    commands : ndarray
        Shape (N, n), V: the sines of the first axis in `ORDER`, then those of the next. Each
        rises and falls slowly, so that the piston does not drift.
    sines : list of Sine
        Evaluated over whole cycles.
    """
    n, first = len(found.axes), 0
    parts, sines = list[Floats](), list[Sine]()
    volts = multisine.travel / _moved(found, multisine.frequencies)
    for axis in range(n):
        for place in ORDER:
            frequency = float(multisine.frequencies[place])
            steps = round(max(seconds / SINES, FEWEST_CYCLES / frequency) / dt)
            at = np.arange(steps)
            rise = np.clip(np.minimum(at, steps - 1 - at) / (RISE * steps), 0.0, 1.0)
            window = 0.5 - 0.5 * np.cos(np.pi * rise)
            gain = volts[place, axis] * (1.0 if gains is None else gains[len(sines)])
            command = np.zeros((steps, n))
            command[:, axis] = gain * window * np.cos(2 * np.pi * frequency * dt * at)
            parts.append(command)
            begin = int(SETTLED_SHARE * steps)
            cycles = int((steps - 2 * begin) * frequency * dt)
            end = begin + round(cycles / (frequency * dt))
            sines.append(Sine(axis, frequency, first + begin, first + end))
            first += steps
    return np.concatenate(parts), sines


def gains_after(multisine: Multisine, moved: Floats) -> Floats:
    """Factors on the sines of a multisine test after a pilot, in which they moved so much, (m,), m.

    Between 1/2 and 2: where the pilot was held by friction, more may move it suddenly.
    """
    factors: Floats = np.clip(multisine.travel / np.maximum(moved, 1e-30), 0.5, 2.0)
    return factors


def no_images(lines: int) -> tuple[Complexes, Floats]:
    """Give `fault_free_relations` of a rig of whose commands nothing folds down."""
    return np.ones((lines, 2), dtype=np.complex128), np.zeros((lines, 3))


def fault_free_relations(
    found: Identified,
    sines: Sequence[Sine],
    dt: float,
    dead_time: float,
    lag: Floats,
    filters: tuple[Floats, Floats],
) -> tuple[Complexes, Floats]:
    """Velocity and acceleration of a fault-free rig over x's derivatives, see `held_relations`.

    Parameters
    ----------
    found, sines, dt
        The rig, the multisine test, and the sampling period, s.
    dead_time : float
        Of the valves alone, s.
    lag : ndarray
        Of each channel, shape (4, n), s.
    filters : tuple of ndarray
        p and q of each channel's filter, (4, n) each.

    Returns
    -------
    relations : ndarray
        Shape (m, 2), without the lags themselves.
    unsure : ndarray
        What is not known of them, shape (m, 3).
    """
    frequencies = np.array([sine.frequency for sine in sines])
    if found.has_servos:  # what folds down is what a servo does not follow
        return no_images(len(sines))
    plant, at = replace(_plant(found), delay=dead_time), np.arange(len(sines))
    held, unsure = held_relations(plant, frequencies, dt, lag, filters)
    moved = [sine.axis for sine in sines]
    return held[at, :, moved], unsure[at, :, moved]
