"""Models of motion and sensor, likelihoods, particles, records and random streams."""
