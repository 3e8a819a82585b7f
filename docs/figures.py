"""Figures of theory.md, and the numbers on that page: run it in the folder of the project.

    .venv/bin/python docs/figures.py

All on the paper's rig, config/jhu.yaml.
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import Value
from seft_plant_sim.lti import bilinear, polynomial_ratio
from seft_plant_sim.whole_structure import reference_response
from seft_ros.analysis.metrics import nrmse
from seft_ros.design.planned_tests import PlannedTest
from seft_ros.design.plant import Plant, rig_model
from seft_ros.design.stability_margins import HIGHEST_MASS_RATIO, critical_mass_ratio
from seft_ros.design.stability_verdict import predicted_modes
from seft_ros.drawing.style import FIRST_COLOUR, MARK, OTHERS, REFERENCE, TEXT, save_figure, tidy
from seft_ros.force_controller.force_controller_parameters import VELOCITY_FEEDFORWARD
from seft_ros.reference_force.reference_force_parameters import TARGET_MOTION
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test
from seft_ros.test_run.parameter_tables import TABLES

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
Override = tuple[str, str, Value]

DOCS = Path(__file__).parent
COLOURS = {"none": MARK, "restoring": OTHERS[2], TARGET_MOTION: FIRST_COLOUR}
DELAYS: Floats = np.array([0.0, 0.002, 0.004, 0.006, 0.01, 0.014, 0.02, 0.026, 0.032, 0.038])
MASS_RATIOS: Floats = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4, 1.7, 2.0, 2.5, 3.0])
COLOURS_OF_A_FILE = 64
BAND_HZ = (1.0, 150.0)
WINDOW_S = (1.0, 3.5)


def planned(*overrides: Override) -> Experiment:
    """Read the paper's experiment, changed."""
    return Experiment.load(TABLES, [DOCS.parent / "config" / "jhu.yaml"], overrides)


def method(name: str) -> list[Override]:
    """Choose the compensation method, and the force controller that belongs to it."""
    chosen: list[Override] = [("reference_force", "compensation.method", name)]
    if name == TARGET_MOTION:
        chosen.append(("force_controller", "method", VELOCITY_FEEDFORWARD))
    return chosen


def mass_ratio(value: float) -> Override:
    """Choose alpha."""
    return ("reference_force", "mass_ratio", value)


def critical_by_delay(name: str) -> Floats:
    """Critical mass ratios of a rig that is a pure delay; infinite where none was found."""
    found = []
    for delay in DELAYS:
        rig = [("/**", "actuator.kind", "delay"), ("/**", "actuator.delay", float(delay))]
        critical = critical_mass_ratio(PlannedTest(planned(*rig, *method(name))))
        found.append(critical.value if critical else np.inf)
    return np.array(found)


def neutral_end(experiment: Experiment) -> tuple[Floats, Floats]:
    """Delay T in s and mass ratio at which the neutral delay equation has a root on the axis."""
    known = experiment["reference_force"]
    mass, damping, stiffness = (known[f"specimen.{n}"] for n in ("mass", "damping", "stiffness"))
    natural = np.sqrt(stiffness / mass)
    ratio = damping / (2.0 * mass * natural)
    v = np.linspace(1e-3, 0.999, 400)  # natural over critical frequency
    phase = np.pi + np.arctan2(2.0 * ratio * v, 1.0 - v**2)
    return phase * v / natural, np.hypot(v**2 - 1.0, 2.0 * ratio * v)


def stability() -> Figure:
    """Draw the critical mass ratio over the delay."""
    experiment = planned()
    figure, (panel,) = panels(1, (6.0, 3.2))
    delays, ends = neutral_end(experiment)
    panel.plot(1e3 * delays, ends, color=REFERENCE, lw=3, label="neutral delay equation")
    loop_delays = 1e3 * (DELAYS + 1.5 * experiment.timebase.dt)
    print(f"of the equation: {np.round(np.interp(loop_delays, 1e3 * delays, ends), 3)}")
    for name, style in (("none", "o"), ("restoring", "^")):
        found = critical_by_delay(name)
        print(f"critical mass ratio, {name}: {np.round(found, 3)} at T = {loop_delays} ms")
        shown = np.minimum(found, HIGHEST_MASS_RATIO)
        label = name if np.isfinite(found).all() else f"{name}: no end up to {HIGHEST_MASS_RATIO:g}"
        panel.plot(loop_delays, shown, style, color=COLOURS[name], label=label)
    panel.set(yscale="log", xlim=(0.0, 42.0), ylim=(0.2, 80.0))
    panel.set_yticks(
        [0.2, 0.5, 1, 2, 5, 10, 20, 50], ["0.2", "0.5", "1", "2", "5", "10", "20", "50"]
    )
    panel.minorticks_off()
    name_axes(panel, "delay T of the whole loop / ms", "critical mass ratio $\\alpha$")
    panel.legend(frameon=False, fontsize=9, labelcolor=TEXT, loc="center right")
    return figure


def growth() -> Figure:
    """Draw growth rate and damping ratio over the mass ratio."""
    figure, (left, right) = panels(2, (7.2, 2.8))
    left.axhline(0.0, color=REFERENCE, lw=3)
    for name, colour in COLOURS.items():
        plans = [PlannedTest(planned(*method(name), mass_ratio(float(a)))) for a in MASS_RATIOS]
        rates = np.array([plan.growth_rate() for plan in plans])
        modes = [predicted_modes(plan) for plan in plans]
        damping = 100 * np.array([m[0].damping if m else np.nan for m in modes])
        exact = 100 * np.array([m[0].exact_damping if m else np.nan for m in modes])
        print(f"{name}: growth rate {np.round(rates, 1)}, damping {np.round(damping, 1)} %")
        left.plot(MASS_RATIOS, rates, color=colour, label=name)
        if name == "none":
            right.plot(MASS_RATIOS, exact, color=REFERENCE, lw=3, label="whole structure")
            print(f"mass ratios {MASS_RATIOS}, exact damping {np.round(exact, 1)} %")
        right.plot(MASS_RATIOS, damping, color=colour, label=name)
    name_axes(left, "mass ratio $\\alpha$", "slowest mode's growth / (1/s)")
    name_axes(right, "mass ratio $\\alpha$", "damping ratio in the test / %")
    right.legend(frameon=False, fontsize=9, labelcolor=TEXT)
    return figure


def force_loop(f: Floats, *overrides: Override) -> tuple[Plant, Complexes, Complexes]:
    """Close the paper's force loop, changed, as it runs: plant, its response, that of the loop."""
    experiment = planned(*overrides)
    dt, control = experiment.timebase.dt, experiment["force_controller"]
    plant = Plant.of_model(*rig_model(experiment))
    sampled = bilinear(np.atleast_1d(control["numerator"]), control["denominator"], dt)
    response = plant.sampled_response(f, dt)
    loop = polynomial_ratio(*sampled, np.exp(2j * np.pi * f * dt)) * response
    return plant, response, loop / (1 + loop)


def interaction() -> Figure:
    """Draw what the valve does to the force, alone and in the loop."""
    figure, (left, right) = panels(2, (7.2, 2.8))
    f = np.geomspace(*BAND_HZ, 2000)
    loops = {
        "the specimen of Eq. 3.1": (force_loop(f), FIRST_COLOUR),
        "20 % less stiff": (
            force_loop(f, ("rig", "simulated.specimen.stiffness", 0.8 * 2.11e5)),
            OTHERS[2],
        ),
    }
    for label, ((plant, response, tracking), colour) in loops.items():
        left.plot(f, decibels(response), color=colour, label=label)
        right.plot(f, decibels(tracking), color=colour, label=label)
        near = (f > 5.0) & (f < 20.0)
        lowest = np.argmin(np.abs(tracking[near]))
        dip = decibels(tracking[near])[lowest]
        delay = np.interp(2.0, f, -np.unwrap(np.angle(tracking)) / (2 * np.pi * f))
        print(f"{label}: zero {plant.roots[1][0].hz:.2f} Hz, G {dip:.2f} dB ", end="")
        print(f"at {f[near][lowest]:.1f} Hz, delay at 2 Hz {1e3 * delay:.1f} ms")
    for panel, what in ((left, "valve to force / (dB of N/V)"), (right, "closed loop $G$ / dB")):
        panel.set(xscale="log")
        panel.set_xticks([1, 2, 5, 10, 20, 50, 100], ["1", "2", "5", "10", "20", "50", "100"])
        panel.minorticks_off()
        name_axes(panel, "frequency / Hz", what)
    right.axhline(0.0, color=REFERENCE, lw=3, zorder=1.5)
    right.set_ylim(-12.0, 6.0)
    right.legend(frameon=False, fontsize=9, labelcolor=TEXT, loc="lower left")
    return figure


def histories() -> Figure:
    """Draw a displacement with and without compensation."""
    figure, (panel,) = panels(1, (7.2, 2.6))
    for name in ("none", TARGET_MOTION):
        load = ("ground_motion", "peak_force", 500.0)
        experiment = planned(*method(name), mass_ratio(1.0), load)
        recording = simulate_test(experiment, build_blocks(experiment))
        states = recording.measured.values
        motion = recording.series["ground_motion"].values[:, 0]
        exact = reference_response(experiment, motion).displacement[:, 0]
        t = np.arange(len(states)) * experiment.timebase.dt
        shown = (t >= WINDOW_S[0]) & (t <= WINDOW_S[1])
        measured = states[:, 0, 0]
        if name == "none":
            panel.plot(t[shown], 1e3 * exact[shown], color=REFERENCE, lw=4, label="exact")
        panel.plot(t[shown], 1e3 * measured[shown], color=COLOURS[name], lw=1.2, label=name)
        peaks = 1e3 * np.abs(measured).max(), 1e3 * np.abs(exact).max()
        at = t[np.abs(exact).argmax()]
        print(f"{name}: displacement error {100 * nrmse(measured, exact):.2f} %, ", end="")
        print(f"peak {peaks[0]:.1f} mm, exact {peaks[1]:.1f} mm at {at:.2f} s")
    name_axes(panel, "time / s", "displacement / mm")
    panel.legend(frameon=False, fontsize=9, labelcolor=TEXT, ncols=3, loc="upper right")
    return figure


def decibels(response: Complexes) -> Floats:
    """Magnitude in dB."""
    magnitude: Floats = 20.0 * np.log10(np.abs(response))
    return magnitude


def panels(count: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """Make a figure of panels side by side."""
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    found = list(figure.subplots(1, count, squeeze=False)[0])
    for panel in found:
        tidy(panel)
    return figure, found


def name_axes(panel: Axes, x: str, y: str) -> None:
    """Write what the axes are."""
    panel.set_xlabel(x, color=TEXT, fontsize=9)
    panel.set_ylabel(y, color=TEXT, fontsize=9)


def main() -> None:
    """Draw all figures."""
    for draw in (stability, growth, interaction, histories):
        print(f"-- theory_{draw.__name__}.png")
        path = DOCS / f"theory_{draw.__name__}.png"
        save_figure(draw(), path)
        Image.open(path).quantize(COLOURS_OF_A_FILE).save(path, optimize=True)


if __name__ == "__main__":
    main()
