"""The scene: everything that light meets."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import SceneError
from .camera import Camera
from .hidden import HiddenObject, MeshObject, PlanarObject
from .laser import Laser
from .materials import Lambert, Material, SpecularMicrofacet, SumMaterial
from .walls import Wall

#: Matt white paint with a faint gloss; without a mirror-like lobe no wall passes a letter.
PAINT = SumMaterial(Lambert(0.7), SpecularMicrofacet(0.05, 0.0))


@dataclass(frozen=True)
class Scene:
    """Laser, relay wall, hidden object and camera in one world frame.

    The origin is the wall's centre, the mean wall plane is z = 0 with its normal +z into the room,
    and y is up; object, laser and camera have z > 0.

    Parameters
    ----------
    laser : Laser
    wall : Wall
        Shape of the relay wall.
    hidden : PlanarObject or MeshObject
    camera : Camera
    occluders : tuple of trimesh.Trimesh
        Meshes that block light, world frame, m.
    wall_material : Material
        What the relay wall is made of; the default is matt paint with a 5 % mirror-like lobe.
    """

    laser: Laser
    wall: Wall
    hidden: HiddenObject
    camera: Camera
    occluders: tuple[Any, ...] = ()
    wall_material: Material = PAINT

    def __post_init__(self) -> None:
        for name, kind in (
            ("laser", Laser),
            ("wall", Wall),
            ("hidden", (PlanarObject, MeshObject)),
            ("camera", Camera),
            ("wall_material", Material),
        ):
            value = getattr(self, name)
            if not isinstance(value, kind):
                raise SceneError(f"scene.{name} is a {type(value).__name__}, which it cannot be")
        if self.occluders:
            raise SceneError(
                "scene.occluders are not traced yet; leave them out, or model the free paths only"
            )
        if self.laser.aim[2] != 0.0:
            raise SceneError(
                f"laser.aim has z = {self.laser.aim[2]:g} m; give a point of the plane z = 0"
            )

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read a scene file (TOML); see `scene.file` for its keys.

        Raises
        ------
        SceneError
            Naming file, key, value, limit and remedy.
        """
        from .file import load_scene

        return load_scene(Path(path))

    def save(self, path: str | Path) -> None:
        """Write a scene file that `load` reads back to an equal scene."""
        from .file import save_scene

        save_scene(self, Path(path))

    def resized(self, size: int) -> Scene:
        """The same scene with an image of ``size`` pixels across the same field."""
        return replace(self, camera=self.camera.resized(size))

    @property
    def object_point(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Reference point of the hidden object, world, m: its centre, or its mesh's centroid."""
        if isinstance(self.hidden, MeshObject):
            return np.asarray(self.hidden.surface.centroid)
        return np.array(self.hidden.position)

    @property
    def mirrored_object_point(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """`object_point` mirrored in the plane z = 0, world, m."""
        return self.object_point * (1.0, 1.0, -1.0)

    @property
    def focus_distance(self) -> float:
        """Axial distance in front of the lens that is in focus, m."""
        if self.camera.focus_distance is not None:
            return self.camera.focus_distance
        return float(
            (self.mirrored_object_point - np.array(self.camera.position)) @ self.camera.axis
        )

    @property
    def image_distance(self) -> float:
        """Distance from the lens to the detector, m, by the thin-lens equation."""
        f, s = self.camera.focal_length, self.focus_distance
        if s <= f:
            raise SceneError(
                f"the mirrored object is {s:g} m in front of the lens, within its focal length "
                f"{f:g} m; turn the camera to the wall or move it back"
            )
        return f * s / (s - f)
