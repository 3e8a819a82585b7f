"""A rig of which the true samples count: nothing is measured, nothing trips."""

import numpy as np
from seft_plant_sim.continuous_model import ContinuousModel
from seft_plant_sim.limits import Limits
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_parameters import LIMIT_NAMES
from seft_plant_sim.sensors import Channels, Sensors


class BareRig(Rig):
    """Rig of a model, or of what is linear in it; `reset` and `step` give the true samples."""

    def __init__(self, model, dt, *, linear=False):
        if linear:
            model = ContinuousModel.linear(
                model.a, model.b, model.c, model.d, model.delay, model.drive
            )
        n = model.b.shape[1]
        nothing, no_end = np.zeros((4, n)), np.full((4, n), np.inf)
        sensors = Sensors(Channels(nothing, nothing, no_end, nothing), 0)
        limits = Limits(dict.fromkeys(LIMIT_NAMES, np.inf), [str(i) for i in range(n)], dt)
        super().__init__(model, sensors, limits, 1e9, dt)

    def reset(self):
        super().reset()
        return self.sample

    def step(self, command):
        super().step(command)
        return self.sample
