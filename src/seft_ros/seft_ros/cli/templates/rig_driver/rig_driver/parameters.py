"""Parameter table of the driver: the names that other nodes and the operator know it by."""

from seft_msgs_py.config.facts import facts
from seft_msgs_py.config.parameter_table import Table, parameter_rows
from seft_msgs_py.node import host

from rig_driver.volts import PARAMETERS as VOLTS

SAFETY = parameter_rows(
    """
    safe.valve_command          | floats | 0.0  | V   |      | the safe valve command
    safe.close_time             | float  | 0.02 | s   | 0 .. | time in which the valve goes there
    safe.rest_velocity          | float  | 1e-3 | m/s | > 0  | slower counts as rest
    safe.settle_time            | float  | 2.0  | s   | > 0  | time in which it must rest
    watchdog.command_timeout    | float  | 0.02 | s   | > 0  |
        longest time without a new valve command before the rig trips
    watchdog.supervisor_timeout | float  | 1.0  | s   | > 0  |
        longest silence of the supervisor before the rig trips
    """
)
TABLE = Table(
    "rig",
    [*facts("loop_delay", "calibration.", "limits."), *VOLTS, *SAFETY, *host.REALTIME_PARAMETERS],
)
