"""The ROS side of running and evaluating graphs."""
