"""Relay walls: analytic shapes, height maps and meshes."""
