"""Waves without their tilt against sums over their nodes, and the limits of sampled waves."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.psf.wave.detilted import split
from nlosoptics.psf.wave.regime import regime
from nlosoptics.psf.wave.sampling import nodes_of, polar_counts

WAVELENGTH, RADIUS, DISTANCE = 5.3e-7, 4e-3, -0.07
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": DISTANCE}
PENTAGON = psf.Aperture.regular(5, 3.5e-3, 0.2)
TILT = (4e-5, -7e-5)


def path(u, v):
    return 3e-7 + TILT[0] * u + TILT[1] * v + 4e-3 * u * u - 6e-3 * u * v + 0.5 * v**3


def gradient(u, v):
    return TILT[0] + 8e-3 * u - 6e-3 * v, TILT[1] - 6e-3 * u + 1.5 * v**2


def amplitude(u, v):
    return 1.0 - 1.5e4 * (u**2 + 0.6 * v**2) + 40 * u


LAYOUTS = {
    "polar": {"samples": (9, 40)},
    "ring": {"samples": (9, 40), "obscuration": 0.3},
    "cells": {"aperture": PENTAGON, "samples": (7, 9)},
    "grid": {"nodes": "grid", "samples": 36},
    "cut grid": {"nodes": "grid", "samples": 37, "aperture": PENTAGON},
}


def wave_of(name, size=amplitude, change=path):
    options = LAYOUTS[name]
    if "aperture" in options:
        options = options | {"pupil_radius": RADIUS}
    return psf.Wavefront.from_function(change, amplitude=size, **SYSTEM | options)


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("name", LAYOUTS)
def test_tilt_is_the_weighted_plane(name, even):
    """Least squares by numpy, weighted by the amplitude, and the energies that follow."""
    wave = wave_of(name, None if even else amplitude)
    residual = split(wave)
    share = (wave.amplitude * wave.weights).ravel()
    plane = np.stack([np.ones(wave.u.size), wave.u.ravel(), wave.v.ravel()], axis=1)
    root = np.sqrt(share)[:, None]
    scales = np.array([1.0, RADIUS, RADIUS])
    fit = np.linalg.lstsq(root * plane / scales, root[:, 0] * wave.aberration.ravel(), rcond=None)
    fit = fit[0] / scales
    assert residual.tilt == approx(fit[1:], rel=1e-9)
    assert residual.shift == approx(fit[1:] * DISTANCE, rel=1e-9)
    rest = wave.aberration - (plane @ fit).reshape(wave.u.shape)
    assert_allclose(residual.aberration, rest, atol=1e-18)
    assert residual.wavenumber == approx(2 * math.pi / WAVELENGTH, rel=1e-15)
    assert residual.airy_unit == approx(WAVELENGTH * 0.07 / (2 * RADIUS), rel=1e-14)
    assert residual.amplitude_sum == approx(share.sum(), rel=1e-12)
    energy = np.sum(wave.amplitude**2 * wave.weights)
    assert residual.energy == approx(energy, rel=1e-12)
    assert wave.flux == approx(energy / (math.pi * RADIUS**2), rel=1e-12)
    shares = (3e-6 * share.sum()) ** 2 / energy / (WAVELENGTH * DISTANCE) ** 2
    assert residual.pixel_share(3e-6) == approx(shares, rel=1e-12)
    lit = share > 0
    heights = rest.ravel()
    mean = np.sum(share * heights) / share.sum()
    found = residual.heights
    low, high = heights[lit].min(), heights[lit].max()
    if residual.has_series:  # which is known on the rims as well
        assert found.low < low
        assert found.high > high
    else:
        assert (found.low, found.high) == approx((low, high), rel=1e-12)
    assert found.mean == approx(mean, abs=1e-16)
    rms = math.sqrt(np.sum(share * (heights - mean) ** 2) / share.sum())
    assert found.rms == approx(rms, rel=1e-9)
    assert residual.is_uniform is wave.is_uniform is even
    assert not residual.is_plane
    assert not residual.is_flat
    assert wave.is_spectral == (name in ("polar", "ring", "cells"))
    assert wave.f_number == approx(0.07 / (2 * RADIUS), rel=1e-14)


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("name", LAYOUTS)
def test_rays_land_by_their_slopes(name, even):
    """The gradient of the path, times the image distance, and the energy of each node."""
    wave = wave_of(name, None if even else amplitude)
    residual, energy = split(wave), wave.amplitude**2 * wave.weights
    rays = residual.rays
    if wave.is_spectral:
        inner = np.s_[:, 1:-1, 1:-1] if name == "cells" else np.s_[:-1]
        near, far = 1e-9, 0.0
    else:
        inner, near, far = np.s_[:], 3e-4, 1.0
    u, v = (part - tilt for part, tilt in zip(gradient(wave.u, wave.v), residual.tilt, strict=True))
    lit = energy > 0
    if far:  # differences of grid samples are one-sided at the rim
        lit[1:-1, 1:-1] &= lit[:-2, 1:-1] & lit[2:, 1:-1] & lit[1:-1, :-2] & lit[1:-1, 2:]
        lit[[0, -1]] = lit[:, [0, -1]] = False
    limit = near * np.abs(DISTANCE) * 1e-4 if not far else 3e-8
    assert_allclose(rays.x[inner][lit], (u * DISTANCE)[lit], atol=limit)
    assert_allclose(rays.y[inner][lit], (v * DISTANCE)[lit], atol=limit)
    assert_allclose(rays.energy[inner], energy / energy.sum(), atol=1e-12)
    assert rays.energy.sum() == approx(1.0, rel=1e-12)
    size = np.hypot(rays.x, rays.y)
    assert rays.slope == approx(size.max() / abs(DISTANCE), rel=1e-12)
    assert rays.reach == approx(max(np.abs(rays.x).max(), np.abs(rays.y).max()), rel=1e-12)
    if wave.is_spectral:
        more = residual.traced(
            *(n if i < wave.u.ndim - 2 else n + 3 for i, n in enumerate(wave.u.shape))
        )
        assert more.energy.sum() == approx(1.0, rel=1e-12)
        squares = (np.sum(r.energy * (r.x**2 + r.y**2)) for r in (more, rays))
        assert next(squares) == approx(next(squares), rel=1e-9)
        assert_allclose(residual.traced(*wave.u.shape[:-2], 2, 2).x, rays.x, atol=1e-15)


def test_differences_on_a_grid():
    """Central, one-sided next to dark samples, and 0 between them."""
    n, pitch = 9, 1e-3
    rng = np.random.default_rng(4)
    lit = rng.uniform(size=(n, n)) < 0.6
    path_of = 1e-7 * rng.normal(size=(n, n))
    wave = psf.Wavefront.from_map(
        path_of, lit * 1.0, wavelength=WAVELENGTH, pupil_pitch=pitch, image_distance=DISTANCE
    )
    residual = split(wave)
    rest, rays = residual.aberration, residual.rays
    worst, where = 0.0, (0, 0)
    for i in range(n):
        for j in range(n):
            for found, (di, dj) in ((rays.x, (0, 1)), (rays.y, (1, 0))):
                steps = []
                for sign in (-1, 1):
                    a, b = i + sign * di, j + sign * dj
                    if 0 <= a < n and 0 <= b < n and lit[i, j] and lit[a, b]:
                        steps.append(sign * (rest[a, b] - rest[i, j]))
                slope = np.mean(steps) / pitch if steps else 0.0
                assert found[i, j] == approx(slope * DISTANCE, abs=1e-15)
                if len(steps) and sign == 1 and 0 <= i + di < n and 0 <= j + dj < n:
                    step = abs(rest[i + di, j + dj] - rest[i, j])
                    if lit[i + di, j + dj] and step > worst:
                        worst, where = step, (i, j)
    jump, place = residual.jump()
    assert jump == approx(worst / WAVELENGTH, rel=1e-12)
    assert place == where
    assert residual.spacing == pitch
    assert residual.mixed_area == 0.0
    half = max(np.abs(wave.u[lit]).max(), np.abs(wave.v[lit]).max()) + pitch / 2
    assert residual.half_width == approx(half, rel=1e-12)


def test_widths_and_pitches():
    """A rim cell of an area-weighted grid ends at the rim; a map's cells are whole."""
    widths = {name: split(wave_of(name)).half_width for name in LAYOUTS}
    assert widths["polar"] == widths["ring"] == RADIUS
    assert widths["grid"] == approx(RADIUS, rel=1e-12)
    assert widths["cells"] == widths["cut grid"] == PENTAGON.half_width
    for name, width in widths.items():
        limit = WAVELENGTH * 0.07 / (4 * width)
        assert split(wave_of(name)).nyquist_pitch == approx(limit, rel=1e-12)
    narrow = wave_of("grid", lambda u, v: np.where((abs(u) < 2e-3) & (abs(v) < 1e-3), 1.0, 0.0))
    lit = narrow.amplitude * narrow.weights > 0
    expected = np.abs(narrow.u[lit]).max() + narrow.pupil_pitch / 2
    assert split(narrow).half_width == approx(expected, rel=1e-12)
    with pytest.raises(
        SamplingError, match="a polar wavefront has no pupil pitch; sample it with n"
    ):
        _ = wave_of("polar").pupil_pitch
    with pytest.raises(SamplingError, match="layout 'cells' cannot be resampled to a grid; sampl"):
        _ = split(wave_of("cells")).polar_series


def test_flat_and_plane_waves():
    for name in LAYOUTS:
        for size in (None, amplitude):
            residual = split(wave_of(name, size, lambda u, v: 0 * u))
            assert residual.is_plane
            assert residual.tilt == (0.0, 0.0)
            assert tuple(residual.heights) == (0.0, 0.0, 0.0, 0.0)
            assert residual.is_flat == (size is None)
            rays = residual.rays
            assert (rays.slope, rays.reach) == (0.0, 0.0)
            assert rays.energy.sum() == approx(1.0, rel=1e-12)


@pytest.mark.parametrize("name", LAYOUTS)
def test_figures_of_a_regime(name):
    residual = split(wave_of(name))
    found = regime(residual, 4.1e-6, rayleigh_parameter=0.7)
    unit = WAVELENGTH * 0.07 / (2 * RADIUS)
    assert found.pixel == approx(4.1e-6 / unit, rel=1e-12)
    assert found.reach == approx(residual.rays.reach / unit, rel=1e-12)
    assert found.slope == residual.rays.slope
    assert found.rms == approx(residual.heights.rms / WAVELENGTH, rel=1e-12)
    assert found.fresnel_number == approx(RADIUS**2 / (WAVELENGTH * 0.07), rel=1e-12)
    assert found.rayleigh_parameter == 0.7
    assert found.coherent_fraction == approx(math.exp(-0.49), rel=1e-12)
    assert regime(residual, 1e-6).coherent_fraction == 1.0
    if residual.has_series:
        turns = np.linspace(0, 2 * math.pi, 41)[:-1]
        rims = [RADIUS, 0.3 * RADIUS if name == "ring" else 0.0]
        u, v = (np.concatenate([r * f(turns) for r in rims]) for f in (np.cos, np.sin))
        if name == "cells":  # the sides of the pentagon
            corners = 3.5e-3 * np.exp(1j * (0.2 + 2 * math.pi * np.arange(6) / 5))
            sides = np.interp(np.linspace(0, 5, 2001), np.arange(6), corners)
            u, v = sides.real, sides.imag
        wave = residual.wavefront
        rest = path(u, v) - residual.tilt[0] * u - residual.tilt[1] * v
        # the piston that was removed
        moved = path(wave.u, wave.v) - residual.tilt[0] * wave.u - residual.tilt[1] * wave.v
        rest += (residual.aberration - moved).flat[0]
        low = min(residual.aberration.min(), rest.min())
        high = max(residual.aberration.max(), rest.max())
        # on the sides of patches the extremes may lie between nodes
        rel = 1e-2 if name == "cells" else 1e-9
        assert found.peak_to_valley == approx((high - low) / WAVELENGTH, rel=rel)
    else:
        spread = residual.heights.high - residual.heights.low
        assert found.peak_to_valley == approx(spread / WAVELENGTH, rel=1e-12)
    if residual.wavefront.is_spectral:
        assert found.slope_per_sample is None
    else:
        step = residual.rays.slope * residual.wavefront.pupil_pitch / WAVELENGTH
        assert found.slope_per_sample == approx(step, rel=1e-12)


def wave_with(**changes):
    options = {"samples": (4, 12)} if "samples" not in changes else {}
    return replace(psf.Wavefront.from_zernike({}, **options, **SYSTEM), **changes)


def test_ranges_of_a_wave():
    """The widest wavelengths, the largest hole, and signs of the image distance."""
    for wavelength in (1e-8, 1e-3):
        assert wave_with(wavelength=wavelength).wavelength == wavelength
    for wavelength in (0.99e-8, 1.01e-3):
        with pytest.raises(SceneError, match="wavelength = .* is out of range.*give metres"):
            wave_with(wavelength=wavelength)
    ring = psf.Wavefront.from_zernike({}, obscuration=0.99, **SYSTEM)
    assert ring.obscuration == 0.99
    with pytest.raises(SceneError, match=r"obscuration = 0\.991 is out of range"):
        psf.Wavefront.from_zernike({}, obscuration=0.991, **SYSTEM)
    assert type(wave_with(image_distance=1).image_distance) is float
    assert wave_with(image_distance=1).f_number == approx(1 / (2 * RADIUS))


def scattered(**changes):
    rng = np.random.default_rng(2)
    u, v = rng.uniform(-2e-3, 3e-3, (2, 60))
    given = {"u": u, "v": v, "aberration": 0 * u, "amplitude": 0 * u + 1, "weights": 0 * u + 1e-7}
    return psf.Wavefront(**given | changes, layout="scattered", **SYSTEM)


def test_arrays_of_a_wave():
    amplitude = np.ones(60)
    amplitude[7] = -0.25
    with pytest.raises(
        SceneError, match=r"wavefront.amplitude = -0.25 at \(7,\) is below 0; write a"
    ):
        scattered(amplitude=amplitude)
    with pytest.raises(SceneError, match=r"wavefront.weights = -0.25 at \(7,\) is below 0"):
        scattered(weights=amplitude)
    dark = np.zeros(60)
    dark[3] = 1.0
    scattered(amplitude=dark)
    with pytest.raises(SceneError, match="wavefront.amplitude is 0 everywhere; no light passes"):
        scattered(amplitude=dark, weights=1 - dark)
    with pytest.raises(SceneError, match=r"wavefront.weights has shape \(59,\) and u has \(60,\)"):
        scattered(weights=np.ones(59))


@pytest.mark.parametrize("samples", [None, 60])  # a cached node set, and one that is not
def test_nodes_are_those_of_the_layout(samples):
    """A thousand-millionth of the radius may be rounding."""
    wave = psf.Wavefront.from_zernike({}, samples=samples, **SYSTEM)
    for axis in ("u", "v"):
        for factor, refused in ((0.9, False), (1.1, True)):
            moved = getattr(wave, axis).copy()
            moved[2, 5] += factor * 1e-9 * RADIUS
            if refused:
                with pytest.raises(
                    SceneError, match="4.4e-12 m off the nodes of layout 'polar', limit 4"
                ):
                    replace(wave, **{axis: moved})
            else:
                assert getattr(replace(wave, **{axis: moved}), axis)[2, 5] == moved[2, 5]


def test_nodes_of_cells_and_grids():
    cells, grid = wave_of("cells"), wave_of("grid")
    moved = cells.v + np.where(np.arange(cells.v.size).reshape(cells.v.shape) == 9, 1e-8, 0)
    with pytest.raises(
        SceneError, match="1e-08 m off the nodes of layout 'cells'.*from aperture.no"
    ):
        replace(cells, v=moved)
    with pytest.raises(SceneError, match="off the nodes of layout 'grid'.*rows along v"):
        replace(grid, u=grid.v, v=grid.u)
    with pytest.raises(SceneError, match="m off the nodes of layout 'polar'.*from psf.polar_nodes"):
        wave_with(pupil_radius=1.001 * RADIUS)
    fewer = {
        name: getattr(cells, name)[1:] for name in ("u", "v", "aberration", "amplitude", "weights")
    }
    shape = cells.u.shape
    patches = rf"\({shape[0] - 1}, {shape[1]}, {shape[2]}\); the aperture's {shape[0]} patches need"
    with pytest.raises(SceneError, match=f"wavefront.u has shape {patches}"):
        replace(cells, **fewer)
    with pytest.raises(SceneError, match="layout = 'cells' without an aperture; give one or"):
        replace(cells, aperture=None)
    with pytest.raises(SceneError, match="layout = 'polar' cannot follow an aperture; use 'cells'"):
        wave_with(aperture=PENTAGON)
    with pytest.raises(
        SceneError, match=r"obscuration = 0\.2 with an aperture, limit 0; make the obs"
    ):
        replace(cells, obscuration=0.2)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((None, 3, 0.0, None), "aperture is a int; give a psf.Aperture"),
        ((None, None, 0.0, (3, 4, 5)), r"samples = \(3, 4, 5\); give one whole number or two"),
        (
            ("hexagonal", None, 0.0, None),
            "nodes = 'hexagonal' is unknown, must be one of polar, ce",
        ),
        (("cells", None, 0.0, None), "nodes = 'cells' without an aperture; give one or use 'pol"),
        (("polar", PENTAGON, 0.0, None), "nodes = 'polar' cannot follow an aperture; use 'cells'"),
        ((None, PENTAGON, 0.2, None), "obscuration = 0.2 with an aperture, limit 0; make the obs"),
        (("grid", None, 0.0, (30, 30)), r"samples = \(30, 30\); a grid is square, give one whole"),
    ],
)
def test_contradicting_options(given, message):
    with pytest.raises(SceneError, match=message):
        nodes_of(*given)


def test_default_layouts():
    assert nodes_of(None, None, 0.3, (3, 4)) == "polar"
    assert nodes_of(None, PENTAGON, 0.0, 5) == "cells"
    assert nodes_of("grid", PENTAGON, 0.0, 5) == "grid"
    assert nodes_of("grid", None, 0.2, None) == "grid"


@pytest.mark.parametrize(
    ("degree", "samples", "counts"),
    [
        (3, None, (24, 96)),
        (24, None, (24, 96)),
        (25, None, (25, 100)),
        (4, 3, (3, 12)),
        (7, (4, 15), (4, 15)),
        (7, (3, 15), "3 x 15 polar nodes cannot hold Zernike degree 7; use 4 x 15 or more"),
        (7, (4, 14), "4 x 14 polar nodes cannot hold Zernike degree 7; use 4 x 15 or more"),
        (6, 3, "3 x 12 polar nodes cannot hold Zernike degree 6; use 4 x 13 or more"),
    ],
)
def test_counts_of_polar_nodes(degree, samples, counts):
    if isinstance(counts, tuple):
        assert polar_counts(degree, samples) == counts
    else:
        with pytest.raises(SamplingError, match=counts):
            polar_counts(degree, samples)


@pytest.mark.parametrize("name", ["polar", "ring", "cells"])
def test_resampled_waves(name):
    """A polynomial is the same on more nodes; an amplitude that dips below 0 is cut off."""
    wave = wave_of(name)
    old = wave.u.shape[-2:]
    finer = wave.resampled(old[0] + 2, old[1] + 5)
    assert finer.u.shape == (*wave.u.shape[:-2], old[0] + 2, old[1] + 5)
    assert_allclose(finer.aberration, path(finer.u, finer.v), atol=1e-18)
    assert_allclose(finer.amplitude, amplitude(finer.u, finer.v), atol=1e-12)
    assert finer.weights.sum() == approx(wave.weights.sum(), rel=1e-12)
    assert_allclose(wave.resampled(*old).aberration, wave.aberration, atol=1e-18)
    for counts in ((old[0] - 1, old[1]), (old[0], old[1] - 1), (old[0],), (*old, 3)):
        given = " x ".join(map(str, counts))
        layout = wave.layout
        told = f"{given} {layout} nodes are fewer than the present {old[0]} x {old[1]}; give as"
        with pytest.raises(SamplingError, match=told):
            wave.resampled(*counts)
    dark = wave_of(name, lambda u, v: np.maximum(u, 0.0) / RADIUS)
    assert dark.resampled(*(n + 1 for n in old)).amplitude.min() == 0.0
    both = wave.truncation()
    assert both[0] == wave.series(wave.aberration).truncation()
    assert both[1] == wave.series(wave.amplitude).truncation()
    assert both[0] < 1e-15
    assert both[1] < 1e-9
    for values, what in ((wave.nodes, "nodes"), (wave.series, "series")):
        assert callable(values), what


def test_only_spectral_waves_have_more_nodes():
    grid = wave_of("grid")
    calls = {
        "have more nodes": lambda: grid.nodes(3, 4),
        "have a series": lambda: grid.series(grid.aberration),
        "be resampled": lambda: grid.resampled(40, 40),
    }
    for what, call in calls.items():
        told = (
            f"only a wavefront of layout 'polar' or 'cells' can {what}, not 'grid'; sample the wave"
        )
        with pytest.raises(SamplingError, match=told):
            call()
    with pytest.raises(SceneError, match="the number of patches = 4"):
        wave_of("cells").nodes(4, 8, 8)


@pytest.mark.parametrize("n", [6, 7])
def test_map_defaults(n):
    given = {"wavelength": WAVELENGTH, "pupil_pitch": 3e-4, "image_distance": 0.05}
    rng = np.random.default_rng(n)
    surface = rng.normal(size=(n, n)) * 1e-8
    wave = psf.Wavefront.from_map(surface, **given)
    axis = (np.arange(n) - n // 2) * 3e-4
    assert_allclose(wave.u, np.tile(axis, (n, 1)))
    assert_allclose(wave.v, np.tile(axis[:, None], (1, n)))
    assert_allclose(wave.aberration, surface)
    assert (wave.amplitude == 1).all()
    assert_allclose(wave.weights, np.full((n, n), 9e-8))
    assert wave.pupil_radius == approx(3e-4 * (2.5 if n == 6 else 3.5), rel=1e-12)
    assert wave.layout == "grid"
    own = psf.Wavefront.from_map(surface, surface**2, pupil_radius=1e-3, **given)
    assert own.pupil_radius == 1e-3
    assert_allclose(own.amplitude, surface**2)
    with pytest.raises(SceneError, match="pupil_pitch = 0 m"):
        psf.Wavefront.from_map(surface, **given | {"pupil_pitch": 0.0})


@pytest.mark.parametrize("name", LAYOUTS)
def test_card(name):
    """Rms without tilt, weighted by the amplitude."""
    wave, residual = wave_of(name), split(wave_of(name))
    share = wave.amplitude * wave.weights
    rms = math.sqrt(np.sum(share * residual.aberration**2) / share.sum())
    told = str(wave._figures().rows)
    assert f"{rms / WAVELENGTH:.3g} waves rms, {1e9 * rms:.3g} nm, without tilt" in told
    assert f"4 mm radius, F/{wave.f_number:.3g}" in told
    assert f"530 nm, {100 * wave.flux:.4g} % of a clear disc" in told
    assert f"{' x '.join(map(str, wave.u.shape))}, {wave.layout}" in told


def test_radius_of_a_function():
    given = {"wavelength": WAVELENGTH, "image_distance": DISTANCE}
    with pytest.raises(SceneError, match="pupil_radius is missing; give it or an aperture"):
        psf.Wavefront.from_function(path, **given)
    wave = psf.Wavefront.from_function(path, aperture=PENTAGON, **given)
    assert wave.pupil_radius == PENTAGON.bounding_radius
    for name in ("pupil_radius", "wavelength"):
        with pytest.raises(SceneError, match=f"{name} = 0"):
            psf.Wavefront.from_function(path, **SYSTEM | {name: 0.0})
    plain = psf.Wavefront.from_function(**SYSTEM)
    assert not plain.aberration.any()
    assert (plain.amplitude == 1).all()


def test_coefficients():
    """A sum of modes on cached nodes, on others and on a grid; nothing is 0."""
    for options in ({}, {"samples": 60}, {"nodes": "grid", "samples": 30}, {"obscuration": 0.4}):
        wave = psf.Wavefront.from_zernike({2: 3e-8, 8: -5e-8, 11: 2e-8}, **SYSTEM, **options)
        rho = np.hypot(wave.u, wave.v) / RADIUS
        theta = np.arctan2(wave.v, wave.u)
        expected = 3e-8 * 2 * rho * np.cos(theta) + 2e-8 * math.sqrt(5) * (
            6 * rho**4 - 6 * rho**2 + 1
        )
        expected -= 5e-8 * math.sqrt(8) * (3 * rho**3 - 2 * rho) * np.cos(theta)
        lit = wave.weights > 0
        assert_allclose(wave.aberration[lit], expected[lit], atol=1e-20)
        assert (wave.amplitude == 1).all()
        assert not psf.Wavefront.from_zernike({}, **SYSTEM, **options).aberration.any()
    assert psf.Wavefront.from_zernike({}, nodes="grid", **SYSTEM).u.shape == (512, 512)
    assert psf.Wavefront.from_zernike({}, nodes="grid", samples=2, **SYSTEM).u.shape == (2, 2)
    with pytest.raises(SceneError, match=r"samples = 1 is out of range"):
        psf.Wavefront.from_zernike({}, nodes="grid", samples=1, **SYSTEM)
    with pytest.raises(SceneError, match=r"coefficients\[4\] = inf is not finite"):
        psf.Wavefront.from_zernike({4: math.inf}, **SYSTEM)
    with pytest.raises(SceneError, match="ordering = 'born' is unknown"):
        psf.Wavefront.from_zernike({4: 1e-8}, ordering="born", **SYSTEM)
    with pytest.raises(SceneError, match="pupil_radius = -1 m"):
        psf.Wavefront.from_zernike({4: 1e-8}, **SYSTEM | {"pupil_radius": -1.0})


@pytest.mark.parametrize("n", [8, 9, 11])
def test_extremes_lie_on_the_rim(n):
    """Of r^4 cos(4 theta), also where the nodes of a ring see it as their fastest change."""
    given = {"wavelength": 5e-7, "pupil_radius": 4e-3, "image_distance": 0.06}

    def clover(u, v):
        return 3e-7 * (u**4 - 6 * u**2 * v**2 + v**4) / 4e-3**4

    wave = psf.Wavefront.from_function(clover, nodes="polar", samples=(6, n), **given)
    rim = np.cos(4 * np.arctan2(wave.v, wave.u)[0])
    assert np.abs(wave.aberration).max() < 0.95 * 3e-7
    found = regime(split(wave), 1e-6).peak_to_valley
    assert found == approx(3e-7 * np.ptp(rim) / 5e-7, rel=1e-9)
