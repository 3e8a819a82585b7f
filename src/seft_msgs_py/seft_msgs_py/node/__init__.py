"""The shell of a node over rclpy, and how its process runs."""
