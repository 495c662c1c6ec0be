"""What kind of wave it is: how many waves, how steep, how coarsely sampled, how wide its pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .detilted import Rays, Residual
from .polar_series import ring_of

Array = NDArray[np.float64]

#: Share of the largest Jacobian below which its sign is not told from rounding and truncation.
FLAT = 1e-3


@dataclass(frozen=True, kw_only=True)
class Regime:
    """Numbers that decide which transform of a wave does, and what it costs.

    Parameters
    ----------
    peak_to_valley, rms : float
        Residual aberration over the lit pupil, waves: piston and tilt taken out. The rms is
        weighted by amplitude, as in `rms_aberration`.
    slope : float
        Largest gradient of the residual aberration, rad.
    reach : float
        Where its rays land at the farthest along x or y, Airy units (lambda N).
    slope_per_sample : float or None
        What the steepest slope makes of the aberration over a sample of a grid, or over the side of
        the mean area of a scattered node, waves; None for polar nodes, which resolve it exactly.
    pixel : float
        Image pitch, Airy units.
    fresnel_number : float
        ``a^2/(lambda |d_i|)``.
    folded : bool
        Whether the Jacobian of the rays' landing points changes its sign over the pupil: the image
        plane then cuts a caustic, on which rays pile up.
    rayleigh_parameter : float
        s of a rough wall, rad; 0 for a smooth one.
    """

    peak_to_valley: float
    rms: float
    slope: float
    reach: float
    slope_per_sample: float | None
    pixel: float
    fresnel_number: float
    folded: bool
    rayleigh_parameter: float = 0.0

    @property
    def coherent_fraction(self) -> float:
        """``exp(-s^2)``, the share of the light in the smooth core."""
        return math.exp(-(self.rayleigh_parameter**2))


def regime(residual: Residual, pitch: float, *, rayleigh_parameter: float = 0.0) -> Regime:
    """Regime of a wave without its piston and tilt, on image samples or pixels of a pitch, m."""
    wave = residual.wavefront
    rays = residual.rays
    low, high, _, rms = residual.heights
    if wave.layout == "polar" and not residual.is_flat:
        low, high = _with_rims(residual, low, high)
    per_sample = None
    if not wave.is_spectral:
        per_sample = rays.slope * residual.spacing / wave.wavelength
    return Regime(
        peak_to_valley=(high - low) / wave.wavelength,
        rms=rms / wave.wavelength,
        slope=rays.slope,
        reach=rays.reach / residual.airy_unit,
        slope_per_sample=per_sample,
        pixel=pitch / residual.airy_unit,
        fresnel_number=wave.pupil_radius**2 / (wave.wavelength * abs(wave.image_distance)),
        folded=_folded(residual, rays),
        rayleigh_parameter=rayleigh_parameter,
    )


def _with_rims(residual: Residual, low: float, high: float) -> tuple[float, float]:
    """Extremes with those on the rims and in the centre, where no polar node lies."""
    if residual.low is not None:
        n_r, n_theta = residual.wavefront.u.shape
        ring = ring_of(n_r, n_theta, residual.wavefront.obscuration)
        values = residual.low.on_rims(ring.cosine, ring.sine)
        return min(low, float(values.min())), max(high, float(values.max()))
    series = residual.series
    waves = series.coefficients.copy()
    if series.n_theta % 2 == 0:
        waves[:, -1] *= 2
    # Legendre polynomials at 1 and at -1; odd orders are a radius times them
    inner = np.where(np.arange(series.n_r) % 2, -1.0, 1.0)[:, None] * waves
    ends = np.stack([waves.sum(axis=0), inner.sum(axis=0)])
    ends[1, 1::2] *= residual.wavefront.obscuration
    values = np.fft.irfft(ends, series.n_theta, axis=1, norm="forward")
    return min(low, float(values.min())), max(high, float(values.max()))


def _folded(residual: Residual, rays: Rays) -> bool:
    """Whether the Jacobian takes either sign, beyond what rounding can make of a flat wave."""
    wave = residual.wavefront
    if rays.reach <= 1e-6 * residual.airy_unit:
        return False
    if wave.layout == "polar":
        low, high = _polar_extremes(residual, rays)
        return min(-low, high) > FLAT * max(-low, high)
    if wave.layout == "scattered":
        uu, uv, vv = residual.local.bends.T
        jacobian = uu * vv - uv * uv
    elif wave.layout == "cells":
        jacobian = _cell_jacobian(residual, rays)
    else:
        jacobian = _grid_jacobian(residual, rays)
    if not jacobian.size:
        return False
    low, high = float(jacobian.min()), float(jacobian.max())
    return min(-low, high) > FLAT * max(-low, high)


def _polar_extremes(residual: Residual, rays: Rays) -> tuple[float, float]:
    """Extremes of the area of the image of each cell between two rings and spokes, over its own."""
    from . import _wave_kernels

    wave = residual.wavefront
    r = np.append(np.hypot(wave.u[:, 0], wave.v[:, 0]), wave.pupil_radius)
    # rings are dense at the rim, where differences of the series would be rounding
    low, high = _wave_kernels.jacobian_extremes(rays.x, rays.y, r, 1e-4 * wave.pupil_radius)
    return float(low), float(high)


def _cell_jacobian(residual: Residual, rays: Rays) -> Array:
    """The same of the squares between the nodes of each patch."""
    wave = residual.wavefront
    inner = np.s_[:, 1:-1, 1:-1]
    return np.asarray(_diagonals(rays.x[inner], rays.y[inner]) / _diagonals(wave.u, wave.v))


def _diagonals(x: Array, y: Array) -> Array:
    """Twice the area of the squares between neighbours along the last two axes."""
    first_x, first_y = x[..., 1:, 1:] - x[..., :-1, :-1], y[..., 1:, 1:] - y[..., :-1, :-1]
    second_x, second_y = x[..., 1:, :-1] - x[..., :-1, 1:], y[..., 1:, :-1] - y[..., :-1, 1:]
    return first_x * second_y - first_y * second_x


def _grid_jacobian(residual: Residual, rays: Rays) -> Array:
    """The same of a grid's cells, those whose corners all have lit neighbours."""
    wave = residual.wavefront
    lit = wave.amplitude * wave.weights > 0
    inner = lit.copy()
    for axis in (0, 1):
        for step in (-1, 1):
            inner &= np.roll(lit, step, axis=axis)
    inner[[0, -1]] = inner[:, [0, -1]] = False
    whole = inner[1:, 1:] & inner[1:, :-1] & inner[:-1, 1:] & inner[:-1, :-1]
    return np.asarray(_diagonals(rays.x, rays.y)[whole])
