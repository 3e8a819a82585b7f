"""The specimen: hysteresis and energy."""

import numpy as np
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RIG_STATE
from seft_plant_sim.reference.whole_structure import tested_specimen

from seft_ros.analysis.energy_error import energy_error
from seft_ros.analysis.tracked import tracked_of
from seft_ros.drawing.style import FIRST, OTHERS, REFERENCE
from seft_ros.page.content import Block, Plot, Section, Text
from seft_ros.page.plots import level, line, path, plot
from seft_ros.report.numbers import Findings


def hysteresis_section(findings: Findings, column: int, title: str) -> Section:
    """Restoring force over displacement of an axis, test and exact."""
    states = findings.record.series[RIG_STATE.name]
    heading = f"Hysteresis{title}"
    try:
        mass = tested_specimen(findings.record.experiment).mass
    except (InputError, KeyError):
        return Section(heading, [Text("The specimen's mass is not known.")])
    if not len(states.steps):
        return Section(heading, [Text("There are no samples.")])
    panel = plot("displacement / mm", "restoring force / N", height=380)
    exact = findings.reference
    if exact is not None:
        force = (exact.force - exact.acceleration @ mass.T)[:, column]
        displacement = exact.displacement[:, column]
        path(panel, displacement * 1e3, force, "exact response", color=REFERENCE, width=3.0)
    x, _, a, f = np.moveaxis(states.values, 1, 0)
    path(panel, x[:, column] * 1e3, (f - a @ mass.T)[:, column], "test", color=FIRST)
    caption = "Restoring force f - m a: its width is what damping and yielding dissipate."
    return Section(heading, [Plot(panel, caption, wide=True)])


def energy_section(findings: Findings) -> Section:
    """Energy balance of the specimen, and what the actuators' force error adds to it."""
    return Section("Energy", [_balance(findings), *_error(findings)])


def _balance(findings: Findings) -> Block:
    if not findings.energies:
        return Text("No energy balance: the specimen is not known, or samples are missing.")
    panel = plot("time / s", "energy / J")
    dt = findings.record.experiment.timebase.dt
    for (name, (steps, energy)), color in zip(findings.energies.items(), OTHERS, strict=False):
        line(panel, steps * dt, energy, name, color=color)
    closure = findings.summary["energy"]["closure"]
    left = "" if closure is None else f" At most {closure:.2%} of the input is left unexplained."
    return Plot(panel, f"Work of the actuators' force, and where it went.{left}")


def _error(findings: Findings) -> list[Block]:
    record = findings.record
    signals, dt = tracked_of(record), record.experiment.timebase.dt
    if len(signals.steps) < 2:
        return []
    panel = plot("time / s", "energy error / J")
    work = energy_error(signals.force - signals.command, signals.velocity, dt)
    axes = record.experiment.axes
    for column, axis in enumerate(axes[: len(OTHERS)]):
        label = axis if len(axes) > 1 else "force loop"
        line(panel, signals.steps * dt, work[:, column], label, color=OTHERS[column])
    level(panel, 0.0)
    caption = (
        "Work of measured less meant force: where it grows, the force loop's error adds "
        "energy (as damping taken away); where it falls, it takes energy out."
    )
    return [Plot(panel, caption)]
