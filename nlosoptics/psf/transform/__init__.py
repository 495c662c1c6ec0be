"""Transforms from an exit-pupil wave to its point spread function."""
