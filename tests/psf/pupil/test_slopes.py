"""Wave fronts from slopes, and from the facets of a rough wall."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx
from scipy import fft, ndimage

from nlosoptics import psf
from nlosoptics.errors import SceneError
from nlosoptics.psf.pupil import wall_view
from nlosoptics.psf.pupil.slope_integration import slope_filter
from nlosoptics.raytrace.fans.footprints import lens_footprint
from nlosoptics.scene import (
    ConcaveWall,
    ConvexWall,
    FlatWall,
    HeightMapWall,
    SumWall,
    WavyWall,
)

SYSTEM = {"wavelength": 632.8e-9, "image_distance": 50e-3}
RADIUS = 12.5e-3


def axes(n):
    pitch = 2 * RADIUS / n
    axis = (np.arange(n) - n // 2) * pitch
    v, u = np.meshgrid(axis, axis, indexing="ij")
    return u, v, pitch


def masks(n):
    u, v, _ = axes(n)
    r = np.hypot(u, v) / RADIUS
    return {
        "rectangle": np.ones_like(r, dtype=bool),
        "disc": r < 0.98,
        "ring": (r < 0.98) & (r > 0.4),
        "halves": (r < 0.98) & (abs(u) > 0.1 * RADIUS),
        "spots": ndimage.gaussian_filter(np.random.default_rng(2).normal(size=(n, n)), 1.5) > 0,
        "line": (v == 0) & (r < 0.98),
    }


SHAPES = tuple(masks(8))


def quadratic(u, v):
    """A sum of Zernike terms up to astigmatism, m, and its gradient."""
    x, y = u / RADIUS, v / RADIUS
    height = 1e-6 * (3 * x - y + 2 * (2 * (x * x + y * y) - 1) + 1.5 * (x * x - y * y) + 4 * x * y)
    du = 1e-6 * (3 + 8 * x + 3 * x + 4 * y) / RADIUS
    dv = 1e-6 * (-1 + 8 * y - 3 * y + 4 * x) / RADIUS
    return height, np.stack([du, dv], axis=-1)


def by_pieces(values, mask):
    """Values less their mean over every piece of the mask, 0 beside it."""
    pieces, count = ndimage.label(mask)
    out = np.zeros_like(values)
    for i in range(1, count + 1):
        here = pieces == i
        out[here] = values[here] - values[here].mean()
    return out


@pytest.mark.parametrize("n", [32, 65])
@pytest.mark.parametrize("shape", SHAPES)
def test_quadratics_come_back_exactly(shape, n):
    u, v, pitch = axes(n)
    mask = masks(n)[shape]
    height, slopes = quadratic(u, v)
    wave, residual = psf.wavefront_from_slopes(slopes, pitch, mask, **SYSTEM)
    # rounding, amplified by the number of steps across
    assert wave.aberration == approx(by_pieces(height, mask), abs=1e-13 * abs(height).max())
    assert residual < 1e-13 * abs(slopes).max()
    assert np.array_equal(wave.amplitude > 0, mask)
    assert np.array_equal(wave.u, u)
    assert np.array_equal(wave.v, v)


@pytest.mark.parametrize(("index", "degree"), [(8, 3), (11, 4), (14, 4)])
def test_higher_orders_converge_in_second_order(index, degree):
    """Noll terms, their slopes by exact differences of the polynomial in the complex plane."""

    def term(x, y):
        return psf.zernike(index, np.hypot(x, y), np.arctan2(y, x))

    errors, residuals = [], []
    for n in (33, 65, 129):
        u, v, pitch = axes(n)
        mask = np.hypot(u, v) < 0.98 * RADIUS
        x, y = u / RADIUS, v / RADIUS

        # differences over +-1 and +-1/2 by Richardson are exact for polynomials up to degree 4
        def slope(dx, dy, x=x, y=y):
            wide = (term(x + dx, y + dy) - term(x - dx, y - dy)) / 2
            half = term(x + dx / 2, y + dy / 2) - term(x - dx / 2, y - dy / 2)
            return (4 * half - wide) / 3

        slopes = 1e-6 * np.stack([slope(1, 0), slope(0, 1)], axis=-1) / RADIUS
        wave, residual = psf.wavefront_from_slopes(slopes, pitch, mask, **SYSTEM)
        errors.append(np.abs(wave.aberration - by_pieces(1e-6 * term(x, y), mask)).max())
        residuals.append(residual)
    # degree 3 and 4: the trapezoid's error is pitch^2 W'''/12, with edges that move by a node
    assert np.log2(errors[0] / errors[1]) == approx(2, abs=0.25)
    assert np.log2(errors[1] / errors[2]) == approx(2, abs=0.15)
    # what is no gradient of it falls likewise, or is 0
    assert residuals[2] < 0.3 * residuals[1] + 1e-18


@pytest.mark.parametrize("shape", SHAPES)
def test_random_slopes_against_dense_least_squares(shape):
    mask = masks(10)[shape]
    mask[0, 0], mask[0, 1], mask[1, 0] = True, False, False  # a piece of a single node
    rng = np.random.default_rng(5)
    slopes = rng.normal(size=(*mask.shape, 2))
    matrix, right = dense(mask, slopes, 0.3)
    least = np.linalg.lstsq(matrix, right, rcond=None)[0]
    expected = np.zeros(mask.shape)
    expected[mask] = least
    surface, residual = psf.integrated_slopes(slopes, 0.3, mask)
    # the dense solution's own rounding
    assert surface == approx(by_pieces(expected, mask), abs=1e-12)
    misfit = (matrix @ least - right) / 0.3
    assert residual == approx(np.sqrt(np.mean(misfit**2)), rel=1e-12)


def dense(mask, slopes, pitch):
    """Differences of neighbours as a matrix, and what they should be."""
    number = np.full(mask.shape, -1)
    number[mask] = np.arange(mask.sum())
    rows, right = [], []
    for i, j in np.argwhere(mask):
        for k, (a, b) in enumerate(((i, j + 1), (i + 1, j))):
            if a < mask.shape[0] and b < mask.shape[1] and mask[a, b]:
                row = np.zeros(mask.sum())
                row[number[a, b]], row[number[i, j]] = 1, -1
                rows.append(row)
                right.append(pitch * (slopes[i, j, k] + slopes[a, b, k]) / 2)
    return np.array(rows), np.array(right)


def test_curl_residual_of_independent_slopes():
    """Its mean square over many draws is that of the projection on all that is no gradient."""
    mask = masks(16)["disc"]
    count = int(mask.sum())
    matrix, _ = dense(mask, np.zeros((*mask.shape, 2)), 1.0)
    # slopes (2 count) to differences
    columns = []
    for k in range(2 * count):
        unit = np.zeros((*mask.shape, 2))
        flat = np.zeros(2 * count)
        flat[k] = 1.0
        unit[mask] = flat.reshape(count, 2)
        columns.append(dense(mask, unit, 1.0)[1])
    averages = np.array(columns).T
    projector = np.eye(len(matrix)) - matrix @ np.linalg.pinv(matrix)
    form = averages.T @ projector @ averages / len(matrix)
    mean, variance = np.trace(form), 2 * np.trace(form @ form)  # of a Gaussian quadratic form
    rng = np.random.default_rng(3)
    squares = [
        psf.integrated_slopes(0.1 * rng.normal(size=(*mask.shape, 2)), 1.0, mask)[1] ** 2
        for _ in range(300)
    ]
    assert np.mean(squares) / 0.01 == approx(mean, abs=4 * math.sqrt(variance / 300))


def test_curl_residual_of_white_slopes_on_a_wide_grid():
    """Far from edges, wave by wave: the share of the averaged slopes across the gradient."""
    n = 256
    k = 2 * np.pi * (np.arange(n) + 0.5) / n
    x, y = k, k[:, None]
    a, b = np.sin(x / 2) ** 2, np.sin(y / 2) ** 2
    share = (b * np.cos(x / 2) ** 2 + a * np.cos(y / 2) ** 2) / (a + b)
    expected = math.sqrt(share.mean() / 2)
    slopes = np.random.default_rng(8).normal(size=(n, n, 2))
    _, residual = psf.integrated_slopes(slopes, 1.0, np.ones((n, n), dtype=bool))
    # the frame of the grid is 4/n of it; the draw's own scatter is 1/n
    assert residual == approx(expected, rel=8 / n)


def test_pieces_do_not_see_each_other():
    mask = masks(48)["halves"]
    pieces, count = ndimage.label(mask)
    assert count == 2
    slopes = np.random.default_rng(1).normal(size=(48, 48, 2))
    together, _ = psf.integrated_slopes(slopes, 1.0, mask)
    for i in (1, 2):
        alone, _ = psf.integrated_slopes(slopes, 1.0, pieces == i)
        assert together[pieces == i] == approx(alone[pieces == i], abs=1e-12 * abs(alone).max())
        assert together[pieces == i].mean() == approx(0, abs=1e-13)


def test_what_lies_beside_the_mask_is_not_read():
    u, v, pitch = axes(32)
    mask = masks(32)["disc"]
    _, slopes = quadratic(u, v)
    expected, _ = psf.integrated_slopes(slopes, pitch, mask)
    slopes[~mask] = np.nan
    found, _ = psf.integrated_slopes(slopes, pitch, mask)
    assert np.array_equal(found, expected)


def test_threads_change_no_bit():
    mask = masks(200)["disc"]
    slopes = np.random.default_rng(1).normal(size=(200, 200, 2))
    one, residual = psf.integrated_slopes(slopes, 1.0, mask)
    with fft.set_workers(2):
        two, again = psf.integrated_slopes(slopes, 1.0, mask)
    assert np.array_equal(one, two)
    assert residual == again


def test_tilt_moves_the_spot_to_its_side():
    """W = a u lands at x = +a d_i."""
    slopes = np.zeros((64, 64, 2))
    slopes[..., 0] = 2e-4
    wave, _ = psf.wavefront_from_slopes(slopes, 4e-4, np.ones((64, 64), dtype=bool), **SYSTEM)
    spread = psf.point_spread(wave, method="fft")
    n = spread.intensity.shape[0]
    x = (np.arange(n) - n // 2) * spread.pitch
    peak = x[np.argmax(spread.intensity.sum(axis=0))]
    assert peak == approx(2e-4 * SYSTEM["image_distance"], abs=spread.pitch)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"slopes": np.zeros((4, 4))}, r"slopes have shape \(4, 4\) and mask \(4, 4\)"),
        ({"slopes": np.zeros((4, 4, 3))}, r"slopes have shape \(4, 4, 3\)"),
        ({"slopes": np.zeros((4, 5, 2)), "mask": np.ones((4, 5), bool)}, "grid is square"),
        ({"mask": np.ones((4, 5), bool)}, r"mask \(4, 5\)"),
        ({"mask": np.zeros((4, 4), bool)}, "mask is false everywhere"),
        ({"mask": np.ones((4, 4))}, "mask holds float64; give booleans"),
        ({"slopes": np.full((4, 4, 2), np.nan)}, r"slopes\[0, 0\] hold NaN"),
        ({"slopes": "steep"}, "not an array of real numbers"),
        ({"pitch": 0.0}, "pitch = 0 m is out of range"),
        ({"pitch": -1.0}, "pitch = -1 m is out of range"),
        ({"pitch": "wide"}, "pitch"),
        ({"wavelength": 0.6}, "wavelength = 0.6 m is out of range"),
        ({"image_distance": 0.0}, "image_distance = 0 m"),
    ],
)
def test_bad_slopes_are_refused(change, message):
    arguments = {"slopes": np.zeros((4, 4, 2)), "pitch": 1e-3, "mask": np.ones((4, 4), bool)}
    with pytest.raises(SceneError, match=message):
        psf.wavefront_from_slopes(**(arguments | SYSTEM | change))


# ---------------------------------------------------------------- facets to the pupil

MEANS = [
    FlatWall(),
    ConcaveWall(5.0),
    ConvexWall(0.8),
    ConcaveWall(4.0, shape="cylinder", axis="x"),
    WavyWall(2e-4, 0.5, 0.4, direction=0.7),
]


def few_nodes(count, seed=0):
    return np.random.default_rng(seed).uniform(-8e-3, 8e-3, (count, 2))


@pytest.mark.parametrize("wall", MEANS, ids=lambda w: type(w).__name__)
def test_footprint_is_how_the_seen_point_moves(flat_scene, wall):
    """M against differences of aimed points."""
    scene = replace(flat_scene, wall=wall)
    nodes, step = few_nodes(12), 1e-5
    optics = wall_view._optics(scene, nodes)
    tangents, _, _ = wall_view._wall_frames(wall, optics.points)
    for k, shift in enumerate(np.eye(2) * step):
        ahead, back = (wall_view._optics(scene, nodes + s * shift).points for s in (1, -1))
        moved = np.einsum("nak,nk->na", tangents, ahead - back) / (2 * step)
        # step^2 over squared distances, and rounding 1e-16/step
        assert optics.footprint[:, :, k] == approx(moved, abs=2e-8)


@pytest.mark.parametrize("wall", MEANS, ids=lambda w: type(w).__name__)
def test_pupil_slopes_are_those_of_a_tilted_wall(flat_scene, wall):
    """Against the change of W by a small wave that crosses zero where each node sees the wall."""
    scene = replace(flat_scene, wall=wall)
    camera, o = scene.camera, scene.object_point
    period, height, turn, step = 0.05, 1e-9, 0.6, 2e-4
    for node in few_nodes(4, seed=3):
        optics = wall_view._optics(scene, node[None])
        along = optics.points[0, :2] @ (math.cos(turn), math.sin(turn))
        phase = math.pi / 2 - 2 * math.pi * along / period
        bump = WavyWall(height, period, phase, direction=turn)
        both = SumWall(wall, bump)

        def added(nodes, both=both):
            return psf.wall_aberration(
                both, o, camera.position, camera.aim, nodes
            ) - psf.wall_aberration(wall, o, camera.position, camera.aim, nodes)

        offsets = np.array([[-2.0, 0], [-1, 0], [1, 0], [2, 0]]) * step
        rule = np.array([1, -8, 8, -1]) / (12 * step)
        expected = [rule @ added(node + offsets), rule @ added(node + offsets[:, ::-1])]
        tangents, normal, _ = wall_view._wall_frames(wall, optics.points)
        gradient = bump.derivatives(*optics.points[0, :2])[1:3]
        # a height along z is this much along the mean normal
        slope = tangents[0, :, :2] @ gradient * normal[0, 2]
        centre = optics.points[0]
        positions = centre + np.array([[[-1, -1, 0], [1, -1, 0]], [[-1, 1, 0], [1, 1, 0]]]) * 1e-3
        slopes = np.broadcast_to(slope, (2, 2, 2))
        found = psf.pupil_slopes(scene, slopes, positions, node[None])[0]
        # second order: height times (2 pi/period)^2 times distances, some 1e-5; the fourth-order
        # rule errs by (2 pi M step/period)^4/30
        assert found == approx(expected, abs=5e-5 * np.abs(expected).max())


def test_normal_incidence_is_twice_the_footprint(flat_scene):
    """dW/dp = -2 m s with m = d1/(d1 + d2); the camera's e1 is -x, its e2 y."""
    camera = replace(flat_scene.camera, position=(0, 0, 0.8), aim=(0, 0, 0))
    hidden = replace(flat_scene.hidden, position=(0, 0, 1.0))
    scene = replace(flat_scene, camera=camera, hidden=hidden)
    slopes = np.broadcast_to([1e-3, 3e-3], (2, 2, 2))
    positions = np.array([[[-1, -1, 0], [1, -1, 0]], [[-1, 1, 0], [1, 1, 0]]]) * 0.1
    found = psf.pupil_slopes(scene, slopes, positions, [[0.0, 0.0]])
    m = 1.0 / 1.8
    assert found[0] == approx([2 * m * 1e-3, -2 * m * 3e-3], rel=1e-14)


def facets(scene, cell, slope_rms):
    """Return random slopes and centres of cells that cover what the lens sees."""
    seen = lens_footprint(scene.wall, scene.object_point, scene.camera)
    axes = (
        np.arange(a // cell - 1, b // cell + 3) + 0.5
        for a, b in zip(seen.low, seen.high, strict=True)
    )
    x, y = np.meshgrid(*(cell * axis for axis in axes))
    slopes = np.random.default_rng(0).normal(scale=slope_rms, size=(*x.shape, 2))
    return slopes, np.stack([x, y, 0 * x], axis=-1)


def test_each_node_takes_the_facet_it_sees(flat_scene):
    slopes, positions = facets(flat_scene, 1e-3, 1e-4)
    nodes = few_nodes(900)  # none on an edge of a cell
    optics = wall_view._optics(flat_scene, nodes)
    near = np.linalg.norm(
        optics.points[:, None, :2] - positions.reshape(1, -1, 3)[..., :2], axis=-1, ord=np.inf
    ).argmin(axis=1)
    tilts = slopes.reshape(-1, 2)[near]
    expected = -optics.cosines[:, None] * np.einsum("nba,nb->na", optics.footprint, tilts)
    found = psf.pupil_slopes(flat_scene, slopes, positions, nodes)
    assert found == approx(expected, abs=1e-18)
    assert len(np.unique(near)) > 50


def test_gradients_of_a_height_map_leave_no_curl(flat_scene):
    """The same slope rms, once of one surface and once of independent facets."""
    height_rms, length = 2e-8, 4e-3
    slope_rms = math.sqrt(2) * height_rms / length
    rough = HeightMapWall.random(
        height_rms=height_rms, correlation_length=length, size=0.5, pitch=5e-4, seed=3
    )
    camera = flat_scene.camera
    residuals = []
    for samples in (33, 65, 129):
        u, v, weights = psf.grid_nodes(camera.stop_diameter / 2, samples)
        mask = weights > 1e-12 * weights.max()
        optics = wall_view._optics(flat_scene, np.stack([u[mask], v[mask]], axis=1))
        gradient = rough.derivatives(optics.points[:, 0], optics.points[:, 1])[:, 1:3]
        table = np.zeros((samples, samples, 2))
        # the cosines vary a little over the pupil, which adds some of h, not of its slope
        cosine = wall_view._optics(flat_scene, np.zeros((1, 2))).cosines[0]
        table[mask] = -cosine * np.einsum("nba,nb->na", optics.footprint, gradient)
        wave, residual = psf.wavefront_from_slopes(table, u[0, 1] - u[0, 0], mask, **SYSTEM)
        residuals.append(residual / slope_rms)
        height = -cosine * rough.height(optics.points[:, 0], optics.points[:, 1])
        error = wave.aberration[mask] - (height - height.mean())
        assert np.abs(error).max() < 0.1 * 33**2 / samples**2 * height_rms * 2 * 4
    # second order in the pitch, from 0.03 to 0.002; the surface is bicubic, its bends kinked
    assert residuals[0] / residuals[1] == approx(4, rel=0.2)
    assert residuals[1] / residuals[2] == approx(4, rel=0.2)
    assert residuals[2] < 3e-3
    slopes, positions = facets(flat_scene, 2.5e-4, slope_rms)
    nodes = np.stack([u[mask], v[mask]], axis=1)
    table[mask] = psf.pupil_slopes(flat_scene, slopes, positions, nodes)
    _, independent = psf.wavefront_from_slopes(table, u[0, 1] - u[0, 0], mask, **SYSTEM)
    assert independent / slope_rms > 50 * residuals[2]


def test_a_wall_that_is_the_stop(flat_scene):
    """Exit-pupil coordinates are those of the lens times the pupil's magnification."""
    x = flat_scene.camera.aim[0]
    scene = replace(flat_scene, wall=FlatWall(size=(2 * abs(x) + 0.006, 0.006)))
    pupil = psf.exit_pupil(scene)
    assert pupil.stop == "wall"
    zoom = pupil.image_distance / scene.image_distance
    wide = replace(scene, wall=FlatWall())
    slopes, positions = facets(wide, 1e-3, 1e-4)
    nodes = few_nodes(20) / 4
    on_lens = psf.pupil_slopes(wide, slopes, positions, nodes)
    found = psf.pupil_slopes(scene, slopes, positions, nodes * zoom)
    assert found == approx(on_lens / zoom, rel=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"slopes": np.zeros((3, 3))}, r"slopes have shape \(3, 3\)"),
        ({"positions": np.zeros((3, 3, 2))}, r"positions \(3, 3, 2\)"),
        ({"slopes": np.full((3, 3, 2), np.inf)}, "hold NaN or infinity"),
        ({"positions": np.zeros((3, 3, 3))}, "off a lattice"),
        ({"nodes": [[0.0, math.nan]]}, "give \\(n, 2\\) finite u and v"),
        ({"nodes": [0.0, 0.0]}, r"nodes have shape \(2,\)"),
        ({"nodes": [[0.5, 0.0]]}, "pupil node 0 sees the wall at x = .* beyond the cells"),
    ],
)
def test_bad_facets_are_refused(flat_scene, change, message):
    axis = np.array([-0.26, -0.16, -0.06])
    x, y = np.meshgrid(axis, axis + 0.16)
    arguments = {
        "slopes": np.zeros((3, 3, 2)),
        "positions": np.stack([x, y, 0 * x], axis=-1),
        "nodes": [[0.0, 0.0]],
    }
    assert not psf.pupil_slopes(flat_scene, **arguments).any()
    with pytest.raises(ValueError, match=message):
        psf.pupil_slopes(flat_scene, **(arguments | change))


@pytest.mark.parametrize("shape", [(6, 9), (9, 6), (2, 5)])
def test_filter_of_a_rectangle_is_the_least_squares_surface(shape):
    slopes = np.random.default_rng(4).normal(size=(*shape, 2))
    solve = slope_filter(shape)
    (cos_y, cos_x), (source_y, source_x) = solve.cosines, solve.sources
    along = cos_y @ slopes[..., 0] @ source_x.T + source_y @ slopes[..., 1] @ cos_x.T
    surface = 0.3 * cos_y.T @ (along * solve.inverse) @ cos_x
    expected, _ = psf.integrated_slopes(slopes, 0.3, np.ones(shape, dtype=bool))
    # rounding
    assert surface == approx(expected, abs=1e-13)
