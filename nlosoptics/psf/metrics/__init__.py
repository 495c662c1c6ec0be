"""Metrics of waves and point spread functions."""
