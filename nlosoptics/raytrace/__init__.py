"""Rays and their intersections with the relay wall and with meshes."""

from .intersections import BEHIND, HIT, MISS, OUTSIDE, UNRESOLVED, Hits, intersect
from .irradiance import WallIrradiance, wall_irradiance
from .meshes import MeshHits, intersect_mesh, occluded
from .paths import RayPaths
from .surroundings import RayPlan, ray_plan
from .tracing import trace

__all__ = [
    "BEHIND",
    "HIT",
    "MISS",
    "OUTSIDE",
    "UNRESOLVED",
    "Hits",
    "MeshHits",
    "RayPaths",
    "RayPlan",
    "WallIrradiance",
    "intersect",
    "intersect_mesh",
    "occluded",
    "ray_plan",
    "trace",
    "wall_irradiance",
]
