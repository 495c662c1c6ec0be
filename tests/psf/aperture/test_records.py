"""Measures, nodes and grids of apertures of every shape, and point spreads through them."""

import numpy as np
import pytest

from nlosoptics import psf

from ...records import attempt

A = psf.Aperture
SQUARE = [(-0.8, -0.7), (0.9, -0.8), (0.7, 0.8), (-0.9, 0.6)]
APERTURES = {
    "ellipse": lambda: A.ellipse(1.0, 0.6, 0.3, obscuration=0.2, centre=(0.05, -0.02)),
    "vanes": lambda: A.round(1.0, 0.3, vanes=3, vane_width=0.08, angle=0.2),
    "crossed vanes": lambda: A.round(1.0, vanes=4, vane_width=0.05),
    "one vane": lambda: A.round(1.0, 0.4, vanes=1, vane_width=0.1),
    "polygon": lambda: A.polygon(SQUARE, obscuration=0.25),
    "bent polygon": lambda: A.polygon([(0, 0), (1, -0.5), (0.4, 0.2), (0.9, 0.9), (-0.8, 0.5)]),
    "regular": lambda: A.regular(5, 1.0, 0.1, obscuration=0.3),
    "hexagons": lambda: A.hexagons(1, 0.6, 0.05, angle=0.1, central=False),
    "many hexagons": lambda: A.hexagons(2, 0.36, 0.0),
    "discs": lambda: A.discs([((0.1, 0.2), 0.4), ((0.5, 0.1), 0.35), ((-0.6, -0.5), 0.2)]),
    "discs within": lambda: A.discs([((0.1, 0.2), 0.9), ((0.7, 0.1), 0.3)], within=SQUARE),
    "union": lambda: A.union(A.round(0.4).moved((-0.5, 0)), A.regular(3, 0.4).moved((0.5, 0.1))),
}


@pytest.mark.parametrize("name", APERTURES)
def test_an_aperture(name, on_record):
    aperture = attempt(APERTURES[name])
    if isinstance(aperture, Exception):
        return on_record(aperture)
    u, v = np.random.default_rng(1).uniform(-1.1, 1.1, (2, 200))
    names = ("area", "perimeter", "rims", "bounding_radius", "half_width", "owners", "patch_areas")
    on_record(
        {
            "measures": {one: attempt(getattr, aperture, one) for one in names},
            "patches": [aperture.patches, aperture.patch_size],
            "nodes": attempt(aperture.nodes, 4, 5),
            "grid": attempt(aperture.grid_nodes, 24),
            "shares": attempt(aperture.grid_shares, 20, 0.11),
            "inside": attempt(aperture.contains, u, v),
        }
    )


SPREADS = [(name, "auto") for name in ("vanes", "polygon", "hexagons", "union")]
SPREADS += [(name, "geometric") for name in ("polygon", "hexagons")]


@pytest.mark.parametrize(("name", "method"), SPREADS)
def test_a_point_spread(name, method, on_record):
    waves = 40.0 if method == "geometric" else 0.4
    system = {"wavelength": 6e-7, "image_distance": 30.0}
    coefficients = {4: 0.2 * waves * 6e-7, 7: 0.05 * waves * 6e-7}
    aperture = attempt(APERTURES[name])
    wave = attempt(
        psf.Wavefront.from_zernike, coefficients, pupil_radius=1.2, aperture=aperture, **system
    )
    asked = {"pitch": 3e-5 if waves > 1 else 3e-6, "shape": 24, "pixel_integrated": waves > 1}
    spread = attempt(psf.point_spread, wave, tol=0.5, method=method, **asked)
    lines = np.linspace(0, 1.5 / 1.8e-5, 4)
    figures = [attempt(psf.mtf, wave, lines, azimuth=0.7), attempt(psf.strehl, wave)]
    on_record([spread, figures, attempt(psf.encircled_energy, wave, [1e-5, 4e-5])])
