"""Memory that point spreads take, against what they say to need before they begin."""

import pytest

from nlosoptics import psf

SYSTEM = {"wavelength": 632.8e-9, "pupil_radius": 12.5e-3, "image_distance": 50e-3}
UNIT = 632.8e-9 * 2  # lambda N at F/2


def wave(nodes, samples):
    """A wave on a grid of samples, or on as many polar nodes as a tenfold defocus needs."""
    own = {"samples": samples} if nodes == "grid" else {}
    defocus = 3e-8 if nodes == "grid" else 1e-9 * samples
    return psf.Wavefront.from_zernike({4: defocus, 9: 2e-8}, nodes=nodes, **own, **SYSTEM)


#: Layout and samples of the pupil, and the side of the window in pixels.
CASES = {
    "quadrature": [("polar", 20, 900), ("polar", 3000, 60)],
    "nufft": [("polar", 20, 900)],
    "fft": [("grid", 700, 60)],
    "mdft": [("grid", 130, 900), ("grid", 700, 60)],
    "airy": [("polar", 20, 700)],
}


@pytest.mark.parametrize(
    ("method", "nodes", "samples", "side"),
    [(method, *case) for method, cases in CASES.items() for case in cases],
)
def test_memory_is_what_was_stated(method, nodes, samples, side, memory_of):
    wavefront = wave(nodes, samples)
    options = {"method": method, "shape": side, "pitch": UNIT / 4}
    if method == "airy":
        wavefront = psf.Wavefront.from_zernike({4: 0.0}, nodes="polar", **SYSTEM)
    if method == "nufft":
        wavefront = wavefront.resampled(160, 640)
    peak, stated = memory_of(lambda: psf.point_spread(wavefront, **options))
    assert 0.2 * stated < peak < stated
