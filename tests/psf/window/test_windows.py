"""Windows, their edges, and error bounds, point by point from their definitions."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx
from scipy.special import erfc

from nlosoptics import psf
from nlosoptics.errors import SamplingError, SceneError
from nlosoptics.psf.wave.detilted import split
from nlosoptics.psf.window import antialiased_disc, error_bounds, grids, pixels, rim_tails, window

WAVELENGTH, RADIUS, DISTANCE = 600e-9, 4e-3, -0.06
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": DISTANCE}
UNIT = WAVELENGTH * 0.06 / (2 * RADIUS)
HEXAGON = psf.Aperture.regular(6, 3.1e-3, angle=0.2)


def tilted(**options):
    """Aberrated, with its image beside the axis by (-4.5, 2.25) um."""
    terms = {2: 1.5e-7, 3: -0.75e-7, 4: 6e-7, 7: 1e-7}
    return psf.Wavefront.from_zernike(terms, **options, **SYSTEM)


def test_places_of_samples():
    seen = window.Window.centred(0.3, (4, 7))
    assert seen.x == approx(0.3 * np.arange(-3, 4))
    assert seen.y == approx(0.3 * np.arange(-2, 2))
    assert seen.reach_from((0.25, -0.4)) == approx((1.15, 0.7))
    assert seen.reach_from((-0.5, 0.2)) == approx((1.4, 0.8))


@pytest.mark.parametrize(("shape", "inner"), [((9, 8), (5, 4)), ((8, 9), (5, 4)), ((7, 7), (7, 2))])
def test_middle_keeps_the_centre(shape, inner):
    rows, columns = window.middle(shape, inner)
    for cut, n, m in ((rows, shape[0], inner[0]), (columns, shape[1], inner[1])):
        kept = list(range(n))[cut]
        assert len(kept) == m
        assert kept[m // 2] == n // 2


@pytest.mark.parametrize("shape", ["33", 3.5, (3,), (3, 4, 5), None])
def test_shapes_that_are_none(shape):
    with pytest.raises(SceneError, match="shape"):
        window.shape_of(shape)


def test_default_window_holds_the_rays_and_a_margin():
    residual = split(tilted())
    reach = residual.rays.reach + 4.5e-6
    assert window.ray_reach(residual) == approx(reach, rel=1e-9)
    n = 2 * math.ceil((reach + 16 * UNIT) / 2e-7)
    assert window.default_shape(residual, 2e-7) == (n, n)
    assert n > 256
    assert window.default_shape(residual, 2e-5) == (256, 256)
    with pytest.raises(SamplingError, match=r"reaches .* m from the axis, .* across, limit 4096"):
        window.default_shape(residual, 1e-9)


@pytest.mark.parametrize("pitch", [4e-6, 3e-5])
def test_rays_beside_a_window(pitch):
    """Those beyond its outer samples by half a sample or an Airy unit, whichever is more."""
    residual = split(tilted())
    x, y = residual.rays.x + residual.shift[0], residual.rays.y + residual.shift[1]
    assert residual.shift == approx((-4.5e-6, 2.25e-6), rel=1e-9)
    slack = max(pitch / 2, UNIT)
    held = []
    for shape in ((3, 40), (40, 3), (12, 9), (9, 12), (40, 41), (1, 1)):
        beyond = (abs(x) > shape[1] // 2 * pitch + slack) | (abs(y) > shape[0] // 2 * pitch + slack)
        lost = float(residual.rays.energy[beyond].sum())
        held.append(lost <= 0.01)
        assert window.holds_rays(residual, pitch, shape) == held[-1]
        if held[-1]:
            window.check_rays(residual, pitch, shape)
            continue
        ends = [float(v.ravel()[np.argmax(abs(v))]) for v in (x, y)]
        need = 2 * math.ceil(max(map(abs, ends)) / pitch) + 1
        with pytest.raises(SamplingError) as refusal:
            window.check_rays(residual, pitch, shape, ", or else")
        assert str(refusal.value) == (
            f"the geometric spot reaches x = {ends[0]:.3g} m, y = {ends[1]:.3g} m and a window of "
            f"{shape[0]} x {shape[1]} samples of {pitch:.3g} m loses {100 * lost:.3g} % of the ray "
            f"energy, limit 1 %; use shape = ({need}, {need}) or more, or else"
        )
    assert len(set(held)) == 2


def test_rays_on_the_edge_of_a_window_are_held():
    """The narrowest window that loses at most 1 % of the energy ends at a ray."""
    residual = split(tilted())
    for k, (places, shape) in enumerate(
        zip((residual.rays.x, residual.rays.y), ((99, 1), (1, 99)), strict=True)
    ):
        far = np.abs(places + residual.shift[k]).ravel()
        order = np.argsort(far)[::-1]
        beyond = np.cumsum(residual.rays.energy.ravel()[order])
        edge = float(far[order][np.flatnonzero(beyond > 0.01)[0]])
        assert edge > UNIT
        assert window.holds_rays(residual, 2 * edge, shape)
        assert not window.holds_rays(residual, 2 * np.nextafter(edge, 0.0), shape)


@pytest.mark.parametrize("pitch", [0.3, 1.0, 7.0])
def test_side_of_a_window(pitch):
    """The tail's energy per pixel 2 unit p^2/(pi^3 r^3) is that share of the brightest pixel."""
    for wave in (tilted(), psf.Wavefront.from_zernike({}, aperture=HEXAGON, **SYSTEM)):
        residual, p = split(wave), pitch * UNIT
        peak = window.peak_pixel(residual, p)
        edges = 1.0
        if wave.aperture:  # six sides of one length over the area, against a disc's
            edges = 12 * math.sin(math.pi / 6) * 3.1e-3 * RADIUS / (2 * HEXAGON.area)
        for tol in (0.02, 1e-4):
            tail = (edges * 2 * UNIT * p**2 / (math.pi**3 * tol * peak)) ** (1 / 3)
            if wave.aperture:
                tail = max(tail, rim_tails.reach(HEXAGON, WAVELENGTH * 0.06, p, tol * peak))
            half = window.ray_reach(residual) + tail
            side = 2 * math.ceil(half / p - 0.5) + 1
            assert psf.window_shape(wave, pitch=p, tol=tol) == side
            assert side > 1
            assert window.window_side(residual, p, tol, wave.aperture) == side
    airy = split(psf.Wavefront.from_zernike({}, **SYSTEM))
    assert psf.window_shape(airy.wavefront, pitch=1e3 * UNIT, tol=1.0) == 1


def test_brightest_pixel():
    """An Airy disc's peak times the pixel, all light, or the fullest square of rays."""
    airy = split(psf.Wavefront.from_zernike({}, **SYSTEM))
    assert window.peak_pixel(airy, 0.1 * UNIT) == approx(0.01 / 4, rel=1e-9)
    assert window.peak_pixel(airy, 3 * UNIT) == approx(1.0, rel=1e-12)
    assert window.peak_pixel(airy, 1e200) == approx(1.0, rel=1e-12)
    # rays of defocus fill a disc evenly; squares of 1/8 of its radius
    for options in (
        {},
        {"nodes": "grid", "samples": 512},
        {"aperture": psf.Aperture.round(RADIUS)},
    ):
        wave = psf.Wavefront.from_zernike({4: 3e-5}, **options, **SYSTEM)
        radius = 4 * math.sqrt(3) * 3e-5 * 0.06 / RADIUS
        even = (1 / 8) ** 2 / math.pi
        assert even < window.peak_pixel(split(wave), radius / 8) < 1.6 * even
    hexagon = split(psf.Wavefront.from_zernike({}, aperture=HEXAGON, **SYSTEM))
    small = 0.2 * UNIT
    density = HEXAGON.area / (WAVELENGTH * 0.06) ** 2
    assert window.peak_pixel(hexagon, small) == approx(min(density * small**2, 0.01), rel=1e-9)


def test_wave_on_its_own_grid():
    wave = tilted(nodes="grid", samples=24)
    grid = grids.pupil_grid(split(wave))
    plane = split(wave)
    share = wave.weights * wave.amplitude
    phase = np.exp(2j * math.pi / WAVELENGTH * plane.aberration)
    assert grid.values == approx(share * phase / share.sum(), abs=1e-15)
    assert (grid.rim, grid.centre) == ("cut", 12)
    assert grid.pitch == approx(wave.pupil_pitch)
    even = replace(wave, weights=np.full_like(wave.weights, wave.weights.max()))
    assert grids.pupil_grid(split(even)).rim == "map"
    assert grids.grid_size(10.0, 1.0) == 2 * (10 + antialiased_disc.REACH) + 1
    assert grids.grid_size(10.1, 1.0) == 2 * (11 + antialiased_disc.REACH) + 1


def test_softened_rim_of_a_wave_of_one_sign():
    """A negative aberration of the largest modulus: the accuracy is that of its modulus."""
    wave = psf.Wavefront.from_function(
        lambda u, v: -3e-6 * ((u / RADIUS) ** 2 + 0.3 * u / RADIUS * (v / RADIUS) ** 2),
        amplitude=lambda u, v: 1 + 0.2 * v / RADIUS,
        **SYSTEM,
    )
    residual, pitch = split(wave), RADIUS / 40
    grid = grids.pupil_grid_from_polar(residual, pitch)
    n, middle = grid.values.shape[0], grid.centre
    assert (grid.rim, grid.pitch, n) == ("soft", pitch, 2 * (40 + antialiased_disc.REACH) + 1)
    axis = pitch * (np.arange(n) - middle)
    u, v = axis[None, 10 + middle - 30 : middle + 20], axis[middle - 20 : middle + 15, None]
    path = -3e-6 * ((u / RADIUS) ** 2 + 0.3 * u / RADIUS * (v / RADIUS) ** 2)
    path = path - residual.tilt[0] * u - residual.tilt[1] * v
    known = (1 + 0.2 * v / RADIUS) * np.exp(2j * math.pi / WAVELENGTH * path)
    found = grid.values[middle - 20 : middle + 15, 10 + middle - 30 : middle + 20]
    ratio = found / known
    assert ratio == approx(np.full_like(ratio, ratio[0, 0]), rel=1e-6)
    assert grid.jump == approx(residual.rays.slope * pitch / WAVELENGTH)
    # the mean amplitude is 1
    assert abs(ratio[0, 0]) == approx(pitch**2 / (math.pi * RADIUS**2), rel=1e-6)


@pytest.mark.parametrize("factor", [1, 3])
def test_weights_of_fine_samples(factor):
    """Means along either axis are those of one matrix."""
    rule = pixels.PixelRule(factor, 2, np.random.default_rng(factor).random(factor + 4))
    seen = rule.window(0.6, (5, 4))
    assert seen.shape == (5 * factor + 4, 4 * factor + 4)
    for at, n in ((seen.x, 4), (seen.y, 5)):
        assert np.diff(at) == approx(0.6 / factor)
        means = at[2:-2].reshape(n, factor).mean(axis=1)
        assert means == approx(0.6 * (np.arange(n) - n // 2), abs=1e-12)
    fine = np.random.default_rng(3).random(seen.shape)
    table = np.zeros((4, fine.shape[1]))
    for pixel in range(4):
        for k, tap in enumerate(rule.taps):
            table[pixel, pixel * factor + k] = tap
    assert rule.count(fine.shape[1]) == 4
    assert rule.mean(fine) == approx(fine @ table.T, rel=1e-12)
    assert rule.mean_down(fine.T.copy()) == approx(table @ fine.T, rel=1e-12)


def test_fewest_fine_samples():
    """No factor from the lowest allowed gives fewer samples in a row."""
    for pitch, n in ((0.2, 3), (1.0, 1), (2.9, 40), (11.0, 4), (60.0, 2)):
        rule = pixels.pixel_rule(pitch, 1.0, n)
        lowest = max(1, math.ceil(1.05 * pitch))
        counts = {}
        for factor in range(lowest, lowest + 200):
            gap = 0.5 - pitch / factor / 2
            margin = math.ceil(math.hypot(24, math.pi) / (2 * math.pi * gap))
            counts[factor] = n * factor + 2 * margin, margin
        best = min(counts, key=lambda factor: counts[factor][0])
        assert (rule.factor, rule.margin) == (best, counts[best][1])
        assert rule.taps.sum() == approx(1.0, abs=1e-9)
        assert rule.taps == approx(rule.taps[::-1], abs=1e-14)


@pytest.mark.parametrize("pixel", [0.0, 0.5, 0.8, 3.0])
def test_error_of_an_intensity(pixel):
    """|A + e|^2 - |A|^2 <= 2 |A| e + e^2 at each point, against the largest intensity."""
    intensity = np.array([[0.5, 0.1, 0.02], [0.3, 0.4, 0.001]])
    field, spill = np.array([[0.01], [0.03]]), np.array([0.0, 0.002, 0.5])
    beat = {0.0: 1.0, 0.5: 1.0, 0.8: 1.0, 3.0: 0.8 / 3}[pixel]
    floor = 4e-11 if pixel else 1e-13
    assert error_bounds.beat(pixel) == approx(beat)

    def known(energy, level, spill):
        worst = 0.0
        for i in range(2):
            for j in range(3):
                e = float(field[i, 0])
                e = math.sqrt(min(e * e, energy / level)) if pixel else e
                e += spill if np.ndim(spill) == 0 else float(spill[j])
                worst = max(worst, 2 * beat * math.sqrt(intensity[i, j]) * e + e * e)
        return worst / 0.5 + floor

    options = {"pixel": pixel, "level": 0.4}
    for energy in (math.inf, 1e-4):
        for more in (spill, 0.07):
            found = error_bounds.intensity_error(intensity, field, energy, spill=more, **options)
            assert found == approx(known(energy, 0.4, more), rel=1e-12)
    plain = error_bounds.intensity_error(intensity, 0.02, math.inf, spill=0.01, **options)
    assert plain == approx((2 * beat * math.sqrt(0.5) * 0.03 + 9e-4) / 0.5 + floor, rel=1e-12)
    assert error_bounds.intensity_error(intensity, 0.0, 0.0, **options) == floor
    noise = error_bounds.transform_error(intensity, 1e-3, pixel=pixel)
    spread = math.sqrt(intensity.mean() / 0.5)
    assert noise == approx(2e-3 * spread * (1 / 3 if pixel == 3 else 1), rel=1e-12)


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0123, "0.013"), (0.01, "0.01"), (0.0101, "0.011"), (3.21e-7, "3.3e-07"), (9.99, "10")],
)
def test_limits_are_rounded_up(value, text):
    assert error_bounds.rounded_up(value) == text


def airy(r):
    """Bound of the Airy field: its envelope (8/(pi v^3))^(1/2), at most 1, v = pi r."""
    v = max(math.pi * r, 1.0)
    return min(1.0, math.sqrt(8 / (math.pi * v**3)))


@pytest.mark.parametrize("half", [0.0, 2.1e-6])
@pytest.mark.parametrize("outline", [None, HEXAGON], ids=["ring", "hexagon"])
def test_errors_of_a_cut_rim(half, outline):
    options = {"aperture": outline} if outline else {"obscuration": 0.3}
    wave = tilted(nodes="grid", samples=60, **options)
    residual = split(wave)
    grid = grids.pupil_grid(residual)
    period = WAVELENGTH * 0.06 / grid.pitch
    x = np.append(3e-6 * np.arange(-4, 4), [2.3 * period, -2.4 * period])
    y = np.append(3e-6 * np.arange(-2, 3), 2.6 * period)
    found = error_bounds.edge_errors(residual, grid, x, y, half)
    assert rim_tails.edge_ratio(wave) == approx(
        HEXAGON.perimeter * RADIUS / (2 * HEXAGON.area) if outline else 1 / 0.7
    )
    edges = rim_tails.edge_ratio(wave)

    def sent(a, b):
        if outline is None:
            return airy(math.hypot(a, b) / UNIT)
        scale = WAVELENGTH * 0.06
        return float(rim_tails.tail(outline, np.array(a / scale), np.array(b / scale)))

    def repeat(a, b):
        share = min(1.0, math.hypot(a, b) / (2 * half)) if half else 1.0
        return sent(a, b) * math.sqrt(share)

    spill = np.zeros((y.size, x.size))
    for (i, j), _ in np.ndenumerate(spill):
        a, b = abs(x[j] - residual.shift[0]), abs(y[i] - residual.shift[1])
        c, d = a + half, b + half
        own = min(1.65 * (c * c + d * d) / period**2, 2.0) * sent(c, d)
        more = repeat(max(period - c, 0.0), b) * abs(np.sinc(1 - c / period))
        more += repeat(a, max(period - d, 0.0)) * abs(np.sinc(1 - d / period))
        spill[i, j] = own + 3.3 * more if outline else edges * (own + more)
    assert found.spill == approx(spill, rel=1e-9)
    steep = 2 * math.pi * grid.jump
    n = 2 * RADIUS / grid.pitch
    shared = edges * steep / (2 * n)
    if outline:
        assert found.field == approx(shared + residual.mixed_area, rel=1e-9)
        assert found.energy == math.inf
    else:
        assert found.field == approx(shared, rel=1e-9)
        assert found.energy == approx(edges * 0.02 * steep**2 / n, rel=1e-9)
    lost = error_bounds.damping_error(residual, grid, 5e-6)
    assert lost == approx(1.34 * UNIT * 5e-6 / period**2 * edges, rel=1e-9)
    assert error_bounds.damping_error(residual, replace(grid, rim="soft"), 5e-6) == 0
    whole = error_bounds.edge_errors(residual, replace(grid, rim="map"), x, y, half)
    assert (whole.field, whole.energy, whole.spill) == (0.0, 0.0, 0.0)


def test_errors_of_a_soft_rim():
    residual = split(tilted(obscuration=0.3))
    pitch, reach = RADIUS / 50, residual.rays.reach
    period, n = WAVELENGTH * 0.06 / pitch, 100

    def leak(s):
        return erfc((0.5 - s) / 0.08) / 2

    focus = 2 * leak(reach / period) / max(math.pi * reach / UNIT, 1.0)
    degree = max(residual.series.degrees(1e-3 * abs(residual.aberration).max()))
    edge = 0.05 * 2 * math.pi * residual.rays.slope * pitch / WAVELENGTH * degree * (2 / n) ** 2
    distances = np.array([0.0, 4e-5, 1.3e-4])
    found = error_bounds.soft_rim_error(residual, pitch, distances)
    known = [
        (3 * leak((s + reach) / period) * airy((s + reach) / UNIT) + focus + edge) / 0.7
        for s in distances.tolist()
    ]
    assert found == approx(known, rel=1e-9)
    grid = grids.PupilGrid(np.zeros((3, 3), complex), pitch, 0.1, "soft")
    x, y = np.array([1e-5, -2e-5]), np.array([3e-5])
    errors = error_bounds.edge_errors(residual, grid, x, y)
    far = np.hypot(x - residual.shift[0], y[0] - residual.shift[1])
    assert errors.field[0] == approx(error_bounds.soft_rim_error(residual, pitch, far), rel=1e-12)
    assert (errors.energy, errors.spill) == (math.inf, 0.0)


def test_bounds_of_a_kernel_that_ends():
    assert antialiased_disc.cut(12.0, 17) == approx(1e-12 * 2.5**4)
    assert antialiased_disc.cut(45.0, 17) == approx(1e-12)
    assert antialiased_disc.cut(20.0, 10) == approx(2e-6)


def test_spikes_of_straight_edges():
    """Two directions of a rectangle, each with two edges of its length."""
    a, b = 3.0e-3, 1.1e-3
    box = psf.Aperture.polygon(0.5 * np.array([(-a, -b), (a, -b), (a, b), (-a, b)]))
    scale, pitch, share = 3.6e-8, 2e-5, 1e-4
    far = [
        math.sqrt(
            (2 * n) ** 2 * pitch * min(pitch, 2 * scale / n) / (4 * math.pi**2 * a * b * share)
        )
        for n in (a, b)
    ]
    assert rim_tails.reach(box, scale, pitch, share) == approx(max(far), rel=1e-5)
    x, y = np.array([500.0, 3e3, -800.0]), np.array([900.0, -40.0, 0.0])
    f = np.hypot(x, y)
    # each pair of edges: 2/(pi |f_t|), at most their lengths
    total = 2 / np.maximum(math.pi * abs(x), 1 / a) + 2 / np.maximum(math.pi * abs(y), 1 / b)
    known = np.minimum(total / (2 * math.pi * f * a * b), 1.0)
    assert rim_tails.tail(box, x, y) == approx(known, rel=1e-5)
    assert known.min() < 1
    assert rim_tails.reach(psf.Aperture.round(2e-3), scale, pitch, share) == 0
