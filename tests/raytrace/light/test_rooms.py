"""Occluders that reflect light: closed forms, mirror images, and a walk in plain numpy."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from pytest import approx

from nlosoptics.errors import SceneError
from nlosoptics.raytrace import ray_plan, trace, wall_irradiance
from nlosoptics.raytrace.fans.paths import ON_OCCLUDER
from nlosoptics.scene import (
    Camera,
    ConcaveWall,
    FlatWall,
    Lambert,
    Laser,
    MeshObject,
    Occluder,
    OrenNayar,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
    Ward,
    WavyWall,
)

POWER = 2.0
PAINT = Lambert(0.7)
MIRROR = SumMaterial(Lambert(0.4), SpecularMicrofacet(0.4, 0.0))
GLOSS = SumMaterial(Lambert(0.4), SpecularMicrofacet(0.4, 0.08))


def sheet(low, high, material):
    """Return a rectangle as an occluder; ``low`` and ``high`` are equal along one axis."""
    low, high = np.array(low, dtype=float), np.array(high, dtype=float)
    across = np.flatnonzero(high > low)
    corners = np.tile(low, (4, 1))
    corners[1:3, across[0]] = high[across[0]]
    corners[2:4, across[1]] = high[across[1]]
    mesh = trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)], process=False)
    return Occluder(mesh, material=material)


def room(floor, side, ceiling=None, **changes):
    """Return a scene with a floor, a side wall and maybe a ceiling, seen by a wide lens."""
    occluders = [
        sheet((-0.8, -0.5, 0.0), (0.8, -0.5, 1.6), floor),
        sheet((0.8, -0.5, 0.0), (0.8, 0.7, 1.6), side),
    ]
    if ceiling is not None:
        occluders.append(sheet((-0.8, 0.7, 0.0), (0.8, 0.7, 1.6), ceiling))
    scene = Scene(
        Laser(
            wavelength=633e-9,
            power=POWER,
            beam_diameter=0.02,
            position=(-0.1, 0.5, 0.9),
            aim=(0.1, 0.1, 0.0),
        ),
        FlatWall(size=(1.6, 1.2)),
        PlanarObject(
            np.array([[1.0, 0.3], [0.6, 1.0]]),
            0.5,
            position=(0.35, -0.05, 0.5),
            yaw=0.3,
            material=Lambert(0.8),
        ),
        Camera(
            position=(-0.3, 0.1, 1.0),
            aim=(0.0, -0.1, 0.0),
            focal_length=0.1,
            stop_diameter=0.3,
            pixel_pitch=1e-3,
            pixels=(160, 160),
            binning=1,
            focus_distance=1.5,
        ),
        wall_material=PAINT,
        occluders=tuple(occluders),
    )
    material = changes.pop("material", None)
    if material is not None:
        changes["hidden"] = replace(scene.hidden, material=material)
    return replace(scene, **changes)


# brute force: a walk that shares no code with the tracer


def walk(scene, n, bounces, seed):
    """Return power by reflections, stray power, and power absorbed by wall, object and occluders.

    All surfaces are rectangles with Lambert and mirror lobes; rays find the lens by chance. Each
    value is a pair of mean and standard error.
    """
    rng = np.random.default_rng(seed)
    frames = [np.array([[0, 0, 0], [0.8, 0, 0], [0, 0.6, 0]], dtype=float)]
    hidden = scene.hidden
    right, up, _ = hidden.axes
    width, height = hidden.size
    frames.append(np.array([hidden.position, right * width / 2, up * height / 2]))
    lobes = [scene.wall_material, hidden.material]
    for occluder in scene.occluders:
        a, b, c, _ = occluder.surface.vertices
        frames.append(np.array([(a + c) / 2, (b - a) / 2, (c - b) / 2]))
        lobes.append(occluder.material)
    camera = scene.camera
    e1, e2, axis = camera.frame
    middle = np.array(camera.position)
    laser = scene.laser
    beam = np.subtract(laser.aim, laser.position)
    beam /= np.linalg.norm(beam)
    side = np.cross(beam, [1.0, 0, 0])
    side /= np.linalg.norm(side)
    r, turn = laser.beam_diameter / 2 * np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    off = np.outer(r * np.cos(turn), side) + np.outer(r * np.sin(turn), np.cross(beam, side))
    o, d = np.array(laser.position) + off, np.tile(beam, (n, 1))
    power, met, live = np.full(n, POWER), np.zeros(n, dtype=bool), np.ones(n, dtype=bool)
    by_bounce, stray = np.zeros((bounces + 1, n)), np.zeros(n)
    absorbed = np.zeros((3, n))
    for bounce in range(bounces + 1):
        best, kind = np.full(n, np.inf), np.full(n, -1)
        normals = np.zeros((n, 3))
        for k, (centre, a, b) in enumerate(frames):
            normal = np.cross(a, b) / np.linalg.norm(np.cross(a, b))
            along = d @ normal
            with np.errstate(all="ignore"):
                t = ((centre - o) @ normal) / along
            p = o + t[:, None] * d - centre
            hit = (np.abs(p @ a) <= a @ a) & (np.abs(p @ b) <= b @ b) & (t > 1e-9) & (t < best)
            if k == 0:
                hit &= along < 0.0
            best, kind = np.where(hit, t, best), np.where(hit, k, kind)
            normals[hit] = normal * -np.sign(along[hit])[:, None]
        # the lens
        t = ((middle - o) @ axis) / (d @ axis)
        p = o + t[:, None] * d - middle
        lens = (t > 1e-9) & (t < best) & ((p * p).sum(axis=1) <= (camera.stop_diameter / 2) ** 2)
        cosine = -(d @ axis)
        zoom = scene.image_distance / scene.focus_distance
        with np.errstate(all="ignore"):
            far = (scene.focus_distance / cosine)[:, None]
        x, y = (p - far * d) @ e1 * zoom, (p - far * d) @ e2 * zoom
        half = 0.5 * camera.pixels[0] * camera.pixel_pitch
        seen = live & lens & (cosine > 0) & (np.abs(x) <= half) & (np.abs(y) <= half)
        if bounce > 0:
            by_bounce[bounce, seen & met] = power[seen & met] * camera.transmission
            stray[seen & ~met] = power[seen & ~met] * camera.transmission
        back = np.einsum("ij,ij->i", d, np.tile(np.cross(*frames[1][1:]), (n, 1))) > 0
        gone = (kind == 1) & back  # the back of the picture is black
        absorbed[1, live & ~lens & gone] += power[live & ~lens & gone]
        live &= ~lens & (kind >= 0) & ~gone
        for k, material in enumerate(lobes):
            if shares(material) == (0.0, 0.0):  # absorbs on arrival, also after the last reflection
                rows = live & (kind == k)
                absorbed[min(k, 2), rows] += power[rows]
                live &= ~rows
        if bounce == bounces:
            break
        o = o + np.where(live, best, 0.0)[:, None] * d
        met |= live & (kind == 1)
        onward = d.copy()
        for k, material in enumerate(lobes):
            rows = np.flatnonzero(live & (kind == k))
            matt, mirror = shares(material)
            if k == 1:
                p = o[rows] - frames[1][0]
                across = ((p @ frames[1][1]) / (width / 2) ** 2 * 0.5 + 0.5) * 2
                down = (0.5 - (p @ frames[1][2]) / (height / 2) ** 2 * 0.5) * 2
                bright = np.asarray(hidden.reflectance)[down.astype(int), across.astype(int)]
                matt, mirror = matt * bright, mirror * bright
            normal = normals[rows]
            glint = rng.random(len(rows)) * (matt + mirror + 1e-300) < mirror
            random = rng.normal(size=(len(rows), 3))
            random /= np.linalg.norm(random, axis=1)[:, None]
            matted = normal + random
            matted /= np.linalg.norm(matted, axis=1)[:, None]
            mirrored = d[rows] - 2 * np.einsum("ij,ij->i", d[rows], normal)[:, None] * normal
            onward[rows] = np.where(glint[:, None], mirrored, matted)
            absorbed[min(k, 2), rows] += power[rows] * (1 - matt - mirror)
            power[rows] *= matt + mirror
        d = onward
        live &= power > 0.0
    everything = [*by_bounce, stray, *absorbed]
    return [(v.mean(), v.std() / math.sqrt(n)) for v in everything]


def shares(material):
    """Return the reflectances of the Lambert and the mirror part of a material."""
    parts = material.parts if isinstance(material, SumMaterial) else (material,)
    matt = sum(p.rho for p in parts if isinstance(p, Lambert))
    return matt, sum(p.reflectance for p in parts if isinstance(p, SpecularMicrofacet))


ROOMS = {
    "matt": room(Lambert(0.6), Lambert(0.5), Lambert(0.9)),
    "black side": room(Lambert(0.6), Lambert(0.0), Lambert(0.9)),
    "mirror wall": room(Lambert(0.6), Lambert(0.5), wall_material=MIRROR),
    "mirror object": room(Lambert(0.6), Lambert(0.5), wall_material=MIRROR, material=MIRROR),
    "mirror floor": room(MIRROR, Lambert(0.5)),
}


@pytest.mark.thorough
@pytest.mark.parametrize("scene", ROOMS.values(), ids=ROOMS)
def test_rooms_agree_with_a_walk_of_their_own(scene):
    """Power by reflections, stray light, and what each surface absorbs."""
    most = 5
    plain = walk(scene, 1 << 20, most, 3)
    found = trace(scene, n_rays=1 << 16, max_bounces=most, seed=4)
    ours = [*zip(found.by_bounce, found.by_bounce_error, strict=True)]
    ours += [(found.stray, found.stray_error)]
    for name in ("wall", "object", "occluders"):
        key = f"absorbed by {name}"
        ours.append((found.ledger[key], found.ledger_error[key]))
    few = 3 * POWER / (1 << 20)  # where a plain walk found nothing it may have missed a few rays
    for (a, da), (b, db) in zip(plain, ours, strict=True):
        # 50 comparisons at 4.5 standard errors pass with p = 0.9997
        assert b == approx(a, abs=4.5 * math.hypot(da, db) + few)


# closed forms and plain quadrature

FLOOR = ((-0.7, -0.4, 0.0), (0.7, -0.4, 1.2))


def above_floor(material, *, wall_material=PAINT, flipped=False):
    """Return a wall, a floor and a speck of an object, lit at the origin by a thin beam."""
    floor = sheet(*FLOOR, material)
    if flipped:
        floor.mesh.invert()
    scene = room(Lambert(0.0), Lambert(0.0), wall_material=wall_material, occluders=(floor,))
    laser = replace(scene.laser, position=(0.0, 0.6, 0.6), aim=(0, 0, 0), beam_diameter=1e-3)
    speck = PlanarObject(np.zeros((1, 1)), 1e-6, position=(0.0, 1.0, 0.1))
    return replace(scene, laser=laser, hidden=speck, wall=FlatWall(size=(2.0, 2.0)))


@pytest.mark.parametrize("flipped", [False, True])
def test_floor_absorbs_its_view_factor(flipped):
    """Of the spot's matt light: an element and a rectangle perpendicular to it, with an edge."""
    found = trace(above_floor(Lambert(0.6), flipped=flipped), n_rays=1 << 17, max_bounces=2, seed=1)
    (_, height, _), (half, _, depth) = FLOOR
    slant = math.hypot(height, depth)
    factor = (math.atan(half / -height) + height / slant * math.atan(half / slant)) / math.pi
    error = found.ledger_error["absorbed by occluders"]
    assert error < 0.01 * factor
    assert found.ledger["absorbed by occluders"] == approx(
        0.4 * POWER * 0.7 * factor, abs=4 * error
    )


@pytest.mark.thorough
def test_floor_lights_the_wall_by_quadrature():
    """The irradiance of the wall by way of the floor, in cells some of which touch the floor."""
    scene = above_floor(Lambert(0.6))
    found = wall_irradiance(scene, shape=(4, 3), size=(0.9, 0.9), n_rays=1 << 18, seed=2)
    nodes, weights = np.polynomial.legendre.leggauss(160)
    (left, height, _), (right, _, depth) = FLOOR
    x, z = left + (right - left) * (nodes + 1) / 2, depth * (nodes + 1) / 2
    areas = np.outer(weights, weights) * (right - left) * depth / 4
    x, z = np.meshgrid(x, z, indexing="ij")
    lit = z * -height / (x * x + height**2 + z * z) ** 2 * areas * 0.7 * POWER / math.pi
    fine, share = np.polynomial.legendre.leggauss(8)
    for (row, column), value in np.ndenumerate(found.irradiance):
        at_x = found.x[column] + 0.15 * fine
        at_y = found.y[row] + 0.1125 * fine
        total = 0.0
        for i, j in np.ndindex(8, 8):
            above = at_y[j] - height
            if above > 0:
                square = (x - at_x[i]) ** 2 + above**2 + z * z
                total += share[i] * share[j] / 4 * (lit * z * above / square**2).sum()
        # cells below the floor's level see its dark side, and one row is cut by the floor
        if found.y[row] - 0.1125 > height:
            exact = 0.6 / math.pi * total
            assert value == approx(exact, abs=4.5 * found.standard_error[row, column])
            assert found.standard_error[row, column] < 0.05 * exact


@pytest.mark.parametrize("slope", [0.0, 0.02])
def test_glint_on_the_floor_is_seen_in_the_mirror(slope):
    """Mirror, matt floor, mirror: the lens sees the mirrored spot, whose power is exact."""
    scene = above_floor(Lambert(0.6), wall_material=SpecularMicrofacet(0.9, slope))
    camera = replace(
        scene.camera,
        position=(0.0, 0.2, 0.7),
        aim=(0.0, -0.2, 0.0),
        pixels=(60, 60),
        stop_diameter=0.02,
        transmission=0.8,
    )
    found = trace(replace(scene, camera=camera), n_rays=1 << 14, max_bounces=3, seed=3)
    # the beam meets the floor at y = -0.4, z = 0.4, and its image is at z = -0.4
    away = np.array([0.0, 0.2 + 0.4, 0.7 + 0.4])
    square = float(away @ away)
    cosine = away[1] / math.sqrt(square)
    axis = float(away @ [0.0, 0.4, 0.7]) / math.sqrt(square * (0.4**2 + 0.7**2))
    exact = POWER * 0.9**2 * 0.6 / math.pi * cosine * math.pi * 0.01**2 * axis / square * 0.8
    # the facets blur both reflections, which changes the power in second order of their slope
    assert found.stray == approx(exact, rel=0.01, abs=4 * found.stray_error)
    assert found.stray_error < 0.02 * exact
    assert found.flux == 0.0


@pytest.mark.thorough
def test_light_there_and_back():
    """The light from one spot of the wall to a patch around another, and the reverse."""
    scene = above_floor(Lambert(0.6))
    found = []
    for spot, patch in ((0.3, -0.2), (-0.2, 0.3)):
        laser = replace(scene.laser, position=(spot, 0.6, 0.6), aim=(spot, 0, 0))
        cells = wall_irradiance(
            replace(scene, laser=laser), shape=(1, 9), size=(0.9, 0.1), n_rays=1 << 17, seed=5
        )
        column = int(np.abs(cells.x - patch).argmin())
        found.append((cells.irradiance[0, column], cells.standard_error[0, column]))
    (one, da), (other, db) = found
    # a patch is the mean over its width, which differs from its centre by some 0.5 %
    assert one == approx(other, rel=0.01, abs=4 * math.hypot(da, db))
    assert da < 0.02 * one


# the same light by other methods


def tessellated(occluder, count):
    """Return an occluder whose triangles are divided ``count`` times, for Embree."""
    mesh = occluder.surface
    for _ in range(count):
        mesh = mesh.subdivide()
    return replace(occluder, mesh=mesh)


WIDE = {
    "gloss": room(GLOSS, Lambert(0.5), wall_material=GLOSS),
    "ward": room(Ward(0.7, 0.3), OrenNayar(0.8, 0.4), Lambert(0.3)),
    "hollow": room(Lambert(0.6), Lambert(0.5), wall=ConcaveWall(1.5, size=(1.6, 1.2))),
    "wavy": room(
        Lambert(0.6), Lambert(0.5), wall=WavyWall(0.04, 0.4, size=(1.6, 1.2)), wall_material=GLOSS
    ),
    "ball": room(
        Lambert(0.6),
        Lambert(0.5),
        hidden=MeshObject(
            trimesh.creation.icosphere(2, 0.22), position=(0.3, 0.0, 0.5), material=Lambert(0.9)
        ),
    ),
}
WIDE["embree"] = replace(
    WIDE["gloss"], occluders=tuple(tessellated(o, 4) for o in WIDE["gloss"].occluders)
)


@pytest.mark.thorough
@pytest.mark.parametrize("scene", WIDE.values(), ids=WIDE)
def test_connections_agree_with_rays_that_nothing_aims(scene):
    plain = trace(scene, n_rays=1 << 19, max_bounces=5, analog=True, sampler="philox", seed=11)
    found = trace(scene, n_rays=1 << 16, max_bounces=5, seed=12)
    assert math.fsum(plain.ledger.values()) == approx(POWER, rel=1e-12)
    few = 3 * POWER / plain.n_rays
    for k in range(6):
        error = math.hypot(plain.by_bounce_error[k], found.by_bounce_error[k])
        assert found.by_bounce[k] == approx(plain.by_bounce[k], abs=4.5 * error + few)
    error = math.hypot(plain.stray_error, found.stray_error)
    assert found.stray == approx(plain.stray, abs=4.5 * error)
    for name, power in plain.ledger.items():
        error = math.hypot(plain.ledger_error[name], found.ledger_error[name])
        assert found.ledger[name] == approx(power, abs=5 * error + 1e-12)


def test_kept_paths_tell_the_occluders():
    found = trace(ROOMS["matt"], n_rays=2000, max_bounces=4, keep_paths=True, seed=1)
    assert found.weight.sum() == approx(found.flux + found.stray, rel=1e-12)
    met = (found.surface == ON_OCCLUDER).any(axis=1)
    assert 0.1 < met.mean() < 1.0
    on_floor = found.points[found.surface == ON_OCCLUDER]
    planes = np.stack([on_floor[:, 1] + 0.5, on_floor[:, 1] - 0.7, on_floor[:, 0] - 0.8])
    assert np.abs(planes).min(axis=0).max() < 1e-12


# black occluders, and methods that know no others


def test_mirrors_among_occluders_are_named():
    scene = room(MIRROR, Lambert(0.5))
    words = "light that mirror-like lobes of occluders reflect"
    assert any(words in text for text in ray_plan(scene).unreached)
    with pytest.raises(SceneError, match=words):
        trace(scene, tol=0.1)
    assert not ray_plan(ROOMS["matt"]).unreached
