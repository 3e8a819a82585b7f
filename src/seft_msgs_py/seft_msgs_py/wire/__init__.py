"""The wire: topics, samples and messages <-> bytes, experiment time; without rclpy."""
