"""Fit of an actuator model to one test, with any specimen, on the balance of its oil."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft
from scipy.optimize import OptimizeResult, least_squares, nnls
from seft_msgs_py.arrays import Complexes, Floats
from seft_plant_sim.judge.valve_model import ValveModel

_MEMORY = 0.2
"""Time after which the flow of a command is complete, s."""
_WIDTH, _LEAST_WIDTH = 0.05, 2.0  # over which spectra are smoothed: of the frequency, and Hz
_BINS = 80
_AVERAGED = 32  # lines of the spectrum that are one frequency
_ROUGH = 0.03  # of the flow: error of a first fit


class OilBalance:
    """One axis of a test, from rest to rest: q w = v + (f' + friction' + lambda f) / k_oil.

    It is taken over each sampling period. The mean of a rate over a period is a difference of
    samples, so that frequencies beyond half the sampling rate cause no error.

    Parameters
    ----------
    signals : sequence of ndarray
        Valve command (V); displacement (m), acceleration (m/s^2), force (N) as measured; (N,).
    dt : float
        Sampling period, s.
    band : tuple of float
        Lowest and highest frequency that counts, Hz.

    Attributes
    ----------
    dt : float
        As given.
    velocity, rise, between : ndarray
        Mean over each period of the piston's velocity (m/s), of the force's rate (N/s), and of
        the force (N), shape (N - 1,).
    largest_force : float
        N.
    rough : ndarray
        Error that a first fit may leave at each of F frequencies within the band, m/s.
    """

    def __init__(self, signals: Sequence[Floats], dt: float, band: tuple[float, float]) -> None:
        commands, positions, accelerations, forces = signals
        self._n, self.dt = len(commands) - 1, dt
        self._times = np.arange(math.ceil(_MEMORY / dt) + 1, dtype=np.float64) * np.float64(dt)
        self._size = scipy.fft.next_fast_len(self._n + math.ceil(_MEMORY / dt), real=True)
        self._hz: Floats = scipy.fft.rfftfreq(self._size, dt)
        self._used = (self._hz >= band[0]) & (self._hz <= band[1])
        self._commands = self._spectrum(commands[:-1])
        self._drive = self._commands[self._used].conj()
        self._last: dict[str, tuple[bytes, Complexes]] = {}
        self._blocks = np.arange(0, len(self._drive), _AVERAGED)
        self._counts = np.diff(self._blocks, append=len(self._drive))
        drive = np.add.reduceat(np.abs(self._drive) ** 2, self._blocks)
        self._size_of_drive = np.sqrt(np.maximum(drive * self._counts, 1e-30))
        f = np.add.reduceat(self._hz[self._used], self._blocks) / self._counts
        half = np.maximum(_WIDTH * f, _LEAST_WIDTH)
        self._around = np.searchsorted(f, f - half), np.searchsorted(f, f + half, "right")
        self.rise, self.between = np.diff(forces) / dt, (forces[:-1] + forces[1:]) / 2
        self.largest_force = float(np.abs(forces).max())
        self._at_samples, self.velocity, noise = self._motion(positions, accelerations)
        self._of_motion = self._of(self.velocity)
        self._of_force = np.stack([self._of(self.rise), self._of(self.between)], axis=1)
        noise_left = np.add.reduceat(noise, self._blocks) / self._counts**2
        power = drive / self._counts
        gain = self.smooth(np.abs(self._of_motion) ** 2) / np.maximum(self.smooth(power), 1e-30)
        self.rough: Floats = np.sqrt(noise_left + _ROUGH**2 * gain.max() * power + 1e-30)

    def _spectrum(self, signal: Floats) -> Complexes:
        return scipy.fft.rfft(signal, self._size)

    def _back(self, spectrum: Complexes) -> Floats:
        return scipy.fft.irfft(spectrum, self._size)[: self._n]

    def _of(self, signal: Floats) -> Complexes:
        """Part of a signal that is correlated with the commands, at each of F frequencies.

        Noise is not correlated with the commands: it averages out.
        """
        spectrum = self._spectrum(signal)[self._used]
        products = np.add.reduceat(spectrum * self._drive, self._blocks)
        return products / self._size_of_drive

    def _of_last(self, signal: Callable[[Floats], Floats], p: Floats, used: slice) -> Complexes:
        """Part of a signal of parameters, of which it uses some; again if these are the last."""
        name, key = signal.__name__, p[used].tobytes()
        if self._last.get(name, (b"",))[0] != key:
            self._last[name] = key, self._of(signal(p))
        return self._last[name][1]

    def within(self, signal: Floats) -> Floats:
        """Take the part of a signal that lies within the band."""
        return self._back(np.where(self._used, self._spectrum(signal), 0.0))

    def smooth(self, power: Floats) -> Floats:
        """Mean over the frequencies around each one."""
        total, (low, high) = np.concatenate([[0.0], np.cumsum(power)]), self._around
        return (total[high] - total[low]) / (high - low)

    def _motion(self, positions: Floats, accelerations: Floats) -> tuple[Floats, Floats, Floats]:
        """Velocity from displacement and acceleration, each where it has the less error.

        Both have white noise, whose powers follow from their difference. Images of the held
        commands at 1 / dt - f fold down to the acceleration at f; there the actuator moves no more
        than at the end of the band. Returned are the velocity at the beginning of each period and
        its mean over it, in m/s, and the power of the displacement's noise in such a mean at each
        line of the spectrum within the band.
        """
        s = 2j * np.pi * np.maximum(self._hz, self._hz[1])
        change = np.expm1(s * self.dt)
        gains = np.stack([change / self.dt, change / (self.dt * s * s)])  # of x and a
        by_position = self._spectrum(np.diff(positions) / self.dt)
        accelerated = self._spectrum(accelerations[:-1])
        both = np.stack([by_position, gains[1] * accelerated])
        powers = np.abs(gains) ** 2
        bins = np.unique(np.geomspace(1, self._used.sum(), _BINS).astype(int)) - 1
        off = np.add.reduceat(np.abs(both[0] - both[1])[self._used] ** 2, bins)
        rows = np.stack([np.add.reduceat(power[self._used], bins) for power in powers], axis=1)
        rows = rows / np.maximum(off, 1e-30)[:, np.newaxis]
        sizes = np.linalg.norm(rows, axis=0)
        sensors = np.maximum(nnls(rows / sizes, np.ones(len(off)))[0] / sizes, 1e-30)
        noise = sensors[:, np.newaxis] * powers
        noise[1] += np.abs(gains[1] * self._images(accelerated)) ** 2
        weights = 1.0 / noise
        mean = (weights * both).sum(axis=0) / weights.sum(axis=0)
        return self._back(mean * s * self.dt / change), self._back(mean), noise[0, self._used]

    def _images(self, accelerated: Complexes) -> Complexes:
        """Give the most that images of the commands make of a spectrum, at each of its lines."""
        last = np.flatnonzero(self._used)[-_AVERAGED:]
        at_end, commands = self._hz[last].mean(), self._commands[last]
        gain = commands.conj() @ accelerated[last] / (commands.conj() @ commands)
        return self._commands * gain * (at_end / (1.0 / self.dt - self._hz))

    def flow(self, p: Floats) -> Floats:
        """Flow of the commands over q, V, shape (N - 1,).

        The parameters p are, here and below, the logarithms of the valve's frequency (Hz) and
        damping ratio, its dead time in ms, the largest force over the force capacity, the
        logarithm of the velocity (m/s) over which friction builds up, and the lag in ms of a
        Butterworth filter of second order that all sensors have: 1 / (1 + s lag + (s lag)^2 / 2).
        """
        valve = ValveModel(math.exp(p[0]), math.exp(p[1]), p[2] / 1e3, self.dt)
        pulse = np.diff(valve.volume(self._times)) / self.dt
        late = 2j * np.pi * self._hz * p[5] / 1e3
        filtered = self._commands / (1.0 + late + late * late / 2.0)
        flow = self._back(filtered * self._spectrum(pulse))
        return flow * np.sqrt(1.0 - np.sign(flow) * p[3] / self.largest_force * self.between)

    def slip(self, p: Floats) -> Floats:
        """Rate of a friction of 1 N; N/s, (N - 1,)."""
        return np.diff(np.tanh(self._at_samples / math.exp(p[4])), append=0.0) / self.dt

    def drag(self, p: Floats) -> float:
        """Viscous friction equivalent to a friction of 1 N in this test, N s/m."""
        v = self._at_samples
        return float(v @ np.tanh(v / math.exp(p[4]))) / max(float(v @ v), 1e-30)

    def left(self, p: Floats, deviation: Floats) -> tuple[Floats, Floats]:
        """Power of the residual of `solve`, and of the commands' flow; shape (F,), smoothed."""
        solution, _, errors = self.solve(p, deviation)
        power = (errors.reshape(2, -1) ** 2).sum(axis=0) * deviation**2
        flow = np.abs(solution[0] * self._of_last(self.flow, p, slice(6))) ** 2
        return self.smooth(power), self.smooth(flow)

    def solve(self, p: Floats, deviation: Floats) -> tuple[Floats, Floats, Floats]:
        """Solve v = q w - (f' + lambda f + friction') / k_oil for its linear parameters.

        Of parameters p, see `flow`, with an expected error at each frequency, shape (F,).

        Returns
        -------
        solution, deviations : ndarray
            q, 1 / k_oil, lambda / k_oil and friction / k_oil, and their standard deviations.
        errors : ndarray
            Residual over its expected error, real parts, then imaginary parts.
        """
        flow = self._of_last(self.flow, p, slice(6))
        slip = self._of_last(self.slip, p, slice(4, 5))
        terms = np.column_stack([flow, -self._of_force, -slip, self._of_motion])
        terms = terms / deviation[:, np.newaxis]
        split = np.concatenate([terms.real, terms.imag])
        columns, target = split[:, :4], split[:, 4]
        scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-30)
        columns = columns / scale
        inverse = np.linalg.pinv(columns.T @ columns)
        solution = inverse @ (columns.T @ target)
        errors = columns @ solution - target
        variance = inverse.diagonal() * float(np.mean(errors**2))
        return solution / scale, np.sqrt(np.maximum(variance, 0.0)) / scale, errors


MIN_EXPLAINED, GOOD_EXPLAINED = 0.5, 0.9
"""Share of the flow's variance that a fit must explain, and that a good one does."""

_VALVES, _DEAD_TIMES = (25.0, 50.0, 100.0, 200.0), (0.0, 2.0, 5.0, 10.0, 20.0)  # Hz, ms: starts
_DAMPING, _LOAD, _OVER = math.log(0.7), 0.02, math.log(0.005)  # first guesses
_MOST_STEPS = 30
_TOLERANCE = 0.01  # of the flow at a frequency: accuracy of the model itself
_LEAST_LOAD = 0.15  # of the force capacity: below, friction can be taken for it
_STANDS_OUT = 4.0  # standard deviations: by chance once in 30,000 tests
_UNSURE = 0.1  # relative standard deviation; of the dead time in ms
_DOUBTED = ("flow_gain", "oil_stiffness", "valve_frequency", "valve_damping", "dead_time")
_LOWEST = np.array([math.log(3.0), math.log(0.1), 0.0, 0.0, math.log(2e-4), 0.0])
_HIGHEST = np.array([math.log(1000.0), math.log(3.0), 50.0, 0.9, math.log(0.1), 20.0])
_SCALE = np.array([0.1, 0.1, 0.1, 0.01, 0.3, 0.1])
_FILTER_LAG = 1.0  # ms, of a filter of 225 Hz: first guess
_FILTERED = 0.5  # part of what no filter leaves: a filter that leaves more is none


@dataclass(frozen=True)
class ActuatorFit:
    """An actuator: f' = k_oil (q w - v) - lambda f, with the flow w of its valve under load.

    Attributes
    ----------
    flow_gain : float
        q, m/s/V.
    oil_stiffness : float
        k_oil, N/m.
    leakage : float
        lambda, 1/s.
    force_capacity : float
        Force at which the supply pressure is used up, N; 0: not determined by the test.
    valve_frequency, valve_damping : float
        Hz, and damping ratio.
    dead_time : float
        Of the valve, without the loop's own step, s; with the lag of a filter that all sensors
        have, which is no part of the valve.
    friction, friction_velocity : float
        Coulomb friction of the piston, N (0: it does not stand out from its standard deviation),
        and the velocity over which it builds up, m/s.
    drag : float
        Viscous friction equivalent to the piston's friction in the test, N s/m.
    explained : float
        Share of the flow's variance that the balance explains, up to 1.
    unsure : tuple of str
        Names of the values that the test determines poorly (without leakage and force capacity).
    largest_force : float
        In the test, N.
    dt : float
        Sampling period, s.
    measured, modelled : ndarray
        Flow over each sampling period within the band of the test: v + (f' + lambda f) / k_oil
        as measured (and the piston's friction), and q w of the commands; shape (N - 1,), m/s.
    """

    flow_gain: float
    oil_stiffness: float
    leakage: float
    force_capacity: float
    valve_frequency: float
    valve_damping: float
    dead_time: float
    friction: float
    friction_velocity: float
    drag: float
    explained: float
    unsure: tuple[str, ...]
    largest_force: float
    dt: float
    measured: Floats
    modelled: Floats

    @property
    def verdict(self) -> str:
        """``good``, ``fair`` or ``not usable``."""
        if self.flow_gain <= 0 or self.oil_stiffness <= 0 or self.explained < MIN_EXPLAINED:
            return "not usable"
        return "good" if self.explained >= GOOD_EXPLAINED else "fair"

    def fault(self) -> str:
        """Say why the fit is not usable; empty if it is."""
        if self.verdict != "not usable":
            return ""
        if self.explained < MIN_EXPLAINED:
            share = f"{max(self.explained, 0.0) * 100:.0f} % of the flow's variance"
            check = "the oil is on and that displacement, acceleration and force have SI units"
            mend = f"raise --amplitude or --duration, and check that {check}"
            return f"commands explain {share}, where {MIN_EXPLAINED * 100:.0f} % are needed; {mend}"
        pair = "displacement against command" if self.flow_gain <= 0 else "force against motion"
        check = "check the polarity of the sensors and the valve"
        return f"the sign of {pair} is wrong; {check}, and that no channel has a filter of its own"


def fit_actuator(oil: OilBalance) -> ActuatorFit:
    """Fit an actuator to the balance of its oil in a test.

    The specimen enters the balance only by its measured motion and force: it may yield, slip or
    be coupled with others. Least squares over frequency, of the parts of the signals that are
    correlated with the commands (these have no noise); first with an error of a share of the flow,
    then with each frequency weighted by the residual of the last fit. The piston's friction, which
    the load cell does not measure, is fitted too.
    """
    start = _roughly(oil)
    p, deviation, jacobian = _fitted(oil, start, filtered=False)
    start[5] = _FILTER_LAG
    behind = _fitted(oil, start, filtered=True)
    alone, with_filter = (np.sum(oil.solve(q, deviation)[2] ** 2) for q in (p, behind[0]))
    if with_filter < _FILTERED * alone:
        p, deviation, jacobian = behind
    linear, linear_deviations, errors = oil.solve(p, deviation)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * float(np.mean(errors**2))
    deviations = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    linear[3] *= linear[3] > _STANDS_OUT * linear_deviations[3]
    q, compliance, leaking, friction = linear.tolist()
    lost = leaking * oil.between + friction * oil.slip(p)
    measured = oil.within(oil.velocity + compliance * oil.rise + lost)
    modelled = oil.within(q * oil.flow(p))
    total = float(np.sum(measured**2))
    size = np.maximum(np.abs(linear[:2]), 1e-30)
    relative = [*linear_deviations[:2] / size, *deviations[:3]]
    return ActuatorFit(
        flow_gain=q,
        oil_stiffness=1.0 / compliance if compliance else 0.0,
        leakage=max(leaking / compliance, 0.0) if compliance else 0.0,
        force_capacity=oil.largest_force / float(p[3]) if p[3] > _LEAST_LOAD else 0.0,
        valve_frequency=math.exp(p[0]),
        valve_damping=math.exp(p[1]),
        dead_time=float(p[2] + p[5]) / 1e3,
        friction=friction / compliance if compliance else 0.0,
        friction_velocity=math.exp(p[4]),
        drag=friction / compliance * oil.drag(p) if compliance else 0.0,
        explained=1.0 - float(np.sum((measured - modelled) ** 2)) / total if total else 0.0,
        unsure=tuple(n for n, r in zip(_DOUBTED, relative, strict=True) if r > _UNSURE),
        largest_force=oil.largest_force,
        dt=oil.dt,
        measured=measured,
        modelled=modelled,
    )


def _fitted(oil: OilBalance, p: Floats, filtered: bool) -> tuple[Floats, Floats, Floats]:
    """Fit the parameters, with a filter of the sensors or without.

    Give them, the expected errors, and the Jacobian of what is left over these.
    """
    free, deviation = slice(6 if filtered else 5), oil.rough

    def errors(q: Floats, weights: Floats) -> Floats:
        return oil.solve(np.append(q, p[len(q) :]), weights)[2]

    for _ in range(2):
        power, flow = oil.left(p, deviation)
        deviation = np.sqrt(power + _TOLERANCE**2 * flow + 1e-30)
        found = _least_squares(errors, p[free], oil.dt, 1e-6, deviation)
        p = np.append(found.x, p[len(found.x) :])
    return p, deviation, found.jac


def _least_squares(
    errors: Callable[..., Floats], start: Floats, dt: float, tolerance: float, *given: Floats
) -> OptimizeResult:
    """Search the first parameters from a start, within their bounds.

    Of a valve beyond half the rate samples show the delay alone, and its image seems a slower one.
    """
    free, most, highest = slice(len(start)), _MOST_STEPS, _HIGHEST.copy()
    highest[0] = min(math.log(0.5 / dt), highest[0])
    start, bounds = np.minimum(start, highest[free]), (_LOWEST[free], highest[free])
    scale = _SCALE[free]
    return least_squares(
        errors, start, bounds=bounds, x_scale=scale, ftol=tolerance, max_nfev=most, args=given
    )


def _roughly(oil: OilBalance) -> Floats:
    """Parameters of a first fit, from several starts.

    The resonances of valve and oil column are similar: if one is taken for the other, the fit
    explains the piston's motion, but not the force. So the best fit is the one that explains the
    flow at the most frequencies.
    """

    def whole(found: Floats) -> Floats:
        return np.append(found, [0.0, _OVER, 0.0])

    def errors(found: Floats) -> Floats:
        return oil.solve(whole(found), oil.rough)[2]

    def unexplained(p: Floats) -> float:
        """Share of the flow, mean over frequencies."""
        power, flow = oil.left(p, oil.rough)
        return float(np.minimum(power / np.maximum(flow, 1e-30), 1.0).mean())

    best = []
    for hz in _VALVES:
        starts = [np.array([math.log(hz), _DAMPING, dead_time]) for dead_time in _DEAD_TIMES]
        start = min(starts, key=lambda found: float(np.sum(errors(found) ** 2)))
        best.append(whole(_least_squares(errors, start, oil.dt, 1e-4).x))
    found = min(best, key=unexplained)
    found[3] = _LOAD
    return found
