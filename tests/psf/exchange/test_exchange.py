"""Pupils exported to prysm and imported again, against images by prysm."""

from __future__ import annotations

import numpy as np
import pytest
from pytest import approx

from nlosoptics import psf
from nlosoptics.errors import SamplingError, SceneError

WAVELENGTH, DISTANCE, RADIUS = 632.8e-9, 0.5, 5e-3
SYSTEM = {"wavelength": WAVELENGTH, "pupil_radius": RADIUS, "image_distance": DISTANCE}


def letter(samples):
    """An F, upright with y up, off the centre: no flip, turn or transposition leaves it alone."""
    n = samples
    f = np.zeros((n, n))
    f[n // 8 : 7 * n // 8, n // 4 : n // 3] = 1.0
    f[3 * n // 4 : 7 * n // 8, n // 4 : 3 * n // 4] = 1.0
    f[n // 2 : 5 * n // 8, n // 4 : n // 2] = 0.5
    pitch = 2 * RADIUS / n
    v, u = np.meshgrid(*2 * [(np.arange(n) - n // 2) * pitch], indexing="ij")
    return psf.Wavefront.from_map(
        # no symmetry here either
        WAVELENGTH * (40 * u + 90 * v + 3e3 * u**2),
        f,
        wavelength=WAVELENGTH,
        pupil_pitch=pitch,
        image_distance=DISTANCE,
    )


@pytest.mark.parametrize("samples", [64, 65])
def test_image_is_that_of_prysm(peer, samples):
    """The same field by two matrix transforms; nothing is interpolated on the way."""
    propagation = peer("prysm.propagation")
    wave = letter(samples)
    pitch, side = WAVELENGTH * DISTANCE / (2 * RADIUS) / 3, 41
    here = psf.point_spread(wave, method="mdft", pitch=pitch, shape=side, tol=1.0).intensity
    there = (
        propagation.Wavefront.from_amp_and_phase(*psf.to_prysm(wave))
        .focus_fixed_sampling(1e3 * DISTANCE, 1e6 * pitch, side)
        .intensity.data
    )
    here, there = here / here.max(), there / there.max()
    # both are sums in float64 of some 1e3 terms, with phases of up to 1e2 rad
    assert there == approx(here, abs=1e-13)
    # nothing in these images is symmetric
    for other in (here[::-1], here[:, ::-1], here[::-1, ::-1], here.T):
        assert np.abs(other - here).max() > 0.05


def test_prysm_pupil_comes_back():
    wave = letter(64)
    pupil = psf.to_prysm(wave)
    assert pupil.phase == approx(1e9 * wave.aberration, rel=1e-15)
    assert (pupil.wavelength, pupil.dx) == approx((0.6328, 1e3 * wave.pupil_pitch), rel=1e-15)
    back = psf.from_prysm(pupil, image_distance=DISTANCE, pupil_radius=wave.pupil_radius)
    # nm and mm there and back, two roundings
    for name in ("u", "v", "aberration", "amplitude", "weights"):
        assert getattr(back, name) == approx(getattr(wave, name), rel=1e-15, abs=1e-18)
    assert back.wavelength == approx(WAVELENGTH, rel=1e-15)


def test_cut_cells_carry_their_share():
    """The field's sum is that of the wave, cell by cell."""
    wave = psf.Wavefront.from_zernike(
        {8: 0.1 * WAVELENGTH}, nodes="grid", samples=48, obscuration=0.3, **SYSTEM
    )
    pupil = psf.to_prysm(wave)
    assert pupil.amplitude * wave.pupil_pitch**2 == approx(wave.weights, rel=1e-13)
    back = psf.from_prysm(pupil, image_distance=DISTANCE, pupil_radius=RADIUS)
    assert psf.strehl(back) == approx(psf.strehl(wave), rel=1e-12)


def test_path_where_no_light_is_may_be_missing():
    dark, path = np.ones((5, 5)), np.ones((5, 5))
    dark[0, 0], path[0, 0] = 0.0, np.nan
    wave = psf.from_prysm((dark, path, 0.6, 1.0), image_distance=DISTANCE)
    assert wave.aberration[0, 0] == 0.0
    with pytest.raises(SceneError, match="aberration = nan"):
        psf.from_prysm((np.ones((5, 5)), path, 0.6, 1.0), image_distance=DISTANCE)


def test_what_is_refused():
    with pytest.raises(SamplingError, match="nodes='grid'"):
        psf.to_prysm(psf.Wavefront.from_zernike({}, **SYSTEM))
    square = np.ones((3, 3))
    for pupil, message in (
        ([square, square, 0.6, 1.0], "not a prysm pupil"),
        ((square, np.ones((3, 4)), 0.6, 1.0), "two square arrays"),
        ((np.ones(3), np.ones(3), 0.6, 1.0), "two square arrays"),
        # half of it would be lost
        ((square + 1j, square, 0.6, 1.0), "amplitude has type complex128; give real"),
    ):
        with pytest.raises(SceneError, match=message):
            psf.from_prysm(pupil, image_distance=DISTANCE)
