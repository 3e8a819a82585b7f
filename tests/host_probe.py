"""What the rig of a host does, a JSON object a line: states, valve commands, what the rig says.

Run as ``python -m host_probe CONFIG`` on the host of the rig.
"""

import json
import sys

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.node.rclpy_interface import message_class, qos_profile
from seft_msgs_py.wire.messages import decode_diagnostics
from seft_msgs_py.wire.topics import DIAGNOSTICS, RIG_STATE, VALVE_COMMAND
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_ros.test_run.parameter_tables import TABLES


def tell(**what):
    print(json.dumps(what), flush=True)


def main():
    experiment = Experiment.load(TABLES, [sys.argv[1]])
    rclpy.init()
    node = Node("host_probe", start_parameter_services=False)

    def of_a_step(topic, row):
        codec = TrajectoryCodec(topic, experiment.axes, experiment.timebase)

        def receive(raw, info):
            step, values = codec.decode(raw)
            sent = info["source_timestamp"] / 1e9  # this process may be late
            tell(topic=topic.name, at=sent, step=step, value=values[0, row, 0])

        return receive

    def of_the_rig(raw):
        for status in decode_diagnostics(raw)[1]:
            if status.name == "rig" and status.values.get("phase") == "tripped":
                tell(tripped=status.values["reason"])

    for topic, receive in (
        (RIG_STATE, of_a_step(RIG_STATE, 3)),
        (VALVE_COMMAND, of_a_step(VALVE_COMMAND, 0)),
        (DIAGNOSTICS, of_the_rig),
    ):
        quality = qos_profile(topic, 4096)
        node.create_subscription(message_class(topic), topic.name, receive, quality, raw=True)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while True:
        executor.spin_once()


if __name__ == "__main__":
    main()
