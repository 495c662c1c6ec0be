"""Scene description: laser, wall, hidden object, occluders, camera, materials and scene files."""

from .parts.burst import Burst
from .parts.camera import Camera
from .parts.hidden import MeshObject, PlanarObject
from .parts.laser import Laser
from .parts.library import material_library, named_material
from .parts.materials import (
    Lambert,
    Material,
    OrenNayar,
    Retroreflector,
    SpecularMicrofacet,
    SumMaterial,
    Ward,
)
from .parts.occluders import Occluder
from .parts.spectrum import Spectrum
from .parts.transient_scan import TransientScan
from .scene import Scene
from .walls.analytic import ConcaveWall, ConvexWall, FlatWall, SumWall, Wall, WavyWall
from .walls.height_maps import CallableWall, HeightMapWall
from .walls.mesh_walls import MeshWall
from .walls.relief import FacetWall, GaussianWall
from .walls.roughness import WallRoughness

__all__ = [
    "Burst",
    "CallableWall",
    "Camera",
    "ConcaveWall",
    "ConvexWall",
    "FacetWall",
    "FlatWall",
    "GaussianWall",
    "HeightMapWall",
    "Lambert",
    "Laser",
    "Material",
    "MeshObject",
    "MeshWall",
    "Occluder",
    "OrenNayar",
    "PlanarObject",
    "Retroreflector",
    "Scene",
    "Spectrum",
    "SpecularMicrofacet",
    "SumMaterial",
    "SumWall",
    "TransientScan",
    "Wall",
    "WallRoughness",
    "Ward",
    "WavyWall",
    "material_library",
    "named_material",
]


def __dir__() -> list[str]:
    """Return the public names, for completion."""
    return __all__
