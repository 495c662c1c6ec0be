"""Wave aberration by aiming, against 50-digit values, closed forms and symmetries."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import CausticError, NotWaveGradeError, SceneError
from nlosoptics.psf.pupil import aiming
from nlosoptics.scene import (
    ConcaveWall,
    ConvexWall,
    FlatWall,
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


def test_light_runs_both_ways():
    """The path is reciprocal: swapping object and pupil point leaves its length."""
    wall = WavyWall(3e-5, 0.3, 0.2)
    forth = psf.path_difference(wall, OBJECT, PUPIL, 0.0)
    back = psf.path_difference(wall, PUPIL, OBJECT, 0.0)
    assert forth == approx(back, abs=2e-16)


def test_a_bump_shortens_the_path():
    """W = -(cos_in + cos_out) h for a raised wall, to first order in h = 1e-7 m."""
    h = 1e-7
    raised = WavyWall(h, 1e3)  # a crest so long that it is a plane at z = h
    o, p = (-0.6, 0.0, 1.0), (0.6, 0.0, 1.0)
    reference = 2 * math.hypot(0.6, 1.0)
    cosine = 1.0 / math.hypot(0.6, 1.0)
    # the second order is h^2/d
    assert psf.path_difference(raised, o, p, reference) == approx(-2 * cosine * h, abs=1e-14)


@pytest.mark.parametrize(
    ("radius", "distance", "height", "expected"),
    [
        (5.0, 1.5, 0.05, -6.802192335846701992e-8),
        (5.0, 1.5, 0.2, -1.728553028186650135e-5),
        (5.0, 5.0, 0.2, 0.0),
    ],
)
def test_spherical_aberration_of_a_sphere(radius, distance, height, expected):
    """|OQ| + |QI| - s - s' with Q at a height h, 1/s + 1/s' = 2/R; 50-digit values."""
    image = 1 / (2 / radius - 1 / distance)
    found = psf.path_difference(
        ConcaveWall(radius),
        (0, 0, distance),
        (0, 0, image),
        distance + image,
        wall_point=(height, 0.0),
    )
    # one rounding of s' = 3.75 m to 4e-16 m enters reference and leg alike and cancels
    assert found == approx(expected, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize(
    ("height", "expected"),
    [
        (0.01, -3.124960939086872865e-10),
        (0.1, -3.121109578094931345e-6),
        (0.25, -1.211404686361889190e-4),
    ],
)
def test_sphere_in_collimated_light(height, expected):
    """-z + sqrt(h^2 + (R/2 - z)^2) - R/2 on a 2 m sphere; 50-digit values."""
    wall = ConcaveWall(2.0)
    z = float(wall.height(height, 0.0))
    # the leg from the plane z = 0 counts -z and the wave front there is flat
    leg = psf.path_difference(
        wall, (height, 0.0, z), (0.0, 0.0, 1.0), 1.0, wall_point=(height, 0.0)
    )
    assert leg - z == approx(expected, rel=1e-12, abs=1e-15)


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


def test_several_images_are_refused():
    with pytest.raises(CausticError, match="more than once"):
        psf.wall_aberration(WavyWall(1e-3, 0.1), OBJECT, PUPIL, AIM, disc())


@pytest.mark.parametrize("part", [0.97, 1.03])
def test_walls_that_are_searched_for_more_images(monkeypatch, part):
    """From 0.8 of the curvature at which a second path may exist; a convex wall has none."""
    searched = []
    monkeypatch.setattr(aiming, "stationary_points", lambda *a: searched.append(a) or iter(()))
    o, p = np.array(OBJECT), np.array(PUPIL)
    radius = 2.0
    for _ in range(9):  # the point of reflection depends on the radius
        searched.clear()
        wall = ConvexWall(radius)
        hit = aiming.aim(wall, o, p[None], -p / np.linalg.norm(p)).points[0]
        d1, d2 = np.linalg.norm(hit - o), np.linalg.norm(hit - p)
        cosines = o[2] / d1, p[2] / d2
        least = cosines[0] ** 2 / d1 + cosines[1] ** 2 / d2
        radius = wall.max_curvature * radius * sum(cosines) / (0.8 * part * least)
    assert bool(searched) == (part > 1)


def test_starts_of_a_search_for_more_images(monkeypatch):
    """An even square about the known path: as far as slopes of the wall can send light, four
    starts for each half period."""
    searched = []
    monkeypatch.setattr(aiming, "stationary_points", lambda *a: searched.append(a) or iter(()))
    o, p = np.array(OBJECT), np.array(PUPIL)
    for wall in (WavyWall(3e-3, 0.3), WavyWall(2e-4, 0.08), WavyWall(0.05, 1.2)):
        searched.clear()
        nodes = np.stack([p, np.add(p, (0.0, 0.01, 0.0))])
        found = aiming.aim(wall, o, nodes, -p / np.linalg.norm(p)).points
        d1, d2 = np.linalg.norm(found[0] - o), np.linalg.norm(found[0] - p)
        period = wall.finest_period
        slope = wall.max_curvature * period / (2 * math.pi)
        reach = 2 * math.hypot(*(o - p)[:2]) + o[2] + p[2]
        reach = min(reach, 4 * slope * d1 * d2 / (d1 + d2) + 2 * period)
        count = int(min(129, max(9, 2 * math.ceil(4 * reach / period) + 1)))
        assert len(searched) == 2
        for (_, _, node, starts, side), end, hit in zip(searched, nodes, found, strict=True):
            assert side == 1
            assert node == approx(end)
            line = np.linspace(-reach, reach, count)
            x, y = np.meshgrid(line, line)
            assert starts == approx(np.stack([x + hit[0], y + hit[1]], -1).reshape(-1, 2), abs=1e-9)


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
