"""Transfer function of the image that mirror-like lobes form, without a wide point spread."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..psf import PointSpread, SceneOptics, Wavefront, mtf
from ..psf.pupil.scene_optics import PointOptics
from ..psf.rough.view import RoughView
from ..psf.transform.wide_pixels import detilted_wide_spread
from ..psf.walls.scene_psf import scene_lobes, scene_point_spread
from ..psf.window.window import window_side

Array = NDArray[np.float64]

TOL = 1e-3  # error tolerance of point spreads, relative to their peak


@dataclass(frozen=True, eq=False, kw_only=True)
class Transfer:
    """Modulus of the transfer function of lens, wall and pixels."""

    core: PointSpread  # Point spread of the smooth wall, energy per pixel
    # Point spread of a wall with a given roughness, which replaces the lobes
    rough: PointSpread | None
    # (float, RoughView): Share of the light and statistics of each lobe. Their transfer function is
    # a closed form
    lobes: tuple[tuple[float, RoughView], ...]
    wave: Wavefront  # Wave of the smooth wall

    def sharp(self, u: Array, v: Array) -> Array:
        """Return the modulus of the smooth wall's transfer function, (len(v), len(u)).

        ``u`` and ``v`` are image frequencies along x and y, 1/m.
        """
        return _modulus(self.core, u, v)

    def __call__(self, u: Array, v: Array) -> Array:
        """Return the modulus of the wall's transfer function, (len(v), len(u)).

        ``u`` and ``v`` are image frequencies along x and y, 1/m. Values below the point spread's
        own error are set to 0, since they carry no known signal.
        """
        if self.rough is not None:
            return _modulus(self.rough, u, v)
        shift = self.wave.wavelength * self.wave.image_distance
        return np.asarray(self.sharp(u, v) * _blur(self.lobes, shift * u, shift * v[:, None]))


def scene_transfer(optics: SceneOptics) -> Transfer:
    """Return the transfer function at the hidden object's reference point."""
    scene, seen = optics.scene, optics.at()
    pitch = scene.camera.image_pitch
    side = window_side(seen.first.residual, pitch, TOL, seen.first.outline)
    aimed, core = seen.refined(
        lambda wave: detilted_wide_spread(wave.residual, pitch, (side, side), TOL)
    )
    if scene.wall_roughness is not None:
        rough = scene_point_spread(optics, TOL)
        return Transfer(core=core, rough=rough.point_spread, lobes=(), wave=rough.wavefront)
    return Transfer(core=core, rough=None, lobes=_shares(seen), wave=aimed.wave)


def image_modulation(optics: SceneOptics, frequency: float, azimuth: float, tol: float) -> float:
    """Return the modulation of a sinusoid in the image, by lens, wall and pixels, without aliases.

    The frequency is in cycles per m on the detector along the azimuth, rad from x toward y, up to
    the Nyquist frequency. It is the product of transfer functions of wave, lobes and pixel. A wave
    that has no closed transfer function (roughness, a cut cone) is sampled by a point spread whose
    pixels resolve it, or are 16 times finer than the image's, with an error below 0.002.
    """
    scene, seen = optics.scene, optics.at()
    pitch, wave = scene.camera.image_pitch, seen.first.wave
    u, v = frequency * math.cos(azimuth), frequency * math.sin(azimuth)
    pixel = float(np.sinc(pitch * u) * np.sinc(pitch * v))
    if scene.wall_roughness is not None or not seen.first.residual.is_disc:
        core = scene.laser.wavelength * optics.exit_pupil.f_number
        finer = pitch / min(16, math.ceil(2 * pitch / core))
        fine = scene_point_spread(optics, tol, pitch=finer).point_spread
        pixel /= float(np.sinc(finer * u) * np.sinc(finer * v))
        return pixel * float(mtf(fine, frequency, azimuth=azimuth))
    shift = wave.wavelength * wave.image_distance
    blur = float(_blur(_shares(seen), np.array(shift * u), np.array(shift * v)))
    return pixel * float(mtf(wave, frequency, azimuth=azimuth)) * blur


def _shares(seen: PointOptics) -> tuple[tuple[float, RoughView], ...]:
    """Return the share of the light and the statistics of each lobe of the wall."""
    lobes = scene_lobes(seen)
    total = sum(lobe.share for lobe in lobes)
    return tuple((lobe.share / total, lobe.view) for lobe in lobes)


def _blur(lobes: tuple[tuple[float, RoughView], ...], du: Array, dv: Array) -> Array:
    """Return the factor of lobes on the transfer function at separations (du, dv), m."""
    parts = [
        share * (view.coherent_fraction + view.scattered_transfer(du, dv)) for share, view in lobes
    ]
    return np.asarray(sum(parts))


def _modulus(spread: PointSpread, u: Array, v: Array) -> Array:
    """Return the modulus of a point spread's Fourier sums over its total, (len(v), len(u)).

    An error e of the point spread, relative to its peak, changes each sum by about e times the peak
    and the root of the number of pixels, if errors of pixels are independent; smaller values are
    set to 0.
    """
    x, y = (2 * math.pi * np.outer(f, at) for f, at in ((u, spread.x), (v, spread.y)))
    intensity = spread.intensity
    # real products: the imaginary part of a complex one would be mostly zeros
    rows = [wave(x) @ intensity.T for wave in (np.cos, np.sin)]
    even, odd = np.cos(y), np.sin(y)
    real = even @ rows[0].T - odd @ rows[1].T
    imaginary = even @ rows[1].T + odd @ rows[0].T
    total = float(intensity.sum())
    found = np.hypot(real, imaginary) / total
    error = spread.error_estimate * float(intensity.max()) * math.sqrt(intensity.size) / total
    return np.asarray(np.where(found > error, found, 0.0))
