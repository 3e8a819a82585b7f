"""ROS nodes: they move samples between topics and blocks."""
