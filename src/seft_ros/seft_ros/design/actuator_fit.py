"""Fit of an actuator model to one test, with any specimen."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from seft_ros.design.oil_balance import OilBalance

Floats = npt.NDArray[np.float64]

LEAST_EXPLAINED, GOOD_EXPLAINED = 0.5, 0.9
"""Share of the flow's variance that a fit must explain, and that a good one does."""

_VALVES, _DEAD_TIMES = (25.0, 50.0, 100.0, 200.0), (0.0, 2.0, 5.0, 10.0, 20.0)  # Hz, ms: starts
_DAMPING, _LOAD, _OVER = 0.7, 0.02, 0.005  # first guesses
_MOST_STEPS = 30
_TOLERANCE = 0.01  # of the flow at a frequency: accuracy of the model itself
_LEAST_LOAD = 0.15  # of the force capacity: below, friction can be taken for it
_UNSURE = 0.1  # relative standard deviation
# logarithms of the valve's frequency and damping, dead time in ms, largest force over force
# capacity, logarithm of the velocity over which friction builds up
_LOWEST = np.array([math.log(3.0), math.log(0.1), 0.0, 0.0, math.log(2e-4)])
_HIGHEST = np.array([math.log(1000.0), math.log(3.0), 50.0, 0.9, math.log(0.1)])
_SCALE = np.array([0.1, 0.1, 0.1, 0.01, 0.3])


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
        Of the valve, without the loop's own step, s.
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
        if self.flow_gain <= 0 or self.oil_stiffness <= 0 or self.explained < LEAST_EXPLAINED:
            return "not usable"
        return "good" if self.explained >= GOOD_EXPLAINED else "fair"

    def fault(self) -> str:
        """Say why the fit is not usable; empty if it is."""
        if self.verdict != "not usable":
            return ""
        if self.explained < LEAST_EXPLAINED:
            return (
                f"commands explain {max(self.explained, 0.0):.0%} of the flow's variance, where "
                f"{LEAST_EXPLAINED:.0%} are needed; raise --amplitude or --duration, and check "
                "that the oil is on and that displacement, acceleration and force have SI units"
            )
        pair = "displacement against command" if self.flow_gain <= 0 else "force against motion"
        return f"the sign of {pair} is wrong; check the polarity of the sensors and the valve"


def fit_actuator(
    commands: Floats,
    positions: Floats,
    accelerations: Floats,
    forces: Floats,
    dt: float,
    band: tuple[float, float],
) -> ActuatorFit:
    """Fit an actuator to the balance of its oil in a test; parameters as of `OilBalance`.

    The specimen enters the balance only by its measured motion and force: it may yield, slip or
    be coupled with others. Least squares over frequency, of the parts of the signals that are
    correlated with the commands (these have no noise); first with an error of a share of the flow,
    then with each frequency weighted by the residual of the last fit. The piston's friction, which
    the load cell does not measure, is fitted too.
    """
    oil = OilBalance(commands, positions, accelerations, forces, dt, band)
    p, deviation = _roughly(oil), oil.rough
    for _ in range(2):
        power, flow = oil.left(p[:4], math.exp(p[4]), deviation)
        deviation = np.sqrt(power + _TOLERANCE**2 * flow + 1e-30)
        found = least_squares(
            lambda q, weights: oil.solve(q[:4], math.exp(q[4]), weights)[2],
            p,
            bounds=(_LOWEST, _HIGHEST),
            x_scale=_SCALE,
            ftol=1e-6,
            max_nfev=_MOST_STEPS,
            args=(deviation,),
        )
        p = found.x
    linear, linear_deviations, errors = oil.solve(p[:4], math.exp(p[4]), deviation)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * float(np.mean(errors**2))
    deviations = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    q, compliance, leaking, friction = linear.tolist()
    lost = leaking * oil.between + friction * oil.slip(math.exp(p[4]))
    measured = oil.within(oil.velocity + compliance * oil.rise + lost)
    modelled = oil.within(q * oil.flow(p[:4])[0])
    total = float(np.sum(measured**2))
    relative = {
        "flow_gain": linear_deviations[0] / max(abs(q), 1e-30),
        "oil_stiffness": linear_deviations[1] / max(abs(compliance), 1e-30),
        "valve_frequency": deviations[0],
        "valve_damping": deviations[1],
        "dead_time": deviations[2],  # ms
    }
    return ActuatorFit(
        flow_gain=q,
        oil_stiffness=1.0 / compliance if compliance else 0.0,
        leakage=max(leaking / compliance, 0.0) if compliance else 0.0,
        force_capacity=oil.largest_force / float(p[3]) if p[3] > _LEAST_LOAD else 0.0,
        valve_frequency=math.exp(p[0]),
        valve_damping=math.exp(p[1]),
        dead_time=float(p[2]) / 1e3,
        drag=max(friction / compliance, 0.0) * oil.drag(math.exp(p[4])) if compliance else 0.0,
        explained=1.0 - float(np.sum((measured - modelled) ** 2)) / total if total else 0.0,
        unsure=tuple(name for name, value in relative.items() if value > _UNSURE),
        largest_force=oil.largest_force,
        dt=dt,
        measured=measured,
        modelled=modelled,
    )


def _roughly(oil: OilBalance) -> Floats:
    """Parameters of a first fit, from several starts.

    The resonances of valve and oil column are similar: if one is taken for the other, the fit
    explains the piston's motion, but not the force. So the best fit is the one that explains the
    flow at the most frequencies.
    """

    def errors(valve: Floats) -> Floats:
        return oil.solve(np.append(valve, 0.0), _OVER, oil.rough)[2]

    def cost(start: Floats) -> float:
        return float(np.sum(errors(start) ** 2))

    found = []
    for hz in _VALVES:
        starts = [np.array([math.log(hz), math.log(_DAMPING), late]) for late in _DEAD_TIMES]
        fit = least_squares(
            errors,
            min(starts, key=cost),
            bounds=(_LOWEST[:3], _HIGHEST[:3]),
            x_scale=_SCALE[:3],
            max_nfev=_MOST_STEPS,
        )
        found.append(np.append(fit.x, [0.0, math.log(_OVER)]))

    def unexplained(p: Floats) -> float:
        """Share of the flow, mean over frequencies."""
        power, flow = oil.left(p[:4], math.exp(p[4]), oil.rough)
        return float(np.minimum(power / np.maximum(flow, 1e-30), 1.0).mean())

    best = min(found, key=unexplained)
    best[3] = _LOAD
    return best
