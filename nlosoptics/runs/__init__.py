"""Whole runs: plan, simulate, reconstruct, and the record of a run."""
