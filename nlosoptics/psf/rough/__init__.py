"""Point spread functions of rough walls: mean, random samples, and two scales combined."""
