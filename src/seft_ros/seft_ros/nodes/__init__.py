"""ROS nodes: thin shells that move samples between topics and blocks."""
