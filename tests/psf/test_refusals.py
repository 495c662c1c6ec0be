"""What is refused, in one line that names value, limit and remedy; the last value is accepted."""

from __future__ import annotations

import numpy as np
import pytest

from nlosoptics import psf
from nlosoptics._checks import Budget, within
from nlosoptics.errors import MemoryLimitError, NlosError

SYSTEM = {"wavelength": 6e-7, "pupil_radius": 4e-3, "image_distance": 0.06}
ROUGH = psf.Roughness(3e-8, 1e-3)
SEEN = {"footprint": 0.5, "cos_sum": 1.8, "pitch": 2e-6, "shape": 16}
LINE = np.linspace(-3e-3, 3e-3, 8)


def wave(nodes="polar", coefficients=((5, 5e-8),), samples=None, **changes):
    return psf.Wavefront.from_zernike(
        dict(coefficients), nodes=nodes, samples=samples, **SYSTEM | changes
    )


def cells():
    return wave("cells", aperture=psf.Aperture.hexagons(1, 2e-3, 1e-4))


def scattered(u, v, aberration=0.0, **changes):
    u, v = np.broadcast_arrays(u, v)
    ones = np.ones(u.shape)
    arrays = {"aberration": aberration * ones, "amplitude": ones, "weights": 1e-8 * ones}
    return psf.Wavefront(layout="scattered", u=u, v=v, **SYSTEM | arrays | changes)


def spread(front=None, **options):
    return psf.point_spread(front or wave(), **{"pitch": 2e-6, "shape": 8} | options)


REFUSED = {
    "too few nodes of a fit": (
        lambda _: psf.fit_zernike(scattered(LINE, 0.5 * LINE), 9),
        "8 lit nodes cannot determine 9 Zernike terms; use fewer terms",
    ),
    "frequency": (lambda _: psf.mtf(wave(), [1e3, np.nan]), "frequency is NaN"),
    "no discs": (lambda _: psf.Aperture.discs([]), "discs = []; give at least one ((u, v), radius"),
    "samples with nodes": (
        lambda s: psf.wavefront(s, nodes=np.zeros((3, 2)), samples=5),
        "samples = 5 with nodes given as an array; leave it out",
    ),
    "oblong grid": (
        lambda _: wave("grid", samples=(5, 6)),
        "samples = (5, 6); a grid is square, give one whole number",
    ),
    "no cells": (
        lambda _: wave("cells"),
        "nodes = 'cells' without an aperture; give one or use 'polar', 'grid'",
    ),
    "too few rings": (
        lambda _: wave(samples=(4, 96), coefficients=((37, 1e-8),)),
        "4 x 96 polar nodes cannot hold Zernike degree 8; use 5 x 17 or more",
    ),
    "complex": (lambda _: scattered(LINE, LINE, 1j), "wavefront.aberration is not an array of"),
    "no light": (
        lambda _: scattered(LINE, LINE, amplitude=0 * LINE),
        "wavefront.amplitude is 0 everywhere; no light passes the pupil",
    ),
    "flat pupil": (lambda _: wave(image_distance=0.0), "wavefront.image_distance = 0 m; the pupil"),
    "fringe": (
        lambda _: psf.zernike(38, 0.5, 0.1, ordering="fringe"),
        "fringe index = 38 is out of range, must be 1 to 37; use noll",
    ),
    "shape": (lambda _: spread(shape="wide"), "shape = 'wide'; give one whole number or (ny, nx)"),
    "wide cone": (
        lambda _: spread(wave(pupil_radius=0.06), model="high-aperture", pitch=1e-7),
        "at F/0.5, limit F/0.5, where it is as wide as the wave's sphere",
    ),
    "polarised scalar": (
        lambda _: spread(model="scalar", polarisation=0.3),
        "polarisation = 0.3 with the scalar model, which has none",
    ),
    "matrix transform of cells": (
        lambda _: spread(cells(), method="mdft"),
        "method = 'mdft' cannot transform a wavefront of layout 'cells'; use method='quadrature'",
    ),
    "closed form on a grid": (
        lambda _: spread(wave("grid", samples=32), method="airy"),
        "method = 'airy' cannot transform a wavefront of layout 'grid'; use method='mdft'",
    ),
    "jump": (
        lambda _: spread(wave("grid", coefficients=((11, 4e-6),), samples=32), method="mdft"),
        "limit 0.50; use ",
    ),
    "autocorrelation above 1": (
        lambda _: psf.Roughness(3e-8, 1e-3, lambda r: 2 * np.exp(-r)),
        "is 2 at lag 0 and reaches 2, must be 1 and at most 1; divide it by its value at 0",
    ),
    "footprint of a scene": (
        lambda s: psf.mean_point_spread(s, ROUGH, footprint=1.0),
        "footprint is given with a scene, which defines it; leave it out",
    ),
    "singular footprint": (
        lambda _: psf.mean_point_spread(
            wave(), ROUGH, **SEEN | {"footprint": [[1.0, 2.0], [2.0, 4.0]]}
        ),
        "footprint = [[1.0, 2.0], [2.0, 4.0]] is singular; give an invertible matrix",
    ),
    "no distance": (
        lambda _: psf.sample_point_spread(wave(), ROUGH, **SEEN, seed=0),
        "effective_distance is missing, but a wavefront does not hold the distance to the wall",
    ),
    "grid of a field": (
        lambda s: psf.point_spread_field(s, (2, 2, 2)),
        "grid = (2, 2, 2); give one whole number or (ny, nx)",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_line(name, flat_scene):
    call, words = REFUSED[name]
    with pytest.raises(NlosError) as caught:
        call(flat_scene)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("front", "options"),
    [
        (wave, {"method": "quadrature"}),
        (cells, {"method": "fft"}),
        (wave, {"method": "fft"}),
        (lambda: wave("grid", samples=64), {"method": "mdft"}),
        (wave, {"model": "high-aperture"}),
        (
            lambda: wave(coefficients=((4, 4e-6),)),
            {"method": "geometric", "pixel_integrated": True},
        ),
    ],
    ids=["quadrature", "cells", "fft", "mdft", "vector", "rays"],
)
def test_what_does_not_fit_into_memory_is_refused(front, options):
    options = {"shape": 70, "pitch": 2e-5 if "pixel_integrated" in options else 1e-6} | options
    front = front()
    for limit in (1e4, 2e5):  # below the result, and below what the transform needs for it
        with (
            within(Budget(memory=limit, seconds=60.0)),
            pytest.raises(MemoryLimitError, match=r"needs .*GiB.*use a (smaller|wider)"),
        ):
            spread(front, **options)


def test_the_last_value_is_accepted():
    assert wave(samples=(5, 17), coefficients=((37, 1e-8),)).u.shape == (5, 17)
    assert psf.zernike(37, 0.5, 0.1, ordering="fringe") is not None
    assert psf.mean_point_spread(wave(), ROUGH, **SEEN | {"cos_sum": 2.0}).shape == (16, 16)
    assert spread(shape=1, normalisation="ideal-peak").shape == (1, 1)
