"""Parameter table of the force controller."""

from seft_msgs_py.parameters import Parameter, Table

TABLE = Table(
    "force_controller",
    [
        Parameter(
            "numerator",
            "floats",
            37.0,
            "numerator of the controller (force error in N -> valve in V), in s, highest power "
            "first; default the paper's Eq. 3.1",
        ),
        Parameter(
            "denominator", "floats", [1.0, 17.14, 4002.0], "denominator of the controller, likewise"
        ),
        Parameter(
            "voltage_limit", "float", 10.0, "largest valve drive, either way", "V", positive=True
        ),
    ],
)
