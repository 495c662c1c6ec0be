"""Rays and their intersections with the relay wall and with meshes."""

from .intersections import BEHIND, HIT, MISS, OUTSIDE, UNRESOLVED, Hits, intersect
from .meshes import AllHits, MeshHits, all_hits, intersect_mesh, occluded

__all__ = [
    "BEHIND",
    "HIT",
    "MISS",
    "OUTSIDE",
    "UNRESOLVED",
    "AllHits",
    "Hits",
    "MeshHits",
    "all_hits",
    "intersect",
    "intersect_mesh",
    "occluded",
]
