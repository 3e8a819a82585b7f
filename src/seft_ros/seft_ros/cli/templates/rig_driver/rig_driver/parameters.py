"""Parameter table of the driver: the names that other nodes and the operator know it by."""

from seft_msgs_py.config.parameter_table import Table, parameter_rows
from seft_msgs_py.node import host
from seft_plant_sim.rig_parameters import CALIBRATION as KNOWN_OF_A_RIG
from seft_plant_sim.rig_parameters import limit_rows

from rig_driver.calibration import PARAMETERS as CALIBRATION

KNOWN = [row for row in KNOWN_OF_A_RIG if row.name != "calibration.zeroing"]  # the supervisor's
SAFETY = parameter_rows(
    """
    limits.command              | float  | 10.0 | V   | > 0  | largest valve command either way
    safe.valve_command          | floats | 0.0  | V   |      | valve command of the safe position
    safe.close_time             | float  | 0.02 | s   | 0 .. | time in which the valve goes there
    safe.rest_velocity          | float  | 1e-3 | m/s | > 0  | slower counts as rest
    safe.settle_time            | float  | 2.0  | s   | > 0  | time in which it must rest
    watchdog.command_timeout    | float  | 0.02 | s   | > 0  |
        longest time without a new valve command before the rig trips
    watchdog.supervisor_timeout | float  | 1.0  | s   | > 0  |
        longest silence of the supervisor before the rig trips
    """
)
TABLE = Table("rig", [*CALIBRATION, *KNOWN, *limit_rows(), *SAFETY, *host.REALTIME_PARAMETERS])
