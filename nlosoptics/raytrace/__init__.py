"""Rays and their intersections with the relay wall."""

from .intersections import BEHIND, HIT, MISS, OUTSIDE, UNRESOLVED, Hits, intersect

__all__ = ["BEHIND", "HIT", "MISS", "OUTSIDE", "UNRESOLVED", "Hits", "intersect"]
