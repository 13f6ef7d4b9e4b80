"""Models, statistics and loops that several detectors use."""
