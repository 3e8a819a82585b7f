"""Settings of every test; rclpy and the processes that tests start read those of ROS 2."""

import os

from hypothesis import settings
from ros_domain import reserve_domain
from seft_msgs_py.node.process import prepare_middleware

os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"  # a wrong type in a message raises, not corrupts
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
prepare_middleware()
_number, _ = reserve_domain()  # until this process ends, apart from tests that run beside it
os.environ["ROS_DOMAIN_ID"] = str(_number)
# A busy machine is no fault of a test, and a change is tried on the examples of the one before.
settings.register_profile("seft", deadline=None, derandomize=True, max_examples=50)
settings.register_profile("drawn", deadline=None)  # anew and more of them: `make thorough-offline`
settings.load_profile("seft")
