"""Section VI: scoring, Monte Carlo studies and reports."""
