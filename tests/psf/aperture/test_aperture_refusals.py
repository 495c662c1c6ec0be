"""Outlines of pupils, and functions on them, that are refused."""

import math
from dataclasses import replace

import numpy as np
import pytest

from nlosoptics import psf
from nlosoptics.errors import SamplingError, SceneError

MM = 1e-3
SYSTEM = {"wavelength": 632.8e-9, "image_distance": 50e-3}
CORNERS = MM * np.array([(-5, -3), (5, -3), (5, 3), (-5, 3)])
BOX = psf.Aperture.polygon(CORNERS)
#: Not seen from its centroid.
HOOK = 2 * MM * np.array([(0, 0), (4, 0), (4, 3), (1, 3), (1, 2), (3, 2), (3, 1), (0, 1)])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: psf.Aperture.ellipse(0, 1), "a = 0 m is out of range"),
        (lambda: psf.Aperture.ellipse(1, math.nan), "b = nan is not finite"),
        (lambda: psf.Aperture.ellipse(1, 1, obscuration=1.0), "obscuration = 1 is out of range"),
        (lambda: psf.Aperture.polygon([(0, 0), (1, 0)]), r"shape \(2, 2\); give 3 to 1000"),
        (lambda: psf.Aperture.polygon([(0, 0), (1, 0), (2, 0)]), "on a line"),
        (lambda: psf.Aperture.polygon([(0, 0), (1, 0), (1, 0), (0, 1)]), "is repeated"),
        (lambda: psf.Aperture.polygon([(0, 0), (1, 1), (1, 0), (0, 1)]), "start at corners 0 and"),
        (
            lambda: psf.Aperture.polygon([(0, 0), (2, 0), (1, 0), (1, 1)]),
            "the sides that start at corners",
        ),
        (
            lambda: psf.Aperture.polygon([(0, 0), (2, 0), (2, 2), (1, 0), (0, 2)]),
            "the sides that start at corners 0 and 2 meet",
        ),
        (lambda: psf.Aperture.polygon([(0, 0), (np.nan, 0), (1, 1)]), r"vertices\[1\] = \[nan"),
        (lambda: psf.Aperture.polygon("round"), "not numbers"),
        (
            lambda: psf.Aperture.polygon(HOOK, obscuration=0.2),
            "every side visible from its centroid",
        ),
        (lambda: psf.Aperture.regular(2, 1.0), "sides = 2 is out of range"),
        (lambda: psf.Aperture.hexagons(1, 1.0, -0.1), "gap = -0.1 m is out of range"),
        (lambda: psf.Aperture.hexagons(0, 1.0, central=False), "leaves no segment"),
        (lambda: psf.Aperture.discs([]), "give at least one"),
        (lambda: psf.Aperture.discs([((0, 0), 1), ((3, 0), 1)]), "no area in common"),
        (lambda: psf.Aperture.discs([((0, 0), 1), ((2, 0), 1)]), "no area in common"),
        (lambda: psf.Aperture.discs([(0.0, 1)]), "is not a point"),
        (
            lambda: psf.Aperture.discs([((0, 0), 1)], within=[(2, 2), (3, 2), (2, 3)]),
            "no area in common",
        ),
        (
            # clockwise: told by its place, which does not change with the order
            lambda: psf.Aperture.discs([((0, 0), 1)], within=[(0, 3), (3, 3), (1, 1), (1, 0)]),
            r"the corner \[1.0, 1.0\] m is turned inward",
        ),
        (lambda: psf.Aperture.discs([((0, math.inf), 1)]), r"centre\[1\] = inf is not finite"),
        (lambda: psf.Aperture.round(1.0, vanes=4, vane_width=1.5), "meet 1.061 m from the axis"),
        (
            lambda: psf.Aperture.round(1.0, vanes=1, vane_width=0.1),
            "vanes = 1 with obscuration = 0",
        ),
        (lambda: psf.Aperture.round(1.0, vane_width=0.1), "with vanes = 0"),
        (lambda: psf.Aperture.round(1.0, angle=math.nan), "angle = nan is not finite"),
        (
            lambda: psf.Aperture.union(psf.Aperture.round(1.0), BOX),
            "cells 0 and 1 of the aperture overlap",
        ),
        (
            lambda: psf.Aperture.union(
                psf.Aperture.polygon([(-3, -1), (3, -1), (3, 1), (-3, 1)]),
                psf.Aperture.polygon([(-1, -3), (1, -3), (1, 3), (-1, 3)]),
            ),
            "overlap",
        ),
        (lambda: psf.Aperture.union(), "union got no apertures"),
        (lambda: psf.Aperture.union(BOX, "box"), "union got a str"),
    ],
)
def test_bad_outlines_are_refused(make, message):
    with pytest.raises(SceneError, match=message) as refusal:
        make()
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"nodes": "polar"}, "'polar' cannot follow an aperture"),
        ({"nodes": "cells", "aperture": None, "pupil_radius": 1e-3}, "without an aperture"),
        ({"aperture": None}, "pupil_radius is missing"),
        ({"obscuration": 0.3}, "with an aperture, limit 0"),
        ({"pistons": [1.0, 2.0]}, r"pistons have shape \(2,\); give \(1,\)"),
        ({"pistons": [math.nan]}, r"pistons\[0\] = nan"),
        ({"tilts": [1.0]}, r"tilts have shape \(1,\); give \(1, 2\)"),
        ({"aperture": None, "pupil_radius": 1e-3, "pistons": [0.0]}, "need an aperture"),
        ({"aberration": lambda u, v: np.log(u)}, r"aberration\(u, v\) = nan at u = -"),
        ({"aberration": lambda u, v: np.zeros(3)}, "must return one real number"),
        ({"amplitude": lambda u, v: np.exp(1j * u)}, "nodes: the values are complex"),
        ({"amplitude": lambda u, v: -1.0}, "is below 0"),
        ({"nodes": "grid", "samples": (4, 5)}, "a grid is square"),
        ({"samples": (0, 5)}, "samples = 0 is out of range"),
        ({"samples": "many"}, "samples = 'many' is not a whole number"),
        ({"aperture": None, "pupil_radius": 1e-3, "obscuration": [0.1]}, "is not a number"),
        ({"samples": (4, 5, 6)}, "give one whole number or two"),
        ({"aperture": CORNERS}, "aperture is a ndarray; give a psf.Aperture"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value")  # the logarithm's own
def test_bad_functions_are_refused(options, message):
    given = {"aperture": BOX, **SYSTEM, **options}
    with pytest.raises(SceneError, match=message):
        psf.Wavefront.from_function(**given)


def test_bad_coefficients_are_told_by_their_index():
    with pytest.raises(SceneError, match=r"^coefficients\[4\] = nan is not finite"):
        psf.Wavefront.from_zernike({4: math.nan}, pupil_radius=9 * MM, aperture=BOX, **SYSTEM)


def test_wavefronts_that_do_not_fit_their_aperture_are_refused():
    wave = psf.Wavefront.from_function(None, aperture=BOX, **SYSTEM)
    with pytest.raises(SceneError, match="without an aperture"):
        replace(wave, aperture=None)
    with pytest.raises(SceneError, match="off the nodes of layout 'cells'"):
        replace(wave, u=wave.u + 1e-6)
    with pytest.raises(SceneError, match="the aperture's 3 patches need"):
        replace(wave, aperture=psf.Aperture.regular(6, 1e-3))
    polar = psf.Wavefront.from_zernike({}, pupil_radius=1e-3, **SYSTEM)
    with pytest.raises(SceneError, match="'polar' cannot follow an aperture"):
        replace(polar, aperture=BOX)


def test_transforms_that_need_another_layout_say_so():
    wave = psf.Wavefront.from_function(None, aperture=BOX, **SYSTEM)
    with pytest.raises(SamplingError, match="layout 'cells'; use method='quadrature'"):
        psf.point_spread(wave, method="airy")
    hexagons = psf.Aperture.hexagons(2, 4 * MM, 0.1 * MM, angle=0.2)
    grid = psf.Wavefront.from_function(None, aperture=hexagons, nodes="grid", samples=64, **SYSTEM)
    for metric in (psf.encircled_energy, psf.mtf):
        with pytest.raises(SamplingError, match=r"give psf.point_spread\(wavefront\)"):
            metric(grid, 1e-6)
