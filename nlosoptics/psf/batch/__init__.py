"""Point spreads of many waves on one pupil, and their gradients."""
