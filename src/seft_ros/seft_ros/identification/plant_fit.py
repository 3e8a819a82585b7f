"""Fit of the valve-to-force response to what was measured of it."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from seft_ros.identification.measurement import Measurement
from seft_ros.identification.plant_model import PlantModel, oil_column_model
from seft_ros.identification.rational import sampled
from seft_ros.loop_shaping.roots import Root

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

_FLOOR = 0.01  # of the magnitude: what a model is asked to explain
_COARSE_FLOOR = 0.3
_COARSE_POINTS = 120
_STARTS = 4
_MOST_STEPS = 60
_SPECIMEN_SCALE = (0.03, 0.3)  # trust in the specimen's frequency and damping, relative
_WORTH = 0.7  # cost over cost that another pair of poles and zeros must reach


@dataclass(frozen=True)
class PlantFit:
    """A fitted valve-to-force response.

    Attributes
    ----------
    model : PlantModel
        Poles and zeros.
    leakage : float
        lambda of the oil's spring, 1/s, where the actuator is one.
    error : float
        RMS of the model's error relative to the measured response, each frequency by the
        inverse of its variance, 0 to 1.
    """

    model: PlantModel
    leakage: float
    error: float


def fit_plant(measured: Measurement, dt: float, specimen: Root, most_pairs: int = 1) -> PlantFit:
    """Fit poles, zeros and dead time to a measured valve-to-force response.

    First the actuator is an oil spring against the specimen, from many starts; from the best of
    these the poles are set free, and further pairs are added while they are worth it. Hold and
    latency of the loop are accounted for exactly: the model is the continuous plant.

    Parameters
    ----------
    measured : Measurement
        From u_k to f_k, N/V.
    dt : float
        Sampling period, s.
    specimen : Root
        Natural frequency and damping of the specimen on this axis: the first zero stays near
        it unless data say otherwise.
    most_pairs : int
        Largest number of zero pairs, and of oil-column pairs.
    """
    springs = [_refined(measured, dt, start) for start in _starts(measured, dt, specimen)]
    cost, parameters = min(springs, key=lambda found: found[0])
    leakage = float(parameters[3])
    start = _spring(parameters)
    cost, model = _freed(measured, dt, start, specimen)
    while len(model.zeros) < most_pairs:
        wider = model.with_pair(_misfit(measured, dt, model))
        next_cost, next_model = _freed(measured, dt, wider, specimen)
        if next_cost > _WORTH * cost:
            break
        cost, model = next_cost, next_model
    deviation = measured.tolerance(_FLOOR)
    error = (sampled(model, measured.frequencies_hz, dt) - measured.response) / deviation
    relative = np.abs(measured.response) / deviation
    total = float(np.sum(np.abs(error) ** 2) / np.sum(relative**2))
    return PlantFit(model, leakage, float(np.sqrt(total)))


# parameters of an oil spring: gain, specimen's frequency and damping (logarithms), leakage,
# oil column and valve (logarithms), valve's damping (logarithm), dead time in ms


def _spring(p: Floats) -> PlantModel:
    specimen = Root(float(np.exp(p[1])), float(np.exp(p[2])))
    oil_hz = float(np.hypot(np.exp(p[4]), specimen.hz))
    valve = Root(float(np.exp(p[5])), float(np.exp(p[6])))
    return oil_column_model(float(p[0]), specimen, oil_hz, float(p[3]), valve, float(p[7]) / 1e3)


def _starts(measured: Measurement, dt: float, specimen: Root) -> list[Floats]:
    """Best of a grid of oil columns, leakages, valves and dead times; the gain fits itself."""
    few = measured.thinned(_COARSE_POINTS)
    deviation = few.tolerance(_COARSE_FLOOR)
    target = few.response / deviation
    found = []
    damping = min(max(specimen.damping or 0.0, 0.003), 0.5)
    oils = specimen.hz + np.geomspace(15.0, 300.0, 14)
    for oil, leakage, valve in product(oils, (5.0, 100.0), (30.0, 70.0, 160.0)):
        logarithms = np.log([oil, valve, 0.7])
        for dead_time in np.arange(0.0, 20.5, 1.0):
            parameters = np.array(
                [1.0, np.log(specimen.hz), np.log(damping), leakage, *logarithms, dead_time]
            )
            shape = sampled(_spring(parameters), few.frequencies_hz, dt) / deviation
            parameters[0] = np.vdot(shape, target).real / np.vdot(shape, shape).real
            cost = float(np.sum(np.abs(parameters[0] * shape - target) ** 2))
            found.append((cost, (oil, valve), parameters))
    found.sort(key=lambda item: item[0])
    best: dict[tuple[float, float], Floats] = {}
    for _, kind, parameters in found:
        best.setdefault(kind, parameters)
    return list(best.values())[:_STARTS]


def _refined(measured: Measurement, dt: float, start: Floats) -> tuple[float, Floats]:
    scale = np.array([abs(start[0]), 1, 1, 20.0, 1, 1, 1, 1.0])
    low = np.array([-np.inf, np.log(0.2), np.log(1e-4), 0.0, np.log(2), np.log(5), np.log(0.1), 0])
    high = np.array(
        [np.inf, np.log(300), np.log(2), 1e4, np.log(2000), np.log(1000), np.log(3.0), 100.0]
    )
    few = measured.thinned(4 * _COARSE_POINTS)
    return _solve(few, dt, _spring, start, scale, (low, high), [5, 6])


def _free(p: Floats) -> PlantModel:
    pairs = [Root(float(np.exp(w)), float(np.exp(z))) for w, z in p[5:].reshape(-1, 2)]
    count = len(pairs) // 2
    valve = Root(float(np.exp(p[2])), float(np.exp(p[3])))
    return PlantModel(
        float(p[0]),
        tuple(pairs[:count]),
        tuple(pairs[count:]),
        Root(float(p[1])),
        valve,
        float(p[4]) / 1e3,
    )


def _freed(
    measured: Measurement, dt: float, start: PlantModel, specimen: Root
) -> tuple[float, PlantModel]:
    valve = start.valve
    pairs = (specimen, *start.zeros[1:], *start.poles)
    roots = [(root.hz, max(root.damping or 0.0, 2e-4)) for root in pairs]
    logarithms = np.log([valve.hz, valve.damping or 0.7])
    p = np.array(
        [start.gain, start.leakage.hz, *logarithms, start.dead_time * 1e3, *np.log(np.ravel(roots))]
    )
    ones = np.ones(2 * len(pairs))
    scale = np.array([abs(start.gain), 1.0, 1.0, 1.0, 1.0, *ones])
    scale[5:7] = _SPECIMEN_SCALE
    low = np.array([-np.inf, 0.0, np.log(5), np.log(0.1), 0.0, *np.log(ones * 1e-4)])
    high = np.array([np.inf, 1e3, np.log(1000), np.log(3.0), 100.0, *np.log(ones * 2000)])
    cost, found = _solve(measured, dt, _free, p, scale, (low, high), [1, 2, 3, 5, 6])
    return cost, _free(found)


def _misfit(measured: Measurement, dt: float, model: PlantModel) -> Root:
    """Pair that cancels itself, where the model is furthest off."""
    error = np.abs(sampled(model, measured.frequencies_hz, dt) - measured.response)
    smooth = np.convolve(error / measured.tolerance(_FLOOR), np.full(9, 1 / 9), "same")
    return Root(float(measured.frequencies_hz[int(smooth.argmax())]), 0.05)


def _solve(
    measured: Measurement,
    dt: float,
    make: Callable[[Floats], PlantModel],
    start: Floats,
    scale: Floats,
    bounds: tuple[Floats, Floats],
    held: list[int],
) -> tuple[float, Floats]:
    """Least squares over parameters; those in ``held`` stay near their start if data say nothing.

    Returns
    -------
    cost : float
        Robust sum of squares.
    parameters : ndarray
        Shape of ``start``.
    """
    deviation = measured.tolerance(_FLOOR)
    start = np.clip(start, bounds[0], bounds[1])

    def residuals(p: Floats) -> Floats:
        error = (sampled(make(p), measured.frequencies_hz, dt) - measured.response) / deviation
        return np.concatenate([error.real, error.imag, ((p - start) / scale)[held]])

    found = least_squares(
        residuals,
        start,
        bounds=bounds,
        x_scale=scale,
        loss="soft_l1",
        f_scale=3.0,
        ftol=1e-7,
        max_nfev=_MOST_STEPS,  # pairs that cancel each other would wander on
    )
    return float(found.cost), found.x
