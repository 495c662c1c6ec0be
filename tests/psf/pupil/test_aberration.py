"""Wave aberration by aiming, against 50-digit values, closed forms and symmetries."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from pytest import approx
from scipy.optimize import minimize_scalar

from nlosoptics import psf
from nlosoptics.errors import CausticError, NotWaveGradeError, SceneError
from nlosoptics.scene import (
    CallableWall,
    ConcaveWall,
    ConvexWall,
    FlatWall,
    HeightMapWall,
    MeshWall,
    SumWall,
    WavyWall,
)
from nlosoptics.scene.parts.camera import pupil_frame

WAVELENGTH = 632.8e-9
TRUTHS = json.loads((Path(__file__).parents[2] / "truths" / "wall_aberrations.json").read_text())[
    "cases"
]
OBJECT, PUPIL, AIM = (0.1, 0.05, 1.0), (-0.6, 0.0, 0.8), (0.0, 0.0, 0.0)
WALLS = [
    FlatWall(),
    ConcaveWall(5.0),
    ConvexWall(3.0),
    ConcaveWall(4.0, shape="cylinder", axis="x"),
    ConvexWall(4.0, shape="cylinder", axis="y"),
    WavyWall(2e-5, 0.3, 0.4, direction=0.7),
    SumWall(WavyWall(1e-5, 0.25), WavyWall(1e-5, 0.35, direction=math.pi / 2)),
]


def disc(n=64, radius=0.0125, seed=3):
    rng = np.random.default_rng(seed)
    r, t = radius * np.sqrt(rng.random(n)), 2 * math.pi * rng.random(n)
    return np.stack([r * np.cos(t), r * np.sin(t)], axis=1)


def wall_of(row):
    kind = row["kind"]
    if kind == "flat":
        return FlatWall()
    if kind == "wavy":
        return WavyWall(row["amplitude"], row["period"], row["phase"])
    return {"concave": ConcaveWall, "convex": ConvexWall}[kind](row["radius"])


@pytest.mark.parametrize("case", TRUTHS, ids=lambda c: c["name"])
def test_fifty_digit_values(case):
    rows = np.array(case["rows"], dtype=float)
    found = psf.wall_aberration(
        wall_of(case["wall"]),
        case["object_point_m"],
        case["pupil_centre_m"],
        case["pupil_aim_m"],
        rows[:, :2],
    )
    # differences of two excesses of at most 0.03 m, each rounded to 1e-16 of itself
    limit = 1e-9 * WAVELENGTH if case["wall"]["kind"] == "flat" else 2e-17
    assert abs(found - rows[:, 2]).max() <= limit


@pytest.mark.parametrize(
    ("wall", "expected"),
    [(ConcaveWall(5.0), -9.765523676185589600e-6), (ConvexWall(5.0), 6.510245363964648799e-6)],
    ids=["concave", "convex"],
)
def test_defocus_of_a_sphere_at_normal_incidence(wall, expected):
    """50-digit values; leading term -kappa m^2 u^2/(1 - 2 kappa d_eff)."""
    ends = [[0.0125, 0.0], [0.0, 0.0125], [-0.0125, 0.0]]
    found = psf.wall_aberration(wall, (0, 0, 1), (0, 0, 1), (0, 0, 0), ends)
    assert found == approx(expected, rel=1e-12)
    kappa = 0.2 if isinstance(wall, ConcaveWall) else -0.2
    leading = -kappa * 0.25 * 0.0125**2 / (1 - kappa)
    # the next order is u^4/d^3, 1e-4 of the leading one
    assert found[0] == approx(leading, rel=3e-4)


@pytest.mark.parametrize("wall", WALLS, ids=lambda w: type(w).__name__)
def test_stationary_path_is_what_minimisation_finds(wall):
    """Independent: scipy minimises the plain path length from O to p."""
    from scipy.optimize import minimize

    o, c = np.array(OBJECT), np.array(PUPIL)
    e1, e2, _ = pupil_frame(-c / np.linalg.norm(c))

    def excess(node):
        p = c + node[0] * e1 + node[1] * e2

        def path(x):
            h = np.array([x[0], x[1], float(wall.height(*x))])
            return np.linalg.norm(o - h) + np.linalg.norm(h - p)

        best = minimize(
            path, (-0.28, 0.02), method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-16}
        )
        return best.fun - np.linalg.norm(p - o * (1, 1, -1))

    node = (0.009, -0.006)
    found = psf.wall_aberration(wall, OBJECT, PUPIL, AIM, [node])
    # lengths of 2 m carry 2e-16 m each, four of them are taken
    assert found[0] == approx(excess(node) - excess((0.0, 0.0)), abs=3e-15)


@pytest.mark.parametrize("radius", [0.5, 0.07, 0.02, 1e-3])
def test_small_balls_are_mirrors_without_caustics(radius):
    """A ball that is smaller than the distance to the mirror point of its tangent plane."""
    o, c, centre = np.array((0.3, 0.1, 0.8)), np.array((-0.4, 0.05, 0.9)), (0, 0, -radius)
    e1, e2, _ = pupil_frame(-c / np.linalg.norm(c))

    def excess(node):
        p = c + node[0] * e1 + node[1] * e2
        first, second = (end - centre for end in (o, p))
        e = first / np.linalg.norm(first)
        f = second - (second @ e) * e
        f /= np.linalg.norm(f)

        def path(angle):  # in the plane of both ends and the ball's centre
            hit = centre + radius * (math.cos(angle) * e + math.sin(angle) * f)
            return np.linalg.norm(hit - o) + np.linalg.norm(hit - p)

        found = minimize_scalar(
            path, bounds=(0, math.atan2(second @ f, second @ e)), options={"xatol": 1e-10}
        )
        return found.fun - np.linalg.norm(p - o * (1, 1, -1))

    node = (0.009, -0.006)
    found = psf.wall_aberration(ConvexWall(radius), o, c, (0, 0, 0), [node])
    # lengths of 2 m carry 2e-16 m each, four of them are taken
    assert found[0] == approx(excess(node) - excess((0.0, 0.0)), abs=3e-15)


@pytest.mark.parametrize("angle", [0.3, 2.0, -1.1])
@pytest.mark.parametrize("wall", [ConcaveWall(5.0), ConvexWall(2.0), FlatWall()])
def test_turning_the_scene_about_z_changes_nothing(wall, angle):
    turn = np.array(
        [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]]
    )
    nodes, axis = disc(), -np.array(PUPIL) / np.linalg.norm(PUPIL)
    before = psf.wall_aberration(wall, OBJECT, PUPIL, AIM, nodes)
    # the same pupil points in the turned frame's own coordinates
    points = (nodes @ pupil_frame(axis)[:2]) @ turn.T
    turned_nodes = points @ pupil_frame(turn @ axis)[:2].T
    after = psf.wall_aberration(wall, turn @ OBJECT, turn @ PUPIL, AIM, turned_nodes)
    # turning rounds coordinates to 1e-16 m, which a slope of up to 0.1 passes on
    assert after == approx(before, abs=1e-16)


@pytest.mark.parametrize(
    ("wall", "shift"),
    [
        (FlatWall(), (0.21, -0.4, 0.0)),
        (WavyWall(2e-5, 0.3, 0.4), (0.0, 0.37, 0.0)),
        (WavyWall(2e-5, 0.3, 0.4), (0.3, 0.0, 0.0)),
        (ConcaveWall(5.0, shape="cylinder", axis="x"), (0.5, 0.0, 0.0)),
    ],
)
def test_shifts_that_the_wall_allows_change_nothing(wall, shift):
    nodes = disc()
    before = psf.wall_aberration(wall, OBJECT, PUPIL, AIM, nodes)
    moved = [np.add(p, shift) for p in (OBJECT, PUPIL, AIM)]
    after = psf.wall_aberration(wall, *moved, nodes)
    # 1e-9 wave: coordinates of about 1 m are rounded to 1e-16 m
    assert after == approx(before, abs=1e-9 * WAVELENGTH)


def test_a_mesh_of_a_sphere_follows_the_sphere_within_its_residual():
    sphere = ConcaveWall(5.0, size=1.2)
    mesh = MeshWall(sphere.to_mesh(max_sag_error=3e-6))
    nodes = disc()
    exact = psf.wall_aberration(sphere, OBJECT, PUPIL, AIM, nodes)
    found = psf.wall_aberration(mesh, OBJECT, PUPIL, AIM, nodes)
    # a height error counts twice on a reflected path, and W is a difference of two of them
    assert abs(found - exact).max() <= 4 * mesh.fit_residual
    assert mesh.fit_residual < WAVELENGTH / 1000


def test_a_coarse_mesh_is_refused_as_not_wave_grade(flat_scene):
    from dataclasses import replace

    wall = MeshWall(WavyWall(2e-3, 0.2, size=2.0).to_mesh(max_sag_error=1e-4))
    with pytest.raises(NotWaveGradeError, match=r"limit 31\.6 nm \(lambda/20\)"):
        psf.wavefront(replace(flat_scene, wall=wall))


def test_a_sphere_near_its_caustic_is_refused():
    with pytest.raises(CausticError, match="flatter wall"):
        psf.wall_aberration(ConcaveWall(1.0), OBJECT, PUPIL, AIM, disc())


BOWL = CallableWall(
    lambda x, y: (x**2 + y**2) / 2,
    lambda x, y: (x, y),
    hessian=lambda x, y: (1 + 0 * x, 0 * x, 1 + 0 * y),
    max_height=1.0,
    max_curvature=1.0,
)


@pytest.mark.parametrize("wall", [ConcaveWall(1.0), BOWL])
def test_a_pupil_at_the_centre_of_curvature_is_refused(wall):
    """All rays return to it, so that their spreading is infinite."""
    with pytest.raises(CausticError, match="rays to the pupil cross on a caustic"):
        psf.wall_aberration(wall, (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), AIM, [[0.0, 0.0]])


def test_several_images_are_refused():
    with pytest.raises(CausticError, match="more than once"):
        psf.wall_aberration(WavyWall(1e-3, 0.1), OBJECT, PUPIL, AIM, disc())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"object_point": (0.1, 0.0, -1.0)}, r"object_point has z = -1 m, behind the wall"),
        ({"object_point": (math.nan, 0.0, 1.0)}, r"object_point\[x\] = nan is not finite"),
        ({"pupil_centre": (0.0, 0.0, -0.5)}, "pupil has z"),
        ({"pupil_aim": PUPIL}, "pupil_aim equals pupil_centre"),
        ({"nodes": [[0.0, math.inf]]}, "NaN or infinity"),
        ({"nodes": [0.0, 0.0]}, r"shape \(2,\)"),
    ],
)
def test_bad_input(change, message):
    arguments = {"object_point": OBJECT, "pupil_centre": PUPIL, "pupil_aim": AIM, "nodes": [[0, 0]]}
    with pytest.raises(SceneError, match=message):
        psf.wall_aberration(ConcaveWall(5.0), **(arguments | change))


def test_a_wall_that_ends_too_early_is_no_caustic():
    """A height map has no surface beyond its edges; light is reflected 0.2 m from its centre."""
    x = np.linspace(-0.05, 0.05, 21)
    wall = HeightMapWall(np.tile(0.02 * x**2, (21, 1)), pitch=0.005)
    with pytest.raises(CausticError, match="wall ends before .* enlarge it") as caught:
        psf.wall_aberration(wall, (0.8, 0.1, 0.8), (-0.2, 0.05, 0.9), (0, 0, 0), [(0, 0.01)])
    assert "a caustic" not in str(caught.value)
