"""The ROS side of a run: manager, supervisor and cameras."""
