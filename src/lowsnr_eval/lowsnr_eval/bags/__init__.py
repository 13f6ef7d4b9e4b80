"""Recorded runs and real frames: bags written, read, repaired, replayed, and made of files."""
