"""Reconstruction with a known point spread function."""
