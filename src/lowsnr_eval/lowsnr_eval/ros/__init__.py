"""Messages of recorded runs and of viewers."""
