"""Rosbag2 bags: written, read, repaired, replayed, and made of files."""
