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
    "frequency": (lambda _: psf.mtf(wave(), [1e3, np.nan]), "frequency or azimuth is NaN"),
    "no discs": (lambda _: psf.Aperture.discs([]), "discs = []; give at least one ((u, v), radius"),
}
PUPILS = {
    "optics of a word": (lambda _: psf.SceneOptics("scene"), "scene is a str; give a Scene, such"),
    "optics of a wrong pupil": (
        lambda s: psf.SceneOptics(s, pupil=2.0),
        "pupil is a float; give an ExitPupil, or leave it out",
    ),
    "samples with nodes": (
        lambda s: psf.wavefront(s, nodes=np.zeros((3, 2)), samples=5),
        "samples = 5 with nodes given as an array; leave it out",
    ),
    "oblong grid": (
        lambda _: wave("grid", samples=(5, 6)),
        "samples = (5, 6); a grid is square, give one whole number",
    ),
    "wall as stop": (
        lambda s: psf.wavefront(with_wall(s, FlatWall(size=0.012)), nodes="polar"),
        "the wall is the stop and its outline is a rectangle, which polar nodes cannot follow",
    ),
    "cells of a curved wall": (
        lambda s: psf.wavefront(with_wall(s, ConcaveWall(9.0, size=0.3)), nodes="cells"),
        "nodes = 'cells' needs a flat wall with an edge, and this one is curved",
    ),
    "light beside the wall": (
        lambda s: psf.wavefront(with_wall(s, FlatWall(size=0.2)), (0.8, 0.3, 1.0)),
        "is reflected to the lens by no part of the wall, wall.size = (0.2, 0.2) m; enlarge",
    ),
    "wall too near": (
        lambda s: psf.exit_pupil(with_wall(s, FlatWall(size=0.01), focal_length=1.2)),
        "the wall is 1 m from the lens, within its focal length 1.2 m; move the camera back",
    ),
}
WAVES = {
    "no cells": (
        lambda _: wave("cells"),
        "nodes = 'cells' without an aperture; give one, or use 'polar' or 'grid'",
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
    "no whole padding": (
        lambda _: spread(wave("grid", samples=32), method="fft", pitch=1.11e-6, shape=None),
        "padded samples, not a whole number; use pitch = ",
    ),
    "wide cone": (
        lambda _: spread(wave(pupil_radius=0.06), model="high-aperture", pitch=1e-7),
        "at F/0.5, limit F/0.5, where it is as wide as the wave's sphere",
    ),
}
ROUGH_VIEW = {"footprint": 0.5, "cos_sum": 1.8}
SEEN = ROUGH_VIEW | {"effective_distance": 0.4, "seed": 0, "pitch": 2e-6, "shape": 16}


def mean(source=None, **changes):
    given = ROUGH_VIEW | {"pitch": 2e-6, "shape": 16} | changes
    roughness = given.pop("roughness", ROUGH)
    return psf.mean_point_spread(wave() if source is None else source, roughness, **given)


ROUGHNESSES = {
    "above 1": (
        lambda _: psf.Roughness(3e-8, 1e-3, lambda r: 2 * np.exp(-r)),
        "is 2 at lag 0 and reaches 2, must be 1 and at most 1; divide it by its value at 0",
    ),
    "later above 1": (
        lambda _: psf.Roughness(3e-8, 1e-3, lambda r: np.where(r == 1e-3, 1.01, 1.0)),
        "is 1 at lag 0 and reaches 1.01, must be 1 and at most 1",
    ),
    "another shape": (
        lambda _: psf.Roughness(3e-8, 1e-3, lambda _: 1.0),
        "gave shape () for lags of shape (98,), or values that are not finite; return one",
    ),
    "not finite": (
        lambda _: psf.Roughness(3e-8, 1e-3, lambda r: np.where(r > 0.1, np.nan, 1.0)),
        "gave shape (98,) for lags of shape (98,), or values that are not finite; return one",
    ),
    "flat table": (lambda _: psf.Roughness(3e-8, 1e-3, [1.0, 0.5, 0.0, 0.0]), "has shape (4,)"),
    "endless": (
        lambda _: psf.sample_point_spread(
            wave(), psf.Roughness(3e-8, 1e-3, lambda r: 0.5 + 0.5 * np.exp(-r / 1e-3)), **SEEN
        ),
        "up to 1000 correlation lengths; give one that falls to 0",
    ),
}
ROUGH_CALLS = {
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
    "halo too wide": (
        lambda _: mean(shape=None, roughness=psf.Roughness(3e-8, 2e-6), pitch=1e-7),
        "limit 4096; give a wider pitch with pixel_integrated=True, or a shape",
    ),
    "coarse pixels": (
        lambda _: psf.sample_point_spread(wave(), ROUGH, **SEEN | {"pitch": 6e-6}),
        "pitch = 6e-06 m is wider than the Nyquist pitch 2.25e-06 m and does not resolve",
    ),
    "coarse pupil": (
        lambda _: psf.sample_point_spread(
            wave("grid", samples=32), psf.Roughness(3e-7, 1e-4), **SEEN
        ),
        "or more pupil samples (now 32), or of polar nodes",
    ),
    "repeats": (
        lambda _: psf.sample_point_spread(
            wave("grid", samples=32), psf.Roughness(1e-9, 1e-2), **SEEN | {"shape": 160}
        ),
        "the pupil samples repeat the image every 0.000139 m, but window and halo need",
    ),
}
WALLS = {
    "grid": (
        lambda s: psf.point_spread_field(s, (2, 2, 2)),
        "grid = (2, 2, 2); give one whole number or (ny, nx)",
    ),
}
POLARISED = {"polarisation": 0.3, "pitch": 2e-6, "shape": 8}
TRANSFORMS = {
    "no whole padding": (
        lambda _: psf.point_spread(wave("grid", samples=32), method="fft", pitch=1.11e-6),
        "padded samples, not a whole number; use pitch = ",
    ),
    "aliased padding": (
        lambda _: psf.point_spread(
            wave("grid", samples=32),
            method="fft",
            pitch=6e-7 * 0.06 / (2.5e-4 * 50),
            normalisation="ideal-peak",
        ),
        "(padding Q below 2); use a finer pitch, or method='mdft'",
    ),
    "two numbers": (
        lambda _: psf.huygens_point_spread(wave(), [(0.0, 0.06)]),
        "points have shape (1, 2); give (..., 3), x, y and z in m",
    ),
    "no points": (
        lambda _: psf.huygens_point_spread(wave(), np.zeros((0, 3))),
        "points have shape (0, 3); give (..., 3), x, y and z in m",
    ),
    "infinite point": (
        lambda _: psf.huygens_point_spread(wave(), [(0.0, 0.0, np.inf)]),
        "points hold NaN or infinity; give finite coordinates in m",
    ),
    "point in the pupil": (
        lambda _: psf.huygens_point_spread(wave(), [(0, 0, 0.06), (0, 0, 5.9e-5)], pupil="plane"),
        "point 1 at z = 5.9e-05 m is not beyond the pupil: points must lie at least 6e-05 m",
    ),
    "point behind the pupil": (
        lambda _: psf.huygens_point_spread(wave(image_distance=-0.06), [(0.0, 0.0, 0.06)]),
        "point 0 at z = 0.06 m is not beyond the pupil",
    ),
    "point within the sphere": (
        lambda _: psf.huygens_point_spread(wave(), [(0, 0, 1.9e-4)], pupil="sphere"),
        "points must lie at least 0.000193 m from it",
    ),
    "wide sphere": (
        lambda _: psf.huygens_point_spread(
            wave(pupil_radius=0.06), [(0.0, 0.0, 0.06)], pupil="sphere"
        ),
        "pupil = 'sphere' at F/0.5, limit F/0.5, where the pupil is wider than its sphere",
    ),
    "wide cone": (
        lambda _: psf.point_spread(
            wave(pupil_radius=0.06), model="high-aperture", pitch=1e-7, shape=8
        ),
        "at F/0.5, limit F/0.5, where it is as wide as the wave's sphere",
    ),
    "method of the wide model": (
        lambda _: psf.point_spread(wave(), model="high-aperture", method="fft", pitch=1e-6),
        "method = 'fft' with model = 'high-aperture', which it cannot compute",
    ),
    "polarised scalar": (
        lambda _: psf.point_spread(wave(), model="scalar", **POLARISED),
        "polarisation = 0.3 with the scalar model, which has none",
    ),
    "polarised method": (
        lambda _: psf.point_spread(wave(), method="quadrature", **POLARISED),
        "polarisation = 0.3 with the scalar model, which has none",
    ),
    "short of time": (
        lambda _: psf.point_spread(
            wave(), model="high-aperture", pitch=2e-6, shape=300, max_seconds=1e-6
        ),
        "limit max_seconds = 1e-06; use max_seconds = ",
    ),
    "short of nodes": (
        lambda _: psf.point_spread(
            wave("grid", samples=32), model="high-aperture", pitch=2e-6, shape=8, tol=1e-6
        ),
        "the high-aperture model has an error of",
    ),
    "surface of another method": (
        lambda _: psf.point_spread(
            wave(), method="mdft", image_surface=np.hypot, pitch=2e-6, shape=8
        ),
        "image_surface with method = 'mdft', which computes the image plane only",
    ),
    "surface without a shape": (
        lambda _: psf.point_spread(wave(), method="huygens", image_surface=np.hypot, pitch=2e-6),
        "image_surface without a shape: the default shape holds the rays in the image plane",
    ),
    "closed form on a grid": (
        lambda _: psf.point_spread(wave("grid", samples=32), method="airy", pitch=2e-6, shape=8),
        "the closed form needs a wavefront of layout 'polar', not 'grid'",
    ),
    "closed form of much aberration": (
        lambda _: psf.point_spread(
            wave(coefficients=((11, 4e-6),)),
            method="airy",
            pitch=2e-6,
            shape=1700,
            normalisation="ideal-peak",
        ),
        "waves, too much for the closed form; use method='quadrature'",
    ),
    "jump": (
        lambda _: psf.point_spread(
            wave("grid", coefficients=((11, 4e-6),), samples=32),
            method="mdft",
            pitch=2e-6,
            shape=8,
        ),
        "limit 0.50; use ",
    ),
    "steps toward points": (
        lambda _: psf.huygens_point_spread(
            wave("grid", samples=32, coefficients=()), [(3e-3, 0.0, 0.06)]
        ),
        "waves between nodes, limit 1, beyond which the nodes repeat the spot there",
    ),
}
TABLE = {"metrics": METRICS, "batch": BATCH, "pupil": PUPILS, "wave": WAVES}
TABLE |= {"roughness": ROUGHNESSES, "rough": ROUGH_CALLS, "walls": WALLS}
TABLE |= {"transform": TRANSFORMS}
CASES = [(folder, name) for folder, rows in TABLE.items() for name in rows]


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_line(name, flat_scene):
    call, words = REFUSED[name]
    with pytest.raises(NlosError) as caught:
        call(flat_scene)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


TURNED = np.arange(8) * 2.4
LAST = {
    "as many nodes as terms": lambda: psf.fit_zernike(
        scattered(3e-3 * np.cos(TURNED) * np.sqrt(TURNED / 20), 3e-3 * np.sin(TURNED)), 8
    ),
    "rings of a degree": lambda: wave(samples=(5, 17), coefficients=((37, 1e-8),)),
    "fringe": lambda: psf.zernike(37, 0.5, 0.1, ordering="fringe"),
    "cosines": lambda: mean(cos_sum=2.0),
    "autocorrelation at 0": lambda: psf.Roughness(3e-8, 1e-3, lambda r: np.exp(-r) * (1 + 9e-10)),
    "one pixel": lambda: psf.point_spread(wave(), pitch=2e-6, shape=1, normalisation="ideal-peak"),
}


def test_the_last_value_is_accepted():
    assert wave(samples=(5, 17), coefficients=((37, 1e-8),)).u.shape == (5, 17)
    assert psf.zernike(37, 0.5, 0.1, ordering="fringe") is not None
    assert psf.mean_point_spread(wave(), ROUGH, **SEEN | {"cos_sum": 2.0}).shape == (16, 16)
    assert spread(shape=1, normalisation="ideal-peak").shape == (1, 1)
