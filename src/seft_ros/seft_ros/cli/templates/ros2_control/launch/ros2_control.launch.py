"""controller_manager with the rig's interface and its two controllers; start the driver beside it.

ros2 launch rig_driver ros2_control.launch.py
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    """Start controller_manager, and have it load the controllers."""
    share = Path(get_package_share_directory("rig_driver"))
    description = {"robot_description": (share / "urdf" / "rig.urdf").read_text()}
    controllers = str(share / "config" / "controllers.yaml")
    return LaunchDescription(
        [
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                parameters=[description],
            ),
            Node(
                package="controller_manager",
                executable="ros2_control_node",
                parameters=[controllers],
            ),
            Node(
                package="controller_manager",
                executable="spawner",
                arguments=["joint_state_broadcaster", "valves", "--param-file", controllers],
            ),
        ]
    )
