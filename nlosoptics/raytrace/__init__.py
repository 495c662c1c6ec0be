"""Rays and their intersections with the relay wall and with meshes."""

from .intersections import BEHIND, HIT, MISS, OUTSIDE, UNRESOLVED, Hits, intersect
from .meshes import MeshHits, intersect_mesh, occluded

__all__ = [
    "BEHIND",
    "HIT",
    "MISS",
    "OUTSIDE",
    "UNRESOLVED",
    "Hits",
    "MeshHits",
    "intersect",
    "intersect_mesh",
    "occluded",
]
