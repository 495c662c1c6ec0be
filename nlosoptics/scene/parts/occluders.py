"""Occluders: further surfaces of the room, which block light and may reflect it."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ..._checks import Vector
from ...errors import SceneError
from ._posed import PosedMesh
from .materials import Lambert, Material
from .meshes import load_mesh

if TYPE_CHECKING:
    import trimesh

BLACK = Lambert(0.0)  # material of occluders that only block light


@dataclass(frozen=True, eq=False)
class Occluder(PosedMesh):
    """Surface in the room: a triangle mesh that blocks light, such as a screen, or a floor.

    It is black by default. With a ``material`` it also reflects light, from both sides, so that
    floor, ceiling and side walls can be modelled. Only ray tracing takes this light into account
    (`nlosoptics.raytrace` except `trace_point`, and `nlosoptics.transient.render_scene`); all other
    methods refuse occluders that reflect light.

    The wall is at the plane z = 0, the room at z > 0, and y points up. The mesh may touch this
    plane but must not reach behind it. Its parts behind the surface of a curved wall block nothing,
    and a triangle that lies in the wall's surface does not cover the wall.

    Parameters
    ----------
    mesh : str, Path or trimesh.Trimesh
        Mesh file (STL, OBJ, PLY, ...) or mesh. Its coordinates, m, refer to an origin of its own.
    scale : float
        Factor applied to the mesh's coordinates, for example 1e-3 for a file in millimetres.
    position : (float, float, float)
        Position of the mesh's origin, world frame, m.
    yaw, pitch, roll : float
        Right-handed rotations about the world's y, x and z axis, rad, applied in the order roll,
        pitch, yaw.
    material : Material
        Bidirectional reflectance of the surface, from both sides. The default is black.

    Raises
    ------
    SceneError
        If a value is out of range or ``material`` is no `Material`. The file is read when the
        property `surface` (the mesh in the world frame) is first used. Only then is an error raised
        if the file is missing or the mesh reaches behind the plane z = 0.

    See Also
    --------
    MeshObject : Hidden triangle mesh.
    nlosoptics.imaging.cast_shadows : Effect of occluders.

    Examples
    --------
    A board 0.4 m wide and 1 m high, upright at a distance of 0.8 m from the wall:

    >>> from dataclasses import replace
    >>> import trimesh
    >>> from nlosoptics import Scene
    >>> from nlosoptics.scene import Occluder
    >>> board = Occluder(trimesh.creation.box((0.4, 1.0, 0.01)), position=(0.0, 0.0, 0.8))
    >>> scene = Scene.load("examples/scenes/letter_flat.toml")
    >>> shadowed = replace(scene, occluders=(board,))

    A grey floor, 4 m wide and 3 m deep, 1 m below the centre of the wall:

    >>> from nlosoptics.scene import Lambert
    >>> corners = [(-2, 0, 0), (2, 0, 0), (2, 0, 3), (-2, 0, 3)]
    >>> sheet = trimesh.Trimesh(corners, [(0, 2, 1), (0, 3, 2)])
    >>> floor = Occluder(sheet, position=(0.0, -1.0, 0.0), material=Lambert(0.3))
    """

    table: ClassVar[str] = "occluder"
    _: KW_ONLY
    position: Vector = (0.0, 0.0, 0.0)
    material: Material = BLACK

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.material, Material):
            raise SceneError(
                f"occluder.material = {self.material!r} is a {type(self.material).__name__}; give "
                "a Material, such as Lambert(0.3)"
            )

    @cached_property
    def surface(self) -> trimesh.Trimesh:
        """Mesh in the world frame, m; its file is read at the first access."""
        mesh = self._placed()
        _refuse_behind("occluder.mesh", mesh, "move occluder.position into the room")
        return mesh


def checked_occluders(values: Any) -> tuple[Occluder | trimesh.Trimesh, ...]:
    """Return the occluders as a tuple; raise `SceneError` for other types or meshes behind z = 0.

    Files of an `Occluder` are not read here.
    """
    try:
        occluders = tuple(values)
    except TypeError:
        raise SceneError(
            f"scene.occluders is a {type(values).__name__}; give a tuple of meshes"
        ) from None
    for index, occluder in enumerate(occluders):
        if isinstance(occluder, Occluder):
            continue
        import trimesh

        name = f"scene.occluders[{index}]"
        if not isinstance(occluder, trimesh.Trimesh):
            raise SceneError(
                f"{name} is a {type(occluder).__name__}; give a trimesh.Trimesh or an Occluder"
            )
        _refuse_behind(name, load_mesh(name, occluder), "move it into the room")
    return occluders


def joined(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh | None:
    """Return all meshes as one; None without meshes."""
    if not meshes:
        return None
    import trimesh

    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    faces = [np.asarray(m.faces) + start for m, start in zip(meshes, starts, strict=True)]
    return trimesh.Trimesh(
        np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces), process=False
    )


def _refuse_behind(name: str, mesh: trimesh.Trimesh, remedy: str) -> None:
    """Raise `SceneError` if the mesh reaches below z = 0 by more than rounding."""
    lowest = float(mesh.vertices[:, 2].min())
    # rotating a mesh onto the wall has an error of 1e-12 of the largest coordinate
    if lowest < -1e-12 * float(np.abs(mesh.vertices).max()):
        raise SceneError(
            f"{name} reaches z = {lowest:g} m, behind the wall's plane, must be at least 0; "
            f"{remedy}"
        )
