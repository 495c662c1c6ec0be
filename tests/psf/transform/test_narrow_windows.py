"""Windows that lose rays: parts of the image on request, and refusals with a remedy."""

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SamplingError

WAVELENGTH, RADIUS, DISTANCE = 632.8e-9, 12.5e-3, 50e-3
UNIT = WAVELENGTH * DISTANCE / (2 * RADIUS)
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": DISTANCE}
WAVES = {2: 0.3 * WAVELENGTH, 4: 3 * WAVELENGTH, 7: 0.5 * WAVELENGTH}
VANED = psf.Aperture.round(RADIUS, 0.3, vanes=3, vane_width=0.05 * RADIUS)

PARTS = [("quadrature", {}), ("nufft", {"samples": (80, 320)}), ("quadrature", {"aperture": VANED})]
PARTS += [(method, {"nodes": "grid", "samples": 200}) for method in ("mdft", "nufft")]


@pytest.mark.parametrize("pixels", [False, True])
@pytest.mark.parametrize(("method", "nodes"), PARTS)
def test_parts_are_those_of_the_whole_image(method, nodes, pixels):
    wave = psf.Wavefront.from_zernike(WAVES, **SYSTEM, **nodes)
    options = {"pitch": 0.4 * UNIT, "normalisation": "ideal-peak", "tol": 1e-9}
    options["pixel_integrated"] = pixels
    same, n = "mdft" if wave.layout == "grid" else "quadrature", 201
    whole = psf.point_spread(wave, method=same, shape=n, **options)
    part = psf.point_spread(wave, method=method, shape=(9, 14), **options)
    expected = whole.intensity[n // 2 - 4 : n // 2 + 5, n // 2 - 7 : n // 2 + 7]
    difference = np.abs(part.intensity - expected).max() / expected.max()
    # the grid's error of its rim is common to both
    assert difference < part.error_estimate + whole.error_estimate
    assert difference < 1e-8
    # the rest of the energy is outside, and known
    assert part.enclosed_energy < 0.5
    assert part.enclosed_energy == approx(
        expected.sum() * whole.enclosed_energy / whole.intensity.sum(), rel=1e-3
    )


@pytest.mark.parametrize("seed", range(8))
def test_estimates_hold_in_the_dark(seed):
    rng = np.random.default_rng([17, seed])
    waves = dict(zip(range(4, 12), (WAVELENGTH * rng.normal(size=8)).tolist(), strict=True))
    wave = psf.Wavefront.from_zernike(waves, **SYSTEM, aperture=VANED)
    # beside the spot, which a tilt moves by 60 lambda N
    tilted = psf.Wavefront.from_zernike({**waves, 2: 15 * WAVELENGTH}, **SYSTEM, aperture=VANED)
    for given in (wave, tilted):
        options = {"pitch": 0.3 * UNIT, "shape": 12}
        truth = psf.point_spread(given, method="quadrature", tol=1e-13, **options)
        for tol in (1e-2, 1e-4, 1e-7):
            found = psf.point_spread(given, method="quadrature", tol=tol, **options)
            error = np.abs(found.intensity - truth.intensity).max() / truth.intensity.max()
            assert error < found.error_estimate


@pytest.mark.parametrize("method", ["auto", "fft", "mdft"])
def test_other_methods_name_one_that_can(method):
    wave = psf.Wavefront.from_zernike(WAVES, **SYSTEM)
    with pytest.raises(SamplingError, match=r"or more, or method='quadrature', which computes"):
        psf.point_spread(wave, method=method, pitch=0.4 * UNIT, shape=9)
    grid = psf.Wavefront.from_zernike(WAVES, **SYSTEM, nodes="grid", samples=200)
    if method != "mdft":
        with pytest.raises(SamplingError, match="or method='mdft', which computes any part"):
            psf.point_spread(grid, method=method, pitch=0.4 * UNIT, shape=9)
