"""The sampled wave in the exit pupil."""
