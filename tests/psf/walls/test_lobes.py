"""Lobes with slopes blur the smooth wall's point spread by the density of those slopes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pytest import approx
from scipy.special import ndtr

from nlosoptics import psf
from nlosoptics.psf.walls.scene_psf import mirror_lobes
from nlosoptics.scene import Lambert, SpecularMicrofacet, SumMaterial, Ward


def rough(scene, *lobes):
    return replace(scene, wall_material=SumMaterial(Lambert(0.7), *lobes))


def blur(scene, wave, slope):
    """Covariance, m^2, of where facets of Gaussian slopes send the light."""
    view = psf.wall_view(scene)
    turn = view.cos_sum * slope * wave.image_distance * view.footprint
    return turn.T @ turn


def blurred(scene, **options):
    """Point spread of a scene."""
    return psf.scene_point_spread(scene, **options).point_spread


def test_smooth_lobe_is_the_wave_alone(flat_scene):
    wave = psf.wavefront(flat_scene)
    pitch = flat_scene.camera.image_pitch
    found = blurred(flat_scene)
    shape = psf.window_shape(wave, pitch=pitch)
    exact = psf.point_spread(wave, pitch=pitch, shape=shape, pixel_integrated=True)
    limit = (found.error_estimate + exact.error_estimate) * exact.intensity.max()
    assert np.abs(found.intensity - exact.intensity).max() <= limit
    bare = replace(flat_scene, wall_material=Lambert(0.7))
    assert np.array_equal(blurred(bare).intensity, found.intensity)


@pytest.mark.parametrize("lobe", [SpecularMicrofacet(0.05, 0.01), Ward(0.05, 0.01 * 2**0.5)])
def test_gaussian_slopes_give_a_gaussian(flat_scene, lobe):
    """Of the covariance that the wall's view gives, in pixels much wider than diffraction."""
    scene = rough(flat_scene, lobe)
    wave = psf.wavefront(scene)
    found = blurred(scene, tol=1e-4)
    covariance = blur(scene, wave, 0.01)
    # symmetric about the plane of incidence, which holds e1
    assert abs(covariance[0, 1]) < 1e-9 * covariance[0, 0]
    sides = []
    for centres, variance in ((found.x, covariance[0, 0]), (found.y, covariance[1, 1])):
        edges = np.append(centres - found.pitch / 2, centres[-1] + found.pitch / 2)
        sides.append(np.diff(ndtr(edges / np.sqrt(variance))))
    exact = np.outer(sides[1], sides[0])
    # the Airy disc of a hundredth of a pixel adds its tail, some 1e-2 of a pixel's light
    assert np.abs(found.intensity - exact).max() < 5e-3 * exact.max()
    assert found.intensity.sum() == approx(1.0, abs=2e-3)


def test_ggx_has_its_own_tails(flat_scene):
    scene = rough(flat_scene, SpecularMicrofacet(0.05, 0.05, distribution="ggx"))
    wave = psf.wavefront(scene)
    found = blurred(scene)
    view = psf.wall_view(scene)
    turn = view.cos_sum * abs(wave.image_distance) * view.footprint
    x, y = np.meshgrid(found.x, found.y)
    slopes = np.linalg.solve(turn.T, np.stack([x.ravel(), y.ravel()]))
    alpha = np.sqrt(2) * 0.05
    density = 1 / (np.pi * alpha**2 * (1 + (slopes**2).sum(axis=0) / alpha**2) ** 2)
    exact = density.reshape(x.shape) * found.pitch**2 / abs(np.linalg.det(turn))
    # a pixel is a seventh of alpha: its mean is 1 - 7e-3 of its middle at the peak
    assert np.abs(found.intensity - exact).max() < 2e-2 * exact.max()
    far = np.hypot(x, y) > 0.4 * np.abs(x).max()
    assert found.intensity[far] == approx(exact[far], rel=1e-2)


def test_narrow_slopes_tend_to_the_smooth_lobe(flat_scene):
    smooth = blurred(flat_scene, shape=9, pitch=10e-6)
    scene = rough(flat_scene, SpecularMicrofacet(0.05, 1e-6))
    found = blurred(scene, shape=9, pitch=10e-6)
    # a two-hundredth of a pixel of blur, and both estimates
    limit = 5e-3 + found.error_estimate + smooth.error_estimate
    assert np.abs(found.intensity - smooth.intensity).max() < limit * smooth.intensity.max()


def test_lobes_count_by_their_reflectance(flat_scene):
    parts = [SpecularMicrofacet(0.03, 0.0), SpecularMicrofacet(0.06, 0.02)]
    both = blurred(rough(flat_scene, *parts), shape=41)
    one = blurred(rough(flat_scene, parts[0]))
    other = blurred(rough(flat_scene, parts[1]), shape=41)
    margin = (41 - one.shape[0]) // 2
    core = np.pad(one.intensity, margin)
    assert both.intensity == approx((core + 2 * other.intensity) / 3, abs=1e-15)
    assert both.enclosed_energy == approx(both.intensity.sum(), abs=1e-12)


@pytest.mark.parametrize("tol", [1e-4, 0.3])
@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
def test_halo_ends_where_the_slopes_density_is_tol(flat_scene, distribution, tol):
    """Along the widest axis, where the blur's covariance is largest; it lies askew here."""
    x, y, z = flat_scene.hidden.position
    scene = rough(flat_scene, SpecularMicrofacet(0.05, 0.003, distribution=distribution))
    scene = replace(scene, hidden=replace(scene.hidden, position=(x, y + 0.6, z)))
    wave = psf.wavefront(scene)
    (lobe,) = mirror_lobes(psf.SceneOptics(scene).at())
    far = lobe.halo(tol)
    variance = np.linalg.eigvalsh(blur(scene, wave, 0.003)).max()
    square = far**2 / (2 * variance)  # of slopes, in units of alpha^2 = 2 sigma^2
    density = np.exp(-square) if distribution == "beckmann" else (1 + square) ** -2.0
    assert density == approx(tol, rel=1e-9)
