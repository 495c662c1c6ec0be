"""Rays on a relief, one by one from the mirror's law to first order in slopes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.psf.rough import relief_rays
from nlosoptics.psf.rough.relief import STEEPEST
from nlosoptics.psf.rough.source import rough_source
from nlosoptics.psf.window.window import Window
from nlosoptics.scene import FacetWall, GaussianWall

WAVELENGTH, RADIUS = 6e-7, 4e-3
FOOTPRINT = np.array([[0.5, 0.05], [0.02, 0.6]])
DISTANCE = np.array([[0.4, 0.03], [0.03, 0.5]])
COSINES = 1.7
RELIEFS = {"facets": FacetWall(1e-3, 4e-4, seed=3), "bumps": GaussianWall(2e-7, 1e-3, seed=5)}
TERMS = {4: 3e-7, 5: -2e-7, 7: 2e-7}


def source_of(relief, image_distance=0.06, obscuration=0.0, terms=TERMS):
    front = psf.Wavefront.from_zernike(
        {2: 2e-7, 3: -1e-7, **terms},
        wavelength=WAVELENGTH,
        pupil_radius=RADIUS,
        image_distance=image_distance,
        obscuration=obscuration,
    )
    given = {"footprint": FOOTPRINT, "cos_sum": COSINES, "effective_distance": DISTANCE}
    return rough_source(front, relief, *given.values(), pattern=True)


def path(terms, u, v):
    return sum(a * psf.zernike(n, math.hypot(u, v) / RADIUS, math.atan2(v, u)) for n, a in terms)


def slopes(terms, u, v, step=1e-7):
    """Gradient of the smooth wave."""
    along = path(terms, u + step, v) - path(terms, u - step, v)
    up = path(terms, u, v + step) - path(terms, u, v - step)
    return np.array([along, up]) / (2 * step)


@pytest.mark.parametrize(
    "options",
    [{"obscuration": 0.4}, {"image_distance": -0.05}, {"terms": {}}],
    ids=["ring", "behind", "flat"],
)
@pytest.mark.parametrize("name", RELIEFS)
def test_image_is_the_sum_of_rays(name, options, monkeypatch):
    monkeypatch.setattr(relief_rays, "RAYS", 500)
    source = source_of(RELIEFS[name], **options)
    view, residual = source.view, source.residual
    terms, hidden = [*options.get("terms", TERMS).items()], options.get("obscuration", 0.0)
    distance = options.get("image_distance", 0.06)
    seen = RADIUS * np.hypot(FOOTPRINT[:, 0], FOOTPRINT[:, 1])
    throw = STEEPEST * COSINES * RELIEFS[name].slope_rms
    half = seen + throw * np.hypot(DISTANCE[:, 0], DISTANCE[:, 1])
    n = math.isqrt(math.ceil(500 * np.prod(half) / np.prod(seen)))
    found_n, found_half = relief_rays.ray_counts(view, RADIUS, WAVELENGTH)
    assert (found_n, found_half) == (n, approx(half, rel=1e-12))
    x, y = residual.shift
    pitch = 1.1e-5 if terms else 6e-6  # light falls on all sides of the window
    window = Window(pitch, (5, 7), (x - 3.0 * pitch, y - 2.1 * pitch))
    counts, back = np.zeros(window.shape), np.linalg.inv(FOOTPRINT)
    for i in range(n):
        for j in range(n):
            x = half * ((2 * j + 1) / n - 1, (2 * i + 1) / n - 1)
            at = view.origin + x[0] * view.axes[0] + x[1] * view.axes[1]
            tilt = view.roughness.derivatives(at[:1], at[1:2])[0, 1:3]
            slope = COSINES * np.array([view.axes[0] @ tilt, view.axes[1] @ tilt])
            p = back @ (x - DISTANCE @ slope)
            if not hidden <= math.hypot(*p) / RADIUS <= 1:
                continue
            turn = slopes(terms, *p) if terms else np.zeros(2)
            landing = distance * (turn - FOOTPRINT.T @ slope) + residual.shift
            column, row = np.round((landing - window.first) / window.pitch).astype(int)
            if 0 <= column < 7 and 0 <= row < 5:
                counts[row, column] += 1
    assert all(edge.any() for edge in (counts[0], counts[-1], counts[:, 0], counts[:, -1]))
    area = 4 * np.prod(half) / n**2 / np.linalg.det(FOOTPRINT)
    energy = counts * area / (math.pi * RADIUS**2 * (1 - hidden**2))
    found, error = relief_rays.ray_image(residual, view, window)
    # the smooth wave's slopes are tabulated: some rays land across a pixel's edge
    assert np.abs(found - energy).sum() < 0.06 * energy.sum()
    across = np.linalg.norm(FOOTPRINT, 2)
    spread = WAVELENGTH * abs(distance) * across / view.length / window.pitch
    most = found.max() / (energy.max() / counts.max())
    assert error == approx(min(1.0, spread) + 1 / math.sqrt(most), rel=1e-9)
    beside = Window(pitch, (3, 2), (0.9, 0.9))
    none, doubt = relief_rays.ray_image(residual, view, beside)
    assert not none.any()
    assert doubt == approx(min(1.0, spread) + 1.0, rel=1e-9)


def test_light_of_a_facet_over_a_pixel():
    source = source_of(RELIEFS["facets"], image_distance=-0.05)
    wave, view = source.residual.wavefront, source.view
    spread = WAVELENGTH * 0.05 * np.linalg.norm(FOOTPRINT, 2) / view.length
    assert view.length == approx(1e-3 / math.sqrt(2), rel=1e-12)
    for share in (0.5, 0.999, 1.001, 7.0):
        error = relief_rays.neglected_diffraction(view, wave, share * spread)
        assert error == approx(min(1.0, 1 / share), rel=1e-12)
