"""Fans of rays via the wall to the lens, random facets of a rough wall, and the ray paths."""
