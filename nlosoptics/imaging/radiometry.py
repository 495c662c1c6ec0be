"""Radiometry from laser power to electrons, over three reflections: wall, object, wall.

The laser spot on the wall has the radiant intensity P f_r cos_o. The object, lit by it, has the
radiance f_o E_o times its picture. The wall reflects this light to the camera: its mirror-like
lobes form an image, its diffuse lobes a background.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._photons import photon_rate
from .._vectors import dot
from ..errors import SceneError
from ..kernels.codes import BECKMANN, GGX, LAMBERT, RETROREFLECTOR
from ..psf.pupil.exit_pupil import working_f_number
from ..raytrace import intersect, occluded
from ..raytrace.intersection.meshes import worker_pool
from ..scene import Material, PlanarObject, Scene
from .geometry import ChiefRays, chief_rays, on_wall, pixel_centres, wall_visibility
from .objects import Patches, object_patches

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]

NODES = 24  # nodes of the Chebyshev interpolation along each side of the detector
NODES_HEIGHT = 3  # nodes of the interpolation over the wall's height


def electrons_per_joule(scene: Scene) -> float:
    """Return the photoelectrons per joule of laser light that reaches the detector."""
    return photon_rate(1.0, scene.laser.wavelength) * scene.camera.quantum_efficiency


def electrons_per_radiance(scene: Scene, cos_axis: Array, exposure: float) -> Array:
    """Electrons of an image pixel per radiance toward the lens, electrons m^2 sr/W.

    The irradiance of the detector, E = pi L T cos^4/(4 N^2), is multiplied by pixel area, exposure
    and electrons per joule. The working F-number N is 1/(2 sin) of the cone's half angle, so that
    E never exceeds pi L T.
    """
    camera = scene.camera
    f_number = working_f_number(camera.stop_diameter / 2, scene.image_distance)
    irradiance = math.pi * camera.transmission / (4.0 * f_number**2) * cos_axis**4
    return irradiance * (camera.image_pitch**2 * exposure * electrons_per_joule(scene))


@dataclass(frozen=True, eq=False, kw_only=True)
class LaserSpot:
    """Laser spot on the wall."""

    # (3,): Centre of the spot, m, and the wall's unit normal there, toward the room; world frame
    point: Array
    normal: Array
    incident: Array  # (3,): Unit vector from the spot to the laser, world frame
    area: float  # Illuminated area of the wall, m^2


def lit_spot(scene: Scene) -> LaserSpot | None:
    """Return the laser's spot; None without a laser, or if its power is 0."""
    return laser_spot(scene) if scene.laser.power > 0.0 else None


def laser_spot(scene: Scene) -> LaserSpot:
    """Find the laser spot: the intersection of the beam's axis with the wall surface itself."""
    scene.check_black_occluders()
    laser = scene.laser
    beam = np.subtract(laser.aim, laser.position)
    hits = intersect(scene.wall, np.array(laser.position), beam)
    if not hits.hit:
        raise SceneError(
            f"laser.aim = {laser.aim}: the beam from {laser.position} misses the wall "
            f"(size {scene.wall.size} m); aim inside its edges"
        )
    incident = -beam / math.sqrt(float((beam * beam).sum()))
    cosine = float((incident * hits.normals).sum())
    _check_footprint(scene, hits.points, hits.normals, incident, cosine)
    area = math.pi / 4 * laser.beam_diameter**2 / cosine
    return LaserSpot(point=hits.points, normal=hits.normals, incident=incident, area=area)


def _check_footprint(
    scene: Scene, point: Array, normal: Array, incident: Array, cosine: float
) -> None:
    """Raise for a spot that is stretched by grazing incidence or cut by the wall's edge."""
    width = scene.laser.beam_diameter
    remedy = "raise laser.position or make laser.beam_diameter smaller"
    if cosine < math.cos(math.radians(89.0)):
        raise SceneError(
            f"laser.position = {scene.laser.position} m: the beam meets the wall at "
            f"{math.degrees(math.acos(cosine)):.4g} deg from its normal, limit "
            "89 deg; raise laser.position"
        )
    distance = math.dist(point, scene.object_point)
    if width / cosine > distance:
        raise SceneError(
            f"laser.beam_diameter = {width:g} m lights {width / cosine:g} m of the wall, longer "
            f"than the {distance:.4g} m to the object; {remedy}"
        )
    if scene.wall.size is None:
        return
    for i, name in enumerate("xy"):
        # extent of the beam's cross-section projected along the beam onto the tangent plane
        axis = np.eye(3)[i] - normal * (incident[i] / cosine)
        reach = abs(float(point[i])) + width / 2 * math.sqrt(float((axis * axis).sum()))
        if reach > scene.wall.size[i] / 2:
            raise SceneError(
                f"laser.aim = {scene.laser.aim} m: the spot reaches |{name}| = {reach:.6g} m, past "
                f"the wall's edge at {scene.wall.size[i] / 2:g} m; aim further inside or {remedy}"
            )


def check_beam(scene: Scene, mesh: trimesh.Trimesh, spot: LaserSpot) -> None:
    """Raise if an occluder cuts the laser beam, on its axis or at its edge."""
    laser = np.array(scene.laser.position)
    across = np.linalg.svd(spot.incident[None])[2][1:]
    angles = 2 * math.pi * np.arange(16) / 16
    rim = np.stack([np.cos(angles), np.sin(angles)], axis=1) @ across
    offsets = np.concatenate([np.zeros((1, 3)), scene.laser.beam_diameter / 2 * rim])
    # intersection of each ray with the tangent plane at the spot
    cosine = float((spot.incident * spot.normal).sum())
    ends = spot.point + offsets - np.outer(offsets @ spot.normal / cosine, spot.incident)
    cut = occluded(mesh, laser + offsets, ends)
    if cut.any():
        raise SceneError(
            f"scene.occluders cut the laser's beam from {scene.laser.position} m to the wall at "
            f"{tuple(round(float(c), 6) for c in spot.point)} m; move the occluder or the laser"
        )


def radiant_intensity(scene: Scene, spot: LaserSpot, toward: Array) -> Array:
    """Radiant intensity P f_r cos_o of the spot along unit vectors ``toward`` (..., 3), W/sr.

    All lobes of the wall contribute except perfectly smooth ones, whose reflected beam is not
    traced.
    """
    cosine = np.maximum(dot(toward, spot.normal), 0.0)
    reflectance = scene.wall_material.evaluate(spot.incident, toward, spot.normal)
    return np.asarray(scene.laser.power * reflectance * cosine)


def spot_irradiance(
    scene: Scene, spot: LaserSpot, points: Array, normals: Array
) -> tuple[Array, Array]:
    """Irradiance on surfaces at ``points``, W/m^2, and the unit vectors from them to the spot.

    E = I cos'/r^2, zero on back sides. The spot is treated as a point source, with a relative error
    of about (beam diameter/4 r)^2 at distance r.
    """
    toward = spot.point - points
    square = dot(toward, toward)
    toward = toward / np.sqrt(square)[..., None]
    cosine = np.maximum(dot(toward, normals), 0.0)
    return radiant_intensity(scene, spot, -toward) * cosine / square, toward


def object_radiance(
    scene: Scene, spot: LaserSpot | None, points: Array, normals: Array, toward: Array
) -> Array:
    """Radiance of a white object at ``points`` along unit vectors ``toward``, W/(m^2 sr).

    It is f_o E by the laser's spot, if there is a laser, and zero on the back side; the light that
    the object emits; and ambient light that it reflects as a matt surface.
    """
    hidden, total = scene.hidden, np.zeros(np.broadcast_shapes(points.shape, toward.shape)[:-1])
    if spot is not None:
        irradiance, incident = spot_irradiance(scene, spot, points, normals)
        total = hidden.material.evaluate(incident, toward, normals) * irradiance
    cosine = np.maximum(dot(toward, normals), 0.0)
    if isinstance(hidden, PlanarObject) and hidden.luminous is not None:
        lobe = np.where(cosine > 0.0, hidden.luminous, 0.0)
        for power, axis in zip(hidden.luminous_lobe, hidden.axes, strict=False):
            if power > 0.0:
                along = np.hypot(cosine, dot(toward, axis))
                lobe = lobe * (cosine / np.maximum(along, 1e-300)) ** power
        total = total + lobe
    if scene.ambient_irradiance > 0.0:
        albedo = float(hidden.material.albedo(0.0)) / math.pi
        total = total + np.where(cosine > 0.0, scene.ambient_irradiance * albedo, 0.0)
    return np.asarray(total)


def ambient_radiance(scene: Scene, rays: ChiefRays, seen: NDArray[np.bool_]) -> Array:
    """Radiance (ny, nx) of the wall's diffuse lobes in ambient light from all sides, W/(m^2 sr).

    By reciprocity it is the directional albedo toward the lens, over pi.
    """
    result, diffuse = np.zeros(seen.shape), scene.wall_material.diffuse
    if scene.ambient_irradiance > 0.0 and diffuse is not None:
        angle = np.arange(91) * (math.pi / 180)
        facing = np.clip(-dot(rays.directions[seen], rays.normals[seen]), 0.0, 1.0)
        albedo = np.interp(np.arccos(facing), angle, diffuse.albedo(angle))
        result[seen] = scene.ambient_irradiance / math.pi * albedo
    return result


def has_highlight(scene: Scene) -> bool:
    """Return whether a mirror-like lobe with slopes throws a highlight onto the object."""
    return any(scene.mirror_slopes)


def lit_patches(scene: Scene, spot: LaserSpot | None) -> Patches:
    """Represent the hidden object by patches, see `object_patches`.

    The highlight of a mirror-like lobe may be narrower than a patch. Its irradiance is sampled at
    steps of its rms radius.
    """
    hidden = scene.hidden
    if spot is None or not (has_highlight(scene) and isinstance(hidden, PlanarObject)):
        return object_patches(hidden)
    normal = hidden.axes[2]

    def irradiance(points: Array) -> Array:
        return spot_irradiance(scene, spot, points, normal)[0]

    slope = min(slope for slope in scene.mirror_slopes if slope > 0.0)
    distance = float(np.linalg.norm(scene.object_point - spot.point))
    return object_patches(hidden, irradiance, 2.0 * slope * distance)


def spot_power_through_lens(scene: Scene, spot: LaserSpot | None) -> float:
    """Power of the spot's direct light that the lens transmits to the detector, W.

    It is I A_lens cos/r^2 T, or zero without a spot or if the field stop blocks it.
    """
    if spot is None:
        return 0.0
    camera = scene.camera
    toward = np.array(camera.position) - spot.point
    distance = math.sqrt(float((toward * toward).sum()))
    cosine = -float((toward * camera.axis).sum()) / distance
    if cosine <= 0.0:
        return 0.0
    if camera.field_stop is not None and cosine < math.cos(camera.field_stop / 2):
        return 0.0
    intensity = float(radiant_intensity(scene, spot, toward / distance))
    lens = math.pi / 4 * camera.stop_diameter**2 * cosine / distance**2
    return intensity * lens * camera.transmission


def background_radiance(
    scene: Scene, spot: LaserSpot | None, patches: Patches, rays: ChiefRays, seen: NDArray[np.bool_]
) -> Array:
    """Radiance toward the lens of the wall's diffuse lobes, lit by the object, W/(m^2 sr).

    L = sum over patches of f_r L_o cos cos' dA/r^2, with an error below 1e-3. For a flat wall it is
    evaluated at Chebyshev nodes of the detector and interpolated. On a curved wall the normal may
    change within a few pixels, but the incident light varies smoothly. Therefore the vector
    irradiance is interpolated over detector and wall height, separately for groups of patches a
    few degrees wide, and each pixel applies its own normal and lobes.
    """
    diffuse = scene.wall_material.diffuse
    result = np.zeros(seen.shape)
    if diffuse is None or not seen.any() or not len(patches.areas):
        return result
    rows, columns = (np.nonzero(seen.any(axis=axis))[0] for axis in (1, 0))
    window = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    inside = seen[window]
    x, y = pixel_centres(scene.camera)
    x, y = x[window[1]], y[window[0]]
    heights = rays.points[window][..., 2]
    heights = np.where(inside, heights, heights[inside].mean())
    axes = [Chebyshev(y, NODES), Chebyshev(x, NODES), Chebyshev(heights, NODES_HEIGHT)]
    node_y, node_x, node_height = np.meshgrid(*(a.nodes for a in axes), indexing="ij")
    shape = node_y.shape
    nodes = Nodes(scene, node_x.ravel(), node_y.ravel(), node_height.ravel())
    on_y, on_x, on_height = (a.basis(v) for a, v in zip(axes, (y, x, heights), strict=True))

    if scene.wall.is_flat:
        (values,) = np.moveaxis(
            _flat_radiance(scene, spot, patches, diffuse, nodes).reshape(shape), 2, 0
        )
        # einsum without BLAS, whose rounding can depend on the number of threads
        part = np.einsum("ik,kj->ij", on_y, np.einsum("kl,jl->kj", values, on_x))
        result[window] = np.where(inside, np.maximum(part, 0.0), 0.0)
        return result
    shown = inside[..., None]
    normals, views = (
        np.ascontiguousarray(np.moveaxis(np.where(shown, vectors[window], 0.0), -1, 0))
        for vectors in (rays.normals, -rays.directions)
    )
    fluxes = _grouped_flux(scene, spot, patches, nodes, diffuse).reshape(-1, *shape, 3)
    weights = on_y, np.ascontiguousarray(on_x.T), np.ascontiguousarray(np.moveaxis(on_height, 2, 0))
    part = _reflected(fluxes, weights, normals, views, diffuse.lobe_table())
    result[window] = np.where(inside, part, 0.0)
    return result


def _reflected(
    fluxes: Array, weights: tuple[Array, Array, Array], normals: Array, views: Array, lobes: Array
) -> Array:
    """Return the radiance (rows, columns), W/(m^2 sr), that lobes reflect to the lens."""
    from ..kernels import brdf
    from ._radiance_kernels import arriving

    on_y, on_x, on_height = weights

    def band(first: int) -> Array:
        rows = slice(first, first + 64)  # few enough for the processor's cache
        # of one layout, so that numba compiles the kernel once
        normal, view, heights = (
            np.ascontiguousarray(array[:, rows]) for array in (normals, views, on_height)
        )
        facing = dot(np.moveaxis(normal, 0, -1), np.moveaxis(view, 0, -1)).ravel()
        total = np.zeros(facing.size)
        strength, incidence, between = (np.empty(normal.shape[1:]) for _ in range(3))
        found = np.empty(facing.size)
        cosines = incidence.ravel(), facing, between.ravel()  # views of these arrays
        for flux in fluxes:
            into = strength, incidence, between
            arriving(flux, on_y[rows], on_x, heights, normal, view, *into)
            brdf.evaluate(lobes, *cosines, found)
            found *= np.maximum(cosines[0], 0.0)
            found *= strength.ravel()
            total += found
        return total.reshape(strength.shape)

    return np.concatenate(list(worker_pool().map(band, range(0, normals.shape[1], 64))))


class Nodes:
    """Points on the camera's chief rays at given heights above the mean wall plane."""

    def __init__(self, scene: Scene, x: Array, y: Array, height: Array) -> None:
        e1, e2, axis = scene.camera.frame
        lens = np.array(scene.camera.position)
        d = scene.image_distance * axis - x[:, None] * e1 - y[:, None] * e2
        d /= np.sqrt(dot(d, d))[:, None]
        self.count = len(x)
        self.used = np.nonzero(d[:, 2] < 0.0)[0]
        d, height = d[self.used], height[self.used]
        self.directions = d
        self.points = lens + ((height - lens[2]) / d[:, 2])[:, None] * d


def arrivals(
    scene: Scene, spot: LaserSpot | None, patches: Patches, points: Array
) -> Iterator[tuple[slice, Array, Array]]:
    """Compute the light that object patches send to wall points (n, 3), m, in blocks of points.

    Yields the block; unit vectors to the patches, (n_block, n_patches, 3); and the irradiance of a
    surface that faces each patch, (n_block, n_patches), W/m^2.
    """
    step = max(1, 400_000 // len(patches.areas))  # to bound the memory
    for start in range(0, len(points), step):
        block = slice(start, start + step)
        toward = patches.points - points[block][:, None]
        square = dot(toward, toward)
        toward /= np.sqrt(square)[..., None]
        cosine = np.maximum(-dot(toward, patches.normals), 0.0)
        light = object_radiance(scene, spot, patches.points, patches.normals, -toward)
        yield block, toward, light * cosine * patches.areas / square


def _flat_radiance(
    scene: Scene, spot: LaserSpot | None, patches: Patches, diffuse: Material, nodes: Nodes
) -> Array:
    """Radiance of a flat wall at nodes; zero, its limit at the horizon, for rays that miss it."""
    result = np.zeros(nodes.count)
    for block, toward, light in arrivals(scene, spot, patches, nodes.points):
        lobe = diffuse.evaluate(toward, -nodes.directions[block][:, None], (0.0, 0.0, 1.0))
        light *= lobe * np.maximum(toward[..., 2], 0.0)
        result[nodes.used[block]] = light.sum(axis=-1)
    return result


def background_work(scene: Scene, patches: Patches) -> tuple[float, int]:
    """Return the numbers of node-patch pairs and of patch groups in `background_radiance`."""
    diffuse = scene.wall_material.diffuse
    if diffuse is None or not len(patches.areas):
        return 0.0, 0
    pairs = float(NODES**2 * len(patches.areas))
    if scene.wall.is_flat:
        return pairs, 1
    return NODES_HEIGHT * pairs, int(_groups(patches, diffuse).max()) + 1


def _groups(patches: Patches, diffuse: Material) -> NDArray[np.intp]:
    """Return a group number for each patch; patches of a group are close together.

    Seen from the wall, a group is small compared with the width of the wall's diffuse lobes.
    """
    cell = 0.08 * max(float(patches.points[:, 2].min()), 1e-3)
    if (diffuse.lobe_table()[:, 0] == LAMBERT).all():
        cell = math.inf  # Lambertian: the direction of incidence does not matter
    else:
        # a glossy lobe varies over angles of half its slope
        glossy = diffuse.lobe_table()
        slopes = glossy[glossy[:, 0] >= RETROREFLECTOR, 2]
        cell *= min(1.0, 0.5 * float(slopes.min(initial=1.0)))
    cells = np.floor((patches.points - patches.points.min(axis=0)) / cell).astype(np.intp)
    return np.asarray(np.unique(cells, axis=0, return_inverse=True)[1].ravel(), dtype=np.intp)


def _grouped_flux(
    scene: Scene, spot: LaserSpot | None, patches: Patches, nodes: Nodes, diffuse: Material
) -> Array:
    """Return the vector irradiance (groups, n_nodes, 3), W/m^2, due to each group of patches."""
    group = _groups(patches, diffuse)
    order = np.argsort(group, kind="stable")
    starts = np.nonzero(np.diff(group[order], prepend=-1))[0]
    patches = Patches(
        points=patches.points[order], normals=patches.normals[order], areas=patches.areas[order]
    )
    flux = np.zeros((len(starts), nodes.count, 3))
    for block, toward, light in arrivals(scene, spot, patches, nodes.points):
        toward *= light[..., None]
        sums = np.add.reduceat(toward, starts, axis=1)
        flux[:, nodes.used[block]] = sums.transpose(1, 0, 2)
    return flux


class Chebyshev:
    """Chebyshev interpolation over the range of given values; one node if they are all equal."""

    def __init__(self, values: Array, count: int) -> None:
        low, high = float(values.min()), float(values.max())
        self._middle, self._half = (low + high) / 2, (high - low) / 2
        if self._half <= 1e-12 * max(abs(low), abs(high), 1e-3):
            self._half, count = 0.0, 1
        angles = np.pi * (np.arange(count) + 0.5) / count
        self.nodes = self._middle + self._half * np.cos(angles)
        self._from_nodes = np.cos(np.arange(count)[:, None] * angles) * (2.0 / count)
        self._from_nodes[0] /= 2.0

    def basis(self, values: Array) -> Array:
        """Return the interpolation weights of the nodes at ``values``, shape (..., count)."""
        if self._half == 0.0:
            return np.ones((*values.shape, 1))
        u = np.clip((values - self._middle) / self._half, -1.0, 1.0)
        terms = np.cos(np.arange(self.nodes.size) * np.arccos(u)[..., None])
        return np.asarray(np.einsum("...j,jk->...k", terms, self._from_nodes))


def wall_lobes(scene: Scene, material: Material | None = None) -> Array:
    """Return the table of the wall's lobes that scatter light, or of those of a material."""
    if material is not None:
        table = material.lobe_table()
    else:
        diffuse = scene.wall_material.diffuse
        parts = [*scene.mirror_lobes] + ([] if diffuse is None else [diffuse])
        table = np.concatenate([np.empty((0, 7)), *(part.lobe_table() for part in parts)])
    smooth = ((table[:, 0] == BECKMANN) | (table[:, 0] == GGX)) & (table[:, 2] == 0.0)
    if smooth.all():
        raise SceneError(
            "scene.wall_material has 0 lobes that scatter light, must be at least 1; add a "
            "Lambert lobe, or form the image of a mirror by form_image"
        )
    return np.ascontiguousarray(table[~smooth])


def visible_shares(
    scene: Scene, centres: tuple[Array, Array], sides: tuple[float, float], shape: tuple[int, int]
) -> Array:
    """Return the share of the light of areas of the detector that edges and field stop let pass.

    The areas form a grid of ``shape``, and the share is that of the image pixels within each.
    """
    (x, y), (width, height) = centres, sides
    steps = [math.ceil(n / count) for n, count in zip(scene.camera.shape, shape, strict=True)]
    parts = [(np.arange(n) + 0.5) / n - 0.5 for n in steps]
    rows = np.add.outer(y, height * parts[0]).ravel()
    columns = np.add.outer(x, width * parts[1]).ravel()
    passed = wall_visibility(scene, chief_rays(scene, columns, rows))
    return np.asarray(passed.reshape(len(y), steps[0], len(x), steps[1]).mean((1, 3)))


def wall_paths(
    scene: Scene,
    centres: tuple[Array, Array],
    sides: tuple[float, float],
    visible: Array,
    count: int,
    exposure: float,
) -> tuple[Array, Array, Array, Array]:
    """Return wall points, normals (n, k, 3), electrons per radiance (n, k) and lens points (k, 3).

    ``centres`` along x and y, as in `chief_rays`, and ``sides`` are those of areas of the detector,
    m; ``visible`` is the share of their light that passes edges and field stop. The wall points of
    each area, of which there are ``count``, lie on a lattice over it, and each of them has a point
    of the lens. Electrons are those of one pixel in the place of the area.
    """
    (x, y), (width, height) = centres, sides
    k = np.arange(count)
    along, across = (k + 0.5) / count - 0.5, k * (math.sqrt(5.0) - 1.0) / 2 % 1.0
    across -= across.mean()
    radius = scene.camera.stop_diameter / 2 * np.sqrt((k + 0.5) / count)
    angle = 2 * math.pi * (k * 0.7548776662466927 % 1.0)  # R sequence, see `objects`
    disc = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    lens = (disc - disc.mean(axis=0)) @ scene.camera.frame[:2] + scene.camera.position
    points = np.zeros((visible.size, count, 3))
    normals = np.zeros(points.shape)
    weights, met = np.zeros(points.shape[:2]), np.zeros(visible.size)
    for i in range(count):
        rays = chief_rays(scene, x + across[i] * width, y + along[i] * height)
        use = np.isfinite(rays.distance) & (visible > 0.0)
        # points that the stop hides count only if it hides all of the area's points
        part = wall_visibility(scene, rays) + 1e-9
        at = use.ravel()
        points[at, i] = on_wall(scene, rays, use, lens[i])
        normals[at, i] = rays.normals[use]
        weights[at, i] = electrons_per_radiance(scene, rays.cos_axis[use], exposure) * part[use]
        met[at] += part[use]
    weights *= (visible.ravel() / np.where(met > 0.0, met, 1.0))[:, None]
    return points, normals, weights, lens
