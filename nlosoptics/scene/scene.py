"""The scene: laser, relay wall, hidden object, occluders and camera."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from .._checks import counted, in_range, path_of
from .._html import Figures, Shown
from .._nouns import Noun
from ..errors import SceneError
from ..kernels.codes import RETROREFLECTOR
from .parts._material import MirrorLobe
from .parts._sources import bare_mesh
from .parts.burst import Burst
from .parts.camera import Camera
from .parts.hidden import HiddenObject, MeshObject, PlanarObject
from .parts.laser import Laser
from .parts.materials import Lambert, Material, SpecularMicrofacet, SumMaterial
from .parts.occluders import BLACK, Occluder, checked_occluders, joined
from .parts.transient_scan import TransientScan
from .walls.analytic import Array, ConcaveWall, ConvexWall, FlatWall, SumWall, Wall, WavyWall
from .walls.mesh_walls import MeshWall
from .walls.relief import FacetWall, GaussianWall
from .walls.roughness import WallRoughness

if TYPE_CHECKING:
    import trimesh

T = TypeVar("T")
#: Matt white paint with a faint gloss: without a mirror-like lobe the wall transfers no letter.
PAINT = SumMaterial(Lambert(0.7), SpecularMicrofacet(0.05, 0.0))


@dataclass(frozen=True)
class Scene(Noun, Shown):
    """Laser, relay wall, hidden object and camera in one world frame.

    The origin of the world frame is the wall's centre. The mean wall plane is z = 0, its normal +z
    points into the room, and y is up. Laser, object and camera have z > 0, and lie in front of the
    surface of a curved wall.

    Parameters
    ----------
    laser : Laser
        Light source and the point of the wall that it is aimed at.
    wall : Wall
        Shape of the relay wall.
    hidden : PlanarObject or MeshObject
        Hidden object: an image on a plane, or a triangle mesh.
    camera : Camera
        Thin-lens camera that looks at the wall.
    occluders : tuple of trimesh.Trimesh or Occluder
        Surfaces that block light: meshes in the world frame, m, which are black, or `Occluder`
        objects with a mesh file, a position, a rotation and a material. By default none.
    wall_material : Material
        Bidirectional reflectance of the relay wall. The default is matt paint (albedo 0.7) with a
        smooth mirror-like part that reflects 5 % of the light.
    transient : TransientScan, optional
        Settings of a time-resolved capture, for example by a single-photon camera, and the volume
        that is reconstructed from it. Not needed for the image of an ordinary camera.
    wall_roughness : WallRoughness, optional
        Random or measured heights that are added to ``wall``, which is then the mean surface. Their
        slopes spread the mirror-like reflection of the wall. So that no slope is counted twice, the
        mirror-like lobes of ``wall_material`` must have slope zero or the rms slope of these
        heights. By default no heights are added.
    ambient_irradiance : float, default 0
        Irradiance of wall and hidden object by the light of the room, W/m^2, 0 to 1e18. It lights
        the object, and adds a slowly varying background to the image of a matt wall.
    burst : Burst, optional
        Several exposures from different camera positions, for a wall with ``wall_roughness``. By
        default a single exposure.

    Raises
    ------
    SceneError
        If a part has the wrong type, the laser is not aimed at a point of the plane z = 0, a part
        lies behind the wall, the roughness contradicts the wall or its material, or the exposures
        of the burst would have the same speckle.

    Notes
    -----
    Whether a planar object lies in front of a curved wall is checked at its corners and centre.
    Checks that must read a mesh file or fit a surface (`MeshWall`, `MeshObject`, `Occluder`) are
    made later, by `imaging.form_image` and `raytrace.trace`.

    See Also
    --------
    Scene.load : Read a scene file.

    Examples
    --------
    >>> from nlosoptics import Scene
    >>> scene = Scene.load("examples/scenes/letter_flat.toml")
    >>> scene.camera.shape, scene.hidden.size
    ((512, 512), (0.7, 0.7))
    >>> round(scene.focus_distance, 3), round(1e3 * scene.image_distance, 2)
    (2.049, 51.92)
    """

    laser: Laser
    wall: Wall
    hidden: HiddenObject
    camera: Camera
    occluders: tuple[Occluder | trimesh.Trimesh, ...] = ()
    wall_material: Material = PAINT
    transient: TransientScan | None = None
    wall_roughness: WallRoughness | None = None
    burst: Burst | None = None
    ambient_irradiance: float = 0.0

    def __post_init__(self) -> None:
        kinds: dict[str, tuple[type, ...]] = {
            "laser": (Laser,),
            "wall": (Wall,),
            "hidden": (PlanarObject, MeshObject),
            "camera": (Camera,),
            "wall_material": (Material,),
            "transient": (TransientScan, NoneType),
            "wall_roughness": (WallRoughness, NoneType),
            "burst": (Burst, NoneType),
        }
        for name, allowed in kinds.items():
            value = getattr(self, name)
            if not isinstance(value, allowed):
                wanted = " or ".join(kind.__name__ for kind in allowed if kind is not NoneType)
                raise SceneError(f"scene.{name} is a {type(value).__name__}; give a {wanted}")
        if (self.wall_material.lobe_table()[:, 0] == RETROREFLECTOR).any():
            raise SceneError(
                "wall.material is a retroreflector, which a relay wall must not be, because it "
                "returns light to the laser; give it to the hidden object, or a Lambert to the wall"
            )
        ambient = in_range("ambient.irradiance", self.ambient_irradiance, 0.0, 1e18, unit="W/m^2")
        object.__setattr__(self, "ambient_irradiance", ambient)
        object.__setattr__(self, "occluders", checked_occluders(self.occluders))
        self._evaluate_colours()
        if self.laser.aim[2] != 0.0:
            raise SceneError(
                f"laser.aim has z = {self.laser.aim[2]:g} m; give a point of the plane z = 0"
            )
        if self.wall_roughness is not None:
            self.wall_roughness.check_material(self.wall_material)
        if not _holds_mesh(self.wall):
            if self.wall_roughness is not None:
                self.wall_roughness.check_wall(self.wall)
            self.check_in_front(meshes=False)
        if self.burst is not None:
            self._check_burst(self.burst)

    def _check_burst(self, burst: Burst) -> None:
        """Raise `SceneError` if the exposures of a burst would show the same pattern."""
        rough = self.wall_roughness
        if rough is None or rough.realisation != "pattern" or rough.slope_rms == 0.0:
            raise SceneError(
                "burst is given, but the wall has no speckle to change; add [wall.roughness] with "
                'realisation = "pattern" and a slope, or remove [burst]'
            )
        # a shift of the camera moves the seen part of the wall by d1/(d1 + d2)
        apart = self.hidden.position[2] + self.camera.position[2]
        length = math.sqrt(2.0) * rough.heights.height_rms / rough.slope_rms
        burst.check_step(self.camera.stop_diameter, length * apart / self.hidden.position[2])

    @property
    def exposures(self) -> tuple[Scene, ...]:
        """Scene of each exposure of the burst; without a burst, this scene alone.

        The scenes have no burst themselves. In each one the camera has another position, and its
        axis passes through the same point at the distance in focus, so that the object's image
        stays where it is.
        """
        if self.burst is None:
            return (self,)
        camera, (e1, e2, axis) = self.camera, self.camera.frame
        here = np.array(camera.position)
        aim = tuple(here + self.focus_distance * axis)
        places = [tuple(here + x * e1 + y * e2) for x, y in self.burst.offsets]
        try:
            moved = [replace(camera, position=place, aim=aim) for place in places]
        except SceneError as error:
            raise SceneError(
                f"burst.camera_step = {self.burst.camera_step:g} m leads to a camera that is "
                f"refused ({error}); give a shorter step"
            ) from None
        return tuple(replace(self, camera=camera, burst=None) for camera in moved)

    def _evaluate_colours(self) -> None:
        """Evaluate all materials at the laser's wavelength."""

        def at(name: str, material: Material) -> Material:
            try:
                return material.at(self.laser.wavelength)
            except SceneError as error:
                raise SceneError(f"{name}: {error}") from None

        def coloured(name: str, part: T) -> T:
            """Return a part, or a copy of it whose material is evaluated."""
            material = getattr(part, "material", None)
            if not isinstance(material, Material) or not material.is_coloured:
                return part
            found = at(f"{name}.material", material)
            return part if found is material else replace(part, material=found)  # type: ignore[type-var]

        occluders = tuple(coloured(f"occluder[{k}]", o) for k, o in enumerate(self.occluders))
        object.__setattr__(self, "wall_material", at("wall_material", self.wall_material))
        object.__setattr__(self, "hidden", coloured("hidden", self.hidden))
        object.__setattr__(self, "occluders", occluders)

    @property
    def is_coloured(self) -> bool:
        """Whether the albedo of any material depends on the wavelength."""
        return any(material.is_coloured for material in self.materials.values())

    @property
    def materials(self) -> dict[str, Material]:
        """Materials of all surfaces, black ones too, by the name that errors give them."""
        found = {"wall_material": self.wall_material, "hidden.material": self.hidden.material}
        for index, occluder in enumerate(self.occluders):
            if isinstance(occluder, Occluder):
                found[f"occluder[{index}].material"] = occluder.material
        return found

    def __getstate__(self) -> dict[str, Any]:
        return super().__getstate__() | {"occluders": tuple(map(bare_mesh, self.occluders))}

    @classmethod
    def load(cls, path: str | Path, changes: Mapping[str, Any] | None = None) -> Scene:
        """Read a scene file (TOML), optionally with some of its values replaced.

        Parameters
        ----------
        path : str or Path
            Scene file. The command ``nlosoptics schema`` prints a JSON schema that describes its
            keys.
        changes : mapping of str to value, optional
            New values by address. A value is written as in the file, with its unit. An address is
            table and key, such as ``wall.radius``. An element of a list has an index from 0, as in
            ``wall.material[1].slope_rms``. Keys of the file that contradict a new one are removed:
            setting ``camera.f_number`` removes ``camera.stop_diameter``.

        Returns
        -------
        Scene
            Scene described by the file. Paths in the file are relative to its folder.

        Raises
        ------
        SceneError
            If the file or a change is wrong. The message names file, key, value, limit and remedy.

        Examples
        --------
        >>> from nlosoptics import Scene
        >>> scene = Scene.load("examples/scenes/letter_flat.toml")
        >>> print(f"{1e9 * scene.laser.wavelength:.1f} nm, {type(scene.wall).__name__}")
        632.8 nm, FlatWall

        >>> bent = {"wall.shape": "concave_sphere", "wall.radius": "5 m", "laser.power": "20 mW"}
        >>> scene = Scene.load("examples/scenes/letter_flat.toml", bent)
        >>> type(scene.wall).__name__, scene.wall.radius, scene.laser.power
        ('ConcaveWall', 5.0, 0.02)
        """
        from .file.scene_file import read_scene

        return read_scene(path_of("path", path), cls, changes)

    def with_values(self, changes: Mapping[str, Any]) -> Scene:
        """Return a copy of the scene with some of its values replaced.

        Parameters
        ----------
        changes : mapping of str to value
            New values by address, as for `load`: numbers in SI units, or texts with a unit. Paths
            are relative to the current folder. ``wall.curvature``, 1/m, is positive for a concave
            wall and negative for a convex one; it replaces the curvature of a flat, spherical or
            cylindrical wall, and adds a sphere to all others.

        Raises
        ------
        SceneError
            If an address or value is wrong, or a part cannot be written in a scene file, such as a
            `CallableWall`.

        Examples
        --------
        >>> from nlosoptics import Scene
        >>> scene = Scene.load("examples/scenes/letter_concave.toml")
        >>> scene.with_values({"wall.radius": 4.0, "camera.exposure": "10 ms"}).wall.radius
        4.0
        >>> type(scene.with_values({"wall.curvature": -0.25}).wall).__name__
        'ConvexWall'
        """
        from .file.scene_file import changed_scene

        return changed_scene(self, changes)

    def save(self, path: str | Path) -> None:
        """Write a scene file from which `load` restores exactly the same values.

        An image, heights or meshes that are arrays in memory are written to files of their own in
        the same folder, without loss.

        Parameters
        ----------
        path : str or Path
            File to write; an existing file is replaced.

        Raises
        ------
        SceneError
            If the folder does not exist, or a wall or material cannot be written as TOML.
        """
        from .file.scene_file import save_scene

        save_scene(self, path_of("path", path))

    def _figures(self) -> Figures:
        """Return the key figures of the scene, for display in notebooks."""
        laser, camera = self.laser, self.camera
        size = self.wall.size
        ny, nx = camera.shape
        figures = {
            "laser": f"{1e9 * laser.wavelength:.4g} nm, {1e3 * laser.power:.3g} mW",
            "wall": type(self.wall).__name__ + (f", {size[0]:g} x {size[1]:g} m" if size else ""),
            "wall material": type(self.wall_material).__name__,
            "hidden": type(self.hidden).__name__,
            "occluders": f"{len(self.occluders)}",
            "camera": f"{1e3 * camera.focal_length:.3g} mm at F/{camera.f_number:.3g}",
            "image": f"{nx} x {ny} pixels of {1e6 * camera.image_pitch:.3g} µm",
            "exposure": f"{1e3 * camera.exposure:.3g} ms",
        }
        if self.wall_roughness is not None:
            figures["roughness"] = _in_words(self.wall_roughness)
        if isinstance(self.hidden, PlanarObject):
            across, high = self.hidden.size
            figures["hidden"] = f"picture, {across:g} x {high:g} m"
        if self.transient is not None:
            scan = self.transient
            figures["scan"] = (
                f"{scan.scan}, {scan.count} x {scan.count} points, {counted(scan.n_bins, 'bin')}"
            )
        if self.burst is not None:
            figures["burst"] = (
                f"{self.burst.images} exposures, {1e3 * self.burst.camera_step:.3g} mm apart"
            )
        alt = "Sketch of the scene from above and from the side: wall, laser, hidden object, camera"
        return Figures("Scene", figures, alt)

    def resized(self, size: int) -> Scene:
        """Return a copy whose camera image has ``size`` pixels along x over the same field of view.

        Only the binning of the camera changes: the number of native pixels of the sensor that are
        summed to one image pixel.

        Parameters
        ----------
        size : int
            Image pixels along x. ``camera.pixels[0] / size`` must be a whole number that also
            divides ``camera.pixels[1]``.

        Raises
        ------
        SceneError
            If no binning gives this size.
        """
        return replace(self, camera=self.camera.resized(size))

    def with_relief(self) -> Scene:
        """Return the scene with its roughness included in wall and material, for ray tracing.

        Returns
        -------
        Scene
            Scene without ``wall_roughness``. If ``wall_roughness.realisation`` is "pattern", the
            wall is the sum of mean wall and heights, and the mirror-like lobes of the material have
            slope 0. If it is "mean", the wall is the mean wall, and these lobes have the rms slope
            of the roughness. A scene without roughness is returned unchanged.

        Raises
        ------
        SceneError
            If a height map does not cover the wall, or a part lies behind the rough surface.

        Examples
        --------
        >>> from nlosoptics import Scene
        >>> scene = Scene.load("examples/scenes/letter_rough.toml")
        >>> rough = scene.with_relief()
        >>> type(scene.wall).__name__, type(rough.wall).__name__, rough.wall_roughness
        ('FlatWall', 'SumWall', None)
        """
        if self.wall_roughness is None:
            return self
        wall, material = self.wall_roughness.added_to(self.wall, self.wall_material)
        return replace(self, wall=wall, wall_material=material, wall_roughness=None, burst=None)

    @property
    def mirror_lobes(self) -> tuple[MirrorLobe, ...]:
        """Mirror-like lobes of ``wall_material``: tuple of `MirrorLobe`, rms slope up to 0.1 rad.

        If the scene has ``wall_roughness``, each lobe has the rms slope of the roughness.
        """
        lobes = self.wall_material.mirror_lobes
        if self.wall_roughness is None:
            return lobes
        return tuple(self.wall_roughness.mean_lobe(lobe) for lobe in lobes)

    @property
    def mirror_slopes(self) -> tuple[float, ...]:
        """Rms slope of each of `mirror_lobes`, (n,), rad; it is equal along both axes."""
        return tuple(lobe.slope_rms for lobe in self.mirror_lobes)

    def check_in_front(self, *, meshes: bool = True) -> None:
        """Check that laser, camera and hidden object lie in front of the wall's surface.

        Points whose x or y is outside the wall's edges are not checked.

        Parameters
        ----------
        meshes : bool
            Whether to check the vertices of a `MeshObject` too, which reads its file.

        Raises
        ------
        SceneError
            If one of them lies behind the wall.
        """
        if self.wall.is_flat or not self.wall.has_height:
            return  # each of them checks its own z > 0
        places: list[tuple[str, ArrayLike]] = [
            ("laser.position", self.laser.position),
            ("camera.position", self.camera.position),
        ]
        if isinstance(self.hidden, PlanarObject):
            places.append(("hidden.position", self.hidden.position))
            places.append(("hidden.size", self.hidden.corners))
        elif meshes:
            places.append(("hidden.mesh", self.hidden.surface.vertices))
        for name, points in places:
            _refuse_behind(self.wall, name, np.array(points, dtype=np.float64).reshape(-1, 3))

    @cached_property
    def occluding_mesh(self) -> trimesh.Trimesh | None:
        """All occluders as one mesh in the world frame, m; None without occluders."""
        return joined([mesh for mesh, _ in self.occluder_surfaces])

    @cached_property
    def occluder_surfaces(self) -> tuple[tuple[trimesh.Trimesh, Material], ...]:
        """Mesh in the world frame, m, and material of each occluder; its file is read here."""
        return tuple(
            (o.surface, o.material) if isinstance(o, Occluder) else (o, BLACK)
            for o in self.occluders
        )

    @property
    def room_materials(self) -> tuple[Material, ...]:
        """Materials of the occluders that reflect light."""
        materials = (o.material for o in self.occluders if isinstance(o, Occluder))
        return tuple(material for material in materials if not material.is_black)

    def check_laser_light(self) -> None:
        """Check that the laser alone lights the scene, as most methods assume.

        Raises
        ------
        SceneError
            If the laser has no power, the object is luminous, or there is ambient light.
        """
        what = "laser.power = 0 W: the scene has no laser"
        if self.ambient_irradiance > 0.0:
            what = f"ambient.irradiance = {self.ambient_irradiance:g} W/m^2: the room is lit"
        if isinstance(self.hidden, PlanarObject) and self.hidden.luminous is not None:
            what = f"hidden.luminous = {self.hidden.luminous:g} W/(m^2 sr): the object emits light"
        elif self.laser.power > 0.0 and self.ambient_irradiance == 0.0:
            return
        raise SceneError(
            f"{what}, but this computes light of the laser alone; use imaging.WallTransport, or "
            "give a [laser] and remove other light"
        )

    def check_black_occluders(self) -> None:
        """Check that no occluder reflects light, which most methods do not take into account.

        Raises
        ------
        SceneError
            If an occluder has a material that reflects light.
        """
        for index, occluder in enumerate(self.occluders):
            if isinstance(occluder, Occluder) and not occluder.material.is_black:
                raise SceneError(
                    f"occluder[{index}].material reflects light, which only raytrace.trace, "
                    "trace_image and wall_irradiance and transient.render_scene take into account; "
                    "use one of these, or remove the material"
                )

    @property
    def object_point(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Reference point of the object: image centre or mesh centroid, (3,), world frame, m."""
        if isinstance(self.hidden, MeshObject):
            return np.asarray(self.hidden.surface.centroid)
        return np.array(self.hidden.position)

    @property
    def mirrored_object_point(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Mirror image of `object_point` in the plane z = 0, (3,), world frame, m."""
        return self.object_point * (1.0, 1.0, -1.0)

    @property
    def focus_distance(self) -> float:
        """Distance along the optical axis from the lens to the plane in focus, m.

        It is ``camera.focus_distance`` or, if that is None, the distance of the hidden object's
        mirror image.
        """
        if self.camera.focus_distance is not None:
            return self.camera.focus_distance
        return float(
            (self.mirrored_object_point - np.array(self.camera.position)) @ self.camera.axis
        )

    @property
    def image_distance(self) -> float:
        """Distance from the lens to the detector, m, from the thin-lens equation."""
        f, s = self.camera.focal_length, self.focus_distance
        if s <= f:
            raise SceneError(
                f"the mirrored object is {s:g} m in front of the lens, within its focal length "
                f"{f:g} m; turn the camera to the wall or move it back"
            )
        return f * s / (s - f)


def _height_bound(wall: Wall, square: Array) -> Array | None:
    """Upper bound on the height at squared distances from the origin, m; None if not known."""
    if isinstance(wall, SumWall):
        bounds = [_height_bound(term, square) for term in wall.terms]
        known = [bound for bound in bounds if bound is not None]
        return np.sum(known, axis=0) if len(known) == len(bounds) else None
    if isinstance(wall, FacetWall | GaussianWall):
        return np.full_like(square, wall.max_height)
    if isinstance(wall, WavyWall):
        return np.full_like(square, abs(wall.amplitude))
    if isinstance(wall, ConcaveWall):
        # the sag r^2/(R + sqrt(R^2 - r^2)) is at most r^2/R
        return square / wall.radius
    return np.zeros_like(square) if isinstance(wall, FlatWall | ConvexWall) else None


def _in_words(roughness: WallRoughness) -> str:
    """Return the roughness in a few words, for display in notebooks."""
    heights = roughness.heights
    kind = "height map"
    if isinstance(heights, FacetWall):
        kind = f"facets of {1e3 * heights.cell:.3g} mm"
    elif isinstance(heights, GaussianWall):
        kind = f"bumps of {1e3 * heights.correlation_length:.3g} mm"
    return f"{kind}, {1e3 * roughness.slope_rms:.3g} mrad, {roughness.realisation}"


def _holds_mesh(wall: Wall) -> bool:
    """Whether the wall is a mesh or contains one, so that its height requires a surface fit."""
    if isinstance(wall, SumWall):
        return any(_holds_mesh(term) for term in wall.terms)
    return isinstance(wall, MeshWall)


def _refuse_behind(wall: Wall, name: str, points: Array) -> None:
    """Raise `SceneError` if a point, (n, 3), lies behind the wall."""
    points = points[wall.contains(points[:, 0], points[:, 1])]
    bound = _height_bound(wall, points[:, 0] ** 2 + points[:, 1] ** 2)
    if bound is not None:
        points = points[points[:, 2] <= bound]  # usually none is left and no kernel is compiled
    if not len(points):
        return
    x, y, z = np.ascontiguousarray(points.T)
    heights = wall.surface_values(x, y)[:, 0] if wall.is_compiled else wall.height(x, y)
    # where the wall has no height, NaN compares false and the point passes
    behind = np.nonzero(z <= heights)[0]
    if len(behind):
        i = behind[0]
        what = {"hidden.size": " puts a corner", "hidden.mesh": " puts a vertex"}.get(name, " is")
        raise SceneError(
            f"{name}{what} at x = {x[i]:g} m, y = {y[i]:g} m, z = {z[i]:g} m, behind the wall, "
            f"whose height there is {heights[i]:g} m; move it further into the room"
        )
