"""A rig that speaks as controller_manager does with the package's two controllers.

python -m ros2_control_system RATE, with the driver's template on the path
"""

import sys
import time

import numpy as np
import rclpy
from rig_driver.stand_in import VOLTS, StandIn
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray


def main() -> None:
    rate = float(sys.argv[1])
    rclpy.init(args=[])
    node = rclpy.create_node("controller_manager")
    rig, command = StandIn(rate, ("x",), np.zeros(1)), np.zeros(1)

    def take(message) -> None:
        command[:] = message.data

    node.create_subscription(Float64MultiArray, "valves/commands", take, 1)
    publisher = node.create_publisher(JointState, "joint_states", 1)
    deadline = time.monotonic()
    while True:
        deadline += 1.0 / rate
        while (left := deadline - time.monotonic()) > 0:
            rclpy.spin_once(node, timeout_sec=left)
        rig.write_command(command)
        x, v, a, f = (rig.read_sample() * VOLTS)[:, 0].tolist()
        message = JointState(name=["x_accelerometer", "x"])
        message.position, message.velocity, message.effort = [a, x], [0.0, v], [0.0, f]
        publisher.publish(message)


if __name__ == "__main__":
    main()
