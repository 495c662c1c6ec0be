"""Reconstruction, and the gradients that it needs; these checks need PyTorch."""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import imaging, inverse, psf

_PUPIL: dict[str, Any] = {"wavelength": 632.8e-9, "pupil_radius": 5e-3, "image_distance": 50e-3}
_PITCH = 632.8e-9 * 5 / 3  # m


def _letter() -> np.ndarray:
    """Return an F of 1000 electrons."""
    letter = np.zeros((48, 48))
    letter[10:38, 14:19] = letter[10:15, 14:34] = letter[22:27, 14:29] = 1000.0
    return letter


def sharpened_letter() -> tuple[float, float]:
    """Letter behind coma and photon noise, 1 - correlation: it comes back in its place."""
    wave = psf.Wavefront.from_zernike({4: 2e-7, 8: 3e-7}, **_PUPIL)
    spread = psf.point_spread(wave, pitch=8 * _PITCH, shape=33, pixel_integrated=True)
    model = imaging.ForwardModel(spread, shape=(48, 48))
    light = model.forward(_letter()) + 100.0
    image = np.random.default_rng(0).poisson(light) - 100.0
    fit = inverse.tv_deconvolve(image, model)
    return 1 - np.corrcoef(fit.object.ravel(), _letter().ravel())[0, 1], 0.02


def differentiable_spread() -> tuple[float, float]:
    """Differentiable point spread, of its peak: that of the same wave by two transforms."""
    module = _module()
    wave = psf.Wavefront.from_map(
        module.aberration().detach().numpy(),
        module.optics.share,
        pupil_pitch=module.optics.pupil_pitch[0],
        **_PUPIL,
    )
    found = module().detach().numpy()
    errors = []
    for method in ("mdft", "fft"):
        expected = psf.point_spread(wave, method=method, pitch=_PITCH, shape=32).intensity
        errors.append(abs(found / found.max() - expected / expected.max()).max())
    return max(errors), 1e-6


def gradient() -> tuple[float, float]:
    """Gradient of the differentiable point spread, relative: central differences."""
    module = _module()
    (leaf,) = module.parameters()
    (module() ** 2).sum().backward()
    found, step, expected = leaf.grad.numpy(), 1e-11, []  # m
    for k in range(len(leaf)):
        values = []
        for move in (step, -2 * step):
            leaf.data[k] += move
            values.append(float((module().detach() ** 2).sum()))
        leaf.data[k] += step
        expected.append((values[0] - values[1]) / (2 * step))
    return abs(found - expected).max() / abs(found).max(), 1e-4


def _module() -> Any:
    """Return a differentiable point spread of three Zernike terms, in float64."""
    modes = {4: 1e-7, 6: -5e-8, 8: 8e-8}
    return inverse.PupilPSF.from_zernike(modes, pitch=_PITCH, shape=32, **_PUPIL).double()
