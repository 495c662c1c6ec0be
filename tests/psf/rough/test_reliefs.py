"""Point spreads of given rough walls: propagation, rays, memory effect, and their ensemble mean."""

import numpy as np
import pytest

from nlosoptics import errors, psf
from nlosoptics.psf.rough.aberration import aberration_error, rough_wave
from nlosoptics.psf.rough.relief import relief_screen
from nlosoptics.psf.rough.source import rough_source
from nlosoptics.scene import FacetWall, FlatWall, GaussianWall, HeightMapWall

LAMBDA = 632.8e-9
#: Both distances 1 m at normal incidence: M = 1/2, d_eff = 0.5 m.
NORMAL = {"footprint": 0.5, "cos_sum": 2.0, "effective_distance": 0.5}
#: The same at 45 degrees in the plane of x: M and d_eff of the reference formulas.
C45 = np.cos(np.pi / 4)
OBLIQUE = {
    "footprint": np.diag([0.5 / C45, 0.5]),
    "cos_sum": 2 * C45,
    "effective_distance": np.diag([0.5 / C45**2, 0.5]),
}


def wave_of(radius=12.5e-3, distance=0.2):
    return psf.Wavefront.from_zernike(
        {}, wavelength=LAMBDA, pupil_radius=radius, image_distance=distance
    )


def facets(s, cell, seed=0, cos_sum=2.0):
    """Return facets of a Rayleigh parameter s averaged over the area."""
    height = s * LAMBDA / (2 * np.pi * cos_sum)
    return FacetWall(cell, 2 * height / cell, seed=seed)


def bumps(s, length, seed=0):
    return GaussianWall(s * LAMBDA / (4 * np.pi), length, seed=seed)


def view_of(relief, geometry=NORMAL, wave=None):
    return rough_source(wave or wave_of(), relief, *geometry.values(), pattern=True).view


def rings(image, width=4):
    """Return the means of an image over rings of a width in samples."""
    y, x = np.indices(image.shape) - np.array(image.shape)[:, None, None] // 2
    index = (np.hypot(x, y) / width).astype(int)
    return np.bincount(index.ravel(), image.ravel()) / np.bincount(index.ravel())


@pytest.mark.thorough
@pytest.mark.parametrize("geometry", [NORMAL, OBLIQUE], ids=["0 deg", "45 deg"])
@pytest.mark.parametrize("s", [0.3, 1.0, 3.0])
def test_mean_over_facet_walls(s, geometry):
    wave, n = wave_of(4e-3), 24
    options = {"shape": 65, "pitch": 4e-6}
    wall = facets(s, 1e-3, cos_sum=geometry["cos_sum"])
    size = {name: geometry[name] for name in ("footprint", "cos_sum")}
    mean = psf.mean_point_spread(wave, wall, tol=3e-3, **options, **size)
    drawn = []
    for seed in range(n):
        one = facets(s, 1e-3, seed=seed, cos_sum=geometry["cos_sum"])
        drawn.append(rings(psf.sample_point_spread(wave, one, **options, **geometry).intensity))
    error = np.std(drawn, axis=0, ddof=1) / np.sqrt(n)
    # 12 rings inside the window, 24 walls: Student's t beyond 4.5 has a chance of 1e-4 each
    off = np.abs(np.mean(drawn, axis=0) - rings(mean.intensity))[:8]
    assert np.all(off <= 4.5 * error[:8] + 3e-3 * mean.intensity.max())


@pytest.mark.parametrize("relief", [facets(0.1, 1e-3), facets(3.0, 1e-3), bumps(0.1, 1e-3)])
def test_lattice_on_the_wall_does_not_depend_on_the_distances(relief):
    """A pupil pitch is the wall's divided by the footprint's magnification."""
    pitches = []
    for footprint in (0.5, 0.2):
        view = view_of(relief, NORMAL | {"footprint": footprint})
        pitches.append(view.widest_pitch(LAMBDA) * footprint)
    assert pitches[0] == pytest.approx(pitches[1], rel=1e-12)


@pytest.mark.thorough
def test_core_and_halo_of_facets_share_the_energy():
    wave = wave_of(2e-3)
    size = {"footprint": 0.5, "cos_sum": 2.0}
    mean = psf.mean_point_spread(wave, facets(1.0, 1e-3), shape=257, pitch=15e-6, tol=3e-3, **size)
    # Gaussian height at each point: the mean field is the mean of exp(-variance/2) over a facet
    a, b = (np.indices((400, 400)) + 0.5) / 400
    lower = a + b < 1
    square = (1 - a - b) ** 2 + a**2 + b**2
    expected = np.mean(np.exp(-square[lower])) ** 2
    assert mean.coherent_fraction == pytest.approx(expected, rel=2e-3)
    assert mean.coherent.sum() + mean.diffuse.sum() == pytest.approx(mean.intensity.sum())
    assert mean.enclosed_energy == pytest.approx(1.0, abs=0.02)  # the tail outside the window


def nodes_under(a, b):
    """Return lattice indices and weights of the three nodes under points (a, b)."""
    i, j = np.floor(a), np.floor(b)
    c, d = a - i, b - j
    upper = c + d > 1
    ends = [(i + upper, j + upper), (i + 1, j), (i, j + 1)]
    return ends, np.where(upper, [c + d - 1, 1 - d, 1 - c], [1 - c - d, c, d])


@pytest.mark.parametrize(("s", "farthest"), [(1.0, 3.0), (5.0, 0.6), (20.0, 0.15)])
def test_pairs_of_facets_are_integrated_over_the_lattice(s, farthest):
    """Against a plain mean over 500 x 500 positions in a lattice cell."""
    view = rough_source(wave_of(), facets(s, 1e-3), 0.5, 2.0).view
    lags, turn = np.linspace(0, farthest, 8), 0.3 + np.arange(8)
    x, y = lags * np.cos(turn), lags * np.sin(turn)
    found = view.on_wall(x * view.length, y * view.length) + view.coherent_fraction
    a, b = (np.indices((500, 500)) + 0.5) / 500
    here, one = nodes_under(a, b)
    for k in range(8):
        row = y[k] / np.sqrt(0.75)
        there, two = nodes_under(a + x[k] - row / 2, b + row)
        square = (one**2).sum(axis=0) + (two**2).sum(axis=0)
        for (i, j), v in zip(here, one, strict=True):
            for (m, n), w in zip(there, two, strict=True):
                square -= 2 * v * w * ((i == m) & (j == n))
        expected = np.exp(-0.5 * view.node_variance * square).mean()
        # positions h apart leave the order h^2 at creases; 1e-5 at s = 20, by halving h
        assert found[k] == pytest.approx(expected, abs=3e-5)


@pytest.mark.parametrize("relief", [facets(3.0, 1e-3, 4), bumps(3.0, 1e-3, 5)])
def test_rough_limit_has_the_lobe_s_half_energy_radius(relief):
    """Many facets within the pupil: the image of a rough wall is that of its slopes."""
    steep = 12.0
    kind = facets if isinstance(relief, FacetWall) else bumps
    wall = kind(steep, 5e-4, 4)
    mean = psf.mean_point_spread(
        wave_of(), wall, footprint=0.5, cos_sum=2.0, shape=513, pitch=5e-6, tol=1e-2
    )
    y, x = np.indices(mean.shape) - 256
    order = np.argsort(np.hypot(x, y).ravel())
    energy = np.cumsum(mean.intensity.ravel()[order])
    radius = np.hypot(x, y).ravel()[order][np.searchsorted(energy, 0.5)] * mean.pitch
    # slopes of the wave 2 m slope_rms per axis, Rayleigh distributed
    expected = 0.2 * wall.slope_rms * np.sqrt(2 * np.log(2))
    assert radius == pytest.approx(expected, rel=0.03)


@pytest.mark.thorough
def test_propagation_is_the_kirchhoff_sum():
    """Spherical waves from every point of a smooth wall, with exact distances."""
    relief, pitch = GaussianWall(6e-8, 5e-4, seed=3), 2.5e-5
    view = view_of(relief, wave=wave_of(2.5e-3))
    field = relief_screen(view, 201, pitch, LAMBDA, 100).field()[:201, :201][::40, ::40]
    at = (np.arange(201) - 100)[::40] * pitch
    axis = np.arange(-6e-3, 6e-3, 1.25e-5)
    x, y = np.meshgrid(axis, axis)
    fade = np.cos(np.clip((np.abs(axis) - 3e-3) / 3e-3, 0, 1) * np.pi / 2) ** 2
    height, k = relief.height(x, y), 2 * np.pi / LAMBDA
    expected = np.empty(field.shape, complex)
    for i, v in enumerate(at):
        for j, u in enumerate(at):
            sums = []
            for z in (height, 0.0):
                # relative to 2 m, so that the phase keeps its accuracy
                path = np.sqrt(x**2 + y**2 + (1 - z) ** 2) - 1
                path += np.sqrt((x - u) ** 2 + (y - v) ** 2 + (1 - z) ** 2) - 1
                sums.append(np.sum(fade * fade[:, None] * np.exp(1j * k * path)))
            expected[i, j] = sums[0] / sums[1]
    expected *= np.exp(1j * np.angle(np.vdot(expected, field)))  # the piston is arbitrary
    # the patch of 6 mm and its soft edge leave 6e-5, of 8 mm 1e-5
    assert np.abs(field - expected).max() < 1e-3


@pytest.mark.thorough
def test_propagation_of_facets_is_the_fresnel_integral():
    """The image of a direct quadrature over a patch much wider than that of the code."""
    relief, pitch = FacetWall(5e-4, 2e-4, seed=3), 2.5e-5
    view = view_of(relief, wave=wave_of(2.5e-3))
    field = relief_screen(view, 201, pitch, LAMBDA, 100).field()[:201, :201][::4, ::4]
    at = (np.arange(201) - 100)[::4] * pitch
    axis = np.arange(-16e-3, 16e-3, 8e-6)
    x, y = np.meshgrid(axis, axis)
    fade = np.cos(np.clip((np.abs(axis) - 8e-3) / 8e-3, 0, 1) * np.pi / 2) ** 2
    k = 2 * np.pi / LAMBDA
    kernel = fade * np.exp(1j * k * (axis - 0.5 * at[:, None]) ** 2 / (2 * 0.5))
    flat = kernel.sum(axis=1)
    expected = kernel @ np.exp(-2j * k * relief.height(x, y)) @ kernel.T / (flat * flat[:, None])
    inside = np.hypot(at, at[:, None]) <= 2.5e-3
    turn = np.exp(-1j * k / 0.2 * np.linspace(-1e-4, 1e-4, 41)[:, None] * at)
    images = [np.abs(turn @ (part * inside) @ turn.T) ** 2 for part in (field, expected)]
    assert np.abs(images[0] - images[1]).max() < 1e-3 * images[1].max()


def test_energy_is_conserved_and_the_lattice_converges():
    view = view_of(facets(3.0, 1e-3, 7))
    fields = []
    for cells in (501, 1001):
        pitch = 25e-3 / (cells - 1)
        field = relief_screen(view, cells, pitch, LAMBDA, (cells - 1) / 2).field()
        # propagation is unitary on the torus
        assert np.mean(np.abs(field) ** 2) == pytest.approx(1.0, abs=1e-12)
        fields.append(field[:cells, :cells][:: cells // 500, :: cells // 500])
    fields[1] *= np.exp(1j * np.angle(np.vdot(fields[1], fields[0])))
    # light of the creases beyond the coarse lattice's band; it lands far outside the image
    assert np.sqrt(np.mean(np.abs(fields[0] - fields[1]) ** 2)) < 1e-2


@pytest.mark.thorough
@pytest.mark.parametrize(
    "relief",
    [
        bumps(1.0, 5e-3, 1),
        bumps(3.0, 8e-3, 2),
        bumps(0.5, 4e-3, 3),
        bumps(5.0, 12e-3, 4),
        bumps(2.0, 6e-3, 5),
    ],
)
def test_aberration_by_rays_is_the_propagated_wave(relief):
    wave = wave_of()
    view = view_of(relief)
    rough = rough_wave(wave.resampled(60, 240), view)
    options = {"shape": 129, "pitch": 1.25e-6, "normalisation": "flux"}
    rays = psf.point_spread(rough, tol=1e-5, model="scalar", **options)
    waves = psf.sample_point_spread(wave, relief, **options, **NORMAL)
    off = np.abs(rays.intensity - waves.intensity).max() / waves.intensity.max()
    assert off < 1e-3
    assert off < aberration_error(view, LAMBDA)


@pytest.mark.thorough
def test_aberration_refuses_a_caustic():
    with pytest.raises(errors.CausticError, match="focuses light before the pupil"):
        rough_wave(wave_of(), view_of(bumps(30.0, 1e-3)))


@pytest.mark.thorough
def test_memory_effect():
    """A displaced object point sees the same field, shifted by (d2/d1) times its displacement."""
    relief, pitch, steps = bumps(3.0, 4e-3, 2), 1e-4, 40
    here, there = view_of(relief), view_of(relief)
    object.__setattr__(there, "origin", there.origin + 0.5 * pitch * np.array([steps, 0]))
    first = relief_screen(here, 251, pitch, LAMBDA, 125).field()[:251, :251]
    second = relief_screen(there, 251, pitch, LAMBDA, 125).field()[:251, :251]
    shifted = second[:, :-steps] * np.exp(
        1j * np.angle(np.vdot(second[:, :-steps], first[:, steps:]))
    )
    assert np.abs(shifted - first[:, steps:]).max() < 1e-6


@pytest.mark.thorough
def test_patterns_of_displaced_points_decorrelate():
    """Correlation of the patterns' intensity: the squared overlap of the displaced pupils."""
    options = {"shape": 65, "pitch": 7e-6} | NORMAL
    wave, shifts = wave_of(4e-3), np.array([0.1, 0.25, 0.5])
    found = []
    mean = psf.mean_point_spread(
        wave, bumps(2.5, 2e-4), footprint=0.5, cos_sum=2.0, shape=65, pitch=7e-6, tol=1e-2
    ).intensity
    for seed in range(6):
        relief = bumps(2.5, 2e-4, seed)
        patterns = []
        for shift in (0.0, *shifts):
            step = np.array([shift * 8e-3 * 0.5, 0.0])
            patterns.append(_displaced(wave, relief, step, options) / mean)
        first = patterns[0] - patterns[0].mean()
        found.append(
            [np.mean(first * (p - p.mean())) / (first.std() * p.std()) for p in patterns[1:]]
        )
    overlap = 2 / np.pi * (np.arccos(shifts) - shifts * np.sqrt(1 - shifts**2))
    # 6 walls of some hundred speckles each
    assert np.abs(np.mean(found, axis=0) - overlap**2).max() < 0.03


def _displaced(wave, relief, step, options):
    """Return the pattern of a wall displaced by ``step`` (x, y), m."""

    class Displaced(GaussianWall):
        def height(self, x, y):
            return super().height(x + step[0], y + step[1])

    wall = Displaced(relief.height_rms, relief.correlation_length, seed=relief.seed)
    return psf.sample_point_spread(wave, wall, **options).intensity


def test_a_measured_map_is_one_wall():
    x, _ = np.meshgrid(*[np.arange(-400, 401) * 5e-5] * 2)
    # the other orders have a dark ring of the Airy pattern on the axis: the fifth zero of J1
    heights = 1e-7 * np.cos(2 * 16.470630 * x / 8e-3 * 2)
    wall = HeightMapWall(heights, 5e-5)
    wave = wave_of(4e-3)
    found = psf.sample_point_spread(wave, wall, shape=129, pitch=4e-6, **NORMAL)
    # an infinite phase grating: orders J_n(s)^2 at n lambda d_i m / period
    from scipy.special import jv

    s = 4 * np.pi / LAMBDA * 1e-7
    clear = psf.sample_point_spread(
        wave, HeightMapWall(0 * heights, 5e-5), shape=129, pitch=4e-6, **NORMAL
    )
    assert found.intensity[64, 64] / clear.intensity[64, 64] == pytest.approx(
        float(jv(0, s) ** 2), rel=0.05
    )


@pytest.mark.parametrize(
    ("roughness", "change", "message"),
    [
        (facets(1.0, 1e-3), {"seed": 1}, "seed = 1 is given with the heights of one wall"),
        (facets(1.0, 1e-3), {"independent_patterns": 2}, "independent_patterns = 2"),
        (psf.Roughness(1e-7, 1e-3), {}, "seed is missing"),
        (FacetWall(1e-3, 0.3), {"shape": 65, "pitch": 1e-4, "pixel_integrated": True}, "smaller"),
    ],
)
def test_bad_input_is_refused(roughness, change, message):
    with pytest.raises(errors.NlosError, match=message):
        psf.sample_point_spread(wave_of(), roughness, **NORMAL, **change)


def test_mean_of_a_height_map_has_its_rms_height_and_slope():
    drawn = HeightMapWall.random(
        height_rms=1e-7, correlation_length=1e-3, size=0.1, pitch=2e-4, seed=3
    )
    options = {"footprint": 0.5, "cos_sum": 2.0, "shape": 65, "pitch": 2.5e-6, "tol": 1e-3}
    found = psf.mean_point_spread(wave_of(), drawn, **options).intensity
    expected = psf.mean_point_spread(wave_of(), GaussianWall(1e-7, 1e-3), **options).intensity
    # one map of 10^4 correlation areas, whose slopes between neighbours miss 2 % of the variance
    assert np.abs(found - expected).max() < 0.05 * expected.max()


def test_other_walls_have_no_statistics():
    with pytest.raises(errors.SceneError, match="give a Roughness, a FacetWall"):
        psf.mean_point_spread(wave_of(), FlatWall(), footprint=0.5, cos_sum=2.0)
