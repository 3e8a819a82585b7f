"""The ground motion for which the measured test is exact, and how well forces were followed.

Undefined results (of a command that is zero throughout, of too few samples, of values that are not
finite) are NaN.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import GROUND_MOTION, REFERENCE_FORCE, TARGET
from seft_plant_sim.channels import ACCELERATION, DISPLACEMENT, FORCE
from seft_plant_sim.whole_structure import WholeStructure, reference_response, whole_structure

from seft_ros.analysis import metrics
from seft_ros.analysis.channel_estimates import noise_of, with_motion, without_folding
from seft_ros.analysis.metrics import nrmse
from seft_ros.analysis.specimen_law import SpecimenLaw, springs_of
from seft_ros.bags.recording import Recording, every_step
from seft_ros.ground_motion.response_spectrum import response_spectrum

DAMPING = 0.05
"""Of the oscillators of a spectrum."""
BAND_MARGIN = 2.0
"""Spectra must agree from the lowest natural frequency over this to the highest times this: a
specimen that yields makes the structure softer, and one that closes gaps stiffer."""
_DRAWN = 4  # times, noise
_PERIODS, _AROUND = 60, 4.0  # of a spectrum, and how far it goes beyond the structure's frequencies


def assumed_structure(experiment: Experiment) -> Experiment | None:
    """Give the structure that the reference-force node assumes, the model and what is computed.

    Returns
    -------
    Experiment or None
        One without a rig: its whole structure is linear. None if the experiment does not describe
        one, or it has a computed model.
    """
    section = experiment.sections.get("reference_force", {})
    try:
        assumed = Experiment({"reference_force": section})
        computed = whole_structure(assumed).computed
        if computed.model is not None or computed.on_axes is not None:
            return None
    except (InputError, KeyError):
        return None
    return assumed


class EquivalentMotion:
    """Computes the ground motion of a test from measurements.

    With the specimen's restoring force r = f - M_e a, and the force g of what is computed beside
    lumped mass (docs/theory.md, "More than lumped mass"), the whole structure obeys
    (M_e + M_c) (a + a_eq) + g = -r, so

        a_eq = -(M_e + M_c)^-1 (f + M_c a + g)

    Whatever the specimen is, the test is exact for a_eq. Internal degrees of freedom are driven by
    a_eq as well; they are integrated exactly where what was measured is linear between samples.
    In an EFT test the specimen carries all of the mass, and a_eq = -(M_e + M_c)^-1 f.

    Parameters
    ----------
    whole : WholeStructure
        Specimen and computed substructure; of the specimen the mass alone counts.
    dt : float
        Sampling period, s.

    The attribute ``mass`` is M_e, that of the specimen, shape (n, n), kg.
    """

    def __init__(self, whole: WholeStructure, dt: float) -> None:
        computed = whole.computed.without_inertial_coupling()
        n = computed.axes
        on_axes = (slice(n), slice(n))
        self.mass = (whole.structure.mass[on_axes] - whole.computed.mass[on_axes]).copy()
        self._computed, self._dt = computed, dt
        self._inverse = np.linalg.inv(self.mass + computed.mass[on_axes])
        self._internal = np.zeros(2 * computed.internal)
        self._last: Floats | None = None  # input of the internal degrees of freedom

    def advance(self, states: Floats) -> Floats:
        """Go on over the next N >= 1 steps, the first of all step 0, at rest; give a_eq, (N, n).

        ``states`` are displacement, velocity, acceleration and force as measured, (N, 4, n).
        """
        x, v, a, f = np.moveaxis(states, 1, 0)
        n, computed = len(self.mass), self._computed
        m, c, k = (part[:n, :n] for part in (computed.mass, computed.damping, computed.stiffness))
        force = f + a @ m.T + v @ c.T + x @ k.T
        if computed.internal:
            force += self._pull(np.hstack([x, v, force]))
        return -force @ self._inverse.T

    def _pull(self, given: Floats) -> Floats:
        """Force of the internal degrees of freedom on the axes, from (x, v, the other force)."""
        from scipy.signal import lsim  # 20 MB that others need not have

        n, q, computed = len(self.mass), self._computed.internal, self._computed
        mass = computed.mass[n:, n:]
        k, c = (np.linalg.solve(mass, y[n:]) for y in (computed.stiffness, computed.damping))
        pull = np.hstack([computed.stiffness[:n, n:], computed.damping[:n, n:]])
        driven = computed.influence @ self._inverse
        a = np.vstack([np.eye(q, 2 * q, q), driven @ pull - np.hstack([k[:, n:], c[:, n:]])])
        b = np.vstack([np.zeros((q, 3 * n)), np.hstack([-k[:, :n], -c[:, :n], driven])])
        inputs = given if self._last is None else np.vstack([self._last, given])
        system = (a, b, pull, np.zeros((n, 3 * n)))
        times = self._dt * np.arange(len(inputs))
        _, force, internal = lsim(system, inputs, times, self._internal)
        self._internal = internal.reshape(len(inputs), -1)[-1]
        self._last = given[-1:].copy()
        return force.reshape(len(inputs), n)[len(inputs) - len(given) :]


@dataclass(frozen=True)
class MotionDifference:
    """A test's own ground motion against the one that was asked for.

    Attributes
    ----------
    natural_hz, damping : ndarray
        Natural frequencies and damping ratios of the linear whole structure, shape (d,).
    response_nrmse : float
        RMS(y_eq - y) / RMS(y), with y and y_eq the displacements of that structure under both
        motions.
    specimen_nrmse : float
        The same of the whole structure with the specimen's own law, see `SpecimenLaw`.
    noise_nrmse : float
        What of that the noise of force and acceleration alone would make.
    band_hz : tuple of float
        See `BAND_MARGIN`.
    frequency_hz : ndarray
        Of the spectra, shape (P,), increasing.
    asked, tested : ndarray
        Response spectra (pseudo-acceleration, 5 % damping), shape (P, n), m/s^2.
    """

    natural_hz: Floats
    damping: Floats
    response_nrmse: float
    specimen_nrmse: float
    noise_nrmse: float
    band_hz: tuple[float, float]
    frequency_hz: Floats
    asked: Floats
    tested: Floats

    def numbers(self) -> dict[str, Any]:
        """For JSON; docs/metrics.md explains each number."""
        low, high = self.band_hz
        inside = (self.frequency_hz >= low * (1 - 1e-9)) & (self.frequency_hz <= high * (1 + 1e-9))
        frequency = self.frequency_hz[inside]
        with np.errstate(divide="ignore", invalid="ignore"):
            deviation = self.tested[inside] / self.asked[inside] - 1.0
        size = np.where(np.isfinite(deviation), np.abs(deviation), -1.0)
        place = np.unravel_index(np.argmax(size), size.shape) if (size >= 0).any() else None
        return {
            "response_nrmse": self.response_nrmse,
            "specimen_response_nrmse": self.specimen_nrmse,
            "noise_nrmse": self.noise_nrmse,
            "spectrum_deviation": None if place is None else float(deviation[place]),
            "spectrum_deviation_frequency_hz": place and float(frequency[place[0]]),
            "structure": {
                "frequency_hz": self.natural_hz.tolist(),
                "damping_ratio": self.damping.tolist(),
                "band_hz": list(self.band_hz),
                "spectrum_damping_ratio": DAMPING,
            },
        }


def motion_difference(recording: Recording) -> MotionDifference | None:
    """Compare the ground motion of which a test is the exact one with the one asked for.

    It needs no specimen model: the specimen answers both by the law that it had in this test.

    Returns
    -------
    MotionDifference or None
        None if the recording does not begin with step 0, lacks ground motion, holds what is not
        finite, or does not describe a structure with stiffness.
    """
    assumed = assumed_structure(recording.experiment)
    states, motion = recording.states, recording.series[GROUND_MOTION.name]
    count = int(states.steps[-1]) + 1 if len(states.steps) else 0
    begun = count > 1 and states.steps[0] == 0
    whole = begun and np.array_equal(motion.steps[:count], np.arange(count))
    if assumed is None or not whole or not np.isfinite(states.values).all():
        return None
    measured, asked = every_step(states, np.arange(count)), motion.values[:count, 0, :]
    structure, dt = whole_structure(assumed), recording.experiment.timebase.dt
    natural, damping = structure.structure.modes()
    if not len(natural):
        return None
    equivalent = EquivalentMotion(structure, dt)
    with np.errstate(over="ignore", invalid="ignore"):  # of a test that went unstable
        seen = without_folding(measured, equivalent.mass, recording.experiment)
        noise = noise_of(measured)
        tested = equivalent.advance(with_motion(seen, noise, dt))
        of_tested, of_asked = (reference_response(assumed, y) for y in (tested, asked))
        first = nrmse(of_tested.displacement, of_asked.displacement)
        springs = springs_of(assumed, structure)
        law = SpecimenLaw(structure, equivalent.mass, measured, springs, dt)
        specimen = law.difference(asked - tested)
        drawn = (with_motion(one, noise, dt) for one in _noise(measured, equivalent.mass))
        of_noise = [law.difference(EquivalentMotion(structure, dt).advance(y)) for y in drawn]
        band = (float(natural[0]) / BAND_MARGIN, float(natural[-1]) * BAND_MARGIN)
        frequency = spectrum_frequencies(band, dt)
        spectra = [
            np.stack([response_spectrum(y, dt, 1 / frequency, DAMPING) for y in a.T], axis=1)
            for a in (asked, tested)
        ]
    unsure = float(np.sqrt(np.mean(np.square(of_noise))))
    return MotionDifference(natural, damping, first, specimen, unsure, band, frequency, *spectra)


def _noise(samples: Floats, mass: Floats) -> Iterator[Floats]:
    """Draw noise like that of displacement, acceleration and force, shape (N, 4, n), some times.

    That of the last two is the size of f - M a, in which a motion that no noise is, such as that of
    the oil column, cancels.
    """
    a, f = samples[:, ACCELERATION], samples[:, FORCE]
    inertial = a @ mass.T
    size = noise_of(f - inertial) / np.maximum(np.hypot(noise_of(f), noise_of(inertial)), 1e-300)
    sizes = np.minimum(size, 1.0) * noise_of(samples)
    sizes[DISPLACEMENT] = noise_of(samples[:, DISPLACEMENT])
    rng = np.random.default_rng(0)
    for _ in range(_DRAWN):
        drawn = rng.standard_normal(samples.shape)
        drawn *= sizes
        yield drawn


def spectrum_frequencies(band_hz: tuple[float, float], dt: float) -> Floats:
    """Choose the frequencies (Hz) of a spectrum: the band, and two octaves on either side.

    They end at a tenth of the sampling rate: above, peaks are between samples.
    """
    low, high = band_hz[0] / _AROUND, min(band_hz[1] * _AROUND, 0.1 / dt)
    return np.geomspace(min(low, high / 2), high, _PERIODS)


SENT_AS_MEANT = ("none", "restoring", "target_motion")
"""Compensation methods whose reference force is that of its own step; others send it ahead."""


@dataclass(frozen=True)
class Tracked:
    """Signals at every step from the first to the last that both topics have.

    Attributes
    ----------
    steps : ndarray of int64
        Shape (N,), consecutive.
    counted : ndarray of int64
        Indices of those that both topics have, increasing.
    command, force : ndarray
        Intended and measured force, N, shape (N, n); lost samples are interpolated.
    derived : bool
        Whether the intended force is derived from measurements, and not the one sent.
    """

    steps: Ints
    counted: Ints
    command: Floats
    force: Floats
    derived: bool


def tracked_of(recording: Recording) -> Tracked:
    """Pair the intended with the measured force.

    The intended force is the reference force of the same step; where the compensation method
    sends that ahead of time, it is f* = -M_e a_g + S r, from measurements (docs/theory.md, "The
    algebraic loop solved"). With the test's own ground motion a_eq this is
    f* = f + M_e (a_eq - a_g), whatever is computed.
    """
    commands, motion = (recording.series[topic.name] for topic in (REFERENCE_FORCE, GROUND_MOTION))
    states = recording.states
    steps, _, _ = metrics.common_steps(commands.steps, states.steps)
    every = np.arange(steps[0], steps[-1] + 1) if len(steps) else steps
    counted = steps - every[:1]
    measured = every_step(states, every)
    force = measured[:, FORCE]
    section = recording.experiment.sections.get("reference_force", {})
    assumed = assumed_structure(recording.experiment)
    ahead = section.get("compensation.method", "none") not in SENT_AS_MEANT
    command = every_step(commands, every)[:, -1]  # effort, with a target's motion or not
    derived = bool(ahead and assumed and len(motion.steps) and len(every))
    if derived and assumed:
        equivalent = EquivalentMotion(whole_structure(assumed), recording.experiment.timebase.dt)
        with np.errstate(over="ignore", invalid="ignore"):  # of a test that went unstable
            difference = equivalent.advance(measured) - every_step(motion, every)[:, 0]
            command = force + difference @ equivalent.mass.T
    return Tracked(every, counted, command, force, derived)


def tracking_of(recording: Recording) -> dict[str, dict[str, float]]:
    """Measure the tracking of each axis.

    The intended force is that of `tracked_of`. Where it is the reference force of the same step,
    even an ideal actuator is one period late: the rig measures at step k what commands before it
    did. Samples between the first and the last step that both topics have count; lost ones are
    left out of errors, and interpolated for the delay.

    Returns
    -------
    dict
        Axis -> ``delay_s`` (best-fit pure delay, positive where the measured force m lags the
        intended one c), ``nrmse``, RMS(m - c) / RMS(c), and ``peak_error``, max|m - c| / max|c|.
    """
    signals, dt = tracked_of(recording), recording.experiment.timebase.dt
    found = {}
    with np.errstate(invalid="ignore", over="ignore"):  # of a test that went unstable
        for column, axis in enumerate(recording.experiment.axes):
            c, m = (y[:, column] for y in (signals.command, signals.force))
            error = (m - c)[signals.counted]
            found[axis] = {
                "delay_s": metrics.best_fit_delay(m, c, dt),
                "nrmse": metrics.nrmse(m[signals.counted], c[signals.counted]),
                "peak_error": metrics.ratio(metrics.peak(error), metrics.peak(c[signals.counted])),
            }
    return found


def tracking_error_of(recording: Recording) -> dict[str, float] | None:
    """Compare the displacement of a test with its target; None: the reference force has none.

    Returns
    -------
    dict
        ``rms`` and ``peak`` of x - x_target, m, over all axes, and ``nrmse``, that RMS over the
        RMS of x.
    """
    targets, states = recording.series[REFERENCE_FORCE.name], recording.states
    if targets.values.shape[1] < len(TARGET.quantities):
        return None
    _, at_targets, at_states = metrics.common_steps(targets.steps, states.steps)
    wanted, x = targets.values[at_targets, 0], states.values[at_states, DISPLACEMENT]
    with np.errstate(invalid="ignore", over="ignore"):
        error = wanted - x
        rms = float(np.sqrt(np.mean(np.square(error)))) if error.size else np.nan
    return {"rms": rms, "peak": metrics.peak(error), "nrmse": metrics.nrmse(wanted, x)}
