"""Exit pupils of tilted cameras by distances of lines, and vignetting by areas of a disc."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SceneError
from nlosoptics.psf.pupil.exit_pupil import working_f_number
from nlosoptics.scene import FlatWall

OBJECT, CAMERA = np.array([0.41, -0.17, 0.9]), np.array([-0.55, 0.36, 0.75])


@pytest.fixture
def tilted(flat_scene):
    """``tilted(size, aim, **camera)``: a wall of this size, seen from no plane of symmetry."""

    def made(size, aim, **camera):
        seen = {"position": tuple(CAMERA), "aim": (*aim, 0.0), "pixels": (64, 64), "binning": 1}
        return replace(
            flat_scene,
            wall=FlatWall(size=size),
            hidden=replace(flat_scene.hidden, position=tuple(OBJECT)),
            camera=replace(flat_scene.camera, **(seen | camera)),
        )

    return made


@pytest.mark.parametrize(
    ("size", "aim", "nearest"),
    [
        ((0.05, 0.4), (0.01, 0.02), (0.025, 0.0)),
        ((0.05, 0.4), (-0.01, 0.02), (-0.025, 0.0)),
        ((0.4, 0.06), (0.01, 0.02), (0.0, 0.03)),
        ((0.4, 0.06), (0.01, -0.02), (0.0, -0.03)),
    ],
)
def test_image_of_the_nearest_edge(tilted, size, aim, nearest):
    """The edge's distance from the axis, magnified by the thin lens."""
    scene = tilted(size, aim, stop_diameter=0.7, focus_distance=2.3, focal_length=0.06)
    pupil, n, f = psf.exit_pupil(scene), scene.camera.axis, 0.06
    along = np.array([float(nearest[0] == 0), float(nearest[1] == 0), 0.0])
    normal = np.cross(along, n)
    gap = np.array([*nearest, 0.0]) - (*aim, 0.0)
    edge = abs(gap @ normal) / np.linalg.norm(normal)
    d2 = math.dist(CAMERA, (*aim, 0.0))
    behind = 1 / (1 / f - 1 / d2)
    image = 1 / (1 / f - 1 / 2.3)
    assert pupil.stop == "wall"
    assert pupil.layout == "grid"
    assert pupil.radius == approx(edge * behind / d2, rel=1e-12)
    assert pupil.image_distance == approx(image - behind, rel=1e-10)
    assert pupil.f_number == approx((behind - image) / (2 * edge * behind / d2), rel=1e-10)
    assert pupil.centre == approx(CAMERA - behind * n, abs=1e-14)
    assert pupil.entrance_radius == approx(edge * 2.3 / (2.3 - d2), rel=1e-12)
    assert 0 <= pupil.vignetting <= 1


def test_vignetting_of_a_wall_as_stop(tilted):
    """By random points of the cone of light; the object lies beside what the axis sees."""
    scene = tilted((0.05, 0.06), (-0.009, 0.011), stop_diameter=0.7, focus_distance=2.0)
    scene = replace(scene, hidden=replace(scene.hidden, position=(0.6, -0.39, 0.9)))
    pupil = psf.exit_pupil(scene)
    assert pupil.stop == "wall"
    rng = np.random.default_rng(4)
    r = pupil.entrance_radius * np.sqrt(rng.random(40000))
    angle = 2 * math.pi * rng.random(40000)
    e1, e2, _ = scene.camera.frame
    points = CAMERA + (r * np.cos(angle))[:, None] * e1 + (r * np.sin(angle))[:, None] * e2
    mirrored = scene.object_point * (1, 1, -1)
    share = -mirrored[2] / (points[:, 2] - mirrored[2])
    hits = mirrored[:2] + share[:, None] * (points - mirrored)[:, :2]
    lost = 1 - np.mean(np.all(np.abs(hits) <= (0.025, 0.03), axis=1))
    assert 0.1 < lost < 0.9
    assert pupil.vignetting == approx(lost, abs=0.012)  # 2048 nodes, and 3 standard errors


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("turn", [1, -1])
def test_vignetting_by_one_edge_is_a_segment_of_the_lens(tilted, side, turn):
    """Edges of the wall, all across the disc: each a straight line on the plane of the lens."""
    place = CAMERA * (turn, turn, 1)
    o = OBJECT * (turn, turn, 1)
    hit = place + place[2] / (place[2] + o[2]) * (o - place)
    found, exact, steps = [], [], np.linspace(-1.2, 1.2, 33)
    for step in steps.tolist():
        half = abs(hit[side]) + 0.0075 * step
        size = tuple(2 * half if k == side else 4.0 for k in (0, 1))
        scene = tilted(size, tuple(0.7 * hit[:2]), position=tuple(place))
        scene = replace(scene, hidden=replace(scene.hidden, position=tuple(o)))
        pupil = psf.exit_pupil(scene)
        assert pupil.stop == "lens"
        assert pupil.entrance_radius == pupil.radius == 0.0125
        assert pupil.layout == ("grid" if pupil.vignetting else "polar")
        e1, e2, _ = scene.camera.frame
        outward = math.copysign(1, hit[side])

        def beyond(p, half=half, outward=outward):
            """Positive where the ray through a point of the lens misses the wall; linear."""
            edge = outward * half
            return outward * ((o[2] + p[2]) * (o[side] - edge) + o[2] * (p[side] - o[side]))

        middle = beyond(place)
        slope = math.hypot(*(beyond(place + e) - middle for e in (e1, e2)))
        t = min(max(-middle / (slope * 0.0125), -1.0), 1.0)
        exact.append((math.acos(t) - t * math.sqrt(1 - t * t)) / math.pi)
        found.append(pupil.vignetting)
    change = np.array(found) - exact
    assert (found[0], found[-1]) == (1.0, 0.0)
    assert np.abs(change).max() < 0.02  # 64 nodes around
    # 33 edges: nodes are neither shifted nor spread
    assert abs(change.mean()) < 2e-3
    assert abs(np.mean(change * steps)) < 1.5e-3


def test_a_lens_in_focus_before_the_wall_is_the_stop(tilted):
    """A focus before the wall leaves the lens as the stop, however small the wall is."""
    near = tilted((0.05, 0.06), (0.0, 0.0), focus_distance=0.9)
    assert psf.exit_pupil(near).stop == "lens"
    far = tilted((0.05, 0.06), (0.0, 0.0), focus_distance=2.3, stop_diameter=0.9)
    assert psf.exit_pupil(far).stop == "wall"


@pytest.mark.parametrize("aim", [(0.0251, 0.0), (0.0, -0.0301)])
def test_an_axis_beside_the_wall_is_refused(tilted, aim):
    message = (
        rf"meets the wall plane at x = {aim[0] or -0.0:g} m, y = {aim[1] or -0.0:g} m, outside "
        r"wall.size = \(0.05, 0.06\) m; change camera.aim"
    ).replace("-0 m", "-?[0-9.e-]+ m")
    with pytest.raises(SceneError, match=message):
        psf.exit_pupil(tilted((0.05, 0.06), aim))


def test_a_wall_within_the_focal_length_is_refused(tilted):
    d2 = math.dist(CAMERA, (0.0, 0.0, 0.0))
    options = {"stop_diameter": 0.9, "focus_distance": 3.0}
    with pytest.raises(SceneError, match=f"wall is {d2:g} m from the lens.*focal length 1 m"):
        psf.exit_pupil(tilted((0.05, 0.06), (0.0, 0.0), focal_length=1.0, **options))


def test_cones_up_to_the_half_space():
    assert working_f_number(0.3, -0.7) == approx(0.7 / 0.6, rel=1e-15)
    assert working_f_number(0.25, 0.2501) == approx(0.5002, rel=1e-12)
    with pytest.raises(SceneError, match=r"radius of 0.25 m at 0.25 m from the detector, F/0.5, "):
        working_f_number(0.25, -0.25)
