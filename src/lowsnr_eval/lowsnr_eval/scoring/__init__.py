"""Scores of frames and runs."""
