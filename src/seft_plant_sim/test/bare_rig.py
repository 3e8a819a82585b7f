"""A rig of which the true samples count, and parameters for rigs and other nodes."""

from dataclasses import replace

import numpy as np
from seft_msgs_py.config.experiment import Source
from seft_msgs_py.config.facts import place_of
from seft_msgs_py.wire.topics import Timebase
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_parameters import RIG_TABLE
from seft_plant_sim.simulated.continuous_model import ContinuousModel
from seft_plant_sim.simulated.faults import Faults
from seft_plant_sim.simulated.rig import SimulatedRig
from seft_plant_sim.simulated.rig_step import SATURATED_PARTS
from seft_plant_sim.simulated.sensors import Channels, Sensors

FRAME = {
    "mass": [60.0, 45.0],
    "damping": [900.0, -200.0, -200.0, 400.0],
    "stiffness": [3.3e5, -1.5e5, -1.5e5, 1.5e5],
    "springs": [1.0, 0.0, -1.0, 1.0],
}
"""Specimen of two storeys."""


def section_of(table, **values):
    """Section of a table's defaults with changes; a double underscore stands for a dot."""
    named = {name.replace("__", "."): value for name, value in values.items()}
    source = Source({table.node: table}, (table.node,))
    for name, value in named.items():
        source.add(place_of(name, table.node), {name: value}, "here")
    return source.resolve()[table.node]


def rig_section(group="", /, **values):
    """Section of the table's defaults with changes in a group; a double underscore is a dot.

    What is neither a fact nor a setting is what the simulated rig truly is.
    """
    named = {group + name.replace("__", "."): value for name, value in values.items()}
    true = {name if name in RIG_TABLE.rows else f"simulated.{name}": v for name, v in named.items()}
    unzeroed = {"calibration.zeroing": 0.0}  # its sensors show what they do
    paper = {"specimen.mass": 52.7, "specimen.stiffness": 2.11e5}
    return section_of(RIG_TABLE, **(paper | unzeroed | true))


def make_rig(axes=("x",), **values):
    """Rig of these parameters at 500 Hz; a double underscore stands for a dot."""
    return Rig(rig_section(**values), axes, Timebase.from_rate(500.0))


def driven(rig, commands):
    """Samples as measured, and drives, of a rig that gets these commands, shape (N, 5, n).

    The first one is at rest. A command is a number, or has shape (n,).
    """
    found = []
    for command in [None, *commands]:
        if isinstance(rig, SimulatedRig):
            rig.reset() if command is None else rig.write(np.atleast_1d(command))
            measured = rig.read()
        else:
            rig.reset() if command is None else rig.step(np.atleast_1d(command))
            measured = rig.measured
        applied = np.zeros(measured.shape[1]) if command is None else np.atleast_1d(command)
        found.append([*measured, applied])
    return np.array(found)


def transfer(model, hz):
    """From the drives to what is seen of a model, shape (4n, n)."""
    s, shown = 2j * np.pi * hz, model.shown
    return shown.c @ np.linalg.solve(s * np.eye(len(model.a)) - model.a, model.b) + shown.d


class BareRig(SimulatedRig):
    """Rig of a model, or of what is linear in it; its sensors have no noise, and nothing trips."""

    def __init__(self, model, dt, *, linear=False):
        if linear:
            sensed, parts = model.sensed, ("a", "b", "c", "d", "delay", "drive")
            model = ContinuousModel.linear(*(getattr(model, name) for name in parts))
            if sensed:
                model = replace(model, sensed=replace(sensed, outputs=sensed.outputs[:, :0]))
        n = model.b.shape[1]
        nothing, no_end = np.zeros((4, n)), np.full((4, n), np.inf)
        sensors = Sensors(rig_section(), [*map(str, range(n))], range(n))
        sensors.channels = Channels(nothing, nothing, no_end, nothing)
        no_faults = Faults(np.zeros((0, 6), dtype=np.int64), np.zeros((0, 3))), 0
        super().__init__(model, sensors, dt, no_faults)
        self.saturation = set()

    def reset(self):
        super().reset()
        self.saturation.clear()

    def read(self):
        sample = super().read()
        self.saturation |= {name for name, bit in SATURATED_PARTS.items() if self.saturated & bit}
        return sample
