"""From options and files to a checked graph."""
