"""From the frames of a real camera to what detectors expect."""
