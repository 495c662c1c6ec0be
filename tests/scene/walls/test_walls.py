"""Wall heights, their derivatives, normals and meshes."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from pytest import approx

from nlosoptics.errors import MemoryLimitError, SceneError
from nlosoptics.scene import ConcaveWall, ConvexWall, FlatWall, SumWall, WavyWall

mpmath.mp.dps = 40


def sphere(radius):
    return lambda x, y: radius - mpmath.sign(radius) * mpmath.sqrt(radius**2 - x * x - y * y)


def wave(amplitude, period, phase, direction):
    def height(x, y):
        along = x * mpmath.cos(direction) + y * mpmath.sin(direction)
        return amplitude * mpmath.cos(2 * mpmath.pi * along / period + phase)

    return height


#: Walls beside their heights in arbitrary precision.
WALLS = {
    "flat": (FlatWall(), lambda x, y: mpmath.mpf(0)),
    "concave sphere": (ConcaveWall(5.0), sphere(mpmath.mpf(5))),
    "convex sphere": (ConvexWall(1.0), sphere(mpmath.mpf(-1))),
    "cylinder along y": (
        ConcaveWall(2.0, shape="cylinder", axis="y"),
        lambda x, y: sphere(mpmath.mpf(2))(x, 0),
    ),
    "cylinder along x": (
        ConvexWall(2.0, shape="cylinder", axis="x"),
        lambda x, y: sphere(mpmath.mpf(-2))(0, y),
    ),
    "wave": (WavyWall(1e-4, 0.25, 0.7, direction=0.5), wave(1e-4, 0.25, 0.7, 0.5)),
    "sum": (
        SumWall(ConcaveWall(3.0), WavyWall(1e-3, 0.5, 0.1), WavyWall(2e-3, 0.3, direction=2.0)),
        lambda x, y: (
            sphere(mpmath.mpf(3))(x, y)
            + wave(1e-3, 0.5, 0.1, 0)(x, y)
            + wave(2e-3, 0.3, 0, 2)(x, y)
        ),
    ),
}
POINTS = [(0.0, 0.0), (1e-9, -2e-9), (0.3, 0.2), (-0.41, 0.17), (0.0, 0.6), (0.5, -0.55)]
DERIVATIVES = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]


@pytest.mark.parametrize(("wall", "exact"), WALLS.values(), ids=WALLS.keys())
def test_height_and_derivatives(wall, exact) -> None:
    for x, y in POINTS:
        found = wall.derivatives(x, y)
        expected = [exact(mpmath.mpf(x), mpmath.mpf(y))]
        expected += [
            mpmath.diff(exact, (mpmath.mpf(x), mpmath.mpf(y)), order) for order in DERIVATIVES[1:]
        ]
        # rounding of a few operations; the phase of a wave, of 10 rad, amplifies it tenfold, and
        # derivatives scale with (2 pi / period)^n
        for value, truth in zip(found, expected, strict=True):
            assert value == approx(float(truth), rel=5e-15, abs=1e-15 * wall.max_curvature + 1e-30)


@pytest.mark.parametrize("radius", [0.5, 5.0, 1e4])
def test_sag_keeps_its_relative_accuracy_at_the_vertex(radius: float) -> None:
    """R - sqrt(R^2 - r^2) would lose all digits where the sag is below 1e-16 R."""
    x = np.geomspace(1e-12, 0.3, 60)
    exact = [float(sphere(mpmath.mpf(radius))(mpmath.mpf(v), mpmath.mpf(0))) for v in x]
    assert ConcaveWall(radius).height(x, 0.0) == approx(exact, rel=4e-16)  # two roundings
    assert_array_equal(ConvexWall(radius).height(x, 0.0), -ConcaveWall(radius).height(x, 0.0))


@pytest.mark.parametrize(("wall", "exact"), WALLS.values(), ids=WALLS.keys())
def test_normal_is_unit_upward_and_across_the_slopes(wall, exact) -> None:
    x, y = np.array(POINTS).T
    normal, slopes = wall.normal(x, y), wall.derivatives(x, y)
    assert np.linalg.norm(normal, axis=-1) == approx(1.0, rel=1e-15)
    assert (normal[:, 2] > 0).all()
    for axis in (0, 1):
        tangent = np.zeros((len(x), 3))
        tangent[:, axis], tangent[:, 2] = 1.0, slopes[:, 1 + axis]
        assert abs((normal * tangent).sum(-1)).max() < 1e-15  # rounding


def test_no_height_beyond_the_rim() -> None:
    with pytest.raises(SceneError, match=r"no height at x = 1\.5 m, y = 0 m; stay inside"):
        ConcaveWall(1.0).height([0.5, 1.5], 0.0)
    assert ConcaveWall(1.0, shape="cylinder", axis="x").height(1.5, 0.0) == 0.0


def test_max_curvature_bounds_and_is_reached() -> None:
    """Second derivatives of waves reach amplitude k^2; a sphere's curvature is 1/R."""
    x = np.linspace(-0.3, 0.3, 2001)
    wall = WavyWall(1e-4, 0.25, 0.7)
    bend = abs(wall.derivatives(x, 0.0)[:, 3])
    assert bend.max() <= wall.max_curvature
    assert bend.max() == approx(wall.max_curvature, rel=1e-4)  # the crest lies between samples
    assert ConvexWall(4.0).max_curvature == 0.25
    assert SumWall(wall, ConvexWall(4.0)).max_curvature == wall.max_curvature + 0.25
    assert FlatWall().max_curvature == 0.0


def distance_to_surface(wall, points):
    """Distance along the wall's normal, by a few Newton steps on the foot point."""
    foot = points.copy()
    for _ in range(5):
        height = wall.height(foot[:, 0], foot[:, 1])
        normal = wall.normal(foot[:, 0], foot[:, 1])
        on_wall = np.column_stack([foot[:, :2], height])
        along = ((points - on_wall) * normal).sum(-1)
        foot = points - along[:, None] * normal
    return abs(along)


MESHED = {
    "concave": ConcaveWall(2.0, size=(1.0, 0.6)),
    "steep": ConvexWall(0.5, size=0.6),
    "cylinder": ConcaveWall(0.4, shape="cylinder", size=(0.7, 0.3)),
    "wave": WavyWall(1e-3, 0.2, 0.3, direction=0.6, size=0.5),
    "sum": SumWall(WavyWall(1e-3, 0.2), ConvexWall(1.0), size=(0.5, 0.4)),
}


@pytest.mark.parametrize("wall", MESHED.values(), ids=MESHED.keys())
@pytest.mark.parametrize("bound", [1e-3, 5e-5])
def test_mesh_stays_within_its_sag_error(wall, bound: float) -> None:
    mesh = wall.to_mesh(max_sag_error=bound)
    assert abs(mesh.vertices[:, 2] - wall.height(*mesh.vertices.T[:2])).max() < 1e-15
    assert mesh.bounds[:, :2] == approx(np.array([[-0.5], [0.5]]) * wall.size)
    assert (mesh.face_normals[:, 2] > 0).all()
    # the worst points of a triangle are its middle and the middles of its sides
    shares = np.array([[1, 1, 1], [0, 1, 1], [1, 0, 1], [1, 1, 0]], dtype=float)
    shares /= shares.sum(1, keepdims=True)
    points = np.einsum("sk,fkx->sfx", shares, mesh.triangles).reshape(-1, 3)
    worst = distance_to_surface(wall, points).max()
    assert worst <= bound
    # nor wasteful: cells are whole, right for the steepest place, and at most a quarter wave wide
    assert worst > bound / 40 or wall.finest_period < math.inf


def test_mesh_errors() -> None:
    with pytest.raises(SceneError, match="unbounded wall has no mesh; give the wall a size"):
        ConcaveWall(5.0).to_mesh(max_sag_error=1e-6)
    with pytest.raises(SceneError, match="max_sag_error = 0 m is out of range"):
        ConcaveWall(5.0, size=1.0).to_mesh(max_sag_error=0)
    with pytest.raises(MemoryLimitError, match=r"needs .* GiB, limit .* GiB; allow a larger sag"):
        ConcaveWall(5.0, size=1.0).to_mesh(max_sag_error=1e-16)
    with pytest.raises(SceneError, match="exceeds a summand's radius; shrink it"):
        SumWall(ConcaveWall(0.5), size=2.0).to_mesh(max_sag_error=1e-6)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: FlatWall(size=-1.0), r"wall.size\[x\] = -1 m .* must be above 0"),
        (lambda: ConcaveWall(-2.0), "wall.radius = -2 m .* must be above 0 m"),
        (lambda: ConvexWall(2.0, shape="torus"), "wall.shape = 'torus' .* sphere, cylinder"),
        (lambda: WavyWall(math.inf, 1.0), "wall.amplitude = inf is not finite"),
    ],
)
def test_bad_walls(make, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        make()


@pytest.mark.parametrize("wall", [FlatWall(), ConcaveWall(2.0), WavyWall(1e-5, 0.3)])
@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_no_height_at_nowhere(wall, bad):
    with pytest.raises(SceneError, match="NaN or infinity"):
        wall.height(bad, 0.0)
    with pytest.raises(SceneError, match="NaN or infinity"):
        wall.normal([0.0, 0.1], [0.0, bad])
