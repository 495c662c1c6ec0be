"""Figures of merit of waves and point spread functions."""
