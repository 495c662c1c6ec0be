"""Monte Carlo light transport from the laser, or from one object point, to the detector."""
