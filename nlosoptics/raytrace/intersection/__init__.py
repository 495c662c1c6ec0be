"""Intersections of rays with walls and triangle meshes, in float64."""
