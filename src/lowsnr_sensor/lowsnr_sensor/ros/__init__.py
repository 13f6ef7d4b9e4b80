"""The one edge to ROS: parameters, messages and the life of a node."""
