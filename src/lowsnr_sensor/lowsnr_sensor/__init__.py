"""Section II: scenarios, simulated sensor, conditioning of real frames."""
