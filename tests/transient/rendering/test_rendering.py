"""Three bounces against brute force, closed forms, an independent renderer, and invariants."""

from __future__ import annotations

import json
import math
import os
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import trimesh

from nlosoptics import scene
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.transient import Scan, Volume, phasor_image, render, wall_grid

from .three_bounce_quadrature import brute_force

WHITE = scene.Lambert(1.0)
LASER = (0.13, -0.07, 0.0)
SENSORS = np.array([[-0.6, 0.45, 0.0], [0.31, -0.22, 0.0]])
BINS = {"t_start": 1.5, "delta_t": 0.01, "n_bins": 250}


def mesh(corners, faces):
    return trimesh.Trimesh(np.array(corners, float), faces, process=False)


def plate(width=0.5, height=0.5, centre=(0.0, 0.0, 1.0), turn=0.0):
    """A rectangle turned about y, rad."""
    x, y = np.array([-1, 1, 1, -1]) * width / 2, np.array([-1, -1, 1, 1]) * height / 2
    corners = np.stack([x * math.cos(turn), y, x * math.sin(turn)], axis=1) + centre
    return mesh(corners, [[0, 1, 2], [0, 2, 3]])


def letter():
    """A letter Z of 0.7 m by 0.8 m at 1 m, in six triangles."""
    x, y, s, c = 0.35, 0.4, 0.24, 0.15
    outline = [(-x, y), (x, y), (x, s), (-x, s), (-x, -s), (x, -s), (x, -y), (-x, -y)]
    stroke = [(x, s), (x - c - 0.1, s), (-x, -s), (-x + c + 0.1, -s)]
    corners = [(*p, 1.0) for p in outline + stroke]
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7], [8, 9, 10], [8, 10, 11]]
    return mesh(corners, faces)


def light(surfaces, **changes):
    given = {
        "laser_points": LASER,
        "sensor_points": SENSORS,
        "max_bounces": 3,
        **BINS,
    }
    options = {**given, **changes}
    names = {field.name for field in fields(Scan)}
    scan = {name: options.pop(name) for name in list(options) if name in names}
    return render(surfaces, Scan(**scan), **options)


def edges(capture):
    return capture.edges


def relative(found, true):
    return np.abs(found - true).sum(axis=0) / true.sum(axis=0)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("thing", "n"),
    [
        (plate(), 800),
        (plate(0.3, 0.2, (0.6, -0.3, 0.7), 0.2), 700),
        (letter(), 500),
    ],
    ids=["plate", "off-axis patch", "letter"],
)
def test_brute_force(thing, n):
    found = light([(thing, WHITE)])
    true = np.stack(
        [brute_force([(thing, WHITE)], LASER, s, found.edges, n) for s in SENSORS], axis=1
    )
    # tol = 1e-3 and the grid's own noise, some 3e-4
    assert relative(found.H, true).max() < 1e-3
    # the grid's error falls as 1/n^2, below 1e-5
    assert found.H.sum(axis=0) == pytest.approx(true.sum(axis=0), rel=1e-4)
    assert (found.details["error_estimate"] <= 1e-3 * found.H.sum(axis=0)).all()


@pytest.mark.parametrize(
    "material",
    [
        scene.OrenNayar(0.8, 0.4),
        scene.OrenNayar(0.8, 0.4, model="full"),
        scene.Ward(0.7, 0.4),
        scene.Ward(0.7, 0.15, variant="bounded"),
        scene.SpecularMicrofacet(0.9, 0.15, distribution="ggx"),
        scene.SumMaterial((scene.Lambert(0.3), scene.SpecularMicrofacet(0.5, 0.05))),
    ],
    ids=str,
)
def test_materials(material):
    thing = plate(0.4, 0.3, (0.1, 0.1, 0.9), 0.2)
    found = light([(thing, material)])
    true = np.stack(
        [brute_force([(thing, material)], LASER, s, found.edges, 700) for s in SENSORS], axis=1
    )
    # tol = 1e-3 and the grid's noise, some 5e-4
    assert relative(found.H, true).max() < 2e-3
    assert found.H.sum(axis=0) == pytest.approx(true.sum(axis=0), rel=2e-4)


@pytest.mark.thorough
@pytest.mark.parametrize("case", ["plate before plate", "ball before plate", "dent"])
def test_shadows(case):
    """Polygons cut by shadows against a line of sight for every point of a grid."""
    back = plate(1.6, 1.6, (0.0, 0.0, 1.6))
    if case == "plate before plate":
        things, n = [plate(0.4, 0.3, (0.1, 0.1, 0.9), 0.4), back], 400
    elif case == "ball before plate":
        ball = trimesh.creation.icosphere(subdivisions=2, radius=0.25)
        ball.apply_translation((0.1, 0.05, 0.9))
        things, n = [ball, back], 40
    else:
        roof = [(-0.4, 0, 0.8), (0, -0.4, 0.8), (0.4, 0, 0.8), (0, 0.4, 0.8), (0.05, 0, 1.5)]
        things, n = [mesh(roof, [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])], 500
    surfaces = [(thing, scene.Lambert(0.5)) for thing in things]
    both = trimesh.util.concatenate(things)
    found = light(surfaces, n_bins=60, delta_t=0.05)
    dense = [(s[0], s[1]) for s in surfaces]
    true = np.zeros_like(found.H)
    for thing, material in dense:
        fine = n if case != "ball before plate" or thing is not back else 400
        for k, s in enumerate(SENSORS):
            true[:, k] += brute_force(
                [(thing, material)], LASER, s, found.edges, fine, shadows=both
            )
    free = sum(
        brute_force([(thing, m)], LASER, SENSORS[0], found.edges, 60) for thing, m in surfaces
    )
    assert found.details["shadows"]
    assert free.sum() > 1.03 * found.H[:, 0].sum()  # so that shadows matter
    # a grid of pitch h knows a shadow's edge to h^1.5: 1e-3
    assert relative(found.H, true).max() < 5e-3
    assert found.H.sum(axis=0) == pytest.approx(true.sum(axis=0), rel=2e-3)


def test_shadow_of_a_whole_plate():
    """What a plate hides from the laser gives nothing; what stands beside it gives all."""
    front, back = plate(1.0, 1.0, (0, 0, 0.8)), plate(0.3, 0.3, (0, 0, 1.2))
    points = {"laser_points": (0.02, 0.01, 0.0), "sensor_points": (0.9, 0.9, 0.0)}
    alone = light([(front, WHITE)], **points)
    both = light([(front, WHITE), (back, WHITE)], **points)
    assert np.array_equal(alone.H, both.H)
    aside = light([(plate(0.3, 0.3, (-0.9, 0, 0.8)), WHITE), (back, WHITE)], **points)
    apart = [
        light([(plate(0.3, 0.3, (-0.9, 0, 0.8)), WHITE)], **points).H,
        light([(back, WHITE)], **points).H,
    ]
    # three quadratures of tol = 1e-3
    assert np.abs(aside.H - apart[0] - apart[1]).sum() < 2e-3 * aside.H.sum()


def test_infinite_plane_confocal():
    """Bins of ``[(2z/t0)^6 - (2z/t1)^6]/(3 pi z^2)``: Int z^4/(pi^2 r^8) dA over a plane."""
    z = 0.8
    wide = plate(60.0, 60.0, (0.0, 0.0, z))
    found = light(
        [(wide, WHITE)], laser_points=(0.2, 0.1, 0), sensor_points=(0.2, 0.1, 0), tol=1e-5
    )
    t = np.maximum(found.edges, 2 * z)
    true = ((2 * z / t[:-1]) ** 6 - (2 * z / t[1:]) ** 6) / (3 * math.pi * z**2)
    assert np.abs(found.H - true).sum() < 2e-5 * true.sum()  # tol
    whole = found.H.sum() + found.details["after"]
    # (z/30 m)^6 = 4e-10 lies beyond the plate
    assert whole == pytest.approx(1 / (3 * math.pi * z**2), rel=1e-5)


@pytest.mark.parametrize("b", [0.5, 2.0])
def test_infinite_plane_total(b):
    """``(2 z^4/pi) Int_0^1 s(1-s)/(z^2 + s(1-s) b^2)^3 ds`` by Feynman parameters."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    s = (nodes + 1) / 2
    q = s * (1 - s)
    true = (2 / math.pi) * (weights / 2 * q / (1 + q * b**2) ** 3).sum()
    wide = plate(80.0, 80.0)
    found = light(
        [(wide, WHITE)],
        laser_points=(0, 0, 0),
        sensor_points=(0.6 * b, 0.8 * b, 0),
        delta_t=1.0,
        n_bins=200,
        tol=1e-5,
    )
    assert found.H.sum() == pytest.approx(true, rel=1e-5)  # tol; (1/40 m)^6 lies beyond


def test_small_patch():
    """``G/dA = z^4/(pi^2 r1^4 r2^4)`` of a patch parallel to the wall."""
    side, at = 1e-4, np.array([0.4, 0.2, 0.8])
    laser, sensor = np.array([0.1, -0.2, 0.0]), np.array([0.3, 0.4, 0.0])
    found = light(
        [(plate(side, side, at), WHITE)], laser_points=laser, sensor_points=sensor, delta_t=0.1
    )
    r1, r2 = np.linalg.norm(at - laser), np.linalg.norm(at - sensor)
    # the patch's own size, (1e-4 m)^2 against r^2
    assert found.H.sum() == pytest.approx(
        side**2 * at[2] ** 4 / (math.pi**2 * (r1 * r2) ** 4), rel=1e-7
    )


@pytest.mark.parametrize("side", [-0.1, 0.1])
def test_patch_beside_a_bin_edge(side):
    width, edge = 0.01, 40
    at = np.array([0.1, 0.0, 0.9])
    path = np.linalg.norm(at - LASER) + np.linalg.norm(at - SENSORS[0])
    start = path - (edge + side) * width
    found = light(
        [(plate(1e-4, 1e-4, at), WHITE)],
        sensor_points=SENSORS[0],
        t_start=start,
        delta_t=width,
        n_bins=80,
    )
    assert np.flatnonzero(found.H).tolist() == [edge if side > 0 else edge - 1]


def test_reciprocity():
    box = trimesh.creation.box((0.3, 0.3, 0.3))
    box.apply_translation((0.1, 0.0, 0.8))
    surfaces = [
        (box, scene.Ward(0.5, 0.3)),
        (plate(1.0, 1.0, (0, 0, 1.4)), scene.OrenNayar(0.8, 0.3)),
    ]
    there = light(surfaces, laser_points=SENSORS[0], sensor_points=LASER)
    back = light(surfaces, laser_points=LASER, sensor_points=SENSORS[0])
    assert there.H == pytest.approx(back.H, rel=1e-14, abs=1e-16 * back.H.max())


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_room_that_is_turned_has_the_same_light(turns):
    """By quarter turns about z; points differ along one axis or both, seen past a box."""

    def turned(points):
        x, y, z = np.moveaxis(np.array(points, float), -1, 0)
        for _ in range(turns):
            x, y = -y, x
        return np.stack([x, y, z], axis=-1)

    box = trimesh.creation.box((0.3, 0.2, 0.3)).apply_translation((0.15, 0.05, 0.8))
    wall = plate(1.0, 1.0, (0, 0, 1.4))
    sensors = np.array([[0.0, 0, 0], [0.4, 0, 0], [0, 0.4, 0], [0.4, 0.4, 0]])
    there = light([(box, WHITE), (wall, WHITE)], laser_points=(0, 0, 0), sensor_points=sensors)
    surfaces = [(mesh(turned(one.vertices), one.faces), WHITE) for one in (box, wall)]
    here = light(surfaces, laser_points=(0, 0, 0), sensor_points=turned(sensors))
    # the parts of the surface may be bisected otherwise, to the default tol of 1e-3
    assert (relative(here.H, there.H) < 2e-3).all()


def test_threads_change_no_bit(on_threads):
    surfaces = [(letter(), WHITE), (plate(1.5, 1.5, (0, 0, 1.5)), WHITE)]
    grid = wall_grid(1.0, 3)
    one, two = (on_threads(n, lambda: light(surfaces, sensor_points=grid)) for n in (1, 2))
    assert np.array_equal(one.H, two.H)


def test_error_falls_faster_than_the_parts_rise():
    surfaces = [(letter(), WHITE)]
    true = light(surfaces, tol=1e-5)
    loose, strict = light(surfaces, tol=1e-2), light(surfaces, tol=1e-4)
    errors = [relative(c.H, true.H).max() for c in (loose, strict)]
    parts = [c.details["parts"].mean() for c in (loose, strict)]
    assert errors[0] < 1e-2
    assert errors[1] < 1e-4
    # second order in the size of a part is 1/parts; the means make it a higher one
    assert math.log(errors[0] / errors[1]) / math.log(parts[1] / parts[0]) > 1.2


def test_light_outside_the_bins_is_told():
    surfaces = [(letter(), WHITE)]
    whole = light(surfaces, sensor_points=SENSORS[0], tol=1e-5)
    part = light(surfaces, sensor_points=SENSORS[0], tol=1e-5, t_start=2.25, n_bins=10)
    details = part.details
    assert details["before"] > 0.0
    assert details["after"] > 0.0
    told = part.H.sum(axis=0) + details["before"] + details["after"]
    assert told == pytest.approx(whole.H.sum(axis=0), rel=1e-5)  # tol
    assert part.H == pytest.approx(whole.H[75:85], rel=1e-3)  # a bin is a hundredth of all


def test_quantities_and_legs():
    surfaces = [(plate(), scene.Lambert(0.5))]
    base = light(surfaces)
    half = light(surfaces, wall_albedo=0.5)
    assert half.H == pytest.approx(0.5 * base.H)
    radiance = light(surfaces, wall_albedo=0.5, quantity="radiance")
    assert radiance.H == pytest.approx(0.5 / math.pi * half.H)
    radiosity = light(surfaces, wall_albedo=0.5, quantity="radiosity")
    assert radiosity.H == pytest.approx(0.5 * half.H)
    origin = (-0.5, 0.0, 0.25)
    leg = math.dist(origin, LASER)
    eye = (0.2, 0.3, 1.1)
    shift = leg + math.dist(eye, SENSORS[0])
    far = light(
        surfaces,
        sensor_points=SENSORS[0],
        outer_legs=True,
        laser_origin=origin,
        sensor_origin=eye,
        t_start=BINS["t_start"] + shift,
    )
    assert far.outer_legs
    assert far.H == pytest.approx(base.H[:, 0], abs=1e-9 * base.H.max())


def test_pairs():
    grid = wall_grid(1.0, 2)
    surfaces = [(letter(), WHITE)]
    every = light(surfaces, laser_points=grid, sensor_points=grid)
    assert every.H.shape == (250, 2, 2, 2, 2)
    own = light(surfaces, laser_points=grid, sensor_points=grid, pairing="confocal")
    assert own.H.shape == (250, 2, 2)
    assert np.array_equal(own.H[:, 1, 0], every.H[:, 1, 0, 1, 0])
    assert np.array_equal(every.by_bounce[3], every.H)
    assert not every.standard_error.any()


@pytest.mark.parametrize("pairing", ["all", "confocal"])
def test_what_a_point_sees_is_kept_for_all_that_see_by_it(pairing):
    """Shadows of many pairs at once are those of each pair alone."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.25)
    ball.apply_translation((0.1, 0.05, 0.9))
    surfaces = [(ball, WHITE), (plate(1.6, 1.6, (0.0, 0.0, 1.6)), WHITE)]
    lasers = wall_grid(1.2, 3)
    sensors = lasers if pairing == "confocal" else SENSORS
    every = light(surfaces, laser_points=lasers, sensor_points=sensors, pairing=pairing)
    assert every.details["shadows"]
    for i, j in np.ndindex(3, 3):
        for k, sensor in enumerate([lasers[i, j]] if pairing == "confocal" else SENSORS):
            one = light(surfaces, laser_points=lasers[i, j], sensor_points=sensor)
            found = every.H[:, i, j] if pairing == "confocal" else every.H[:, i, j, k]
            # the other point's shadows may be cut out first: two quadratures of tol = 1e-3
            assert found.sum() == pytest.approx(one.H.sum(), rel=1e-5)
            assert np.abs(found - one.H.ravel()).sum() < 2e-3 * found.sum()


def test_both_sides_scatter_alike():
    one, other = plate(), plate()
    other.faces = other.faces[:, ::-1]
    assert light([(one, WHITE)]).H == pytest.approx(light([(other, WHITE)]).H, rel=1e-12)


def test_a_tilted_wall_is_that_of_brute_force():
    """Within 1 % of a sum in world coordinates; a phasor field finds the plate where it is."""
    turn = trimesh.transformations.rotation_matrix(0.4, (0.3, 1.0, 0.2))[:3, :3]
    grid = wall_grid(1.0, 8) @ turn.T + (0.1, 0.2, -0.3)
    normal = turn @ (0.0, 0.0, 2.0)
    target = plate(0.2, 0.2, grid.mean(axis=(0, 1)) + 0.4 * normal, -0.1)
    outer = {"laser_origin": (0.2, -0.3, 1.0), "sensor_origin": (0.0, 0.5, 0.9)}
    bins = {"t_start": 1.5, "delta_t": 0.02, "n_bins": 200}
    points = {"laser_points": grid[4, 4], "sensor_points": grid, "wall_normal": normal}
    capture = light([(target, WHITE)], **bins, **points)
    for i, j in ((0, 0), (7, 2)):
        true = brute_force(
            [(target, WHITE)], grid[4, 4], grid[i, j], capture.edges, 600, wall_normal=normal / 2.0
        )
        assert relative(capture.H[:, i, j], true) < 0.01
    ends = zip((grid[4, 4], grid), outer.values(), strict=True)
    legs = sum(np.linalg.norm(p - o, axis=-1) for p, o in ends)
    late = light([(target, WHITE)], outer_legs=True, **outer, **bins, **points)
    shift = ((late.H - capture.H) * capture.times[:, None, None]).sum(axis=0)
    assert shift / capture.H.sum(axis=0) == pytest.approx(legs, abs=0.01)
    capture = light([(target, WHITE)], **bins | {"t_start": 1.0, "n_bins": 120}, **points)
    volume = Volume.box(target.centroid, (0.6, 0.6, 0.4), 0.05)
    image = phasor_image(capture, volume, wl_mean=0.25, method="direct")
    where = np.unravel_index(image.intensity.argmax(), volume.shape)
    assert volume.points[where] == pytest.approx(target.centroid, abs=0.06)
    with pytest.raises(SceneError, match="off the plane of the first laser point"):
        light([(target, WHITE)], **bins, **points | {"laser_points": grid[4, 4] + 0.1})
    behind = outer | {"laser_origin": (0.0, 0.0, -2.0), "outer_legs": True}
    with pytest.raises(SceneError, match="height of laser_origin over the wall = -"):
        light([(target, WHITE)], **bins, **points, **behind)


def test_progress_ends_at_one():
    told = []
    light([(letter(), WHITE)], progress=lambda text, share: told.append((share, text)))
    assert told[-1] == (1.0, "three bounces: 2 of 2 pairs of points")


def with_nan():
    thing = plate()
    thing.vertices[1, 0] = math.nan
    return thing


@pytest.mark.parametrize(
    ("surfaces", "changes", "kind", "words"),
    [
        ([], {}, SceneError, "at least one"),
        ([plate()], {}, SceneError, "pairs"),
        ([(plate(), 0.5)], {}, SceneError, "material float"),
        ([("plate", WHITE)], {}, SceneError, r"surfaces\[0\] of type str holds no triangles"),
        ([(mesh([[0, 0, 1]], np.zeros((0, 3), int)), WHITE)], {}, SceneError, "no triangles"),
        ([(with_nan(), WHITE)], {}, SceneError, "NaN or infinite"),
        ([(mesh([[0, 0, 1], [1, 0, 1], [2, 0, 1]], [[0, 1, 2]]), WHITE)], {}, SceneError, "area"),
        ([(plate(centre=(0, 0, -1)), WHITE)], {}, SceneError, "behind the wall, to z = -1 m"),
        ([(plate(centre=(0, 0, 0)), WHITE)], {}, SceneError, "lies in the wall"),
        (
            [(plate(1.0, 1.0, (0.5, 0, 0.5), math.pi / 2), WHITE)],
            {"laser_points": (0.5, 0.1, 0)},
            SceneError,
            r"wall point \(0.5, 0.1\)",
        ),
        (
            [(plate(0.5, 0.5, (0.3, 0, 0.5), math.pi / 2), WHITE)],
            {"laser_points": (0.3, 0.1, 0), "sensor_points": (0.3, -0.5, 0)},
            SceneError,
            "edge-on",
        ),
        ([(plate(), scene.SpecularMicrofacet(1.0, 0.0))], {}, SceneError, "mirror"),
        ([(plate(), WHITE)], {"laser_points": (0, 0, 0.1)}, SceneError, "off the wall"),
        ([(plate(), WHITE)], {"sensor_points": (0, math.nan, 0)}, SceneError, "not finite"),
        ([(plate(), WHITE)], {"sensor_points": np.zeros((2, 2))}, SamplingError, r"\(2, 2\)"),
        ([(plate(), WHITE)], {"pairing": "confocal"}, SamplingError, "not pairs"),
        ([(plate(), WHITE)], {"t_start": 5.0}, SamplingError, "arrives before them"),
        ([(plate(), WHITE)], {"t_start": 0.0, "n_bins": 5}, SamplingError, "arrives after them"),
        ([(plate(), WHITE)], {"delta_t": 0.0}, SceneError, "delta_t"),
        ([(plate(), WHITE)], {"n_bins": 0}, SceneError, "n_bins"),
        ([(plate(), WHITE)], {"tol": 0.0}, SceneError, "tol"),
        ([(plate(), WHITE)], {"max_bounces": 2}, SceneError, "max_bounces"),
        ([(plate(), WHITE)], {"tol_multiple": -5.0}, SceneError, "tol_multiple"),
        ([(plate(), WHITE)], {"n_rays": 0}, SceneError, "n_rays"),
        ([(plate(), WHITE)], {"wall_size": -1.0}, SceneError, "wall_size"),
        ([(plate(), WHITE)], {"seed": 2**64}, SceneError, "seed"),
        ([(plate(), WHITE)], {"quantity": "counts"}, SceneError, "counts"),
        ([(plate(), WHITE)], {"wall_albedo": 1.5}, SceneError, "wall_albedo"),
        (
            [(plate(), WHITE)],
            {"outer_legs": True, "laser_origin": (0, 0, 1)},
            SceneError,
            "sensor_origin",
        ),
    ],
)
def test_one_clear_line(surfaces, changes, kind, words):
    with pytest.raises(kind, match=words) as raised:
        light(surfaces, **changes)
    assert "\n" not in str(raised.value)


@pytest.mark.thorough
def test_a_wall_may_touch_the_relay_wall():
    """A floor from the wall into the room: no bound is met where no point lies on it."""
    floor = mesh([[-1, -1, 0], [1, -1, 0], [1, -1, 3], [-1, -1, 3]], [[0, 1, 2], [0, 2, 3]])
    sensor = (0.1, -0.9, 0.0)
    found = light([(floor, WHITE)], sensor_points=sensor, t_start=0.9, n_bins=700)
    true = brute_force([(floor, WHITE)], LASER, sensor, found.edges, 1500)
    # tol = 1e-3 and the grid's noise where light is dense, near the wall
    assert relative(found.H, true).max() < 4e-3
    assert found.H.sum() == pytest.approx(true.sum(), rel=2e-4)  # the grid's


def peer(name):
    folder = os.environ.get("NLOSOPTICS_DATA")
    if not folder or not (Path(folder) / "peer_transient").is_dir():
        pytest.skip("NLOSOPTICS_DATA has no peer_transient")
    path = Path(folder) / "peer_transient"
    with np.load(path / f"{name}.npz") as file:
        return np.moveaxis(file["H"].astype(float), 2, 0), json.loads(str(file["meta"])), path


def lamp(meta, points):
    """Irradiance of wall points by the peer's lamp of 100 W/sr."""
    lines = points - np.array(meta["sensor_origin"])
    return 100.0 * meta["sensor_origin"][2] / np.linalg.norm(lines, axis=-1) ** 3


@pytest.mark.thorough
@pytest.mark.parametrize(
    "name", ["plane_single16_3b", "Z_single16_3b", "Z_single32_3b", "Z_confocal16_3b"]
)
def test_peer_transient(name):
    """An independent path tracer: absolute scale, totals and bins within its own noise."""
    H, meta, path = peer(name)
    surfaces = [(trimesh.load(path / "meshes" / k, process=False), WHITE) for k in meta["hidden"]]
    grid = wall_grid(2.0, meta["n"])
    found = render(
        surfaces,
        Scan(
            laser_points=grid if meta["capture"] == "confocal" else (0, 0, 0),
            sensor_points=grid,
            pairing="confocal" if meta["capture"] == "confocal" else "all",
            t_start=meta["start_opl_m"],
            delta_t=meta["bin_width_opl_m"],
            n_bins=meta["bins"],
        ),
        max_bounces=3,
        quantity="radiosity",
    )
    true = lamp(meta, found.laser_points) * found.H
    off = H.sum(axis=0) / true.sum(axis=0) - 1.0
    # 0.6 % per pixel, the peer's noise
    assert math.sqrt((off**2).mean()) < 6e-3
    assert abs(off.mean()) < 1.5e-3
    filled = true > 0.05 * true.max()
    # 3 % where bins are well filled; the 32 x 32 file has half as many samples per pixel
    limit = 0.03 if meta["spp"] >= 40000 else 0.03 * math.sqrt(2)
    assert np.abs(H - true)[filled].sum() < limit * true[filled].sum()


def test_peer_corridor():
    """Walls, floor and shadows of the peer's corridor; it counts the letter twice.

    It aims at points of the walls behind the letter too, and takes the letter's light for theirs.
    Least squares of its capture in our parts gives 2.007 for the letter and 1.000 for the rest.
    """
    H, meta, path = peer("Zbox_single16_3b")
    z = (trimesh.load(path / "meshes" / meta["hidden"][0], process=False), scene.Lambert(0.8))
    walls = [
        (trimesh.load(path / "meshes" / f"{k}.obj", process=False), scene.Lambert(0.6))
        for k in meta["extra"]
    ]
    scan = Scan(
        laser_points=(0, 0, 0),
        sensor_points=wall_grid(2.0, 16),
        t_start=0.0,
        delta_t=0.01,
        n_bins=800,
    )
    options = {"max_bounces": 3, "quantity": "radiosity", "tol": 1e-2}
    power = lamp(meta, np.zeros(3))
    letter_alone = power * render([z], scan, **options).H
    rest = power * render([z, *walls], scan, **options).H - letter_alone
    shares = np.linalg.lstsq(np.stack([letter_alone.ravel(), rest.ravel()], 1), H.ravel())[0]
    # the peer's noise in 205 000 bins, some of it in fireflies
    assert shares[1] == pytest.approx(1.0, abs=0.01)
    assert shares[0] == pytest.approx(2.0, abs=0.02)
    first = np.flatnonzero(H.sum(axis=(1, 2)))[0]
    assert np.flatnonzero((rest + letter_alone).sum(axis=(1, 2)))[0] == pytest.approx(first, abs=1)
