"""Parameter table of the reference force."""

from seft_msgs_py.parameters import Parameter, Table

from seft_ros.reference_force.compensation import METHODS

TABLE = Table(
    "reference_force",
    [
        Parameter(
            "method",
            "string",
            "seft",
            "seft: computed mass by acceleration feedback (Eq. 2.5); eft: without (Eq. 2.3)",
            choices=("eft", "seft"),
        ),
        Parameter(
            "mass_ratio", "float", 0.0, "computed mass over specimen mass, alpha", minimum=0.0
        ),
        Parameter(
            "model.mass",
            "floats",
            None,
            "mass of the specimen as known to the experimenter",
            "kg",
            default_from="rig:specimen.mass",
        ),
        Parameter(
            "model.damping",
            "floats",
            0.0,
            "damping of the specimen, likewise",
            "N s/m",
            default_from="rig:specimen.damping",
        ),
        Parameter(
            "model.stiffness",
            "floats",
            None,
            "stiffness of the specimen, likewise",
            "N/m",
            default_from="rig:specimen.stiffness",
        ),
        Parameter(
            "compensation.method",
            "string",
            "none",
            "how the measured acceleration is freed of the actuator's delay",
            choices=tuple(METHODS),
        ),
        Parameter(
            "compensation.delay",
            "float",
            0.0,
            "delay that the method compensates; `none` does not use it",
            "s",
            minimum=0.0,
            maximum=1.0,
        ),
    ],
)
