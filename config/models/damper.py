"""A tuned mass damper on the floor that the specimen carries, for `opensees`."""

import math

import openseespy.opensees as ops
from seft_plant_sim.computed.opensees import interface

MASS = 8.0  # kg: 6 % of the structure's
OMEGA = 2.0 * math.pi * 6.0  # rad/s
DAMPING = 0.13  # of critical

ops.wipe()
ops.model("basic", "-ndm", 1, "-ndf", 1)
ops.node(1, 0.0)  # the floor
ops.node(2, 0.0, "-mass", MASS)
ops.uniaxialMaterial("Elastic", 1, MASS * OMEGA**2)
ops.uniaxialMaterial("Viscous", 2, 2.0 * DAMPING * OMEGA * MASS, 1.0)
ops.element("zeroLength", 1, 1, 2, "-mat", 1, "-dir", 1)
ops.element("zeroLength", 2, 1, 2, "-mat", 2, "-dir", 1)

interface((1, 1), responses={"stroke": lambda: ops.nodeDisp(2, 1) - ops.nodeDisp(1, 1)})
