"""Four and more bounces against quadrature, closed forms, analog walks and a peer's captures."""

from __future__ import annotations

import itertools
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from nlosoptics import transient
from nlosoptics._random import scrambled_sobol
from nlosoptics.errors import MemoryLimitError, SamplingError, SceneError
from nlosoptics.raytrace import intersect_mesh, occluded
from nlosoptics.raytrace.intersection import meshes
from nlosoptics.scene import Lambert, OrenNayar, SpecularMicrofacet, SumMaterial, Ward
from nlosoptics.transient.rendering import _bounce_kernels as kernels
from nlosoptics.transient.rendering import batches
from nlosoptics.transient.rendering import multiple_bounces as multiple_module
from nlosoptics.transient.rendering.multiple_bounces import multiple_bounces
from nlosoptics.transient.rendering.surfaces import bounce_surfaces, hidden_surfaces

pytestmark = pytest.mark.thorough  # they compile kernels that few scenes need


def quad(corner, first, second):
    """A parallelogram as a mesh, its front along first x second."""
    a, u, v = (np.asarray(x, dtype=np.float64) for x in (corner, first, second))
    return trimesh.Trimesh([a, a + u, a + u + v, a + v], [[0, 1, 2], [0, 2, 3]], process=False)


FLOOR = ([-0.3, -0.5, 0.5], [0.6, 0.0, 0.0], [0.0, 0.0, 0.5])
CEILING = ([-0.2, 0.4, 0.6], [0.5, 0.0, 0.0], [0.0, 0.1, 0.5])
LASER, SENSOR = np.array([0.1, 0.0, 0.0]), np.array([-0.2, 0.15, 0.0])


def by_quadrature(materials, edges):
    """Four bounces between FLOOR and CEILING: the double surface integral by Gauss-Legendre."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    nodes, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    s, t = (a.ravel() for a in np.meshgrid(nodes, nodes))
    share = np.outer(weights, weights).ravel()
    plates = []
    for corner, first, second in (FLOOR, CEILING):
        across = np.cross(first, second)
        points = np.array(corner) + s[:, None] * np.array(first) + t[:, None] * np.array(second)
        size = np.sqrt(across @ across)
        plates.append((points, across / size, share * size))
    bins = np.zeros(len(edges) - 1)
    up = np.array([0.0, 0.0, 1.0])

    def unit(a, b):
        line = b - a
        r = np.sqrt((line * line).sum(axis=-1))
        return line / r[..., None], r

    for i, j in ((0, 1), (1, 0)):
        (p, n, da), (q, m, db) = plates[i], plates[j]
        d1, r1 = unit(LASER, p)
        d2, r2 = unit(p[:, None], q[None])
        d3, r3 = unit(q, SENSOR)
        # both sides scatter: normals toward where the light comes from
        n = n * -np.sign(d1[0] @ n)
        m = m * -np.sign(d2[0, 0] @ m)
        f = materials[i].evaluate(-d1[:, None], d2, n) * materials[j].evaluate(-d2, d3, m)
        light = f * (d1 @ up * -(d1 @ n) / r1**2 * da)[:, None]
        light = light * (d2 @ n) * -(d2 @ m) / r2**2 * (d3 @ m * -(d3 @ up) / r3**2 * db)
        length = r1[:, None] + r2 + r3
        bins += np.histogram(length, edges, weights=np.maximum(light, 0.0) / np.pi)[0]
    return bins


@pytest.mark.thorough
@pytest.mark.parametrize(
    "materials",
    [
        (Lambert(0.8), Lambert(0.5)),
        (Ward(0.7, 0.4), Lambert(0.5)),
        (Ward(0.6, 0.5, variant="bounded"), Ward(0.8, 0.3, variant="duer")),
        (OrenNayar(0.8, 0.3), OrenNayar(0.5, 0.4, model="full")),
        (SpecularMicrofacet(0.9, 0.25), SpecularMicrofacet(0.9, 0.3, distribution="ggx")),
        (SumMaterial(Lambert(0.4), Ward(0.4, 0.3)), Lambert(0.6)),
    ],
    ids=["lambert", "ward", "wards", "oren-nayar", "microfacets", "sum"],
)
def test_four_bounces_between_plates_are_the_double_integral(materials):
    hidden = hidden_surfaces(
        [(quad(*place), m) for place, m in zip((FLOOR, CEILING), materials, strict=True)]
    )
    edges = 1.0 + 0.25 * np.arange(13)
    found = multiple_bounces(
        hidden,
        LASER,
        SENSOR,
        starts=1.0,
        delta_t=0.25,
        n_bins=12,
        orders=(4,),
        tol=None,
        n_rays=1 << 18,
    )
    wanted = by_quadrature(materials, edges)
    light, error = found.by_bounce[4], found.standard_error[4]
    total = light.sum()
    # bins' errors are about independent; the plates' narrow lobes are the noisiest
    noise = np.sqrt((error**2).sum())
    assert noise < 0.02 * total
    assert total == pytest.approx(wanted.sum(), abs=4.0 * noise + 1e-3 * total)
    # quadrature nodes at the bins' edges are worth up to 2 % of the whole
    assert np.abs(light - wanted).sum() < 0.04 * total


def hollow_sphere(subdivisions, hole):
    """A sphere of radius 1 m that touches the wall at the origin, without its lowest faces."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)] + [0.0, 0.0, 1.0]
    corners = corners[corners[..., 2].max(axis=1) > hole]
    mesh = trimesh.Trimesh(
        corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3), process=False
    )
    return mesh, float(mesh.area)


# Shadows by kernels, and by embree. Each leg between facets, whose middles are nearer than the
# sphere, brings 0.8 % and 0.05 % more.
@pytest.mark.thorough
@pytest.mark.parametrize(("subdivisions", "facets"), [(3, 0.008), (5, 0.0005)])
def test_every_bounce_in_a_sphere_is_worth_its_albedo(subdivisions, facets):
    mesh, area = hollow_sphere(subdivisions, 0.05)
    albedo = 0.7
    found = multiple_bounces(
        hidden_surfaces([(mesh, Lambert(albedo))]),
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0],
        delta_t=0.05,
        n_bins=200,
        orders=(4, 5, 6),
        tol=None,
        n_rays=1 << 15,
    )
    # cos cos/(pi r^2) is 1/4 pi between any two points of the sphere, and light leaves by the hole
    share = area / (4.0 * np.pi)
    times = 0.05 * (np.arange(200) + 0.5)
    for order in (4, 5, 6):
        light = found.by_bounce[order]
        wanted = (albedo * share) ** (order - 2) / (4.0 * np.pi)
        # and noise of 0.3 %
        assert light.sum() == pytest.approx(wanted, rel=facets * (order - 1) + 0.006)
        # independent points on the sphere: chords of 4/3 m on average; the hole takes short ones
        mean = (light * times).sum() / light.sum()
        assert mean == pytest.approx((order - 1) * 4.0 / 3.0, rel=0.015)


CORRIDOR = [
    (quad([-0.5, -0.5, 0.0], [0.0, 0.0, 1.2], [1.0, 0.0, 0.0]), Lambert(0.6)),
    (quad([-0.5, 0.5, 0.0], [0.0, 0.0, 1.2], [1.0, 0.0, 0.0]), OrenNayar(0.7, 0.3)),
    (quad([-0.5, -0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.2]), Lambert(0.5)),
    (quad([0.5, -0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.2]), Ward(0.8, 0.6)),
    (quad([-0.5, -0.5, 1.2], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]), Lambert(0.6)),
    (quad([-0.2, -0.15, 0.5], [0.3, 0.0, 0.1], [0.0, 0.35, 0.0]), Lambert(0.9)),
]
POINTS = np.array([[[-0.3, -0.25, 0.0], [0.1, 0.2, 0.0]], [[0.35, 0.0, 0.0], [-0.05, -0.35, 0.0]]])


def analog(laser, sensors, n, edges, seed):
    """Walks from the laser's spot along the lobes, joined to sensors: orders 4 and 5, by groups."""
    wall = quad([-0.5, -0.5, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    things = [*CORRIDOR, (wall, Lambert(0.8))]
    together = trimesh.util.concatenate([mesh for mesh, _ in things])
    hidden = trimesh.util.concatenate([mesh for mesh, _ in CORRIDOR])
    owner = np.repeat(np.arange(len(things)), 2)
    draw = np.random.default_rng(seed)
    o, normal = np.tile(laser, (n, 1)), np.tile([0.0, 0.0, 1.0], (n, 1))
    power, length, group = np.ones(n), np.zeros(n), np.arange(n) % 16
    d, _ = Lambert(1.0).sample(normal, normal, draw.random((n, 3)))
    sums = {k: np.zeros((16, len(edges) - 1, len(sensors))) for k in (3, 4, 5)}
    for order in (3, 4, 5):
        hits = intersect_mesh(together, o, d, min_distance=1e-9)
        met = hits.triangle >= 0
        o, d, normal = hits.points[met], d[met], hits.normals[met]
        power, group = power[met], group[met]
        length, what = length[met] + hits.distance[met], owner[hits.triangle[met]]
        onward, passed = np.zeros_like(d), np.zeros(len(d))
        for k, (_, material) in enumerate(things):
            mine = what == k
            if not mine.any():
                continue
            onward[mine], passed[mine] = material.sample(
                -d[mine], normal[mine], draw.random((int(mine.sum()), 3))
            )
            if k == len(things) - 1:
                continue
            for c, sensor in enumerate(sensors):
                line = sensor - o[mine]
                r = np.sqrt((line * line).sum(axis=1))
                line /= r[:, None]
                f = material.evaluate(-d[mine], line, normal[mine])
                cosines = np.maximum((line * normal[mine]).sum(axis=1), 0.0) * -line[:, 2]
                value = power[mine] * f * np.maximum(cosines, 0.0) / r**2
                lit = value > 0.0
                value[lit] *= ~occluded(hidden, o[mine][lit], np.tile(sensor, (int(lit.sum()), 1)))
                where = np.searchsorted(edges, length[mine] + r, side="right") - 1
                fits = (where >= 0) & (where < len(edges) - 1)
                np.add.at(
                    sums[order][..., c], (group[mine][fits], where[fits]), value[fits] * 16.0 / n
                )
        d, power = onward, power * passed
        keep = power > 0.0
        o, d, power, length, group = o[keep], d[keep], power[keep], length[keep], group[keep]
    return {k: (v.mean(axis=0), v.std(axis=0) / np.sqrt(15)) for k, v in sums.items()}


@pytest.mark.thorough
def test_connections_are_unbiased_against_an_analog_walk():
    sensors = POINTS.reshape(-1, 3)
    laser = np.array([0.05, -0.1, 0.0])
    edges = 0.5 * np.arange(17)
    walked = analog(laser, sensors, 100_000, edges, 3)
    found = multiple_bounces(
        hidden_surfaces(CORRIDOR),
        laser,
        POINTS,
        wall_albedo=0.8,
        wall_size=(1.0, 1.0),
        delta_t=0.5,
        n_bins=16,
        tol=None,
        n_rays=1 << 18,
    )
    for order in (4, 5):
        mean, error = walked[order]
        light = found.by_bounce[order].reshape(16, 4)
        noise = np.hypot(error, found.standard_error[order].reshape(16, 4))
        lit = mean > 0.02 * mean.max()
        assert lit.sum() > 15
        away = (light - mean)[lit] / noise[lit]
        # Student's t of 15 and of 7 degrees: variance 1.2; its mean over 30 to 64 bins
        assert (away**2).mean() < 2.0
        # totals, whose errors are about 1 %
        assert light.sum() == pytest.approx(mean.sum(), rel=0.04)


@pytest.mark.thorough
def test_light_goes_either_way():
    hidden = hidden_surfaces(CORRIDOR)
    options = {
        "delta_t": 0.5,
        "n_bins": 16,
        "tol": None,
        "n_rays": 1 << 15,
        "wall_size": (1.0, 1.0),
    }
    one, many = np.array([0.05, -0.1, 0.0]), POINTS
    there = multiple_bounces(hidden, one, many, seed=1, **options)
    # followed from the side with more points in both cases
    back = multiple_bounces(hidden, many, one, seed=1, **options)
    pairs = multiple_bounces(
        hidden, many, np.broadcast_to(one, many.shape), pairing="confocal", seed=2, **options
    )
    for order in (4, 5):
        a, b, c = (x.by_bounce[order] for x in (there, back, pairs))
        assert a.shape == b.shape == c.shape == (16, 2, 2)
        assert np.array_equal(a, b)
        noise = np.hypot(there.standard_error[order], pairs.standard_error[order])
        lit = a > 0.02 * a.max()
        # differences of two independent estimates; Student's t of 7 degrees, as above
        assert (((a - c)[lit] / noise[lit]) ** 2).mean() < 2.5


@pytest.mark.thorough
def test_standard_errors_are_those_of_other_seeds():
    hidden = hidden_surfaces(CORRIDOR)
    runs = [
        multiple_bounces(
            hidden, LASER, POINTS, delta_t=0.5, n_bins=16, tol=None, n_rays=1 << 13, seed=seed
        )
        for seed in range(12)
    ]
    for order in (4, 5):
        values = np.array([run.by_bounce[order] for run in runs])
        errors = np.array([run.standard_error[order] for run in runs])
        lit = values.mean(axis=0) > 0.05 * values.mean(axis=0).max()
        ratio = values.std(axis=0, ddof=1)[lit] ** 2 / (errors**2).mean(axis=0)[lit]
        # variances of 12 seeds, each known to 40 %, over some 30 bins that share paths
        assert 0.6 < ratio.mean() < 1.5


@pytest.mark.thorough
def test_points_drawn_over_the_area_change_the_noise_alone(monkeypatch):
    # a fin that wall points see from either side, between two plates
    things = [
        (quad([0.0, -0.3, 0.3], [0.0, 0.6, 0.0], [0.0, 0.0, 0.5]), Lambert(0.9)),
        (quad([-0.4, -0.3, 0.3], [0.0, 0.6, 0.0], [0.1, 0.0, 0.5]), Lambert(0.7)),
        (quad([0.4, -0.3, 0.3], [0.0, 0.6, 0.0], [0.0, 0.0, 0.5]), Lambert(0.8)),
    ]
    sensors = np.array([[-0.2, 0.0, 0.0], [0.25, 0.1, 0.0]])

    def run(share):
        monkeypatch.setattr(multiple_module, "_aimed", lambda job: (share, share))
        return multiple_bounces(
            hidden_surfaces(things),
            [0.1, 0.0, 0.0],
            sensors,
            delta_t=10.0,
            n_bins=1,
            orders=(4,),
            tol=None,
            n_rays=1 << 18,
        )

    rays, mixed = run(0.0), run(0.6)
    for sensor in range(2):
        a, b = rays.by_bounce[4][0, sensor], mixed.by_bounce[4][0, sensor]
        noise = np.hypot(rays.standard_error[4][0, sensor], mixed.standard_error[4][0, sensor])
        assert noise < 0.02 * a
        assert abs(a - b) < 4.5 * noise  # Student's t of some 10 degrees


@pytest.mark.parametrize("material", [Ward(0.8, 0.3), SumMaterial(Lambert(0.5), Ward(0.4, 0.2))])
def test_first_legs_have_the_density_that_they_are_weighted_by(material):
    around = bounce_surfaces(hidden_surfaces([(quad(*FLOOR), material)]), LASER[None], 1.0, None)
    n = 1 << 14
    vertices = np.zeros((n, kernels.VERTEX))
    vertices[:, kernels.N] = [0.0, 1.0, 0.0]
    vertices[:, kernels.WEIGHT] = 1.0
    slopes = np.linspace(-0.8, 0.9, kernels.VIEWS)
    views = np.stack([slopes, np.ones_like(slopes), -0.3 * slopes], axis=1)
    views /= np.sqrt((views * views).sum(axis=1))[:, None]
    leaving = np.empty((n, kernels.LEAVE))
    columns, shifts = scrambled_sobol(3, 7, 1)
    kernels.leave(
        around.kernel,
        ((np.uint64(3), columns.copy(), shifts.copy()), 0, kernels.DRAWS_SEEN),
        0.0,
        np.tile(views, (n, 1, 1)),
        vertices,
        leaving,
        (np.empty((n, 3)), np.empty((n, 3))),
    )
    sent = leaving[:, kernels.SENT] > 0.0
    # the cosine's integral over the hemisphere, to a percent with these Sobol points
    mean = (leaving[sent, kernels.SENT] / leaving[sent, kernels.DENSITY]).sum() / n
    assert mean == pytest.approx(np.pi, rel=0.01)


def test_threads_change_no_bit(monkeypatch):
    hidden = hidden_surfaces(CORRIDOR)

    def run(seed=5):
        return multiple_bounces(
            hidden, LASER, POINTS, delta_t=0.1, n_bins=80, tol=None, n_rays=1 << 16, seed=seed
        )

    results = []
    for cores in (1, 2, 3):
        with ThreadPoolExecutor(cores) as pool:
            for module in (batches, meshes):
                monkeypatch.setattr(module, "worker_pool", lambda pool=pool: pool)
            results.append(run())
            monkeypatch.undo()
    for a, b in itertools.pairwise(results):
        for order in (4, 5):
            assert np.array_equal(a.by_bounce[order], b.by_bounce[order])
            assert np.array_equal(a.standard_error[order], b.standard_error[order])
    assert not np.array_equal(results[0].by_bounce[4], run(seed=6).by_bounce[4])


def test_the_wall_on_the_way_adds_to_five_bounces_alone():
    hidden = hidden_surfaces(CORRIDOR)
    without, with_wall = (
        multiple_bounces(
            hidden, LASER, POINTS, delta_t=8.0, n_bins=1, tol=None, n_rays=1 << 15, wall_size=size
        )
        for size in (None, (1.0, 1.0))
    )
    # bins hold everything, and noise is about 1 %
    assert with_wall.by_bounce[4].sum() == pytest.approx(without.by_bounce[4].sum(), rel=0.05)
    assert with_wall.by_bounce[5].sum() > 1.2 * without.by_bounce[5].sum()


def test_tolerance_is_reached_or_the_shortfall_told():
    hidden = hidden_surfaces(CORRIDOR)
    told = []
    options = {"delta_t": 0.5, "n_bins": 16, "progress": lambda text, share: told.append(share)}
    good = multiple_bounces(hidden, LASER, POINTS, tol=0.05, **options)
    assert good.details["stopped"] == "tol"
    assert max(good.details["reached"].values()) <= 0.05
    assert told
    assert max(told) <= 1.0
    for order in (4, 5):
        light, error = good.by_bounce[order], good.standard_error[order]
        expected = np.sqrt(2 / np.pi) * (error.sum(axis=0) / light.sum(axis=0)).max()
        assert good.details["reached"][order] == pytest.approx(expected)
    short = multiple_bounces(hidden, LASER, POINTS, tol=1e-4, n_rays=1 << 14, **options)
    assert short.details["stopped"] == "paths"
    assert short.details["paths"] <= 1 << 14
    assert max(short.details["reached"].values()) > 1e-4


@pytest.mark.thorough
def test_a_single_plate_has_no_fourth_bounce():
    hidden = hidden_surfaces([(quad(*FLOOR), Lambert(0.8))])
    found = multiple_bounces(hidden, LASER, SENSOR, delta_t=0.5, n_bins=16, wall_size=(2.0, 2.0))
    assert not found.by_bounce[4].any()
    assert found.by_bounce[5].any()  # wall, plate, wall, plate, wall
    assert found.details["reached"][4] == math.inf
    assert found.details["reached"][5] <= 1e-2
    assert found.details["stopped"] == "dark"


def test_light_that_misses_the_bins_is_no_convergence():
    hidden = hidden_surfaces(CORRIDOR)
    bins = {"delta_t": 0.1, "n_bins": 2, "n_rays": 1 << 12}
    for tol, stopped in ((0.1, "dark"), (None, "paths")):
        found = multiple_bounces(hidden, LASER, SENSOR, tol=tol, **bins)
        assert set(found.details["reached"].values()) == {math.inf}
        assert found.details["stopped"] == stopped


def test_render_keeps_bounces_apart():
    capture = transient.render(
        CORRIDOR[:3],
        transient.Scan(
            laser_points=LASER,
            sensor_points=POINTS,
            wall_albedo=0.8,
            t_start=0.0,
            delta_t=0.5,
            n_bins=16,
        ),
        max_bounces=5,
        quantity="radiosity",
        tol=0.05,
        tol_multiple=0.2,
        seed=4,
    )
    assert sorted(capture.by_bounce) == [3, 4, 5]
    np.testing.assert_allclose(capture.H, sum(capture.by_bounce.values()), rtol=1e-12)
    assert capture.details["multiple_bounces"]["stopped"] == "tol"
    direct = multiple_bounces(
        hidden_surfaces(CORRIDOR[:3]), LASER, POINTS, delta_t=0.5, n_bins=16, tol=0.2, seed=4
    )
    # the wall's spot, and the wall at the sensor
    np.testing.assert_allclose(capture.by_bounce[4], 0.64 * direct.by_bounce[4], rtol=1e-12)
    error = np.sqrt(sum(e**2 for e in direct.standard_error.values()))
    np.testing.assert_allclose(capture.standard_error, 0.64 * error, rtol=1e-12)


@pytest.mark.thorough
def test_further_bounces_alone_are_those_of_all():
    scan = transient.Scan(
        laser_points=LASER, sensor_points=POINTS, t_start=0.0, delta_t=0.5, n_bins=16
    )
    setting = {"tol": 0.05, "tol_multiple": 0.3, "seed": 4}
    whole = transient.render(CORRIDOR[:3], scan, max_bounces=5, **setting)
    more = transient.render(CORRIDOR[:3], scan, min_bounces=4, max_bounces=5, **setting)
    assert sorted(more.by_bounce) == [4, 5]
    for n in (4, 5):
        assert np.array_equal(more.by_bounce[n], whole.by_bounce[n])
    assert np.array_equal(more.H, more.by_bounce[4] + more.by_bounce[5])
    assert np.array_equal(more.standard_error, whole.standard_error)
    assert "error_estimate" not in more.details
    short = replace(scan, n_bins=1, delta_t=0.1)
    with pytest.raises(SamplingError, match="no light of 4 to 5 bounces arrives in the bins"):
        transient.render(CORRIDOR[:3], short, min_bounces=4, **setting)
    with pytest.raises(SceneError, match="max_bounces = 5 is out of range, must be from 6 to 32"):
        transient.render(CORRIDOR[:3], scan, min_bounces=6, **setting)


@pytest.mark.parametrize(
    ("options", "kind", "words"),
    [
        ({"pairing": "confocal"}, SamplingError, "not pairs"),
        ({"n_bins": 10**13}, MemoryLimitError, "GiB"),
    ],
)
def test_wrong_options_are_named(options, kind, words):
    hidden = hidden_surfaces(CORRIDOR)
    with pytest.raises(kind, match=words):
        multiple_bounces(hidden, LASER, POINTS, **({"delta_t": 0.5, "n_bins": 16} | options))


@pytest.mark.thorough
def test_a_corridor_is_the_peers(data):
    """Totals of 4 and 5 bounces; in the peer's captures the letter counts twice at each vertex."""

    folder = data / "peer_transient"

    def load(name):
        return trimesh.load(folder / "meshes" / f"{name}.obj", process=False)

    runs = []
    for albedo in (0.0, 0.4, 0.8):
        things = [(load("Zletter_z1"), Lambert(albedo))]
        things += [(load(n), Lambert(0.6)) for n in ("floor", "ceil", "left", "right", "back")]
        runs.append(
            multiple_bounces(
                hidden_surfaces(things),
                [0.0, 0.0, 0.0],
                transient.wall_grid(2.0, 16),
                wall_size=(2.0, 2.0),
                delta_t=0.01,
                n_bins=800,
                tol=None,
                n_rays=1 << 18,
            ).by_bounce
        )
    for order in (4, 5):
        peer = np.moveaxis(np.load(folder / f"Zbox_single16_{order}b.npz")["H"], -1, 0)
        # paths are the same for every albedo, so that this parabola holds path by path
        dark, middle, bright = (143.108 * run[order].sum(axis=(1, 2)) for run in runs)
        twice = 3.0 * dark - 8.0 * middle + 6.0 * bright
        assert twice.sum() == pytest.approx(peer.sum(), rel=0.03)
        # the peer's first path of each order, at 1.64 and 2.00 m, comes when next to nothing has
        first = int(np.flatnonzero(peer.sum(axis=(1, 2)))[0])
        assert 0.0 < twice[:first].sum() < 0.02 * twice.sum()
        begins = int(np.flatnonzero(bright)[0])
        # by way of two walls, as by a pair of mirrors, to the cell in the corner; with the wall on
        # the way by one of them, where paths come as close as one likes and bring nothing
        shortest = {4: np.hypot(1.0625, 1.0625), 5: np.hypot(1.0625, 0.0625)}[order]
        assert int(shortest / 0.01) <= begins <= int(shortest / 0.01) + (1 if order == 4 else 10)


def test_surfaces_that_a_sensor_sees_edge_on_are_dark():
    """Two plates in a plane through the only wall point: no first vertex has any weight."""
    plates = trimesh.Trimesh(
        [[-1, 0, 1], [1, 0, 1], [0, 0, 2], [0, 0, 2.5]], [[0, 1, 2], [1, 2, 3]], process=False
    )
    hidden = hidden_surfaces([(plates, Lambert(0.5))])
    found = multiple_bounces(hidden, np.zeros(3), np.zeros(3), delta_t=0.1, n_bins=90)
    assert (found.details["stopped"], found.details["paths"]) == ("dark", 0)
    assert not any(part.any() for part in found.by_bounce.values())


def test_lasers_at_a_time_do_not_alter_their_light(monkeypatch):
    """The memory for connections decides how many lasers are joined to paths at a time."""
    hidden = hidden_surfaces(CORRIDOR)
    lasers = np.array([[0.0, 0.1, 0.0], [0.2, 0.0, 0.0], [-0.3, 0.2, 0.0]])
    sensors = np.array([[0.1, -0.2, 0.0], [0.0, 0.3, 0.0], [0.4, 0.1, 0.0]])
    asked = {"delta_t": 0.2, "n_bins": 40, "orders": (4,), "tol": None, "n_rays": 4096}
    whole = multiple_bounces(hidden, lasers, sensors, **asked)
    assert all(whole.by_bounce[4].sum(axis=0).ravel() > 0.0)
    monkeypatch.setattr(batches, "ROWS", 1)
    parts = multiple_bounces(hidden, lasers, sensors, **asked)
    assert np.array_equal(parts.by_bounce[4], whole.by_bounce[4])
    assert np.array_equal(parts.standard_error[4], whole.standard_error[4])
