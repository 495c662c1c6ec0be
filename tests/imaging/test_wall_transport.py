"""Transport from hidden cells to wall pixels: closed forms, ray tracing, adjoint, derivatives."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from pytest import approx
from scipy import constants

from nlosoptics import imaging, raytrace
from nlosoptics.errors import NlosError
from nlosoptics.imaging import WallTransport
from nlosoptics.scene import (
    Camera,
    ConvexWall,
    FlatWall,
    Lambert,
    Laser,
    Occluder,
    PlanarObject,
    Scene,
    SpecularMicrofacet,
    SumMaterial,
)

LASER = Laser(
    wavelength=633e-9, power=5e-3, beam_diameter=3e-3, position=(1.3, 0, 1.1), aim=(0.6, 0.1, 0)
)
CAMERA = Camera(
    position=(-0.6, 0, 0.8),
    aim=(-0.2, 0, 0),
    focal_length=0.05,
    stop_diameter=0.025,
    binning=512,
    exposure=0.04,
)
PICTURE = np.random.default_rng(3).random((12, 12))


def scene(*occluders, **parts) -> Scene:
    given = {
        "laser": LASER,
        "wall": FlatWall(size=(1.6, 1.2)),
        "hidden": PlanarObject(PICTURE, 0.7, position=(0, 0, 1.0), material=Lambert(0.8)),
        "camera": CAMERA,
        "wall_material": Lambert(0.6),
        "occluders": occluders,
    }
    return Scene(**(given | parts))


def disc(radius, at) -> trimesh.Trimesh:
    angles = 2 * math.pi * np.arange(64) / 64
    rim = np.stack([radius * np.cos(angles), radius * np.sin(angles), 0 * angles], axis=1)
    faces = [[64, i, (i + 1) % 64] for i in range(64)]
    return trimesh.Trimesh(np.vstack([rim, np.zeros(3)]) + at, faces, process=False)


def box(size, at, turn=0.0) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(size)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(turn, (1, 2, 3)))
    return mesh.apply_translation(at)


CHAIR = trimesh.util.concatenate(
    [
        box((0.2, 0.02, 0.2), (0, 0.013, 0.5)),
        box((0.023, 0.2, 0.02), (0.09, -0.11, 0.41)),
        box((0.021, 0.2, 0.02), (-0.09, -0.11, 0.59)),
        box((0.2, 0.2, 0.02), (0, 0.11, 0.59)),
    ]
)
DISC = disc(0.06, (0.013, 0.05, 0.5))


def electrons_per_radiance(sharp: Scene) -> float:
    """Electrons on the whole detector, small and on the axis, per W/(m^2 sr)."""
    camera = sharp.camera
    lens = camera.stop_diameter / (2 * sharp.image_distance)
    area = math.prod(camera.pixels) * camera.pixel_pitch**2
    rate = camera.quantum_efficiency * LASER.wavelength / (constants.h * constants.c)
    return math.pi * camera.transmission * lens**2 * area * camera.exposure * rate


def test_luminous_rectangle_has_its_configuration_factor():
    """Patch parallel to a rectangle, one corner above it: Howell's catalogue, B-3."""
    camera = replace(CAMERA, aim=(-0.35, -0.35, 0), pixels=(4, 4), binning=1)
    small = scene(camera=camera)
    transport = WallTransport(small, cells=(5, 7), pixels=(1, 1), source="luminous")
    x = 0.7
    one = x / math.hypot(1, x) * math.atan(x / math.hypot(1, x))
    factor = 2 * one / (2 * math.pi)
    expected = electrons_per_radiance(small) * 0.6 * factor
    assert transport.forward(np.ones((5, 7))).item() == approx(expected, rel=2e-4)


def test_small_cell_is_a_point_source_with_the_cosine_powers_of_its_lobe():
    camera = replace(CAMERA, aim=(-0.3, 0.4, 0), pixels=(4, 4), binning=1)
    hidden = PlanarObject(np.ones((2, 2)), 0.01, position=(0, 0, 1.0))
    small = scene(camera=camera, hidden=hidden)
    transport = WallTransport(
        small,
        cells=(1, 1),
        pixels=(1, 1),
        source="luminous",
        lobe=(3.0, 5.0),
    )
    square = 1 + 0.3**2 + 0.4**2
    lobe = (1 + 0.3**2) ** -1.5 * (1 + 0.4**2) ** -2.5
    expected = electrons_per_radiance(small) * 0.6 / math.pi * lobe * 0.01**2 / square**2
    assert transport.matrix.item() == approx(expected, rel=1e-4)


def test_what_a_straight_edge_leaves_of_a_cell_is_linear_in_its_shift():
    """Half way to the plane, the shadow moves twice as far as the edge."""
    sheet = box((0.2, 1.2, 1e-9), (-0.1, 0, 0.5))
    edged = scene(
        sheet,
        camera=replace(CAMERA, pixels=(4, 4), binning=4, stop_diameter=1e-5),
        hidden=PlanarObject(PICTURE, 0.07, position=(0, 0, 1.0)),
    )
    whole = WallTransport(edged, cells=(1, 7), source="luminous", samples=1)
    free = whole.with_occluders(()).matrix[0, 5]
    high = 0.02 * edged.hidden.axes[0][0] + 0.005  # end of the column, 0.01 m wide
    for left in (0.1, 0.5, 0.8, 1.0):
        # seen from x = -0.2, an edge at x hides what is below 2 x + 0.2
        moved = whole.moved(0, ((high - 0.01 * left - 0.2) / 2, 0, 0))
        assert moved.matrix[0, 5] / free == approx(left, abs=1e-6)


@pytest.mark.parametrize(
    "occluders",
    [
        (disc(0.06, (-0.1, 0.05, 0.5)), disc(0.06, (-0.05, 0.07, 0.45))),
        (box((0.2, 0.1, 0.9), (0.1, 0.05, 0.85), 0.3), CHAIR.copy()),  # reaches behind the plane
        (trimesh.creation.annulus(0.05, 0.1, 0.05).apply_translation((0.05, 0.02, 0.4)),),
    ],
    ids=["two discs", "through the plane", "ring"],
)
def test_visible_parts_of_cells_are_those_of_many_rays(occluders):
    """At the middle of each pixel; 60 x 60 rays from each cell."""
    camera = replace(CAMERA, stop_diameter=1e-5, binning=1024)
    shaded = scene(*occluders, camera=camera)
    transport = WallTransport(shaded, cells=(4, 5), source="luminous", samples=1)
    free = transport.with_occluders(())
    shares = (transport.matrix / free.matrix).reshape(4, 4, 4, 5)
    side = (np.arange(4096, step=1024) - 1536) * camera.pixel_pitch
    e1, e2, axis = camera.frame
    rays = shaded.image_distance * axis - side[None, :, None] * e1 - side[:, None, None] * e2
    wall = np.array(camera.position) - rays * (camera.position[2] / rays[..., 2:])
    u, v = ((np.arange(60 * n) + 0.5) / (60 * n) for n in (5, 4))
    across, down = np.meshgrid(u - 0.5, 0.5 - v)
    right, up, _ = shaded.hidden.axes
    points = np.array(shaded.hidden.position) + 0.7 * (
        across[..., None] * right + down[..., None] * up
    )
    assert np.ptp(shares) > 0.5
    for i, j in ((0, 0), (1, 3), (3, 2)):
        ends = np.broadcast_to(wall[i, j], points.shape)
        lines = points - ends
        light = (lines[..., 2] / (lines**2).sum(axis=-1)) ** 2
        seen = light * ~raytrace.occluded(shaded.occluding_mesh, ends, points)
        expected = [a.reshape(4, 60, 5, 60).sum(axis=(1, 3)) for a in (seen, light)]
        assert shares[i, j] == approx(expected[0] / expected[1], abs=0.012)
        assert (shares[i, j] - expected[0] / expected[1]).mean() == approx(0.0, abs=2e-3)


def traced(sharp: Scene, n_rays: int) -> tuple[np.ndarray, ...]:
    """Electrons by ray tracing, by the operator, and the standard errors of the former."""
    image = raytrace.trace_image(sharp, n_rays=n_rays, max_bounces=3, seed=1)
    light = sharp.laser.wavelength / (constants.h * constants.c)
    light *= sharp.camera.quantum_efficiency * sharp.camera.exposure
    transport = WallTransport(sharp, cells=(48, 48))
    fine = transport.forward(np.kron(sharp.hidden.reflectance, np.ones((4, 4))))
    return image.power * light, fine, image.power_error * light


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("sharp", "n_rays"),
    [
        (scene(), 1 << 19),
        (scene(DISC), 1 << 20),
        (scene(CHAIR), 1 << 21),
        (scene(DISC, wall=ConvexWall(radius=4.0, size=(1.6, 1.2))), 1 << 20),
        (
            scene(DISC, wall_material=SumMaterial(Lambert(0.3), SpecularMicrofacet(0.4, 0.15))),
            1 << 19,
        ),
    ],
    ids=["free", "disc", "chair", "curved wall", "glossy wall"],
)
def test_image_is_that_of_ray_tracing(sharp, n_rays):
    expected, image, error = traced(sharp, n_rays)
    assert np.ptp(expected) > 0.3 * expected.mean()
    assert image.mean() == approx(expected.mean(), rel=1e-3)
    noise = math.sqrt((error**2).mean())
    assert math.sqrt(((image - expected) ** 2).mean()) < 1.25 * noise + 5e-4 * expected.mean()


@pytest.mark.thorough
@pytest.mark.parametrize(
    "sharp",
    [scene(DISC), scene(CHAIR), scene(DISC, wall=ConvexWall(radius=4.0, size=(1.6, 1.2)))],
    ids=["disc", "chair", "curved wall"],
)
def test_diffuse_light_of_an_image_is_that_of_ray_tracing(sharp):
    """Shares of 32 x 32 pixels, most of them interpolated."""
    sharp = replace(sharp, camera=replace(CAMERA, binning=128))
    expected, _, error = traced(sharp, 1 << 20)
    image = imaging.diffuse_background(sharp)
    assert image.mean() == approx(expected.mean(), rel=1e-3)
    noise = math.sqrt((error**2).mean())
    assert math.sqrt(((image - expected) ** 2).mean()) < 1.1 * noise + 1e-3 * expected.mean()


def test_shadow_of_a_disc_is_that_of_ray_tracing():
    sharp = scene(DISC, camera=replace(CAMERA, binning=1024))
    expected, image, error = traced(sharp, 1 << 16)
    free = WallTransport(replace(sharp, occluders=()), cells=(48, 48))
    assert (free.forward(np.ones((48, 48))) / image).std() > 0.02
    assert abs((image - expected) / error).max() < 4.0
    assert math.sqrt((error**2).mean()) < 0.01 * expected.mean()


@pytest.mark.thorough
def test_luminous_screen_past_a_chair_is_its_sum_over_random_points():
    """Quasi-random points of wall and screen, and rays between them."""
    camera = replace(CAMERA, stop_diameter=1e-5)
    screen = scene(CHAIR, camera=camera)
    transport = WallTransport(screen, cells=(12, 12), source="luminous", lobe=(2.0, 4.0))
    image = transport.forward(PICTURE)
    draws, counts = np.random.default_rng(0).random((64, 40000, 4)), []
    e1, e2, axis = camera.frame
    right, up, _ = screen.hidden.axes
    for pixel in range(64):
        u, v, a, b = draws[pixel].T
        x, y = (
            (i - 4 + t) * 512 * camera.pixel_pitch for i, t in ((pixel % 8, u), (pixel // 8, v))
        )
        rays = screen.image_distance * axis - np.outer(x, e1) - np.outer(y, e2)
        wall = np.array(camera.position) - rays * (camera.position[2] / rays[:, 2:])
        points = np.array(screen.hidden.position) + 0.7 * (
            np.outer(a - 0.5, right) + np.outer(0.5 - b, up)
        )
        lines = points - wall
        square = (lines**2).sum(axis=1)
        lobe = (1 + (lines[:, 0] / lines[:, 2]) ** 2) ** -1 * (
            1 + (lines[:, 1] / lines[:, 2]) ** 2
        ) ** -2
        light = PICTURE[(12 * b).astype(int), (12 * a).astype(int)] * lobe
        light *= (lines[:, 2] / square) ** 2 * 0.7**2 * 0.6 / math.pi
        light *= (screen.image_distance / np.linalg.norm(rays, axis=1)) ** 4
        free = ~raytrace.occluded(screen.occluding_mesh, wall, points)
        counts.append((light * free).mean())
    expected = electrons_per_radiance(screen) / 64 * np.reshape(counts, (8, 8))
    # 40000 points for each pixel leave 0.4 %, and 0.05 % of the mean
    assert image.mean() == approx(expected.mean(), rel=1.5e-3)
    assert image == approx(expected, rel=0.025)


@pytest.fixture(scope="module")
def small() -> WallTransport:
    occluders = disc(0.06, (-0.1, 0.05, 0.5)), box((0.1, 0.06, 0.5), (0.1, 0.02, 0.8), 0.3)
    return WallTransport(scene(*occluders), cells=(6, 7), pixels=(5, 4), samples=3)


def test_adjoint_operator_and_factors(small):
    rng = np.random.default_rng(0)
    f, y = rng.random((3, 6, 7)), rng.random((3, 5, 4))
    assert (small.forward(f) * y).sum() == approx((small.adjoint(y) * f).sum(), rel=1e-13)
    operator = small.linear_operator()
    assert operator.matvec(f[0].ravel()) == approx(small.matrix @ f[0].ravel(), rel=1e-13)
    assert operator.rmatvec(y[0].ravel()) == approx(small.matrix.T @ y[0].ravel(), rel=1e-13)
    left, right = small.factors(tol=1e-2)
    values = np.linalg.svd(small.matrix, compute_uv=False)
    assert left.shape[1] == (values > 1e-2 * values[0]).sum() < 20
    assert np.linalg.norm(left @ right - small.matrix, 2) < 1.01e-2 * values[0]


def test_without_room_for_the_matrix_products_are_the_same(small, monkeypatch):
    f, y = np.ones((6, 7)), np.ones((5, 4))
    monkeypatch.setattr(imaging.wall_transport, "available_memory", lambda: 0.0)
    blocks = replace(small)
    assert blocks.forward(f) == approx(small.forward(f), rel=1e-13)
    assert blocks.adjoint(y) == approx(small.adjoint(y), rel=1e-13)
    assert "matrix" not in vars(blocks)


def test_tensors_give_tensors_with_gradients(small):
    torch = pytest.importorskip("torch")
    f = torch.ones((6, 7), dtype=torch.float64, requires_grad=True)
    image = small.forward(f)
    image.sum().backward()
    assert image.detach().numpy() == approx(small.forward(np.ones((6, 7))), rel=1e-13)
    assert f.grad.numpy() == approx(small.adjoint(np.ones((5, 4))), rel=1e-13)
    assert small.adjoint(image.detach()).shape == (6, 7)


@pytest.mark.parametrize("occluder", [0, 1], ids=["disc", "box through the plane"])
def test_derivative_by_the_pose_is_that_of_differences(small, occluder):
    f, weights = np.random.default_rng(0).random((6, 7)), np.random.default_rng(1).random((20, 42))
    rates, step = small.pose_derivative(f, occluder), 1e-6
    gradient = small.pose_gradient(weights)[occluder]
    for k, change in enumerate(step * np.eye(6)):
        ahead, back = (small.moved(occluder, s * change[:3], s * change[3:]) for s in (1, -1))
        error = (ahead.forward(f) - back.forward(f)) / (2 * step) - rates[k]
        assert abs(error).max() < 1e-5 * abs(rates).max()
        error = (weights * (ahead.matrix - back.matrix)).sum() / (2 * step) - gradient[k]
        assert abs(error) < 1e-5 * abs(gradient).max()
    assert abs(rates).max() > 0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: WallTransport(s, cells=3), r"cells = 3 is not \(rows, columns\); give"),
        (lambda s: WallTransport(s, cells=(0, 3)), r"cells\[0\] = 0 is out of range"),
        (lambda s: WallTransport(s, cells=(3, 3), pixels=(9, 9)), r"pixels\[0\] = 9 .* 1 to 8"),
        (lambda s: WallTransport(s, cells=(3, 3), source="sun"), "source = 'sun' is unknown"),
        (lambda s: WallTransport(s, cells=(3, 3)).forward(np.ones(3)), r"f has the shape \(3,\)"),
        (
            lambda s: WallTransport(s, cells=(1, 1)).adjoint(np.full((8, 8), np.nan)),
            "y has 64 values that are not finite",
        ),
        (lambda s: WallTransport(s, cells=(3, 3)).moved(1, (0, 0, 0)), "occluder = 1 is out of"),
        (lambda s: WallTransport(s, cells=(3, 3)).forward("x"), "f = 'x' is no array of numbers"),
        (
            lambda s: WallTransport(s, cells=(3, 3)).pose_derivative(np.ones((2, 3, 3))),
            r"f has the shape \(2, 3, 3\), must be \(3, 3\)",
        ),
        (
            lambda s: WallTransport(s, cells=(3, 3)).pose_gradient(np.ones((2, 64, 9))),
            r"weights has the shape \(2, 64, 9\), must be \(64, 9\)",
        ),
        (lambda s: WallTransport(s, cells=(3, 3)).moved(0, (0, 0, -1)), "behind the wall's plane"),
        (
            lambda s: WallTransport(s, cells=(3, 3), material=SpecularMicrofacet(0.1, 1e-4)).matrix,
            "rms slope 0.0001 needs samples",
        ),
        (
            lambda s: WallTransport(s, cells=(3, 3), material=SpecularMicrofacet(0.1, 0.0)).matrix,
            "has 0 lobes that scatter light",
        ),
        (
            lambda s: WallTransport(
                replace(s, occluders=(Occluder(DISC, material=Lambert(0.1)),)), cells=(3, 3)
            ),
            r"occluder\[0\].material reflects light",
        ),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(NlosError, match=message):
        call(scene(DISC))


@pytest.mark.parametrize("size", [0.15, (0.05, 1.2), (1.6, 0.05)])
def test_pixels_wider_than_the_wall_hold_the_light_of_finer_ones(size):
    """All pixels together see the same wall: 9 x 9 pixels of 80 mm against 54 x 54 of 13 mm."""
    camera = replace(CAMERA, aim=(0, 0, 0), binning=1, pixel_pitch=6.827e-4, pixels=(54, 54))
    small = scene(wall=FlatWall(size=size), laser=replace(LASER, aim=(0, 0, 0)), camera=camera)
    coarse, fine = (WallTransport(small, cells=(4, 4), pixels=(n, n)).matrix for n in (9, 54))
    # the wall's edges cut through the samples of a pixel, 64 in the coarse ones
    assert coarse.sum(axis=0) == approx(fine.sum(axis=0), rel=0.02)
