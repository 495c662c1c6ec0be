"""Memory: each array that a call says to need is refused by name before it is made."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from nlosoptics import psf
from nlosoptics._checks import Budget, within
from nlosoptics.errors import MemoryLimitError, SamplingError
from nlosoptics.scene import FacetWall

from ..records import clear_caches

SYSTEM = {"wavelength": 6e-7, "pupil_radius": 4e-3, "image_distance": 0.06}
SEEN = {"footprint": 0.5, "cos_sum": 1.8}
PITCH = 6e-7 * 7.5 / 4


def wave(nodes="polar", samples=None, coefficients=((5, 5e-8), (7, 3e-8)), **changes):
    aperture = psf.Aperture.hexagons(1, 2e-3, 1e-4) if nodes == "cells" else None
    own = {"aperture": aperture} if aperture else {}
    return psf.Wavefront.from_zernike(
        dict(coefficients), nodes=nodes, samples=samples, **own, **SYSTEM | changes
    )


def dots(count=400):
    turn, r = 2.399963 * np.arange(count), 4e-3 * np.sqrt((np.arange(count) + 0.5) / count)
    u, v = r * np.cos(turn), r * np.sin(turn)
    ones = np.ones(count)
    given = {"aberration": 2e-3 * u * v, "amplitude": ones, "weights": 5e-5 / count * ones}
    return psf.Wavefront(layout="scattered", u=u, v=v, **SYSTEM | given)


def beam():
    """A wave whose amplitude falls to the rim, which no softened grid takes."""
    front = wave(samples=(24, 40), coefficients=((5, 2e-8),))
    return replace(front, amplitude=np.exp(-2 * (front.u**2 + front.v**2) / 1.6e-5))


def spread(front, method, shape=(7, 9), pitch=PITCH, **asked):
    return lambda: partial(
        psf.point_spread, front(), method=method, pitch=pitch, shape=shape, **asked
    )


def mean(**asked):
    given = SEEN | {"pitch": PITCH, "shape": (8, 9), "tol": 1e-2} | asked
    return partial(psf.mean_point_spread, wave(), psf.Roughness(3e-8, 1e-3), **given)


def speckle(samples, wall, **asked):
    given = SEEN | {"effective_distance": 0.4, "pitch": PITCH, "shape": 8}
    return partial(psf.sample_point_spread, wave("grid", samples), wall, **given, **asked)


def tail():
    asked = {"pitch": 2e-6, "shape": 24, "pixel_integrated": True, "tol": 1e-2}
    known = psf.point_spread(wave(), method="quadrature", **asked)
    return partial(psf.widened, known, tol=1e-2, shape=(40, 30))


MAP, CELLS = partial(wave, "grid", 64), partial(wave, "cells")
MANY = {"coefficients": ((4, 4e-6), (7, 3e-7))}
PIXELS = {"shape": (70, 60), "pitch": 2e-5, "pixel_integrated": True}
PLACES = [(0.0, 0.0, 0.06), (1e-5, 2e-5, 0.0601)]
LONG = {"shape": 60, "max_seconds": 1e-7}
CALLS = {
    "airy": spread(partial(wave, coefficients=()), "airy"),
    "quadrature": spread(wave, "quadrature"),
    "quadrature of cells": spread(CELLS, "quadrature"),
    "fft": spread(wave, "fft", 40),
    "fft on pixels": spread(wave, "fft", 30, pixel_integrated=True),
    "fft of a beam": spread(beam, "fft", 40),
    "fft of a map": spread(MAP, "fft", 30, 6e-7 * 0.06 / 1.6e-2),
    "fft of cells": spread(CELLS, "fft", 40),
    "mdft": spread(wave, "mdft", 40),
    "mdft on pixels": spread(wave, "mdft", 30, pixel_integrated=True),
    "mdft of a beam": spread(beam, "mdft", 40),
    "mdft of a map": spread(MAP, "mdft"),
    "mdft of cells": spread(CELLS, "mdft", 40),
    "nufft": spread(dots, "nufft", 3),
    "rays": spread(partial(wave, **MANY), "geometric", **PIXELS),
    "rays of cells": spread(partial(CELLS, **MANY), "geometric", **PIXELS),
    "surface": spread(wave, "huygens"),
    "points": lambda: partial(psf.huygens_point_spread, wave(), PLACES),
    "points of dots": lambda: partial(psf.huygens_point_spread, dots(), PLACES),
    "wide pixels": lambda: partial(psf.wide_point_spread, wave(), pitch=2e-4, shape=9, tol=1e-2),
    "sines": spread(wave, "quadrature", 5, model="high-aperture"),
    "sines of a map": spread(MAP, "mdft", 5, model="high-aperture"),
    "too long": spread(wave, "auto", **LONG),
    "too long on pixels": spread(wave, "auto", **LONG, pixel_integrated=True),
    "too long for rays": spread(partial(wave, **MANY), "auto", **PIXELS, max_seconds=1e-7),
    "too long for cells": spread(CELLS, "auto", **LONG, pixel_integrated=True),
    "nodes": lambda: partial(psf.polar_nodes, 1.0, 9, 12),
    "nodes of cells": lambda: partial(psf.Aperture.hexagons(1, 2.0, 0.1).nodes, 4, 5),
    "squares of cells": lambda: partial(psf.Aperture.hexagons(1, 2.0, 0.1).grid_nodes, 12),
    "wave": lambda: wave,
    "fit": lambda: partial(psf.fit_zernike, wave(), 6),
    "overlap": lambda: partial(psf.mtf, wave("cells"), [3e4, 1e5], azimuth=0.3),
    "mean": mean,
    "mean on pixels": partial(mean, pixel_integrated=True),
    "speckle": partial(speckle, 64, psf.Roughness(3e-8, 2e-3), seed=1),
    "facets": partial(speckle, 200, FacetWall(2e-3, 1e-4)),
    "batch": lambda: partial(
        psf.point_spreads, wave(), 1e-8 * np.ones((3, 24, 96)), pitch=PITCH, shape=12, tol=1e-2
    ),
    "tail": tail,
}


@pytest.mark.parametrize("name", CALLS)
def test_each_need_is_refused_by_name(name, on_record):
    """The first comparison with the limit fails, then the second, and so on to the call's end."""
    call, told, limit = CALLS[name](), {}, Limit(0)
    while limit.count >= limit.last:
        clear_caches()
        limit = Limit(limit.last + 1)
        try:
            with within(Budget(memory=limit, seconds=math.inf)):
                call()
        except MemoryLimitError as error:
            told[str(error)] = limit.need
        except SamplingError as error:
            told[str(error)] = 0.0
    assert told
    on_record([[need, text] for text, need in told.items()])


class Limit(float):
    """A limit of 0 bytes that one comparison exceeds, the last."""

    def __new__(cls, _):
        return super().__new__(cls)

    def __init__(self, last):
        self.last, self.count, self.need = last, 0, 0.0

    def __lt__(self, need):
        self.count += 1
        self.need = float(need)
        return self.count == self.last
