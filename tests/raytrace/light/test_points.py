"""Light of one object point: closed integrals, a closed form, and an independent random walk."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from pytest import approx

from nlosoptics.errors import SceneError
from nlosoptics.raytrace import trace_point
from nlosoptics.scene import (
    Camera,
    ConcaveWall,
    FlatWall,
    Lambert,
    Laser,
    MeshObject,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
)

POINT = np.array([0.35, 0.05, 1.0])
LENS = np.array([-0.5, 0.0, 0.8])
AIM = np.array([-0.05, 0.0, 0.0])
SIZE = (1.2, 0.9)
MIRROR = SpecularMicrofacet(0.1, 0.0)
PAINT = SumMaterial(Lambert(0.6), MIRROR)


def point_scene(material, *, wall=None, stop=0.025, **camera):
    """A picture parallel to the wall, a finite wall and an oblique camera."""
    options = {"pixels": (1024, 1024), "pixel_pitch": 36e-6, "binning": 64, "transmission": 0.9}
    return Scene(
        Laser(wavelength=633e-9, power=1.0, beam_diameter=1e-3, position=(-0.2, 0.1, 0.9)),
        FlatWall(size=SIZE) if wall is None else wall,
        PlanarObject(np.ones((3, 3)), 0.1, position=tuple(POINT)),
        Camera(
            position=tuple(LENS),
            aim=tuple(AIM),
            focal_length=0.05,
            stop_diameter=stop,
            **options | camera,
        ),
        wall_material=material,
    )


def frame(scene):
    return scene.camera.frame


def unit_nodes(n):
    """Gauss-Legendre nodes and weights on -1 to 1."""
    return np.polynomial.legendre.leggauss(n)


def lens_nodes(scene, n_r=6, n_angle=16):
    """Points (n, 3) of the lens disc and their areas."""
    x, w = unit_nodes(n_r)
    share, radius = (x + 1) / 2, scene.camera.stop_diameter / 2
    angle = 2 * np.pi * np.arange(n_angle) / n_angle
    r = radius * np.sqrt(share)[:, None]
    e1, e2, _ = frame(scene)
    u, v = (r * np.cos(angle)).ravel(), (r * np.sin(angle)).ravel()
    area = np.repeat(w / 2 * math.pi * radius**2, n_angle) / n_angle
    return np.array(scene.camera.position) + u[:, None] * e1 + v[:, None] * e2, area


def irradiance(points, normals, source=POINT):
    """Of a Lambertian point of 1 W that faces -z, W/m^2."""
    d = points - source
    r = np.linalg.norm(d, axis=-1)
    return (-d[..., 2] / r / np.pi) * -(d * normals).sum(axis=-1) / r**3


def through_lens(scene, points, normals):
    """Solid angle of the lens times the cosine at wall points, by quadrature, sr."""
    nodes, areas = lens_nodes(scene)
    axis, total = frame(scene)[2], np.zeros(points.shape[:-1])
    for node, area in zip(nodes, areas, strict=True):
        d = node - points
        r = np.linalg.norm(d, axis=-1)
        total += area * (d * normals).sum(axis=-1) * -(d @ axis) / r**4
    return total


def flat_grid(n=80, low=-SIZE[0] / 2):
    """Points of the flat wall, normals and areas."""
    x, w = unit_nodes(n)
    high = SIZE[0] / 2
    xs, ys = (low + high) / 2 + (high - low) / 2 * x, SIZE[1] / 2 * x
    points = np.stack(np.broadcast_arrays(xs[None, :], ys[:, None], 0.0), axis=-1)
    area = np.outer(w * SIZE[1] / 2, w * (high - low) / 2)
    return points, np.array([0.0, 0.0, 1.0]), area


@pytest.mark.thorough
def test_matt_wall_sends_its_integral():
    """80 x 80 x 6 x 16 Gauss nodes are exact to 1e-9 here."""
    scene = point_scene(Lambert(0.6))
    points, normal, area = flat_grid()
    exact = (
        0.9
        * 0.6
        / np.pi
        * (irradiance(points, normal) * through_lens(scene, points, normal) * area).sum()
    )
    found = trace_point(scene, n_rays=1 << 16)
    assert found.flux_error < 2e-3 * exact
    # five standard errors: one false alarm in a million
    assert found.flux == approx(exact, abs=5 * found.flux_error)
    assert found.by_bounce[1] == approx(found.flux, rel=1e-12)
    seen = math.hypot(found.missed_error, found.flux_error, np.linalg.norm(found.energy_error))
    assert found.energy.sum() == approx(found.flux - found.missed, abs=5 * seen)


@pytest.mark.thorough
def test_matt_wall_over_the_pixels():
    """Each pixel against the wall's own integral over what it sees through a pinhole."""
    scene = point_scene(Lambert(0.6), stop=2e-4, focus_distance=0.9)
    found = trace_point(scene, n_rays=64 * 256)
    assert found.rays_per_pixel == 64
    nodes, weights = unit_nodes(6)
    half = found.pitch / 2
    x = (found.x[:, None] + half * nodes).ravel()
    y = (found.y[:, None] + half * nodes).ravel()
    x, y = np.meshgrid(x, y)

    def on_wall(x, y):
        e1, e2, n = frame(scene)
        d = scene.image_distance * n - x[..., None] * e1 - y[..., None] * e2
        return LENS - d * (LENS[2] / d[..., 2:])

    step = 1e-6
    px = (on_wall(x + step, y) - on_wall(x - step, y)) / (2 * step)
    py = (on_wall(x, y + step) - on_wall(x, y - step)) / (2 * step)
    area = np.abs(px[..., 0] * py[..., 1] - px[..., 1] * py[..., 0])
    points, normal = on_wall(x, y), np.array([0.0, 0.0, 1.0])
    on = (np.abs(points[..., 0]) < SIZE[0] / 2) & (np.abs(points[..., 1]) < SIZE[1] / 2)
    density = irradiance(points, normal) * through_lens(scene, points, normal) * area * on
    exact = 0.9 * 0.6 / np.pi * half**2
    exact *= np.einsum("yixj,i,j->yx", density.reshape(16, 6, 16, 6), weights, weights)
    whole = on.reshape(16, 6, 16, 6).all(axis=(1, 3))
    assert whole.sum() > 100
    # the wall's edges cut the others; a lens of 0.2 mm blurs by less than 1e-4 of a pixel
    off = ((found.energy - exact) / found.energy_error)[whole]
    # 100 and more Student numbers, scaled to 1, tell their spread to 7 %
    assert off.std() == approx(1.0, abs=0.25)
    assert np.abs(off).max() < 5.5
    assert np.median((found.energy_error / exact)[whole]) < 1e-3
    assert (found.energy[~on.reshape(16, 6, 16, 6).any(axis=(1, 3))] < 1e-3 * exact.max()).all()


@pytest.mark.thorough
@pytest.mark.parametrize("emission", ["lambertian", "isotropic"])
def test_mirror_sends_what_the_lens_subtends(emission):
    """Seen from the mirrored point, the lens is lit by the inverse square."""
    scene = point_scene(MIRROR)
    nodes, areas = lens_nodes(scene)
    d = nodes - POINT * (1, 1, -1)
    r = np.linalg.norm(d, axis=1)
    intensity = d[:, 2] / r / np.pi if emission == "lambertian" else 0.25 / np.pi
    exact = 0.9 * 0.1 * (intensity * areas * -(d @ frame(scene)[2]) / r**3).sum()
    found = trace_point(scene, n_rays=1 << 16, emission=emission)
    assert found.flux_error < 2e-3 * exact
    assert found.flux == approx(exact, abs=5 * found.flux_error)
    assert found.energy.sum() == approx(found.flux - found.missed, rel=1e-12)


@pytest.mark.thorough
def test_defocus_makes_a_disc():
    """A mirror image out of focus is the lens's shadow, with the thin lens's radius."""
    scene = point_scene(MIRROR, focus_distance=1.2)
    e1, e2, axis = frame(scene)
    line = POINT * (1, 1, -1) - LENS
    depth, d = line @ axis, scene.image_distance
    middle = np.array([-d * (line @ e1) / depth, -d * (line @ e2) / depth])
    blur = 0.0125 * abs(d * (1 / 0.05 - 1 / depth) - 1)
    first = tuple(middle - 16 * 18e-6)
    found = trace_point(scene, n_rays=1 << 16, pitch=18e-6, shape=(33, 33), first=first)
    x, y = np.meshgrid(found.x, found.y)
    away = np.hypot(x - middle[0], y - middle[1])
    assert blur > 3 * found.pitch
    # a pixel counts by its centre
    assert away[found.energy > 0].max() < blur + found.pitch
    inside = found.energy[away < blur - found.pitch]
    assert (inside > 0).all()
    assert inside.std() < 0.3 * inside.mean()


@pytest.mark.thorough
def test_lobes_add():
    scene = point_scene(PAINT)
    both = trace_point(scene, shape=(1, 1))
    matt = trace_point(scene, shape=(1, 1), mirror_image=False, seed=1)
    mirror = trace_point(point_scene(MIRROR), shape=(1, 1), seed=2)
    alone = trace_point(point_scene(Lambert(0.6)), shape=(1, 1), seed=3)
    error = math.hypot(both.flux_error, matt.flux_error, mirror.flux_error)
    assert error < 3e-3 * both.flux
    assert matt.flux + mirror.flux == approx(both.flux, abs=5 * error)
    assert matt.flux == approx(alone.flux, abs=5 * math.hypot(matt.flux_error, alone.flux_error))


@pytest.mark.thorough
@pytest.mark.parametrize("slope", [0.003, 0.03])
def test_glossy_lobe_by_connections_alone(slope):
    """The wall's integral of a narrow lobe, on a grid fine enough for it."""
    scene = point_scene(SpecularMicrofacet(0.1, slope), stop=0.02)
    found = trace_point(scene, n_rays=1 << 17, shape=(1, 1))
    nodes, areas = lens_nodes(scene, 8, 24)
    t = np.linspace(-1.0, 1.0, 121)
    centre = POINT + POINT[2] / (POINT[2] + LENS[2]) * (LENS - POINT)
    half = 0.02 + 6 * slope
    x, y = np.meshgrid(centre[0] + half * t, centre[1] + half * t)
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    d = POINT - points
    incident = d / np.linalg.norm(d, axis=-1, keepdims=True)
    normal, total = np.array([0.0, 0.0, 1.0]), 0.0
    light = irradiance(points, normal)
    for node, area in zip(nodes, areas, strict=True):
        d = node - points
        r = np.linalg.norm(d, axis=-1, keepdims=True)
        f = scene.wall_material.evaluate(incident, d / r, np.broadcast_to(normal, d.shape))
        total += area * (f * light * d[..., 2] * -(d @ frame(scene)[2]) / r[..., 0] ** 4).sum()
    exact = 0.9 * total * (half * (t[1] - t[0])) ** 2
    assert found.flux_error < 0.01 * exact
    # the trapezoid rule ends at 5 standard deviations of the lobe: 1e-4
    assert found.flux == approx(exact, abs=5 * found.flux_error + 2e-4 * exact)


def hollow_scene(material, radius=1.5, side=1.4, **options):
    wall = ConcaveWall(radius, size=(side, side))
    return point_scene(material, wall=wall, **options)


@pytest.mark.thorough
def test_hollow_wall_by_bounces():
    """A sphere lights itself evenly, so every reflection has a closed form."""
    radius, rho = 1.5, 0.8
    scene = hollow_scene(Lambert(rho))
    x, w = unit_nodes(80)
    xs, ys = np.meshgrid(0.7 * x, 0.7 * x)
    depth = np.sqrt(radius**2 - xs**2 - ys**2)
    points = np.stack([xs, ys, radius - depth], axis=-1)
    normals = np.stack([-xs, -ys, depth], axis=-1) / radius
    area = np.outer(0.7 * w, 0.7 * w) * radius / depth
    light, lens = irradiance(points, normals), through_lens(scene, points, normals)
    power, exact = (light * area).sum(), [0.0, (light * lens * area).sum()]
    for _ in range(2):
        even = rho * power / (4 * math.pi * radius**2)
        exact.append(even * (lens * area).sum())
        power = even * area.sum()
    exact = 0.9 * rho / np.pi * np.array(exact)
    found = trace_point(scene, n_rays=1 << 16, max_bounces=3)
    assert (np.abs(found.by_bounce - exact) <= 5 * found.by_bounce_error).all()
    assert (found.by_bounce_error[1:] < [1e-3 * exact[1], 0.02 * exact[2], 0.1 * exact[3]]).all()
    seen = math.hypot(found.missed_error, found.flux_error, np.linalg.norm(found.energy_error))
    assert seen < 0.01 * found.flux
    assert found.energy.sum() == approx(found.flux - found.missed, abs=5 * seen)


def walked(scene, radius, half, lobes, n, bounces, seed):
    """Share of n rays that walk into the lens, by reflections: no connection, no weight."""
    rng = np.random.default_rng(seed)
    matt, mirror = lobes
    o = np.broadcast_to(POINT, (n, 3)).copy()
    normal = np.broadcast_to([0.0, 0.0, -1.0], (n, 3)).copy()
    centre = np.array([0.0, 0.0, radius])

    def even(normal):
        """Cosine-distributed: a point of the unit sphere on the tip of the normal."""
        sphere = rng.normal(size=normal.shape)
        sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
        d = normal + sphere
        return d / np.linalg.norm(d, axis=1, keepdims=True)

    d, counts = even(normal), np.zeros(bounces + 1)
    lens, axis = np.array(scene.camera.position), frame(scene)[2]
    for bounce in range(bounces + 1):
        along = d @ axis
        t = ((lens - o) @ axis) / along
        at = o + t[:, None] * d - lens
        # the lens is black from behind
        met = (t > 0) & (np.linalg.norm(at, axis=1) < scene.camera.stop_diameter / 2)
        into = (along < 0) & met
        counts[bounce] = into.sum() if bounce else 0
        b = ((o - centre) * d).sum(axis=1)
        c = ((o - centre) ** 2).sum(axis=1) - radius**2
        hit = o + (-b + np.sqrt(np.maximum(b * b - c, 0.0)))[:, None] * d
        fate = rng.random(len(o))
        on = (np.abs(hit[:, :2]) < half).all(axis=1) & (hit[:, 2] < radius) & ~met
        on &= fate < matt + mirror
        o, d, fate = hit[on], d[on], fate[on]
        normal = (centre - o) / radius
        mirrored = d - 2 * (d * normal).sum(axis=1, keepdims=True) * normal
        d = np.where((fate < mirror)[:, None], mirrored, even(normal))
    return counts / n, np.sqrt(np.maximum(counts, 1.0)) / n


@pytest.mark.thorough
def test_hollow_wall_of_mirror_and_paint_by_a_walk():
    """Paths by diffuse lobes and mirrors in any order, against rays that only walk."""
    scene = hollow_scene(
        SumMaterial(Lambert(0.4), SpecularMicrofacet(0.5, 0.0)),
        1.0,
        1.4,
        stop=0.3,
        transmission=1.0,
    )
    # low and looking across, the lens sees the wall by way of the wall
    camera = replace(scene.camera, position=(-0.3, 0.0, 0.4), aim=(0.3, 0.0, 0.1))
    scene = replace(scene, camera=replace(camera, focus_distance=1.5))
    found = trace_point(scene, n_rays=1 << 16, max_bounces=3)
    walks = [walked(scene, 1.0, 0.7, (0.4, 0.5), 1_000_000, 3, seed) for seed in range(3)]
    share = np.mean([mean for mean, _ in walks], axis=0)
    error = np.linalg.norm([spread for _, spread in walks], axis=0) / 3
    assert (share > 10 * error)[1:3].all()
    off = (found.by_bounce - share) / np.hypot(error, found.by_bounce_error)
    assert (np.abs(off[1:]) < 4.5).all()
    seen = math.hypot(found.missed_error, found.flux_error, np.linalg.norm(found.energy_error))
    # double mirror images land on pixels too
    assert found.energy.sum() == approx(found.flux - found.missed, abs=5 * seen)


@pytest.mark.thorough
def test_paint_seen_by_way_of_a_mirror():
    """A lens that grazes the hollow sees lit paint reflected in the wall between."""
    material = SumMaterial(Lambert(0.4), SpecularMicrofacet(0.5, 0.0))
    scene = hollow_scene(material, 1.0, 1.4, stop=0.06, transmission=1.0)
    camera = replace(scene.camera, position=(-0.5, 0.0, 0.21), aim=(0.0, 0.0, 0.0))
    scene = replace(scene, camera=replace(camera, focus_distance=1.0))
    found = trace_point(scene, n_rays=1 << 16, max_bounces=2)
    # four fifths of what two reflections send come this way
    matt = hollow_scene(Lambert(0.4), 1.0, 1.4, stop=0.06, transmission=1.0)
    alone = trace_point(replace(matt, camera=scene.camera), n_rays=1 << 14, max_bounces=2)
    assert found.by_bounce[2] > 4 * alone.by_bounce[2]
    walks = [walked(scene, 1.0, 0.7, (0.4, 0.5), 1_000_000, 2, seed) for seed in range(4)]
    share = np.mean([mean for mean, _ in walks], axis=0)
    error = np.linalg.norm([spread for _, spread in walks], axis=0) / 4
    off = (found.by_bounce - share) / np.hypot(error, found.by_bounce_error)
    assert (np.abs(off[1:]) < 4.5).all()
    assert share[2] > 10 * error[2]


@pytest.mark.thorough
def test_occluder_hides_half_the_wall():
    """A black sheet close above the wall leaves the integral over the other half."""
    sheet = trimesh.Trimesh(
        [[-2, -2, 1e-5], [0, -2, 1e-5], [0, 2, 1e-5], [-2, 2, 1e-5]], [[0, 1, 2], [0, 2, 3]]
    )
    scene = replace(point_scene(Lambert(0.6)), occluders=(sheet,))
    points, normal, area = flat_grid(low=0.0)
    exact = (
        0.9
        * 0.6
        / np.pi
        * (irradiance(points, normal) * through_lens(scene, points, normal) * area).sum()
    )
    found = trace_point(scene, n_rays=1 << 16)
    # the sheet's edge casts a shadow of its height: 1e-5 of the wall
    assert found.flux == approx(exact, abs=5 * found.flux_error + 1e-4 * exact)
    assert found.flux_error < 2e-3 * exact
    assert found.queries["shadow"] > 0


@pytest.mark.thorough
def test_field_stop_cuts_the_light():
    """A small lens sees the wall within the baffle's cone, mirror image or not."""
    scene = point_scene(Lambert(0.6), stop=1e-3, field_stop=0.5)
    points, normal, area = flat_grid(300)
    line = points - LENS
    seen = (line @ frame(scene)[2]) / np.linalg.norm(line, axis=-1) >= math.cos(0.25)
    areas = lens_nodes(scene)[1]
    d = LENS - points
    lens = areas.sum() * d[..., 2] * -(d @ frame(scene)[2]) / np.linalg.norm(d, axis=-1) ** 4
    exact = 0.9 * 0.6 / np.pi * (irradiance(points, normal) * lens * seen * area).sum()
    found = trace_point(scene, n_rays=1 << 16)
    # 300 nodes across find the rim of the cone to 0.5 %
    assert found.flux == approx(exact, rel=0.01)
    assert found.flux_error < 0.005 * exact
    assert trace_point(point_scene(MIRROR, field_stop=0.01)).flux == 0.0


@pytest.mark.thorough
def test_point_of_a_mesh_shines_at_the_wall():
    """Its own faces are not in the way, and it shines about -z as the picture does."""
    scene = point_scene(PAINT)
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    mesh = replace(scene, hidden=MeshObject(box, position=tuple(POINT)))
    a, b = (trace_point(s, POINT, n_rays=4096) for s in (scene, mesh))
    assert a.flux == b.flux


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"object_point": (np.nan, 0, 1)}, "not finite"),
        ({"object_point": (0, 0, -0.1)}, "behind the wall"),
        ({"object_point": (0.0, 0.0)}, "2 components"),
        ({"emission": "laser"}, "emission"),
        ({"n_rays": 0}, "n_rays"),
        ({"n_rays": 1.5}, "n_rays"),
        ({"max_bounces": 0}, "max_bounces"),
        ({"pitch": -1.0}, "pitch"),
        ({"shape": 5}, "shape"),
        ({"shape": (0, 5)}, "shape"),
        ({"first": (np.inf, 0.0)}, "first"),
        ({"first": 0.0}, r"first = 0.0; give the centre \(x, y\)"),
        ({"first": (0.0, 0.0, 0.0)}, r"give the centre \(x, y\)"),
        ({"seed": -1}, "seed"),
    ],
)
def test_bad_input_is_told(options, message):
    with pytest.raises(SceneError, match=message):
        trace_point(point_scene(PAINT), **options)
