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
        Parameter(
            "tracking.numerator",
            "floats",
            [0.0],
            "numerator of the identified response from reference force to measured force of the "
            "same step, in s, highest power first; 0: not known. For compensators",
        ),
        Parameter("tracking.denominator", "floats", [1.0], "its denominator, likewise"),
        Parameter(
            "tracking.dead_time",
            "float",
            0.0,
            "its dead time, the loop's latency included",
            "s",
            minimum=0.0,
            maximum=1.0,
        ),
    ],
)
