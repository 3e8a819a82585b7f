"""Experiments: parameter tables and files; without rclpy."""
