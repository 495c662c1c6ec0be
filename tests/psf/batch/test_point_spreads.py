"""Batches of point spreads against closed forms, direct sums, single transforms, and gradients."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx
from scipy.special import j1

from nlosoptics import psf
from nlosoptics._checks import Budget, within
from nlosoptics.errors import MemoryLimitError, SamplingError, SceneError
from nlosoptics.psf.batch import batch_transform
from nlosoptics.psf.batch.chord_nodes import Need, chord_nodes
from nlosoptics.psf.batch.point_spreads import _Batch
from nlosoptics.psf.batch.polar_basis import PolarBasis
from nlosoptics.raytrace.intersection.meshes import worker_pool

WAVELENGTH, RADIUS, DISTANCE = 500e-9, 5e-3, 0.1
UNIT = WAVELENGTH * DISTANCE / (2 * RADIUS)  # lambda N
INDICES = tuple(range(2, 12))  # tilt to spherical aberration


def pupil(obscuration=0.0, uneven=False, distance=DISTANCE):
    """A polar wave that gives the pupil; its own aberration has no effect."""
    wave = psf.Wavefront.from_zernike(
        {5: 1e-7},
        wavelength=WAVELENGTH,
        pupil_radius=RADIUS,
        image_distance=distance,
        obscuration=obscuration,
    )
    if uneven:
        wave = replace(wave, amplitude=transmission(wave.u, wave.v))
    return wave


def transmission(u, v):
    """An amplitude without symmetry."""
    return 1 - 0.3 * (u / RADIUS) ** 2 - 0.2 * (v / RADIUS) + 0.1 * u * v / RADIUS**2


def modes(u, v):
    """Zernike polynomials of 1 rms at points u, v, (10, ...)."""
    r, angle = np.hypot(u, v) / RADIUS, np.arctan2(v, u)
    return np.array([psf.zernike(j, r, angle) for j in INDICES])


def waves(wave, count, rms=4e-8, seed=1):
    """Random coefficients, m, (count, 10), and the aberrations on the pupil's nodes."""
    heights = rms * np.random.default_rng(seed).normal(size=(count, len(INDICES)))
    return heights, np.einsum("wk,krt->wrt", heights, modes(wave.u, wave.v))


def dense(wave):
    """Coordinates and areas of 44 x 160 polar nodes.

    These are far more than a window of 12 Airy units needs: a sum has converged to rounding.
    """
    return psf.polar_nodes(RADIUS, 44, 160, wave.obscuration)


def direct(wave, paths, spreads, uneven=False, change=None):
    """The field by its definition, of paths on `dense` nodes, m, or its derivative by a change."""
    u, v, area = dense(wave)
    size = area * transmission(u, v) if uneven else area
    k = 2 * np.pi / WAVELENGTH
    ny, nx = spreads.intensity.shape[1:]
    x, y = (spreads.pitch * (np.arange(n) - n // 2) for n in (nx, ny))
    rate = -1j * k / wave.image_distance
    across = np.exp(rate * np.multiply.outer(x, u.ravel()))
    up = np.exp(rate * np.multiply.outer(y, v.ravel()))
    fields = []
    for i, path in enumerate(paths):
        lit = size * np.exp(1j * k * path) / size.sum()
        if change is not None:
            lit = lit * 1j * k * change[i]
        fields.append((up * lit.ravel()) @ across.T)
    return np.array(fields)


@pytest.mark.parametrize(
    ("obscuration", "uneven", "shape", "distance"),
    [
        (0.0, False, (48, 33), DISTANCE),
        (0.0, True, (31, 40), -DISTANCE),
        (0.35, True, (25, 46), DISTANCE),
        (0.9, False, (24, 24), DISTANCE),
    ],
)
def test_intensities_are_those_of_the_direct_sum(obscuration, uneven, shape, distance):
    wave = pupil(obscuration, uneven, distance)
    heights, given = waves(wave, 3)
    spreads = psf.point_spreads(wave, given, tol=1e-9, shape=shape, normalisation="ideal-peak")
    paths = np.tensordot(heights, modes(*dense(wave)[:2]), 1)
    exact = np.abs(direct(wave, paths, spreads, uneven)) ** 2
    error = np.abs(spreads.intensity - exact).max(axis=(1, 2)) / exact.max(axis=(1, 2))
    # rounding of 7,000 terms; the nodes converge well beyond what tol asks for
    assert error.max() < 2e-12
    assert (error < spreads.error_estimate).all()
    assert spreads.error_estimate.max() <= 1e-9


def test_no_aberration_is_the_airy_pattern():
    wave = pupil()
    spreads = psf.point_spreads(
        wave, np.zeros((1, *wave.u.shape)), tol=1e-9, normalisation="ideal-peak"
    )
    n = spreads.intensity.shape[1]
    axis = spreads.pitch * (np.arange(n) - n // 2)
    v = np.pi * np.hypot(axis, axis[:, None]) / UNIT
    v[n // 2, n // 2] = 1e-9
    assert n >= 256
    assert spreads.intensity[0] == approx((2 * j1(v) / v) ** 2, abs=1e-12)  # rounding


@pytest.mark.parametrize("normalisation", ["unit-sum", "flux", "ideal-peak"])
@pytest.mark.parametrize("pixel_integrated", [False, True])
def test_agrees_with_single_point_spreads(normalisation, pixel_integrated):
    wave = pupil(0.3, uneven=True)
    _, given = waves(wave, 2)
    options = {
        "pitch": 0.45 * UNIT,
        "shape": (30, 41),
        "normalisation": normalisation,
        "pixel_integrated": pixel_integrated,
        "tol": 1e-8,
    }
    spreads = psf.point_spreads(wave, given, **options)
    for i in range(2):
        one = psf.point_spread(replace(wave, aberration=given[i]), method="quadrature", **options)
        difference = np.abs(spreads.intensity[i] - one.intensity).max() / one.intensity.max()
        assert difference <= one.error_estimate + spreads.error_estimate[i]


def test_default_window_holds_the_rays_of_the_steepest_wave():
    wave = pupil()
    defocus = modes(wave.u, wave.v)[2]
    given = np.array([0.0, 1e-6])[:, None, None] * defocus
    spreads = psf.point_spreads(wave, given)
    energy = spreads.intensity.sum(axis=(1, 2))
    # rays of W = c 2 sqrt(3) (r/R)^2 land up to c 4 sqrt(3) d/R; about 1 % is left to the tails
    assert (
        spreads.intensity.shape[1] * spreads.pitch > 2 * 1e-6 * 4 * np.sqrt(3) * DISTANCE / RADIUS
    )
    assert (energy > 0.985).all()
    assert (energy < 1.0).all()


@pytest.mark.parametrize("obscuration", [0.0, 0.05, 0.4, 0.8])
def test_chord_nodes_converge_as_predicted(obscuration):
    """Field of random fourth-degree waves against three times as many digits."""
    rng = np.random.default_rng(3)
    for half, digits in ((3.0, 4.0), (20.0, 2.0), (20.0, 6.0), (20.0, 9.0)):
        x = np.pi * half
        heights = rng.normal(size=6)
        terms = [4, 5, 6, 7, 8, 11]

        def phase(u, v, heights=heights, terms=terms):
            r, a = np.hypot(u, v), np.arctan2(v, u)
            return sum(h * psf.zernike(j, r, a) for h, j in zip(heights, terms, strict=True))

        t = np.linspace(0, 2 * np.pi, 181)
        u, v = np.cos(t) * np.linspace(obscuration, 1, 15)[:, None], np.sin(t)
        v = v * np.linspace(obscuration, 1, 15)[:, None]
        slope = (
            np.hypot(
                *(phase(u + h, v + k) - phase(u - h, v - k) for h, k in ((5e-5, 0), (0, 5e-5)))
            ).max()
            / 1e-4
        )

        def field(need, x=x, phase=phase):
            nodes = chord_nodes(obscuration, need)
            a = np.concatenate([nodes.u, -nodes.u, nodes.u, -nodes.u])
            b = np.concatenate([nodes.heights, nodes.heights, -nodes.heights, -nodes.heights])
            weights = np.tile(nodes.weights, 4)
            assert weights.sum() == approx(np.pi * (1 - obscuration**2), rel=1e-12)
            lit = weights * np.exp(1j * phase(a, b)) / weights.sum()
            points = x * np.array([(1, 1), (-1, 1), (0.3, -1), (0, 0.2), (0.05, 0)])
            return np.exp(-1j * (points @ np.stack([a, b]))) @ lit

        found = field(Need(x + slope, x * np.sqrt(2) + slope, 4, digits))
        exact = field(Need(1.5 * x + slope, 2.2 * x + slope, 12, 15.0))
        assert np.abs(found - exact).max() < 10.0**-digits


# gradients


@pytest.mark.parametrize(
    ("obscuration", "shape", "pixel_integrated"),
    [(0.0, (24, 31), False), (0.35, (33, 20), False), (0.0, (17, 12), True)],
)
def test_gradient_is_the_adjoint_of_the_tangent(obscuration, shape, pixel_integrated):
    """<J c, g> = <c, J' g>, with J c from direct sums, averaged over pixels like an intensity."""
    wave = pupil(obscuration, uneven=True)
    heights, given = waves(wave, 3)
    change, _ = waves(wave, 3, rms=1e-8, seed=2)
    rng = np.random.default_rng(4)
    options = {"shape": shape, "normalisation": "ideal-peak", "tol": 1e-6}
    pitch = 0.4 * UNIT
    spreads = psf.point_spreads(
        wave, given, pitch=pitch, pixel_integrated=pixel_integrated, **options
    )
    weights = rng.normal(size=spreads.intensity.shape)
    nodes, shares = np.zeros(1), np.ones(1)
    if pixel_integrated:  # Gauss's rule integrates over 0.4 lambda N to rounding
        nodes, shares = np.polynomial.legendre.leggauss(6)
        nodes, shares = pitch * nodes / 2, shares / 2
    u, v, _ = dense(wave)
    terms = modes(u, v)
    paths, changes = (np.tensordot(one, terms, 1) for one in (heights, change))
    tangent = np.zeros(spreads.intensity.shape)
    for dx, wx in zip(nodes, shares, strict=True):
        for dy, wy in zip(nodes, shares, strict=True):
            moved = paths - (dx * u + dy * v) / DISTANCE  # a tilt shows points further by dx, dy
            field = direct(wave, moved, spreads, True)
            slope = direct(wave, moved, spreads, True, changes)
            tangent += wx * wy * 2 * (field.conj() * slope).real
    left = np.sum(tangent * weights)
    gradient = spreads.aberration_gradient(weights)
    on_modes = np.einsum("wrt,krt->wk", gradient, modes(wave.u, wave.v))
    size = np.linalg.norm(tangent) * np.linalg.norm(weights)
    # rounding of both sums; pixel means have an error of 4e-11
    assert abs(left - np.sum(on_modes * change)) < (1e-9 if pixel_integrated else 1e-12) * size


@pytest.mark.parametrize("obscuration", [0.0, 0.3])
def test_gradient_holds_for_every_polynomial_of_its_degree(obscuration):
    """All Zernike polynomials up to degree 10 against direct sums of each."""
    wave = pupil(obscuration)
    heights, given = waves(wave, 1)
    weights = np.random.default_rng(5).normal(size=(1, 20, 20))
    spreads = psf.point_spreads(
        wave, given, tol=1e-6, shape=20, pitch=UNIT / 4, normalisation="ideal-peak"
    )
    gradient = spreads.aberration_gradient(weights, degree=10)
    u, v, _ = dense(wave)
    paths = np.tensordot(heights, modes(u, v), 1)
    field = direct(wave, paths, spreads)
    slopes, found = [], []
    for j in (*range(1, 12), 36, 37, 51, 65, 66):
        terms = [
            psf.zernike(j, np.hypot(a, b) / RADIUS, np.arctan2(b, a))
            for a, b in ((u, v), (wave.u, wave.v))
        ]
        change = 2 * (field.conj() * direct(wave, paths, spreads, change=terms[:1])).real
        slopes.append(np.sum(change * weights))
        found.append(np.sum(gradient * terms[1]))
    assert slopes[0] == approx(0.0, abs=1e-12 * max(np.abs(slopes)))  # piston
    assert found == approx(slopes, abs=1e-11 * max(np.abs(slopes)))  # rounding
    # its density has no other terms: the projection onto them changes nothing
    density = gradient[0] / wave.weights
    basis = np.array(
        [
            psf.zernike(j, np.hypot(wave.u, wave.v) / RADIUS, np.arctan2(wave.v, wave.u))
            for j in range(1, 67)
        ]
    ).reshape(66, -1)
    fit = np.linalg.lstsq(basis.T, density.ravel(), rcond=None)[0] @ basis
    assert fit == approx(density.ravel(), abs=1e-10 * np.abs(density).max())


def test_gradient_is_the_slope_of_the_batch():
    """A loss of the library's own intensities, by central differences along a mode."""
    wave = pupil()
    _, given = waves(wave, 2)
    mode = modes(wave.u, wave.v)[5]
    target = np.random.default_rng(6).normal(size=(2, 20, 20))

    def spreads(step):
        return psf.point_spreads(wave, given + step * mode, tol=1e-7, shape=20)

    def loss(step):
        return np.sum(spreads(step).intensity ** 2 * target)

    middle = spreads(0.0)
    slope = np.sum(middle.aberration_gradient(2 * middle.intensity * target) * mode)
    step = 1e-11
    # second order in k times the step, 1e-4; rounding of the difference 1e-16/1e-4
    assert (loss(step) - loss(-step)) / (2 * step) == approx(slope, rel=1e-7)


def test_a_coarse_tol_takes_single_precision():
    """Intensities and gradients of both precisions, within the claimed errors."""
    wave = pupil(0.2, uneven=True)
    _, given = waves(wave, 6)
    options = {"shape": (60, 64), "normalisation": "ideal-peak"}
    coarse = psf.point_spreads(wave, given, tol=1e-3, **options)
    fine = psf.point_spreads(wave, given, tol=1e-8, **options)
    peaks = fine.intensity.max(axis=(1, 2))
    difference = np.abs(coarse.intensity - fine.intensity).max(axis=(1, 2)) / peaks
    assert difference.max() > 1e-10  # it is single precision
    assert (difference < coarse.error_estimate / 5).all()  # measured 2e-7, claimed 5e-6 or more
    weights = np.random.default_rng(9).normal(size=fine.intensity.shape)
    exact = fine.aberration_gradient(weights)
    off = np.linalg.norm(coarse.aberration_gradient(weights) - exact) / np.linalg.norm(exact)
    assert off < 1e-5  # thousands of terms of rounding 6e-8 with random signs


def test_a_window_beside_the_spot_is_computed_more_accurately():
    """A tilt of 8 waves puts the spot far outside; errors are relative to the window's peak."""
    wave = pupil()
    _, given = waves(wave, 2)
    given += 8 * WAVELENGTH * wave.u / RADIUS
    spreads = psf.point_spreads(wave, given, tol=1e-3, shape=20)
    fine = psf.point_spreads(wave, given, tol=1e-8, shape=20)
    peaks = fine.intensity.max(axis=(1, 2))
    assert peaks.max() < 1e-5  # of the energy; about 0.05 at the spot
    assert spreads.error_estimate.max() <= 1e-3
    difference = np.abs(spreads.intensity - fine.intensity).max(axis=(1, 2)) / peaks
    assert (difference < spreads.error_estimate).all()
    assert 0.0 < spreads.accuracy < 1e-6  # no longer the first accuracy, of about 6e-5


def test_wide_spots_are_computed_once(monkeypatch):
    """Defocus over 30 Airy units: the accuracy that is chosen first suffices for dim light."""
    wave, passes, plan = pupil(), [], _Batch.plan

    def counted(batch, *given, **options):
        passes.append(batch.core)
        return plan(batch, *given, **options)

    monkeypatch.setattr(_Batch, "plan", counted)
    defocus = 4 * WAVELENGTH * (wave.u**2 + wave.v**2) / RADIUS**2
    spreads = psf.point_spreads(
        wave, defocus[None], shape=130, tol=1e-4, normalisation="ideal-peak"
    )
    peak = spreads.intensity.max()
    assert peak < 0.02
    assert len(passes) == 1
    assert spreads.error_estimate.max() <= 1e-4
    assert passes[0] < 1e-4 * peak**0.5 / 2  # I = |E|^2: an error of E counts 2 / sqrt(I) times


# batches as such


def test_bits_do_not_depend_on_threads(monkeypatch):
    wave = pupil()
    _, given = waves(wave, 2 * batch_transform.BLOCK + 3)
    weights = np.random.default_rng(6).normal(size=(len(given), 16, 19))
    found = []
    for count in (1, 3):
        monkeypatch.setattr(batch_transform, "threads", lambda count=count: count)
        spreads = psf.point_spreads(wave, given, shape=(16, 19))
        found.append((spreads.intensity, spreads.aberration_gradient(weights)))
    assert np.array_equal(found[0][0], found[1][0])
    assert np.array_equal(found[0][1], found[1][1])


@pytest.mark.parametrize("count", [3, 2 * batch_transform.BLOCK + 1])
def test_stated_memory_is_that_of_the_threads_with_waves(count, memory_of, monkeypatch):
    wave = pupil()
    _, given = waves(wave, count)
    weights, stated = np.ones((count, 40, 50)), []
    for threads in (1, 3, 64):
        monkeypatch.setattr(batch_transform, "threads", lambda threads=threads: threads)
        spreads = psf.point_spreads(wave, given, shape=(40, 50))
        for call in (
            lambda: psf.point_spreads(wave, given, shape=(40, 50)),
            lambda spreads=spreads: spreads.aberration_gradient(weights),
        ):
            taken, told = memory_of(call)
            # helpers may be too slow to take a block of their own
            assert 0.25 * told < taken <= told
            stated.append(told)
    # three blocks of waves keep no more than three threads busy
    assert stated[2:4] == stated[4:]
    assert (stated[:2] == stated[2:4]) == (count == 3)


def test_batches_on_every_thread_of_the_pool_end():
    """A batch called from a thread of the pool that it shares does not wait for itself."""
    wave = pupil()
    _, given = waves(wave, 2 * batch_transform.BLOCK)

    def run(_):
        return psf.point_spreads(wave, given, shape=8).intensity

    found = list(worker_pool().map(run, range(6), timeout=60))
    assert all(np.array_equal(one, found[0]) for one in found)


def test_results_travel_and_fill_a_given_array():
    wave = pupil()
    _, given = waves(wave, 2)
    out = np.full((2, 10, 12), np.nan)
    spreads = psf.point_spreads(wave, given, shape=(10, 12), out=out)
    assert np.shares_memory(spreads.intensity, out)
    assert out.flags.writeable
    copied = pickle.loads(pickle.dumps(spreads))
    assert not copied.intensity.flags.writeable
    weights = np.ones((2, 10, 12))
    again = copied.aberration_gradient(weights)
    assert np.array_equal(again, spreads.aberration_gradient(weights))
    given[:] = 0.0  # the caller's array is his own
    assert np.array_equal(again, spreads.aberration_gradient(weights))


def test_series_returns_its_samples():
    """The basis at the polar nodes themselves, for even and odd numbers of angles."""
    rng = np.random.default_rng(7)
    for n_theta in (13, 12):
        u, v, _ = psf.polar_nodes(1.0, 5, n_theta, 0.2)
        values = rng.normal(size=(2, 5, n_theta))
        basis = PolarBasis(5, n_theta, 0.2)
        terms = basis.at(u.ravel(), v.ravel())
        parts = basis.analysed(values)
        back = sum(a.reshape(2, -1) @ b for a, b in zip(parts, terms, strict=True))
        assert back.reshape(values.shape) == approx(values, abs=1e-12)  # rounding of 60 terms


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"aberrations": np.zeros((2, 3, 4))}, SceneError, r"shape \(2, 3, 4\); give \(waves, 24"),
        ({"aberrations": np.zeros((0, 24, 96))}, SceneError, "one or more waves"),
        ({"aberrations": np.full((1, 24, 96), np.nan)}, SceneError, r"= nan at \(0, 0, 0\)"),
        ({"aberrations": np.ones((1, 24, 96)) * 1j}, SceneError, "real values"),
        ({"tol": 0.0}, SceneError, "tol = 0 is out of range"),
        ({"shape": 0}, SceneError, "shape"),
        ({"pitch": UNIT}, SamplingError, "wider than the Nyquist pitch"),
        ({"out": np.zeros((2, 8, 8))}, SceneError, r"give a float64 array of shape \(1, 8, 8\)"),
        ({"out": np.zeros((1, 8, 16))[:, :, ::2]}, SceneError, "not contiguous"),
        ({"normalisation": "peak"}, SceneError, "normalisation = 'peak'"),
    ],
)
def test_bad_input_is_refused(change, error, words):
    wave = pupil()
    options = {"aberrations": np.zeros((1, *wave.u.shape)), "shape": 8, **change}
    with pytest.raises(error, match=words):
        psf.point_spreads(wave, **options)


def test_waves_that_nodes_do_not_sample_are_refused():
    wave = pupil()
    given = np.zeros((3, *wave.u.shape))
    given[1] = 2e-8 * np.random.default_rng(8).normal(size=wave.u.shape)
    with pytest.raises(SamplingError, match=r"aberrations\[1\] has an error .* more pupil nodes"):
        psf.point_spreads(wave, given, shape=16)


def test_other_layouts_and_large_batches_are_refused():
    grid = psf.Wavefront.from_zernike(
        {},
        wavelength=WAVELENGTH,
        pupil_radius=RADIUS,
        image_distance=DISTANCE,
        nodes="grid",
        samples=16,
    )
    with pytest.raises(SamplingError, match="layout 'grid', limit 'polar'"):
        psf.point_spreads(grid, np.zeros((1, 16, 16)))
    wave = pupil()
    given = np.zeros((4, *wave.u.shape))
    with (
        within(Budget(memory=1e8, seconds=60.0)),
        pytest.raises(MemoryLimitError, match="4 x 2048 x 2048 values .* fewer waves"),
    ):
        psf.point_spreads(wave, given, shape=2048)
    spreads = psf.point_spreads(wave, given, shape=8)
    with pytest.raises(SamplingError, match=r"shape \(4, 8, 9\); give \(4, 8, 8\)"):
        spreads.aberration_gradient(np.zeros((4, 8, 9)))
    with pytest.raises(SamplingError, match="degree = 47, limit 46 for 24 x 96 pupil nodes"):
        spreads.aberration_gradient(np.zeros((4, 8, 8)), degree=47)
