"""What is there: laser, wall, hidden object, occluders, camera, materials; the scene file."""

from ._material import MirrorLobe
from .camera import Camera, pupil_frame
from .height_maps import CallableWall, HeightMapWall
from .hidden import MeshObject, PlanarObject
from .laser import Laser
from .materials import (
    Lambert,
    Material,
    OrenNayar,
    SpecularMicrofacet,
    SumMaterial,
    Ward,
)
from .mesh import MeshWall
from .occluders import Occluder
from .scene import Scene
from .transient_scan import TransientScan
from .walls import ConcaveWall, ConvexWall, FlatWall, SumWall, Wall, WavyWall

__all__ = [
    "CallableWall",
    "Camera",
    "ConcaveWall",
    "ConvexWall",
    "FlatWall",
    "HeightMapWall",
    "Lambert",
    "Laser",
    "Material",
    "MeshObject",
    "MeshWall",
    "MirrorLobe",
    "Occluder",
    "OrenNayar",
    "PlanarObject",
    "Scene",
    "SpecularMicrofacet",
    "SumMaterial",
    "SumWall",
    "TransientScan",
    "Wall",
    "Ward",
    "WavyWall",
    "pupil_frame",
]
