"""Differentiable point spreads, their gradients and what is refused, on record."""

import numpy as np
import pytest
import torch

from nlosoptics.inverse import FacetPSF, PupilPSF, SceneLeaves

from ...records import attempt
from ...runs.random_scenes import random_case

OPTICS = {"pupil_radius": 2e-3, "image_distance": 0.05, "shape": 32, "dtype": torch.float64}
WAVE = {"wavelength": 6e-7, "pitch": 4e-6, **OPTICS}
DEFOCUS = [0.0, 3e-7]


def everything(psf):
    """Values of a module, and the gradient of a sum of them by its coefficients."""
    picture = torch.linspace(0, 1, 1024, dtype=torch.float64).reshape(32, 32)
    spread = psf(defocus=DEFOCUS)
    weights = torch.cos(torch.arange(spread.numel(), dtype=torch.float64)).reshape(spread.shape)
    parts = [one for one in psf.parameters() if one.requires_grad]
    found = {"spread": spread, "gradient": torch.autograd.grad((spread * weights).sum(), parts)}
    if not isinstance(psf, FacetPSF):
        image = psf.image(picture, defocus=DEFOCUS, gain=1.2, background=0.1)
        found |= {"image": image, "aberration": psf.aberration(), "steepest": psf.steepest()}
    return found | {"transfer": psf.transfer(), "plain": psf()}


CASES = [{}, {"pixel_integrated": True}, {"method": "quadrature"}, {"samples": 80}]


@pytest.mark.parametrize("options", range(len(CASES)))
def test_modes(options, on_record):
    modes = {2: 3e-8, 5: 5e-8, 8: -3e-8, 11: 2e-8}
    psf = attempt(PupilPSF.from_zernike, modes, **WAVE, **CASES[options])
    on_record(psf if isinstance(psf, Exception) else everything(psf))


@pytest.mark.parametrize("kind", ["slopes", "angles", "facets"])
def test_slopes(kind, on_record):
    at = np.linspace(-1, 1, 9)
    x, y = np.meshgrid(at, at)
    slopes = 1e-4 * np.stack([x + 0.3 * y**2, 0.5 * y - 0.2 * x * y], axis=-1)
    pitch = 5e-4
    if kind == "slopes":
        psf = attempt(PupilPSF.from_slopes, slopes, slope_pitch=pitch, **WAVE)
    elif kind == "angles":
        psf = attempt(PupilPSF.from_angles, slopes, angle_pitch=pitch, **WAVE)
    else:
        psf = attempt(FacetPSF, slopes, angle_pitch=pitch, **WAVE)
    on_record(
        psf
        if isinstance(psf, Exception)
        else [everything(psf), kind == "slopes" and psf.curl_residual()]
    )


@pytest.mark.parametrize("number", [0, 2, 3, 4, 6, 7, 9])
def test_a_scene(number, on_record):
    scene = random_case(number).scene
    asked = {"pitch": scene.camera.image_pitch, "shape": 16, "dtype": torch.float64}
    psf = attempt(PupilPSF.from_scene, scene, [4, 5, 8], **asked)
    names = ["wall_radius", "object_position", "object_tilt", "camera_position", "focus_distance"]
    leaves = [attempt(SceneLeaves, scene, [name], **asked) for name in names]
    on_record(
        [
            psf if isinstance(psf, Exception) else [psf(), psf.aberration()],
            [one if isinstance(one, Exception) else attempt(one) for one in leaves],
        ]
    )
