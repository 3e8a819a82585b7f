"""Two storeys of a steel frame, whose columns and beams yield, for `opensees`.

They stand on the floor that the specimen carries: 12 degrees of freedom above it, and the floor's
displacement as the interface.
"""

import openseespy.opensees as ops
from seft_plant_sim.computed.opensees import interface

BAY, STOREY = 1.0, 0.5  # m
FLOOR = 30.0  # kg on each floor

ops.wipe()
ops.model("basic", "-ndm", 2, "-ndf", 3)
for floor in range(3):
    for column in range(2):
        ops.node(1 + 2 * floor + column, column * BAY, floor * STOREY)
for base in (1, 2):
    ops.fix(base, 0, 1, 1)
for joint in (3, 4, 5, 6):
    ops.mass(joint, FLOOR / 2, FLOOR / 2, 1e-3)

ops.uniaxialMaterial("Steel02", 1, 2.75e8, 2.0e11, 0.02, 18.0, 0.925, 0.15)
ops.section("Fiber", 1)  # flat bars, 32 mm wide and 12 mm deep
ops.patch("rect", 1, 10, 1, -0.006, -0.016, 0.006, 0.016)
ops.beamIntegration("Lobatto", 1, 1, 4)
ops.geomTransf("Linear", 1)
for element, ends in enumerate(((1, 3), (2, 4), (3, 5), (4, 6), (3, 4), (5, 6)), 1):
    ops.element("forceBeamColumn", element, *ends, 1, 1)
ops.rayleigh(0.0, 0.0, 4e-4, 0.0)  # 2 % at 16 Hz

interface(
    [(1, 1), (2, 1)],
    responses={
        "roof displacement": lambda: ops.nodeDisp(5, 1),
        "moment at the foot of a column": lambda: ops.eleForce(1, 3),
        "rotation of the column's joint": lambda: ops.nodeDisp(3, 3),
    },
)
