"""Functions of the image model with random arguments, on record.

Coarse arguments are multiples of 1/4: footprints then meet texels at their borders exactly.
"""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from nlosoptics import imaging
from nlosoptics.imaging import (
    _radiance_kernels,
    camera_files,
    coherence,
    detector,
    forward_model,
    geometry,
    image_fields,
    images,
    objects,
    radiometry,
    shadows,
    stray,
)
from nlosoptics.raytrace import intersect
from nlosoptics.scene import (
    ConcaveWall,
    FlatWall,
    HeightMapWall,
    Lambert,
    MeshObject,
    MeshWall,
    Occluder,
    OrenNayar,
    PlanarObject,
    SpecularMicrofacet,
    SumMaterial,
    SumWall,
    WavyWall,
)

from ..records import attempt

BALL = trimesh.creation.icosphere(subdivisions=2, radius=0.12)
WALLS = {
    "endless": FlatWall(),
    "flat": FlatWall(size=(0.11, 0.07)),
    "hemisphere": ConcaveWall(0.09, size=(0.11, 0.13)),
    "wavy": WavyWall(1e-3, 0.2, 0.3, direction=0.4, size=(0.12, 0.08)),
    "sum": SumWall(WavyWall(1e-3, 0.2, direction=0.4), ConcaveWall(1.0), size=(0.1, 0.09)),
    "map": HeightMapWall(1e-4 * np.random.default_rng(2).normal(size=(30, 41)), 3e-3),
    "mesh": MeshWall(ConcaveWall(1.0, size=(0.1, 0.08)).to_mesh(max_sag_error=1e-5)),
}
GLOSS = SumMaterial(OrenNayar(0.5, 0.3), SpecularMicrofacet(0.2, 0.4), SpecularMicrofacet(0.1, 0.0))


@pytest.fixture
def scene(flat_scene):
    """Few pixels, none of whose numbers are equal, a tilted picture and a weak field stop."""
    picture = np.random.default_rng(4).uniform(0.1, 1.0, (5, 7))
    picture[0] = 0.0
    hidden = PlanarObject(picture, (0.3, 0.2), position=(0.35, 0.03, 0.9), yaw=0.3, pitch=0.1)
    camera = replace(
        flat_scene.camera, pixels=(26, 20), binning=2, pixel_pitch=1e-4, focus_distance=1.7
    )
    return replace(flat_scene, hidden=hidden, camera=camera)


def drawn(coarse, low, high, *shape):
    draw = np.random.default_rng(6)
    if coarse:
        return draw.integers(4 * low, 4 * high + 1, shape) / 4.0
    return draw.uniform(low, high, shape)


@pytest.mark.parametrize("name", WALLS)
def test_chief_rays_and_edges(name, scene, on_record):
    found = []
    for stop in (None, 0.02, 0.06):
        one = replace(scene, wall=WALLS[name], camera=replace(scene.camera, field_stop=stop))
        edges, centres = (f(one.camera) for f in (geometry.pixel_edges, geometry.pixel_centres))
        rays = geometry.chief_rays(one, *centres)
        found.append([rays, geometry.wall_visibility(one, rays), *edges])
        for front in (one.hidden, replace(one.hidden, yaw=3.0)):
            found.append(geometry.picture_coordinates(front, rays))
            found.append(geometry.picture_positions(front, rays))
    points = geometry.picture_points(scene.hidden, *drawn(False, -1, 8, 2, 9))
    wider = geometry._with_margin(replace(scene, wall=WALLS[name]))
    on_record([found, points, wider.size], 1e-8)


@pytest.mark.parametrize("coarse", [False, True])
def test_averages_over_footprints(coarse, on_record):
    picture = drawn(False, 0.2, 1.7, 6, 9)
    column, row = np.meshgrid(np.linspace(-1.3, 10.4, 12), np.linspace(-0.9, 7.2, 10))
    column = column + drawn(coarse, -1, 1, *column.shape)
    row = row + drawn(coarse, -1, 1, *column.shape)[::-1, ::-1]
    if coarse:
        column, row = np.round(4 * column) / 4, np.round(4 * row) / 4
    column[2, 3] = row[7, 8] = np.nan
    summed = np.cumsum(np.pad(picture, ((0, 0), (1, 0))), axis=1)
    x0, y0, x1, y1 = drawn(coarse, -2, 10, 4, 200)
    y1[::9], x1[::7] = y0[::9], x0[::7]
    cuts = geometry._cuts(x0, x1 - x0, y0, y1 - y0, 6, 9)
    crossings = geometry._crossings(x0, x1 - x0, 9)
    corners = np.nan_to_num(column), np.nan_to_num(row)
    on_record(
        {
            "average": geometry.area_average(picture, column, row),
            "small": geometry.area_average(picture, 3.4 + 0.1 * column, 2.6 + 0.1 * row),
            "single": geometry.area_average(picture[:1], column, row),
            "integrals": geometry._outline_integral(summed, x0, y0, x1, y1),
            "cuts": [*cuts.T.copy()],
            "crossings": [*crossings],
            "touches": geometry._touches(corners[0], 9),
            "turns": geometry._turn(*corners),
            "parts": geometry._disc_part(drawn(coarse, -2, 2, 99)),
            "common": [
                stray.common_area(np.abs(x0) / 4, a, b)
                for a, b in ((0.5, 1.25), (1.0, 1.0), (0.0, 1.0), (0.75, 0.25))
            ],
        },
        1e-8,
    )


def test_samples_of_the_object(scene, on_record):
    hidden, mesh = scene.hidden, MeshObject(mesh=BALL, position=(0.3, 0.0, 0.9))
    many = trimesh.creation.icosphere(subdivisions=4, radius=0.1)  # more than MAX_PATCHES
    many.vertices[:, 2] *= 1.7
    weights = np.array([[0.0, 2.0, 1.0, 0.0], [3.0, 0.0, 0.5, 0.25]])[[0, 1, 0, 1, 0]]

    def irradiance(points):
        return np.maximum(np.cos(40 * points[:, 0]) + 2 * points[:, 1], 0.0)

    near = replace(hidden, size=(1.1, 0.4), position=(0.0, 0.0, 0.6))
    draw = np.random.default_rng(3)
    aims, origins = draw.uniform(-0.12, 0.12, (80, 3)), draw.uniform(-0.5, 0.5, (80, 3))
    away = aims - origins
    away /= np.linalg.norm(away, axis=1)[:, None]
    on_record(
        {
            "patches": [objects.object_patches(one) for one in (hidden, near, mesh)],
            "many": objects.object_patches(MeshObject(mesh=many, position=(0.3, 0.0, 0.9))),
            "lit": [
                objects.object_patches(one, irradiance, step)
                for one, step in ((hidden, 0.03), (near, 2e-3), (hidden, math.inf))
            ],
            "samples": [objects.object_samples(one, 41) for one in (hidden, mesh)],
            "parts": [objects._barycentric(n) for n in (1, 2, 5)],
            "even": [objects._even(7, axes) for axes in (2, 3)],
            "quantiles": objects._quantiles(weights, np.array([0.0, 0.2, 0.4, 0.8, 0.99])),
            "hits": objects.mesh_hits(BALL, np.array([0.3, 0.1, 0.4]), origins, away),
        },
        1e-8,
    )


@pytest.mark.parametrize("wall", ["endless", "sum"])
def test_light_of_the_object(wall, scene, on_record):
    """Irradiance, radiance and the wall's light, of a picture and a mesh, gloss and paint."""
    large = WALLS[wall]
    if wall == "sum":
        large = SumWall(*large.terms, size=(1.5, 1.2))
    found, draw = [], np.random.default_rng(2)
    for material, hidden in (
        (GLOSS, scene.hidden),
        (Lambert(0.6), scene.hidden),
        (GLOSS, MeshObject(mesh=BALL, position=(0.3, 0.0, 0.9), material=GLOSS)),
    ):
        one = replace(scene, wall=large, wall_material=material, hidden=hidden)
        spot, patches = radiometry.laser_spot(one), objects.object_patches(one.hidden)
        rays = geometry.chief_rays(one, *geometry.pixel_centres(one.camera))
        seen = draw.random(rays.distance.shape) < 0.8
        points = draw.uniform((0.2, -0.2, 0.5), (0.5, 0.2, 1.2), (40, 3))
        normals, toward = draw.normal(size=(2, 40, 3)) - np.array([0.0, 0.0, 0.7])
        normals, toward = (v / np.linalg.norm(v, axis=1)[:, None] for v in (normals, toward))
        nodes = radiometry.Nodes(one, *draw.uniform(-1e-2, 1e-2, (2, 9)), draw.random(9) / 9)
        found += [spot, radiometry.spot_irradiance(one, spot, points, normals)]
        found += [radiometry.object_radiance(one, spot, points, normals, toward)]
        found += [radiometry.lit_patches(one, spot), radiometry.background_work(one, patches)]
        found += [radiometry.spot_power_through_lens(one, spot), stray.spot_image(one, spot)]
        found += [radiometry.background_radiance(one, spot, patches, rays, seen)]
        found += [radiometry._groups(patches, material.diffuse), nodes.used, nodes.points]
        found += [list(radiometry.arrivals(one, spot, patches, nodes))]
        found += [images._mirrored_radiance(one, spot, rays, seen)]
    on_record(found, 1e-8)


def test_spots_in_and_out_of_focus(scene, monkeypatch, on_record):
    """Exactly in focus, where the blur is 0, and with few cells computed at a time."""
    monkeypatch.setattr(stray, "CELLS", 300)
    spot = radiometry.laser_spot(replace(scene, laser=replace(scene.laser, aim=(0.0, 0.0, 0.0))))
    found = []
    for focus, place in ((1.0, 0.0), (1.5, 0.003), (0.8, -0.014), (0.8, 9.0)):
        camera = replace(
            scene.camera,
            position=(place, 0.0, 1.0),
            aim=(place, 0.0, 0.0),
            focal_length=0.5,
            focus_distance=focus,
            stop_diameter=0.05,
            pixel_pitch=1.5e-3,
        )
        found.append(stray.spot_image(replace(scene, camera=camera), spot))
    light = drawn(False, 10, 900, 4, 5)
    noise = [
        images.reading_noise(
            replace(scene, camera=replace(scene.camera, dark_current=7.0, **other)), light
        )
        for other in ({}, {"binning": 1, "exposure": 0.3})
    ]
    on_record([found, noise], 1e-8)


def test_interpolation_and_bands(on_record):
    """Chebyshev nodes, equal values, and radiance of more rows than are computed at a time."""
    draw, found = np.random.default_rng(5), []
    for values in (draw.uniform(-2, 3, 9), np.full(4, 1.25), 1.0 + 1e-13 * np.arange(3.0)):
        one = radiometry._Chebyshev(values, 5)
        found.append([one.nodes, one.basis(values), one.basis(np.array([values.max(), 0.3]))])
    for span in (0.5, 1.0, 1.5, 3.0):
        for scale in (5e-4, 1e-3, 1.7e-3, 2.0):
            values = scale * (1.0 + np.array([-1.0, 1.0]) * 1e-12 * span)
            found.append(len(radiometry._Chebyshev(values, 5).nodes))
            values = scale * np.array([-1.0, 1.0]) * 1e-12 * span
            found.append(len(radiometry._Chebyshev(values, 5).nodes))
    rows, columns = 70, 4
    fluxes = draw.uniform(0.1, 1.0, (2, 3, 2, 2, 3))
    weights = (draw.random((rows, 3)), draw.random((2, columns)), draw.random((2, rows, columns)))
    normals, views = draw.normal(0, 0.2, (2, 3, rows, columns)) + np.eye(3)[2][:, None, None]
    normals /= np.sqrt((normals**2).sum(axis=0))
    views /= np.sqrt((views**2).sum(axis=0))
    found.append(radiometry._reflected(fluxes, weights, normals, views, GLOSS.lobe_table()))
    into = np.zeros((3, rows, columns))
    _radiance_kernels.arriving(fluxes[0], *weights, normals, views, *into)
    found.append(into)
    values, at = draw.random((4, 3)), (np.array([0, 2, 5, 7]), np.array([0, 3, 4]))
    found.append(shadows._bilinear(values, *at, (8, 5)))
    found.append(shadows._bilinear(values[:1, :1], np.array([0]), np.array([0]), (1, 3)))
    found.append(detector._quarter_turn(np.array([0.0, 0.3, 1.0, 1.1, math.sqrt(2.0)])))
    on_record(found, 1e-8)


@pytest.mark.parametrize("mesh", [False, True])
def test_paths_past_occluders(mesh, scene, on_record):
    box = trimesh.creation.box((0.1, 0.08, 0.02)).apply_translation((0.12, 0.02, 0.3))
    lower = trimesh.creation.box((0.02, 0.09, 0.01)).apply_translation((-0.05, 0.01, 0.15))
    camera = replace(scene.camera, pixel_pitch=4e-4)  # sees beyond the picture's edges
    one = replace(scene, camera=camera, wall=FlatWall(size=(0.4, 0.3)), wall_material=GLOSS)
    one = replace(one, occluders=(Occluder(box), Occluder(lower)))
    if mesh:
        one = replace(one, hidden=MeshObject(mesh=BALL, position=(0.3, 0.0, 0.9)))
    spot, centres = radiometry.laser_spot(one), geometry.pixel_centres(one.camera)
    rays = geometry.chief_rays(one, *centres)
    use = np.isfinite(rays.distance)
    use[3, 4:6] = False
    lens = shadows._lens_points(one)
    on_record(
        {
            "lens": lens,
            "on wall": shadows._on_wall(one, rays, use, lens[5] + one.camera.position),
            "points": shadows._object_points(one, rays, use),
            "shares": shadows._path_shares(one, one.occluding_mesh, spot, use),
            "veil": shadows._veil_share(one, one.occluding_mesh, spot, rays, use),
        },
        1e-8,
    )


@pytest.mark.parametrize("at", [-2.1, -1.9, -0.9, 0.9, 1.9, 2.1])
@pytest.mark.parametrize("axis", [0, 1])
def test_occluders_at_the_edge_of_the_beam(axis, at, scene, on_record):
    """A needle beside the beam, some 2 mm from its axis, whose radius is 1.95 mm."""
    laser = replace(scene.laser, beam_diameter=3.9e-3, position=(0.0, 0.0, 1.0), aim=(0, 0, 0.0))
    needle = trimesh.creation.box((4e-4, 4e-4, 0.01))
    needle.apply_translation(1e-3 * at * np.eye(3)[axis] + (0.0, 0.0, 0.5))
    one = replace(scene, laser=laser)
    on_record(attempt(shadows.check_beam, one, needle, radiometry.laser_spot(one)))


def test_kernels_on_grids(on_record):
    draw = np.random.default_rng(7)
    picture, found = draw.random((2, 6, 9)), []
    for kernel, shape in (((3, 4), (6, 9)), ((1, 1), (6, 9)), ((15, 20), (6, 9)), ((6, 9), (6, 9))):
        for boundary in ("padded", "circular"):
            model = attempt(
                forward_model.ForwardModel, draw.random(kernel), shape=shape, boundary=boundary
            )
            found.append([model])
            if not isinstance(model, Exception):
                found.append([model.grid, model.transfer, model.kernel])
                found.append([model.forward(picture), model.adjoint(picture)])
                found.append(attempt(model.forward, picture[:, 1:]))
                found.append(attempt(model.adjoint, np.where(picture > 0.5, np.nan, picture)))
    for kernel in ("text", [], np.zeros((2, 2)), np.full((2, 3), np.inf), np.ones(3)):
        found.append(attempt(forward_model.ForwardModel, kernel, shape=(4, 5)))
    for shape in (4, (3,), (2, 3, 4), (0, 3), (3, 0), (2.5, 3)):
        found.append(attempt(forward_model.ForwardModel, np.ones((2, 2)), shape=shape))
    found.append([forward_model._longer_arm(k, n) for k in range(1, 9) for n in (1, 3, 5)])
    on_record(found, 1e-8)


def test_numbers_of_point_spreads(on_record):
    draw = np.random.default_rng(8)
    picture = np.where(draw.random((11, 14)) < 0.3, draw.random((11, 14)), 0.0)
    picture[:2], picture[:, 11:] = 0.0, 0.0
    echo = image_fields.autocorrelation(picture, 4)
    decay = np.array([1.0, 0.3, 0.1, 0.02, 3e-3, 1e-4, 1e-6])
    on_record(
        {
            "places": image_fields.checked_places(picture),
            "echo": echo,
            "power": image_fields.blurred_power(draw.random((3, 4, 4)), echo),
            "counts": [
                image_fields.expected_counts(error, swing, tol, given)
                for error in (1e-3, 0.2)
                for swing in (0.5, 2.0, 9.0)
                for tol in (1e-4, 1e-2)
                for given in (None, decay)
            ],
        },
        1e-8,
    )


def test_points_and_spreads_that_are_refused(scene, on_record):
    points = ["text", 1.0, np.ones(2), [0.1, np.nan, 1.0], [0.1, 0.2, 0.0], [[0, 0, 1], [0, 0, -1]]]
    pitch = scene.camera.image_pitch

    def spread(values, scale=1.0, unit="unit-sum"):
        return SimpleNamespace(intensity=np.array(values), pitch=scale * pitch, normalisation=unit)

    given = [
        spread([[0.5]], 1.0 + 1.9e-9),
        spread([[0.5]], 1.0 + 0.9e-9),
        spread([[0.5]], 1.0 - 1.1e-9),
        spread([[0.5]], unit="peak"),
        spread([[0.5, -0.4e-9]]),
        spread([[0.5, -0.6e-9]]),
        spread([[0.5, -0.9e-9]]),
        spread([[0.5, 0.505]]),
        spread([[0.5, 0.511]]),
    ]
    incident = np.array([0.6, 0.0, 0.8])
    wide = replace(scene, laser=replace(scene.laser, beam_diameter=0.05))
    gloss = Occluder(BALL, position=(0.0, 0.0, 0.5), material=GLOSS)
    on_record(
        {
            "gloss": attempt(radiometry.laser_spot, replace(scene, occluders=(gloss,))),
            "points": [attempt(coherence._points, "points", one) for one in points],
            "reference": attempt(imaging.spot_coherence, scene, [0.3, 0.0, 1.0], np.ones((2, 3))),
            "nodes": [
                coherence._spot_nodes(scene, np.array(way), 3, 5)
                for way in ((0.6, 0.0, 0.8), (-0.48, 0.36, 0.8), (0.36, -0.48, 0.8))
            ],
            "missed": attempt(
                coherence._spot_nodes, replace(wide, wall=FlatWall(size=0.04)), incident, 3, 5
            ),
            "spreads": [
                [attempt(images._check_pitch, one, pitch), attempt(images._check_energy, one)]
                for one in given
            ],
        }
    )


@pytest.mark.parametrize("limit", ["angle", "length", "edge"])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_spots_at_their_limits(limit, side, scene, on_record):
    """Just within and just beyond the limit of the angle of incidence, of length and of edge."""
    laser, wall, share = scene.laser, scene.wall, 1.0 + 1e-6 * side
    if limit == "angle":
        height = 0.9 / math.tan(share * radiometry.GRAZING)
        laser = replace(laser, position=(0.9, 0.0, height), aim=(0.0, 0.0, 0.0), beam_diameter=1e-3)
    elif limit == "length":
        laser = replace(laser, position=(0.6, 0.0, 0.8), aim=(0.0, 0.0, 0.0))
        reach = float(np.linalg.norm(scene.object_point))
        laser = replace(laser, beam_diameter=share * 0.8 * reach)
    else:
        laser = replace(laser, position=(0.6, 0.3, 0.8), aim=(0.01, -0.02, 0.0))
        away = np.array([0.59, 0.32, 0.8]) / np.linalg.norm([0.59, 0.32, 0.8])
        axis = np.eye(3)[1] - np.eye(3)[2] * away[1] / away[2]
        reach = 0.02 + laser.beam_diameter / 2 * float(np.linalg.norm(axis))
        wall = FlatWall(size=(0.5, 2.0 * reach / share))
    one = replace(scene, laser=laser, wall=wall)
    on_record(attempt(radiometry.laser_spot, one))


def test_counts_of_files(tmp_path, monkeypatch, on_record):
    """Dark frames, flat fields, groups of pixels and shares that are masked, by their functions."""
    draw = np.random.default_rng(9)
    values = draw.uniform(10, 90, (6, 9))
    monkeypatch.chdir(tmp_path)
    frames = {"dark": 0.1 * values[::-1], "flat": 50.0 + values[:, ::-1], "other": values[1:]}
    frames |= {"bright": 2.0 * values, "dim": 0.02 * values}
    for name, frame in frames.items():
        np.save(f"{name}.npy", frame)
    pairs = [(None, None), ("dark", "flat"), ("other", None), (None, "other"), ("dark", "other")]
    pairs += [("bright", None), ("dark", "dim"), (None, "dim"), ("dark", "dark")]
    corrected = [
        attempt(camera_files._corrected, values, "file", *(n and f"{n}.npy" for n in pair))
        for pair in pairs
    ]
    saturated, dead = draw.random((2, 6, 9)) < 0.1
    groups = [
        attempt(camera_files._grouped, "file", values, saturated, dead, shape)
        for shape in (None, (6, 9), (2, 3), (3, 3), (4, 9), (12, 18), (1, 1))
    ]
    masks = [np.arange(54).reshape(6, 9) < count for count in (26, 27, 28, 54)]
    none = np.zeros((6, 9), dtype=bool)
    checked = [attempt(camera_files._checked, "file", values, one, none) for one in masks]
    checked += [attempt(camera_files._checked, "file", values, none, one) for one in masks]
    for level in (0.0, -1.0, 5.0):
        even = np.full((6, 9), level)
        checked.append(attempt(camera_files._checked, "file", even, none, none))
    shapes = [attempt(camera_files._whole_shape, one) for one in ((2, 3), (2,), (0, 1), (1, 0))]
    on_record([corrected, groups, checked, shapes, camera_files.DEAD], 1e-8)


def test_hits_that_a_wall_continues(scene):
    """Rays just beyond an edge meet the wall's continuation, unless it cannot be extended."""
    x, y = geometry.pixel_centres(scene.camera)
    rays = geometry.chief_rays(replace(scene, wall=WALLS["flat"]), x, y)
    alone = intersect(FlatWall(), np.array(scene.camera.position), rays.directions)
    near = np.abs(alone.points[..., :2]) < np.array([0.055, 0.035]) + scene.camera.stop_diameter
    assert (np.isfinite(rays.distance) == near.all(axis=-1)).all()
