"""The verbs of ``ros2`` that look at a running graph."""
