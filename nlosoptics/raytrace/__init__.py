"""Rays and their intersections with the relay wall and with meshes; facets of a rough wall."""

from .facets import facet_angles
from .intersections import BEHIND, HIT, MISS, OUTSIDE, UNRESOLVED, Hits, intersect
from .meshes import MeshHits, intersect_mesh, occluded
from .paths import RayPaths
from .pupil_fans import pupil_rays

__all__ = [
    "BEHIND",
    "HIT",
    "MISS",
    "OUTSIDE",
    "UNRESOLVED",
    "Hits",
    "MeshHits",
    "RayPaths",
    "facet_angles",
    "intersect",
    "intersect_mesh",
    "occluded",
    "pupil_rays",
]
