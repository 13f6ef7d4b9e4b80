"""Settings, models of motion and sensor, particles, and the edge to ROS."""
