"""Rays: their intersections with wall and meshes, facets of a rough wall, and traced light."""

from .facets import facet_angles
from .intersections import BEHIND, HIT, MISS, OUTSIDE, UNRESOLVED, Hits, intersect
from .irradiance import WallIrradiance, wall_irradiance
from .meshes import AllHits, MeshHits, all_hits, intersect_mesh, occluded
from .paths import RayPaths
from .points import PointTrace, trace_point
from .pupil_fans import pupil_rays
from .surroundings import RayPlan, ray_plan
from .tracing import trace

__all__ = [
    "BEHIND",
    "HIT",
    "MISS",
    "OUTSIDE",
    "UNRESOLVED",
    "AllHits",
    "Hits",
    "MeshHits",
    "PointTrace",
    "RayPaths",
    "RayPlan",
    "WallIrradiance",
    "all_hits",
    "facet_angles",
    "intersect",
    "intersect_mesh",
    "occluded",
    "pupil_rays",
    "ray_plan",
    "trace",
    "trace_point",
    "wall_irradiance",
]
