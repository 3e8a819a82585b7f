"""Running a test as separate node processes."""

from seft_msgs_py.node.shared_memory import check_shared_memory

check_shared_memory()  # before any module here imports rclpy
