"""Formats of files with frames, read within bounds whatever a file declares."""
