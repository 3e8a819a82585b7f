"""Node ``rig``: a rig behind ros2_control. Joint states are its sensors, an effort its valve.

The hardware interface, written for ros2_control, belongs to controller_manager. Its
joint_state_broadcaster publishes the sensors on joint_states, and a controller `valves` takes
the commands on valves/commands (config/controllers.yaml). For each axis there are a joint of
its name with position, velocity and effort, and a joint NAME_accelerometer, whose position is
the measured acceleration: sensor_msgs/JointState has no other place for it.
"""

import sys
import time

import numpy as np
from rig_driver.driver_node import serve
from rig_driver.hardware import Floats
from seft_msgs_py.config.parameter_table import per_axis
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.node.node_shell import NodeShell
from seft_msgs_py.wire.messages import decode_message, typestore
from seft_msgs_py.wire.topics import Topic

STATES = Topic("joint_states", "sensor_msgs/msg/JointState", depth=1)
COMMANDS = Topic("valves/commands", "std_msgs/msg/Float64MultiArray", depth=1)
FOUND = 30.0  # s, longest wait for the first joint states
ACCELEROMETER = "_accelerometer"


class Ros2Control:
    """ros2_control as `rig_driver.hardware.Hardware`, in SI units.

    Parameters
    ----------
    shell : NodeShell
        Of the driver.
    safe : ndarray
        Valve command of the safe position, V, shape (n,).
    longest : float
        Time without joint states after which the sensors count as dead, s.
    """

    def __init__(self, shell: NodeShell, safe: Floats, longest: float) -> None:
        self._axes, self._safe, self._longest = shell.rig.axes, safe, longest
        self._sample, self._received_at = np.full((4, len(self._axes)), np.nan), -np.inf
        self._publish = shell.publisher(COMMANDS)
        shell.subscribe(STATES, self._take, reliable=False)

    @property
    def has_sample(self) -> bool:
        """Whether joint states have come."""
        return bool(np.isfinite(self._received_at))

    def read_sample(self) -> Floats:
        """Give the newest joint states, m, m/s, m/s^2 and N, shape (4, n)."""
        silence = time.monotonic() - self._received_at
        if silence > self._longest:
            raise OSError(f"no {STATES.name} for {silence:.3g} s; is controller_manager running?")
        return self._sample.copy()

    def write_command(self, volts: Floats) -> None:
        """Send the valve commands, V, shape (n,)."""
        types = typestore().types
        layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
        message = types[COMMANDS.type](layout=layout, data=np.asarray(volts, np.float64))
        self._publish(bytes(typestore().serialize_cdr(message, COMMANDS.type)))

    def to_safe_position(self) -> None:
        """Send the valve commands of the safe position."""
        self.write_command(self._safe)

    def close(self) -> None:
        """Leave the valves in their safe position."""
        self.to_safe_position()

    def _take(self, raw: bytes, _: int) -> None:
        message = decode_message(STATES.type, raw, STATES.name)
        place = {name: at for at, name in enumerate(message.name)}
        try:
            axes = [place[axis] for axis in self._axes]
            sensors = [place[axis + ACCELEROMETER] for axis in self._axes]
            moved, pushed = message.position, message.effort
            self._sample[:] = moved[axes], message.velocity[axes], moved[sensors], pushed[axes]
        except KeyError as error:
            raise WireError(f"{STATES.name}: no joint {error}; it has {[*place]}") from None
        except IndexError:
            raise WireError(f"{STATES.name}: a position, velocity or effort is missing") from None
        self._received_at = time.monotonic()


def ros2_control(shell: NodeShell) -> Ros2Control:
    """Find the rig; InputError if its joint states don't come."""
    section = shell.experiment["rig"]
    safe = per_axis(section["safe.valve_command"], shell.rig.axes, "rig: safe.valve_command")
    hardware = Ros2Control(shell, safe, section["watchdog.command_timeout"])
    deadline = time.monotonic() + FOUND
    while not hardware.has_sample:
        shell.spin_once(0.05)
        if shell.stopping or time.monotonic() > deadline:
            raise InputError(
                f"no {STATES.name} of {', '.join(shell.rig.axes)} within {FOUND:g} s; start "
                "controller_manager with joint_state_broadcaster (launch/ros2_control.launch.py)"
            )
    return hardware


def main() -> int:
    """Entry point of ``ros2 run rig_driver rig``."""
    return serve(ros2_control)


if __name__ == "__main__":
    sys.exit(main())
