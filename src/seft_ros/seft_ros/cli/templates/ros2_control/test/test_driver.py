"""The driver's own parts, and, where ROS has ros2_control, the driver on its mock components."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rig_driver.ros2_control import COMMANDS, STATES, Ros2Control
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.messages import decode_message, typestore
from seft_msgs_py.wire.topics import RigAxes

PACKAGE = Path(__file__).parents[1]
NEEDED = ("controller_manager", "joint_state_broadcaster", "forward_command_controller")


def joint_states(names, position, velocity, effort):
    types = typestore().types
    stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    values = [np.array(each, float) for each in (position, velocity, effort)]
    message = types[STATES.type](header, names, *values)
    return bytes(typestore().serialize_cdr(message, STATES.type))


@pytest.fixture
def rig():
    """Give the hardware, what it sends, and the function that takes joint states."""
    sent, takers = [], []
    shell = SimpleNamespace(
        rig=RigAxes.whole(("x",)),
        publisher=lambda topic: sent.append,
        subscribe=lambda topic, take, **_: takers.append(take),
    )
    hardware = Ros2Control(shell, np.array([0.1]), longest=60.0)
    return SimpleNamespace(hardware=hardware, sent=sent, take=lambda raw: takers[0](raw, 0))


def test_each_quantity_is_found_by_the_name_of_its_joint(rig):
    names = ["x_accelerometer", "other", "x"]
    rig.take(joint_states(names, [9.0, 0.0, 1.0], [0.0, 0.0, 2.0], [0.0, 0.0, 3.0]))
    np.testing.assert_array_equal(rig.hardware.read_sample()[:, 0], [1.0, 2.0, 9.0, 3.0])


def test_silent_or_wrong_joint_states_are_no_sample(rig):
    with pytest.raises(OSError, match="is controller_manager running"):
        rig.hardware.read_sample()
    with pytest.raises(WireError, match="no joint 'x'"):
        rig.take(joint_states(["y"], [0.0], [0.0], [0.0]))
    with pytest.raises(WireError, match="is missing"):
        rig.take(joint_states(["x", "x_accelerometer"], [0.0, 0.0], [], [0.0, 0.0]))
    assert not rig.hardware.has_sample


def test_the_safe_position_is_a_command(rig):
    rig.hardware.write_command(np.array([2.5]))
    rig.hardware.to_safe_position()
    sent = [float(decode_message(COMMANDS.type, raw).data[0]) for raw in rig.sent]
    assert sent == [2.5, 0.1]


def has_ros2_control():
    folders = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return all(any((Path(each) / "share" / name).is_dir() for each in folders) for name in NEEDED)


@pytest.mark.skipif(not has_ros2_control(), reason="ROS has no ros2_control here")
def test_the_mock_components_mirror_a_command():
    """Their effort follows the command: `seft conform` needs a rig that moves."""
    import rclpy
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    text = (PACKAGE / "urdf" / "rig.urdf").read_text()
    controllers = str(PACKAGE / "config" / "controllers.yaml")
    described = ("--ros-args", "-p", f"robot_description:={text}")
    loads = ("joint_state_broadcaster", "valves", "--param-file", controllers)
    commands = (
        ["robot_state_publisher", "robot_state_publisher", *described],
        ["controller_manager", "ros2_control_node", "--ros-args", "--params-file", controllers],
        ["controller_manager", "spawner", *loads],
    )
    processes = [subprocess.Popen(["ros2", "run", *words]) for words in commands]
    driver = None
    try:
        rclpy.init()
        node = rclpy.create_node("test_of_the_mock_components")
        heard = []
        node.create_subscription(JointState, "joint_states", heard.append, 10)
        sender = node.create_publisher(Float64MultiArray, "valves/commands", 10)
        deadline = time.monotonic() + 60.0
        while not (heard and 1.5 in heard[-1].effort):
            sender.publish(Float64MultiArray(data=[1.5]))
            rclpy.spin_once(node, timeout_sec=0.1)
            assert time.monotonic() < deadline, "the command does not come back"
        words = ["-m", "rig_driver.ros2_control", "--ros-args", "--params-file"]
        driver = subprocess.Popen([sys.executable, *words, str(PACKAGE / "config" / "rig.yaml")])
        while 0.0 not in heard[-1].effort[:1]:  # the driver brings the valve to its safe position
            rclpy.spin_once(node, timeout_sec=0.1)
            assert driver.poll() is None
            assert time.monotonic() < deadline, "the driver does not reach the valve"
        rclpy.shutdown()
    finally:
        for process in [*([driver] if driver else []), *processes]:
            process.send_signal(signal.SIGINT)
            process.wait(10.0)
