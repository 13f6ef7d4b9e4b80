"""Images as cameras send them, without ROS: encodings and compression."""
