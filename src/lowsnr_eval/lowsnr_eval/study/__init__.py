"""Monte Carlo studies of the claims of Section VI."""
