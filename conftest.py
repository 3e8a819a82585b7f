"""Settings of every test; rclpy and the processes that tests start read those of ROS 2."""

import os

from hypothesis import settings
from seft_msgs_py.node.process import prepare_middleware

os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"  # a wrong type in a message raises, not corrupts
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
prepare_middleware()
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)  # apart from tests that run beside us
settings.register_profile("seft", deadline=None)  # a busy machine is no fault of a test
settings.load_profile("seft")
