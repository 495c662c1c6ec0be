"""Ray tracing: intersections with walls and meshes, and light transport."""

from .fans.paths import RayPaths
from .fans.pupil_fans import pupil_rays
from .intersection.intersections import BEHIND, HIT, MISS, OUTSIDE, UNRESOLVED, Hits, intersect
from .intersection.meshes import AllHits, MeshHits, all_hits, intersect_mesh, occluded
from .light.irradiance import WallIrradiance, wall_irradiance
from .light.surroundings import RayPlan, ray_plan
from .light.trace import trace
from .light.trace_point import PointTrace, trace_point

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
    "intersect",
    "intersect_mesh",
    "occluded",
    "pupil_rays",
    "ray_plan",
    "trace",
    "trace_point",
    "wall_irradiance",
]
