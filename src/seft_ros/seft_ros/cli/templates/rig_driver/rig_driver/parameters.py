"""Parameter table of the driver: the names that other nodes and the operator know it by."""

from seft_msgs_py.config.parameter_table import Parameter, Table
from seft_msgs_py.node import realtime
from seft_plant_sim.rig_parameters import limit_rows

from rig_driver.calibration import PARAMETERS as CALIBRATION

TABLE = Table(
    "rig",
    [
        *CALIBRATION,
        *limit_rows(),
        Parameter(
            "limits.command", "float", 10.0, "largest valve command either way", "V", positive=True
        ),
        Parameter("safe.valve_command", "floats", 0.0, "valve command of the safe position", "V"),
        Parameter(
            "safe.close_time", "float", 0.02, "time in which the valve goes there", "s", minimum=0.0
        ),
        Parameter(
            "safe.rest_velocity",
            "float",
            1e-3,
            "slower counts as rest",
            "m/s",
            positive=True,
        ),
        Parameter(
            "safe.settle_time", "float", 2.0, "time in which it must rest", "s", positive=True
        ),
        Parameter(
            "watchdog.command_timeout",
            "float",
            0.02,
            "longest time without a new valve command before the rig trips",
            "s",
            positive=True,
        ),
        Parameter(
            "watchdog.supervisor_timeout",
            "float",
            1.0,
            "longest silence of the supervisor before the rig trips",
            "s",
            positive=True,
        ),
        *realtime.PARAMETERS,
    ],
)
