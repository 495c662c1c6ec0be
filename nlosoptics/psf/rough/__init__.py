"""Point spread functions of rough walls: mean, samples, two scales."""
