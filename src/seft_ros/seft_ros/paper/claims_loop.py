"""Claims of section 3: the rig, and its force loop (Figures 3 and 4)."""

from collections.abc import Iterator

import numpy as np
from seft_msgs_py.config.experiment import Experiment

from seft_ros.identification.identified import Identified
from seft_ros.loop_shaping.margins import BAND_HZ, FLATNESS_DB
from seft_ros.paper.claim import Claim, at_most, holds, near
from seft_ros.paper.findings import Findings
from seft_ros.paper.force_loop import ForceLoop, force_loop

RIG, FIGURE_3, FIGURE_4 = "Section 3.1", "Figure 3", "Figure 4"
G = 9.81  # m/s^2, as a data sheet of an accelerometer counts

_LOW_HZ, _HIGH_HZ = 1.0, 50.0
_SMOOTH_DB = 1.0
_FIT = 0.05
_PHASE_DEG = 10.0


def claims_loop(found: Findings) -> Iterator[Claim]:
    """Judge everything that section 3 says in numbers or of a curve."""
    yield from _rig(found.experiment, found.identified)
    loop = force_loop(found.identified, found.experiment.timebase.dt)
    yield from _open_loop(found.experiment, found.identified, loop)
    yield from _closed_loop(found.identified, loop)


def _rig(experiment: Experiment, identified: Identified) -> Iterator[Claim]:
    rig, specimen = experiment["rig"], identified.specimen
    mass, stiffness = float(specimen.mass[0, 0]), float(specimen.stiffness[0, 0])
    yield near(RIG, "mass of the specimen, identified", 52.7, mass, 0.5, "kg")
    yield near(RIG, "stiffness of the specimen, identified", 2.11e5, stiffness, 2e3, "N/m")
    hz = specimen.axis_root(0).hz
    yield near(RIG, "natural frequency, identified", 10.1, hz, 0.1, "Hz")
    capacity = _first(rig["actuator.force_capacity"]) / 1e3
    yield near(RIG, "capacity of the actuator, configured", 24.5, capacity, 0.05, "kN")
    stroke = 2e3 * _first(rig["actuator.stroke"])
    yield near(RIG, "total stroke of the actuator, configured", 152, stroke, 0.5, "mm")
    load_cell = _first(rig["sensors.force_range"]) / 1e3
    yield near(RIG, "range of the load cell, configured", 22.2, load_cell, 0.05, "kN")
    accelerometer = _first(rig["sensors.acceleration_range"]) / G
    yield near(RIG, "range of the accelerometer, configured", 4, accelerometer, 0.05, "g")


def _open_loop(experiment: Experiment, identified: Identified, loop: ForceLoop) -> Iterator[Claim]:
    valve = identified.valves[0]
    zero, pole = loop.roots_hz()
    natural = identified.specimen.axis_root(0).hz
    where = f"{FIGURE_3} (a)"
    yield near(where, "valve-to-force response has a zero at 10 Hz", 10, zero, 0.5, "Hz")
    yield near(where, "and a pole around 90 Hz", 90, pole, 5, "Hz")
    least = loop.least_hz()
    yield holds(
        where,
        "the zero is the specimen's natural frequency (control-structure interaction)",
        "the same",
        f"least response at {least:.3g} Hz, specimen by its own motion {natural:.4g} Hz",
        abs(least - natural) <= 0.05 * natural,
        "within 5 % of each other; the one from valve and force, the other from force and motion",
    )
    yield at_most(
        where,
        "the rational curve captures the measured response",
        "captured",
        valve.error,
        _FIT,
        shown=".1%",
        noun="error",
        what="RMS error of the fit, relative,",
    )
    own = experiment["force_controller"]
    numerator, denominator = np.atleast_1d(own["numerator"]), np.atleast_1d(own["denominator"])
    yield holds(
        f"{FIGURE_3} (b)",
        "controller of Eq. 3.1",
        "37 / (s^2 + 17.14 s + 4002)",
        f"{_polynomial(numerator)} / ({_polynomial(denominator)})",
        _alike(numerator, [37.0]) and _alike(denominator, [1.0, 17.14, 4002.0]),
        "each coefficient within 0.1 %",
    )
    where = f"{FIGURE_3} (c)"
    yield near(where, "crossover frequency", 12, valve.loop.margins.crossover_hz, 0.5, "Hz")
    low, high = loop.gain_db(_LOW_HZ), loop.largest_db(_HIGH_HZ)
    yield holds(
        where,
        "loop is high at low, low at high frequency",
        "high, low",
        f"{low:.1f} dB at {_LOW_HZ:g} Hz, at most {high:.1f} dB from {_HIGH_HZ:g} Hz on",
        low >= 10.0 and high <= -3.0,
        f"at least 10 dB at {_LOW_HZ:g} Hz, at most -3 dB from {_HIGH_HZ:g} Hz on, so that the "
        "oil column can't close the loop",
    )
    yield at_most(
        where,
        "and smooth in between",
        "smooth",
        loop.largest_rise_db(_LOW_HZ, _HIGH_HZ),
        _SMOOTH_DB,
        shown=".2g",
        unit="dB",
        what=f"rise on the way down from {_LOW_HZ:g} to {_HIGH_HZ:g} Hz",
    )


def _closed_loop(identified: Identified, loop: ForceLoop) -> Iterator[Claim]:
    tracking = identified.closed_loops[0].tracking
    natural = identified.specimen.axis_root(0).hz
    where = f"{FIGURE_4} (a)"
    yield at_most(
        where,
        f"force is controlled up to {BAND_HZ:g} Hz",
        "excellent",
        loop.unevenness_db(BAND_HZ),
        FLATNESS_DB,
        shown=".2g",
        unit="dB",
        what=f"largest departure of the magnitude from 0 dB up to {BAND_HZ:g} Hz",
    )
    hz, depth = tracking.dip_hz, tracking.dip_db
    told = "no dip" if hz is None or depth is None else f"{-depth:.2g} dB at {hz:.3g} Hz"
    small = hz is not None and depth is not None and -3.0 <= depth < 0.0
    yield holds(
        where,
        "with a small dip at the natural frequency",
        "small dip",
        told,
        small and abs(float(hz or 0.0) - natural) <= 0.2 * natural,
        "a dip of less than 3 dB within 20 % of the natural frequency",
        "it stands where the specimen's damping differs from what the controller expects",
    )
    decibels, degrees = loop.mismatch(BAND_HZ)
    yield at_most(
        where,
        "experiment and analysis agree in magnitude",
        "good agreement",
        decibels,
        FLATNESS_DB,
        shown=".2g",
        unit="dB",
        what=f"largest difference up to {BAND_HZ:g} Hz",
    )
    yield at_most(
        f"{FIGURE_4} (b)",
        "experiment and analysis agree in phase",
        "good agreement",
        degrees,
        _PHASE_DEG,
        shown=".2g",
        unit="degrees",
        what=f"largest difference up to {BAND_HZ:g} Hz",
    )


def _first(value: object) -> float:
    return float(np.atleast_1d(np.asarray(value, dtype=np.float64))[0])


def _alike(ours: np.ndarray, paper: list[float]) -> bool:
    return ours.shape == (len(paper),) and bool(np.allclose(ours, paper, rtol=1e-3, atol=0.0))


def _polynomial(coefficients: np.ndarray) -> str:
    highest = len(coefficients) - 1
    terms = []
    for index, value in enumerate(coefficients):
        power = highest - index
        s = {0: "", 1: "s"}.get(power, f"s^{power}")
        terms.append(s if s and value == 1 else f"{value:g} {s}".strip())
    return " + ".join(terms)
