"""Measurement, forward model in torch, result, and the scores and checkpoints of solvers."""
