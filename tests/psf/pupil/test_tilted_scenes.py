"""Waves and views of a scene without any symmetry, against lengths of paths and closed forms."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from pytest import approx
from scipy.optimize import minimize

from nlosoptics import psf
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.psf.pupil import scene_optics
from nlosoptics.psf.pupil.aiming import aim
from nlosoptics.psf.pupil.obstruction import check_cone
from nlosoptics.psf.pupil.paraxial import wave_bends
from nlosoptics.scene import CallableWall, ConcaveWall, ConvexWall, FlatWall, WavyWall

OBJECT, CAMERA = np.array([0.41, -0.17, 0.9]), np.array([-0.55, 0.36, 0.75])
MIRRORED = OBJECT * (1, 1, -1)
#: Where a flat wall shows the object to the camera.
HIT = CAMERA + 0.75 / 1.65 * (MIRRORED - CAMERA)
RADIUS = 7e-3
NODES = np.array([(0.0, 0.0), (5e-3, 1e-3), (-2e-3, 4e-3), (-3e-3, -6e-3), (1e-3, -2e-3)])


@pytest.fixture
def tilted(flat_scene):
    """``tilted(wall, **camera)``: seen from no plane of symmetry, in focus if not said."""

    def made(wall=None, **camera):
        seen = {"position": tuple(CAMERA), "aim": tuple(HIT), "stop_diameter": 2 * RADIUS}
        return replace(
            flat_scene,
            wall=wall or FlatWall(),
            hidden=replace(flat_scene.hidden, position=tuple(OBJECT)),
            camera=replace(flat_scene.camera, **(seen | camera)),
        )

    return made


def paths(wall, o, ends):
    """Stationary points of the path by a wall (n, 2), and its lengths, by plain minimisation."""
    points, lengths = [], []
    for end in ends:

        def length(at, end=end):
            hit = np.array([*at, float(wall.height(*at))])
            return np.linalg.norm(hit - o) + np.linalg.norm(end - hit)

        share = o[2] / (o[2] + end[2])
        start = (o + share * (end - o))[:2]
        found = minimize(length, start, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 0})
        points.append(found.x)
        lengths.append(found.fun)
    return np.array(points), np.array(lengths)


def lens_points(scene, nodes):
    e1, e2, _ = scene.camera.frame
    return np.array(scene.camera.position) + nodes[:, :1] * e1 + nodes[:, 1:] * e2


@pytest.mark.parametrize("focus", [None, 1.3])
@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (0.06, -0.03, 0.11)])
@pytest.mark.parametrize("wall", [FlatWall(), ConvexWall(2.5)], ids=["flat", "convex"])
def test_wave_is_the_excess_of_paths(tilted, wall, shift, focus):
    """Path by the wall less that from the point in focus on the chief ray, and its mean tilt."""
    scene, o = tilted(wall, focus_distance=focus), OBJECT + shift
    wave = psf.wavefront(scene, o, nodes=NODES)
    ends = lens_points(scene, NODES)
    points, lengths = paths(wall, o, ends)
    mirrored = o * (1, 1, -1)
    line = mirrored - CAMERA
    sharp = CAMERA + line * scene.focus_distance / (line @ scene.camera.axis)
    excess = lengths - np.linalg.norm(ends - sharp, axis=1)
    hit = np.array([*points[0], float(wall.height(*points[0]))])
    chief = (CAMERA - hit) / np.linalg.norm(CAMERA - hit)
    kink = chief + line / np.linalg.norm(line)
    tilt = np.array([kink @ e for e in scene.camera.frame[:2]])
    assert wave.removed.tilt == approx(tilt, abs=1e-7)
    known = excess - excess[0] - NODES @ wave.removed.tilt
    # the search finds lengths to 1e-15 m
    assert wave.aberration == approx(known, abs=3e-14)
    assert wave.removed.piston == approx(lengths[0] - np.linalg.norm(line), abs=1e-14)
    assert abs(known).max() > 1e-9 or (wall.is_flat and focus is None and not any(shift))
    assert (wave.layout, wave.pupil_radius) == ("scattered", RADIUS)
    assert wave.weights == approx(math.pi * RADIUS**2 / len(NODES))
    assert wave.image_distance == scene.image_distance
    assert wave.removed.defocus == 0


@pytest.mark.parametrize("more", [(4e-3, 5e-3), (0.02, 3e-3)])
def test_a_wall_as_stop_that_the_lens_cuts(tilted, more):
    """Area of the wall's image within the lens, by random points of the lens."""
    size = (2 * abs(HIT[0]) + more[0], 2 * abs(HIT[1]) + more[1])
    scene = tilted(FlatWall(size=size), stop_diameter=0.03, focus_distance=2.4)
    pupil = psf.exit_pupil(scene)
    assert pupil.stop == "wall"
    rng = np.random.default_rng(3)
    nodes = rng.uniform(-0.015, 0.015, (40000, 2))
    ends = lens_points(scene, nodes)
    share = 0.9 / (0.9 + ends[:, 2])
    hits = OBJECT + share[:, None] * (ends - OBJECT)
    lit = (np.hypot(*nodes.T) < 0.015) & scene.wall.contains(hits[:, 0], hits[:, 1])
    zoom = pupil.image_distance / scene.image_distance
    area = lit.mean() * 0.03**2 * zoom**2
    error = 3 * math.sqrt(lit.mean() / 40000) * 0.03**2 * zoom**2
    for name in ("cells", "grid"):
        wave = psf.wavefront(scene, nodes=name, samples=24 if name == "cells" else 128)
        assert wave.weights.sum() == approx(area, abs=error)
        assert wave.pupil_radius <= 0.015 * abs(zoom) * (1 + 1e-12)
    with pytest.raises(SamplingError, match="the wall is the stop and its outline is a rectangle"):
        psf.wavefront(scene, nodes="polar")


def test_corners_that_never_meet_the_lens(tilted):
    """A camera that looks along a wide wall: its far corners lie behind the lens."""
    wide = tilted(FlatWall(size=(9.0, 7.0)))
    with pytest.raises(SamplingError, match="edge has no closed image there; use nodes='grid'"):
        psf.wavefront(wide, nodes="cells")
    assert psf.wavefront(tilted(FlatWall(size=(0.9, 0.8))), nodes="cells").layout == "cells"


def test_automatic_nodes_of_a_cut_cone(tilted):
    scene = tilted(FlatWall(size=(2 * abs(HIT[0]) + 2e-3, 1.0)))
    assert psf.wavefront(scene).u.shape == (512, 512)
    assert psf.wavefront(scene, samples=20).u.shape == (20, 20)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"nodes": "rings"}, "nodes = 'rings' is unknown"),
        ({"nodes": NODES, "samples": 4}, "samples = 4 with nodes given as an array"),
        ({"nodes": "polar", "samples": (4, 5, 6)}, r"samples = \(4, 5, 6\); give one whole number"),
        ({"nodes": "grid", "samples": (4, 5)}, r"samples = \(4, 5\); a grid is square"),
        ({"nodes": NODES.T}, r"nodes have shape \(2, 5\)"),
        ({"nodes": NODES[None]}, r"nodes have shape \(1, 5, 2\)"),
        ({"nodes": [[0.0, math.nan]]}, "nodes hold NaN"),
        ({"object_point": (0.0, 1.0)}, "object_point"),
    ],
)
def test_bad_options_of_a_wave(tilted, options, message):
    with pytest.raises(SceneError, match=message):
        psf.wavefront(tilted(), **options)


def test_objects_behind_the_camera(tilted):
    scene = tilted(aim=(3.0, 3.0, 0.7))
    with pytest.raises(SceneError, match="mirrored object point is behind the camera"):
        psf.wavefront(scene, (-3.0, -2.0, 0.5), nodes=NODES)


@pytest.mark.thorough
@pytest.mark.parametrize("hessian", [True, False])
@pytest.mark.parametrize(
    "wall", [ConvexWall(2.5), ConcaveWall(6.0), WavyWall(2e-4, 0.31, 0.4, direction=0.7)]
)
def test_walls_by_python_functions_are_those_compiled(tilted, wall, hessian):
    """Newton's steps in Python end at the same points as the compiled ones."""
    same = CallableWall(
        wall.height,
        lambda x, y: np.moveaxis(wall.derivatives(x, y)[..., 1:3], -1, 0),
        hessian=(lambda x, y: np.moveaxis(wall.derivatives(x, y)[..., 3:], -1, 0))
        if hessian
        else None,
        max_height=5.0,
        max_curvature=1.2 * wall.max_curvature,
        finest_period=wall.finest_period,
    )
    scene = tilted(wall)
    ends = lens_points(scene, np.random.default_rng(1).uniform(-0.2, 0.2, (60, 2)))
    known, found = (aim(one, OBJECT, ends, scene.camera.axis) for one in (wall, same))
    points, _ = paths(wall, OBJECT, ends[:3])
    assert known.points[:3, :2] == approx(points, abs=2e-6)  # a flat minimum
    assert found.points == approx(known.points, abs=1e-9)
    assert found.excess == approx(known.excess, abs=1e-15)
    assert found.spreading == approx(known.spreading, rel=1e-9 if hessian else 1e-5)


def test_bends_of_a_weak_wall(tilted):
    """A wall of 1e-7 m, whose height itself adds 5e-8/m of defocus."""
    wall = WavyWall(1e-7, 0.31, 0.4, direction=0.7)
    shift = 0.2 * (MIRRORED - CAMERA) / math.dist(MIRRORED, CAMERA)
    for o, focus in ((OBJECT, None), (OBJECT + shift * (1, 1, -1), None), (OBJECT, 1.4)):
        scene = tilted(wall, stop_diameter=2e-3, focus_distance=focus)
        wave = psf.wavefront(scene, o, samples=(6, 24))
        u, v = wave.u.ravel() / 1e-3, wave.v.ravel() / 1e-3
        powers = [(i, j) for i in range(5) for j in range(5 - i)]
        terms = np.stack([u**i * v**j for i, j in powers], axis=1)
        fit = np.linalg.lstsq(terms, wave.aberration.ravel(), rcond=None)[0] / 1e-6
        fit = dict(zip(powers, fit, strict=True))
        known = np.array([[2 * fit[2, 0], fit[1, 1]], [fit[1, 1], 2 * fit[0, 2]]])
        assert wave_bends(scene, o[None])[0] == approx(known, abs=5e-3 * abs(known).max())
    flat = wave_bends(tilted(focus_distance=1.4), np.array([OBJECT, OBJECT + shift * (1, 1, -1)]))
    depth = math.dist(MIRRORED, CAMERA)
    for found, d in zip(flat, (depth, depth + 0.2), strict=True):
        assert found == approx((1 / d - 1 / 1.4) * np.eye(2), rel=1e-9)


def test_view_of_a_flat_wall(tilted):
    """P_i/d1 + P_o/d2 and its product with the slanted lens, in closed form."""
    view = psf.wall_view(tilted())
    d1, d2 = math.dist(OBJECT, HIT), math.dist(CAMERA, HIT)
    a, b = (OBJECT - HIT) / d1, (CAMERA - HIT) / d2
    total = (np.eye(2) - np.outer(a[:2], a[:2])) / d1 + (np.eye(2) - np.outer(b[:2], b[:2])) / d2
    axes = tilted().camera.frame[:2]
    across = np.array([[(e - (b @ e) * b)[k] for e in axes] for k in (0, 1)])
    assert view.cos_sum == approx(a[2] + b[2], rel=1e-12)
    assert view.effective_distance == approx(np.linalg.inv(total), rel=1e-9)
    assert view.footprint == approx(np.linalg.inv(total) @ across / d2, rel=1e-9)
    assert view.point == approx(HIT, abs=1e-14)
    assert view.tangents == approx(np.eye(3)[:2])
    other = psf.wall_view(tilted(), np.add(OBJECT, (0.1, 0.05, 0.2)))
    assert other.point[0] != approx(HIT[0], abs=1e-3)
    # a wall as stop: its image on the pupil is smaller than its cone on the lens
    small = tilted(
        FlatWall(size=(2 * abs(HIT[0]) + 0.01, 2 * abs(HIT[1]) + 0.013)),
        stop_diameter=0.9,
        focus_distance=2.4,
    )
    pupil = psf.exit_pupil(small)
    assert pupil.stop == "wall"
    seen = psf.wall_view(small)
    zoom = pupil.image_distance / small.image_distance
    assert zoom < 0
    assert seen.footprint == approx(view.footprint / zoom, rel=1e-9)


@pytest.mark.parametrize(
    "wall", [ConvexWall(2.5), ConcaveWall(6.0), WavyWall(2e-4, 0.31, 0.4, direction=0.7)]
)
def test_footprint_is_how_the_seen_point_moves(tilted, wall):
    """M against differences of aimed points, and the slope of a small bump in the wave."""
    scene, step = tilted(wall), 1e-5
    view = psf.wall_view(scene)
    for k, shift in enumerate(np.eye(2) * step):
        ends = lens_points(scene, np.array([shift, -shift]))
        ahead, back = aim(wall, OBJECT, ends, scene.camera.axis).points
        # step^2 over squared distances, and rounding 1e-16/step
        assert view.footprint[:, k] == approx(view.tangents @ (ahead - back) / (2 * step), abs=2e-8)


def plate(centre, side, thick=1e-4):
    box = trimesh.creation.box((side, side, thick))
    box.apply_translation(centre)
    return box


def test_occluders_in_the_cone(tilted):
    """Before the wall, before the lens, beside both, or in the middle of a part of the cone."""
    scene = tilted()
    half = HIT + 0.5 * (CAMERA - HIT)
    near, outward = plate(half, 0.05), HIT + 0.5 * (OBJECT - HIT)
    rim = lens_points(scene, np.array([(0.0, RADIUS)]))[0]
    aside = HIT + 0.95 * (rim - HIT)  # only the outermost rays at one side pass here
    for occluder, hidden in (
        (near, True),
        (plate(outward, 0.05), True),
        (plate(np.add(half, (0.3, 0, 0)), 0.05), False),
        (plate(HIT + 2.0 * (OBJECT - HIT), 0.05), False),
    ):
        blocked = replace(scene, occluders=(occluder,))
        assert check_cone(blocked) == hidden
        assert check_cone(blocked, OBJECT) == hidden
        assert not check_cone(blocked, np.add(OBJECT, (2.0, 0, 0)))
        optics = scene_optics.SceneOptics(blocked)
        assert optics.at().first.hidden == hidden
    assert not check_cone(scene)
    for occluder in (plate(aside, 1.2e-3), plate(half, 1e-3)):
        cut = replace(scene, occluders=(occluder,))
        place = re.escape("object point (0.41, -0.17, 0.9) m by the wall")
        with pytest.raises(SceneError, match=r"scene.occluders cut [\d.]+ % of the .*" + place):
            check_cone(cut)


def test_waves_of_a_scene_are_kept(tilted):
    scene = tilted()
    optics = scene_optics.SceneOptics(scene)
    assert scene_optics.optics_of(optics) is optics
    assert scene_optics.optics_of(scene).scene is scene
    assert optics.at(tuple(OBJECT)) is optics.at() is optics.reference
    assert optics.at().zoom == 1
    points = [np.add(OBJECT, (0.001 * k, 0, 0)) for k in range(1, 18)]
    found = [optics.at(point) for point in points]
    assert [optics.at(p) is one for p, one in zip(points, found, strict=True)] == [True] * 16 + [
        False
    ]
    assert found[3].view.point == approx(psf.wall_view(scene, points[3]).point, abs=1e-12)
    made = []
    assert [found[0].once("key", lambda: made.append(1) or 7) for _ in range(2)] == [7, 7]
    assert made == [1]
    other = replace(psf.exit_pupil(scene), radius=1e-3)
    assert scene_optics.SceneOptics(scene, other).exit_pupil is other
    for wrong, message in (((scene.wall,), "scene is a FlatWall"), ((scene, 3), "pupil is a int")):
        with pytest.raises(SceneError, match=message):
            scene_optics.SceneOptics(*wrong)


def test_waves_are_refined_until_they_suffice(tilted):
    optics, seen = scene_optics.SceneOptics(tilted()).at(), []

    def use(aimed, enough):
        seen.append(aimed.wave.u.shape)
        if aimed.wave.u.shape[0] < enough:
            raise SamplingError("too few")
        return 5

    for enough, shapes in ((24, [24]), (48, [24, 48]), (96, [24, 48, 96])):
        seen.clear()
        aimed, found = optics.refined(lambda a, enough=enough: use(a, enough))
        assert (found, seen) == (5, [(n, 4 * n) for n in shapes])
        assert aimed.wave.u.shape == seen[-1]
    with pytest.raises(SamplingError, match="too few"):
        optics.refined(lambda a: use(a, 97))
    assert scene_optics.FINER["grid"] == (1024, 2048)
