"""What the solvers' parts refuse, in one line that names value, limit and remedy."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from nlosoptics import inverse
from nlosoptics.errors import MissingExtraError, NlosError
from nlosoptics.inverse.blind import wall_proposals

OPTICS = {"pupil_radius": 1e-3, "image_distance": 0.05, "wavelength": 6e-7}
OPTICS |= {"pitch": 7e-6, "shape": 16}
TENT = np.minimum.outer(*[7.0 - np.abs(np.arange(-6.0, 7.0))] * 2)
EDGE = np.pad(np.zeros((5, 5)), 4, constant_values=1.0)


def zernike():
    return inverse.PupilPSF.from_zernike([4, 5], **OPTICS)


def angles(values=None, pitch=1e-3):
    values = np.zeros((3, 3, 2)) if values is None else values
    return inverse.PupilPSF.from_angles(values, angle_pitch=pitch, **OPTICS)


TABLE = {
    "modes twice": (
        lambda: inverse.PupilPSF.from_zernike([4, 6, 5, 6], **OPTICS),
        "modes holds 6 more than once; give each index once",
    ),
    "wavelength in mm": (
        lambda: inverse.PupilPSF.from_zernike([4], **OPTICS | {"wavelength": 1.01e-3}),
        "wavelength = 0.00101 m is out of range, must be from 1e-08 to 0.001 m; give metres",
    ),
    "pixels of a coarse pupil": (
        lambda: inverse.PupilPSF.from_zernike([4], **OPTICS | {"pitch": 1e-6}),
        "samples the pupil every 0.00187 m, limit its radius, 0.001 m; use 30 pixels or more",
    ),
    "lags without power": (
        lambda: inverse.object_from_autocorrelation(EDGE, object_size=(3, 3)),
        "the lags hold no positive power within the object's extent; give object_size",
    ),
    "object as wide as the lags": (
        lambda: inverse.object_from_autocorrelation(TENT, object_size=(8, 3)),
        "an object of 8 x 3 pixels has lags up to 7 x 2, beyond the 6 x 6 that there are",
    ),
    "slopes for modes": (
        lambda: inverse.evidence_fit(np.ones((16, 16)), angles()),
        "pupil_psf has slopes instead of Zernike coefficients; build it by",
    ),
    "coefficients without a number": (
        lambda: inverse.PupilPSF(zernike().optics, zernike().waves, [0.0, np.nan]),
        "coefficients contain NaN or infinity; give finite start values",
    ),
    "nodes inside the pupil": (
        lambda: angles(pitch=0.6e-3),
        "3 x 3 angles 0.0006 m apart reach 0.0009 m from the axis, the pupil 0.001 m; give 5 or",
    ),
    "upright angles": (
        lambda: angles(np.full((3, 3, 2), np.pi / 2)),
        "angles reach 1.57 rad, must be finite and below pi/2; give angles from the axis",
    ),
    "start of a network": (
        lambda: inverse.wu2024_fit(np.kron(np.eye(2), np.ones((8, 8))), zernike(), start=EDGE),
        "is no Reconstruction",
    ),
}


@pytest.mark.parametrize("name", TABLE)
def test_refused_in_one_line(name):
    call, words = TABLE[name]
    with pytest.raises(NlosError) as caught:
        call()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("solver", ["wu2024_fit", "evidence_fit", "phase_retrieval"])
def test_seeds_are_whole_numbers_of_64_bits(solver):
    given = (np.eye(16),) if solver == "phase_retrieval" else (np.eye(16), zernike())
    for seed in (-1, 2**64, 0.5):
        with pytest.raises(NlosError, match="seed = "):
            getattr(inverse, solver)(*given, seed=seed)


def test_the_last_values_are_accepted():
    found = inverse.object_from_autocorrelation(
        TENT, object_size=(7, 3), restarts=2, max_iterations=2
    )
    assert np.isfinite(found.object).all()
    assert angles(pitch=2e-3 / 3).shape == (16, 16)


def test_files_of_networks_need_safetensors(monkeypatch):
    monkeypatch.setitem(sys.modules, "safetensors.torch", None)
    with pytest.raises(MissingExtraError, match="safetensors, which is not installed"):
        wall_proposals.trained_network.__wrapped__()
