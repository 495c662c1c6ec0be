"""Light that mirror-like lobes reflect in a row: images, a plain walk, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from pytest import approx

from nlosoptics.errors import SceneError
from nlosoptics.raytrace import ray_plan, trace
from nlosoptics.raytrace.light._chain_kernels import _set_facet
from nlosoptics.scene import (
    CallableWall,
    Camera,
    ConcaveWall,
    ConvexWall,
    FacetWall,
    FlatWall,
    Lambert,
    Laser,
    MeshObject,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
    SumWall,
    WallRoughness,
    Ward,
    WavyWall,
)

pytestmark = pytest.mark.thorough  # they compile kernels that few scenes need


FLAT, POWER, PAINT, GLOSS, PLATE = FlatWall(size=(2.0, 2.0)), 2.0, 0.4, 0.4, 0.9


def matt_and(reflectance, slope=0.0, **options):
    return SumMaterial(Lambert(PAINT), SpecularMicrofacet(reflectance, slope, **options))


def room(wall=FLAT, wall_material=None, material=None, *, stop=0.3, mesh=None):
    """A mirror-like object before a mirror-like wall, seen by a lens of any width."""
    material = SpecularMicrofacet(PLATE, 0.0) if material is None else material
    hidden = PlanarObject(
        np.ones((1, 1)), 0.6, position=(0.35, -0.05, 0.5), yaw=0.3, material=material
    )
    if mesh is not None:
        hidden = MeshObject(mesh=mesh, position=(0.3, 0.0, 0.5), material=material)
    return Scene(
        Laser(wavelength=633e-9, power=POWER, beam_diameter=1e-3, position=(-0.1, 0.8, 0.9)),
        wall,
        hidden,
        Camera(
            position=(-0.45, 0.0, 0.6),
            aim=(0.0, 0.0, 0.0),
            focal_length=0.05,
            stop_diameter=stop,
            focus_distance=0.9,
            transmission=0.9,
            pixel_pitch=1e-3,
            pixels=(120, 120),
            binning=1,
        ),
        wall_material=matt_and(GLOSS) if wall_material is None else wall_material,
    )


# plane mirrors by images


def lens_points(camera, rings, spokes):
    """Points spread evenly over the lens, world, m."""
    radius = np.sqrt((np.arange(rings) + 0.5) / rings) * camera.stop_diameter / 2
    turn = 2 * math.pi * (np.arange(spokes) + 0.5) / spokes
    u, v = np.multiply.outer(radius, [np.cos(turn), np.sin(turn)]).swapaxes(0, 1).reshape(2, -1)
    return np.array(camera.position) + u[:, None] * camera.frame[0] + v[:, None] * camera.frame[1]


def seen(scene, points, ends):
    """Cosine at the lens points for light from ``ends``, 0 where it misses the detector."""
    camera = scene.camera
    line = ends - points
    line /= np.linalg.norm(line, axis=-1, keepdims=True)
    cosine = line @ camera.axis
    focus = points - np.array(camera.position)
    focus = focus + (scene.focus_distance / cosine)[..., None] * line
    x, y = (focus @ camera.frame[k] * scene.image_distance / scene.focus_distance for k in (0, 1))
    half = 0.5 * camera.image_pitch * np.array(camera.shape[::-1])
    return np.where((abs(x) <= half[0]) & (abs(y) <= half[1]), cosine, 0.0)


def on_plate(hidden, start, end):
    """Whether lines between points cross the plate."""
    centre, (right, up, normal) = np.array(hidden.position), hidden.axes
    share = ((centre - start) @ normal) / ((end - start) @ normal)
    point = start + share[..., None] * (end - start) - centre
    within = (abs(point @ right) <= hidden.size[0] / 2) & (abs(point @ up) <= hidden.size[1] / 2)
    return within & (share > 1e-9) & (share < 1.0), point + centre


def over_two_mirrors(scene):
    """Power from the spot over plate and wall, both smooth, to the lens by mirror images."""
    points, hidden = lens_points(scene.camera, 200, 200), scene.hidden
    in_wall = points * [1, 1, -1]
    normal = hidden.axes[2]
    away = (in_wall - np.array(hidden.position)) @ normal
    image = in_wall - 2 * away[:, None] * normal
    hit, first = on_plate(hidden, np.zeros(3), image)
    share = first[:, 2] / (first[:, 2] - in_wall[:, 2])
    second = first + share[:, None] * (in_wall - first)
    hit &= (abs(second[:, :2]) <= 1.0).all(axis=1) & ~on_plate(hidden, second, points)[0]
    square = (image**2).sum(axis=1)
    at_spot = image[:, 2] / np.sqrt(square)
    density = PAINT / math.pi * at_spot * seen(scene, points, second) / square
    return POWER * PLATE * GLOSS * collected(scene, np.where(hit, density, 0.0))


def collected(scene, density):
    """Integral of a density per area of the lens over the lens."""
    camera = scene.camera
    return camera.transmission * math.pi * camera.stop_diameter**2 / 4 * density.mean()


def over_plate_and_paint(scene):
    """Power from the spot over the plate to the paint of the wall, and from there to the lens."""
    n, hidden = 600, scene.hidden
    x = 2.0 * (np.arange(n) + 0.5) / n - 1.0
    wall = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    wall = np.concatenate([wall, np.zeros((len(wall), 1))], axis=1)
    normal = hidden.axes[2]
    image = 2 * (np.array(hidden.position) @ normal) * normal
    lit, _ = on_plate(hidden, image, wall)
    wall = wall[lit]
    line = wall - image
    square = (line**2).sum(axis=1)
    # the light leaves the true spot; its angle to the wall is that of the line from spot to plate
    leaving = (line - 2 * (line @ normal)[:, None] * normal)[:, 2] / np.sqrt(square)
    arriving = -line[:, 2] / np.sqrt(square)
    lit_by = POWER * PAINT / math.pi * PLATE * leaving * arriving / square
    total = []
    for point in lens_points(scene.camera, 4, 8):
        to = point - wall
        distance = np.linalg.norm(to, axis=1)
        clear = ~on_plate(hidden, wall, np.broadcast_to(point, wall.shape))[0]
        cosine = seen(scene, np.broadcast_to(point, wall.shape), wall)
        total.append((lit_by * clear * to[:, 2] / distance**3 * cosine).sum())
    return PAINT / math.pi * (2.0 / n) ** 2 * collected(scene, np.array(total))


@pytest.mark.parametrize("stop", [0.0125, 0.05, 0.4])
def test_mirror_plate_and_mirror_wall_by_images(stop):
    scene = room(stop=stop)
    exact = over_two_mirrors(scene) + over_plate_and_paint(scene)
    found = trace(scene, n_rays=1 << 14, max_bounces=3, seed=3)
    assert found.standard_error < 2e-3 * exact
    # three standard errors, and 1e-3 for the edges of the light on the grid of the quadrature
    assert found.flux == approx(exact, abs=3 * found.standard_error + 1e-3 * exact)
    assert trace(scene, tol=0.01, max_bounces=3).flux == approx(exact, rel=0.03)


def test_narrow_lobes_approach_the_mirrors():
    """Slopes of 1e-4 rad blur by 0.4 mm, by far less than plate and wall extend."""
    smooth = trace(room(stop=0.0125), n_rays=1 << 14, max_bounces=3, seed=1)
    for lobe in (SpecularMicrofacet, lambda r, s: Ward(r, s, variant="bounded")):
        materials = SumMaterial(Lambert(PAINT), lobe(GLOSS, 1e-4)), lobe(PLATE, 1e-4)
        narrow = trace(room(FLAT, *materials, stop=0.0125), n_rays=1 << 14, max_bounces=3, seed=2)
        error = math.hypot(narrow.standard_error, smooth.standard_error)
        assert error < 5e-3 * smooth.flux
        assert narrow.flux == approx(smooth.flux, abs=4 * error)


# brute force: the same light by a plain random walk

BOX = trimesh.creation.box((0.4, 0.4, 0.4))


@pytest.mark.thorough
@pytest.mark.parametrize(
    "scene",
    [
        room(FLAT, matt_and(0.4), matt_and(0.5)),
        room(FLAT, matt_and(0.4, 0.01), matt_and(0.5, 0.05)),
        room(FLAT, matt_and(0.4, 0.03, distribution="ggx"), SpecularMicrofacet(0.9, 0.02)),
        room(ConvexWall(2.0, size=(2.0, 2.0)), matt_and(0.4, 0.02), matt_and(0.5)),
        room(ConcaveWall(3.0, size=(2.0, 2.0)), matt_and(0.4), matt_and(0.5)),
        room(WavyWall(0.02, 0.4, size=(2.0, 2.0)), matt_and(0.4), SpecularMicrofacet(0.9, 0.03)),
        room(FLAT, matt_and(0.4, 0.03), matt_and(0.5), mesh=BOX),
        room(FLAT, matt_and(0.4), matt_and(0.5, 0.02), mesh=BOX, stop=0.5),
    ],
    ids=["smooth", "narrow", "ggx", "convex", "hollow", "wavy", "box", "wide stop"],
)
def test_chains_agree_with_a_plain_walk(scene):
    plain = trace(scene, n_rays=1 << 18, max_bounces=5, analog=True, sampler="philox", seed=5)
    found = trace(scene, n_rays=1 << 12, max_bounces=5, seed=6)
    for k in range(6):
        error = math.hypot(plain.by_bounce_error[k], found.by_bounce_error[k])
        # four standard errors: 48 comparisons pass with p = 0.997; a walk may miss a few rays
        few = 3 * POWER / plain.n_rays
        assert found.by_bounce[k] == approx(plain.by_bounce[k], abs=4 * error + few)
    error = math.hypot(plain.standard_error, found.standard_error)
    assert found.flux == approx(plain.flux, abs=4 * error)
    assert found.stray == approx(
        plain.stray, abs=4 * math.hypot(plain.stray_error, found.stray_error) + 1e-12
    )


def test_laser_glint_on_the_object_is_seen_by_the_mirror():
    """Laser, wall's mirror, matt object, wall's mirror, lens: the only path besides matt ones."""
    scene = room(material=Lambert(0.8), stop=0.3)
    aim = np.array(scene.laser.aim)
    object_image = np.array(scene.hidden.position) * [1, 1, -1]
    start = aim + 0.45 * (aim - object_image) / np.linalg.norm(aim - object_image)
    scene = replace(scene, laser=replace(scene.laser, position=tuple(start)))
    assert ray_plan(scene).chains
    plain = trace(scene, n_rays=1 << 19, max_bounces=3, analog=True, sampler="philox", seed=1)
    found = trace(scene, n_rays=1 << 13, max_bounces=3, seed=2)
    error = math.hypot(plain.by_bounce_error[3], found.by_bounce_error[3])
    assert plain.by_bounce[3] > 10 * error
    assert found.by_bounce[3] == approx(plain.by_bounce[3], abs=4 * error)


def test_kept_paths_hold_the_reflection_points():
    scene = room(stop=0.0125)
    found = trace(scene, n_rays=256, max_bounces=3, keep_paths=True)
    assert found.weight.sum() == approx(found.flux + found.stray, rel=1e-12)
    steps = np.diff(found.points, axis=1)
    lengths = np.linalg.norm(steps, axis=2)
    assert lengths.sum(axis=1) == approx(found.path_length, rel=1e-12)
    # mirrored at the wall: the direction's components along the wall do not change
    three = found.n_bounces == 3
    assert abs(found.points[three, 3, 2]).max() < 1e-12
    along = steps[three, 2:4, :2] / lengths[three, 2:4, None]
    bends = np.abs(along[:, 0] - along[:, 1]).max(axis=1)
    assert (bends < 1e-9).sum() > 100  # the equations are solved to 1e-10


# what is left to chance


SHORT = SumWall(WavyWall(1e-4, 0.1), WavyWall(1e-4, 0.1, direction=math.pi / 2), size=(2.0, 2.0))
LEVEL = (lambda x, y: 0.0 * x, lambda x, y: (0.0 * x, 0.0 * y))


def with_facets(**options):
    scene = room(FLAT, SumMaterial(Lambert(PAINT), SpecularMicrofacet(GLOSS, 0.01)), **options)
    return replace(scene, wall_roughness=WallRoughness(FacetWall(5e-3, 0.01, seed=1)))


@pytest.mark.parametrize(
    ("scene", "least", "words"),
    [
        (
            room(CallableWall(*LEVEL, size=(2.0, 2.0), max_height=0.0, max_curvature=0.0)),
            3,
            "Python function",
        ),
        (with_facets(), 3, "rough relief"),
        (room(SHORT), 3, "hills and hollows, limit 100"),
        (room(WavyWall(0.05, 0.4, size=(2.0, 2.0)), matt_and(0.3), Lambert(0.8)), 4, "twice"),
        (room(mesh=trimesh.creation.icosphere(2, 0.2)), 2, "320 triangles, limit 128"),
        (room(mesh=trimesh.creation.annulus(0.1, 0.3, 0.2, sections=8)), 3, "not convex"),
    ],
    ids=["python", "facets", "short waves", "wall to wall", "triangles", "hollow mesh"],
)
def test_tol_is_refused_where_light_is_left_to_chance(scene, least, words):
    plan = ray_plan(scene)
    assert any(words in text for text in plan.unreached)
    assert words in str(plan)
    with pytest.raises(SceneError, match=rf"tol = 0.1 cannot .*{words}.*max_bounces = {least - 1}"):
        trace(scene, tol=0.1, max_bounces=least)
    found = trace(scene, n_rays=64, max_bounces=least)
    assert any(words in text for text in found.unreached)
    assert not trace(scene, n_rays=64, max_bounces=least - 1).unreached


def test_nothing_is_refused_without_need():
    matt = room(FLAT, Lambert(0.8), Lambert(0.8))
    assert not ray_plan(matt).chains
    for scene in (matt, room(), room(FLAT, matt_and(0.1), Lambert(0.8))):
        assert not ray_plan(scene).unreached
    gentle = room(ConcaveWall(20.0, size=(2.0, 2.0)), matt_and(0.1), Lambert(0.8))
    assert not ray_plan(gentle).unreached


# the tail of a sum


def test_rare_paths_are_said_to_be_uncertain():
    """The fifth reflection of a deep wave with few rays, against the third one."""
    scene = room(WavyWall(0.1, 0.4, size=(2.0, 2.0)), Lambert(0.7), Lambert(0.8), stop=0.05)
    runs = [trace(scene, n_rays=1024, seed=k) for k in range(20)]
    often = [sum(name in run.uncertain for run in runs) for name in ("bounce 3", "bounce 5")]
    assert often[0] < 5
    assert often[1] > 15


def test_slopes_of_a_single_chain_follow_the_lobe():
    """Inverse density of each slope: 1/p of Gaussian slopes, and of Ward's exp(-s^2/alpha^2)."""
    sigma, slope = 0.02, np.empty(2)
    for material, alpha in (
        (SpecularMicrofacet(0.5, sigma), math.sqrt(2) * sigma),
        (Ward(0.5, sigma), sigma),
    ):
        lobes = material.lobe_table()
        for ray in range(100):
            address = (np.uint64(1), np.uint64(0), np.uint64(0))
            chosen, inverse = _set_facet(lobes, np.uint64(5), np.uint64(ray), address, 1.0, slope)
            assert chosen == 0
            exact = math.pi * alpha**2 * math.exp((slope @ slope) / alpha**2)
            # the slope is rounded, which moves the exponent of up to 20 by its rounding
            assert inverse == approx(exact, rel=1e-12)
