"""The soil that a foundation shears, for `opensees`: a p-y spring with gap and dashpot."""

import openseespy.opensees as ops
from seft_plant_sim.computed.opensees import interface

ops.wipe()
ops.model("basic", "-ndm", 1, "-ndf", 1)
ops.node(1, 0.0)
ops.node(2, 0.0)  # the foundation
ops.fix(1, 1)
ops.uniaxialMaterial("PySimple1", 1, 2, 1500.0, 1.0e-3, 0.3)  # sand: ultimate force N, y50 m, drag
ops.uniaxialMaterial("Viscous", 2, 500.0, 1.0)
ops.element("zeroLength", 1, 1, 2, "-mat", 1, "-dir", 1)
ops.element("zeroLength", 2, 1, 2, "-mat", 2, "-dir", 1)

interface((2, 1), names=["internal 1"])
