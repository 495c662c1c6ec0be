"""Point spread function of a rough wall in two scales: random long waves, mean over short ones."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import chain, islice
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import in_range, one_of, positive, whole
from ...errors import SamplingError, SceneError
from ...scene import Scene
from ..pupil.scene_optics import SceneOptics
from ..transform import mdft
from ..transform.models import speckle_model_error
from ..transform.point_spread import NORMALISATIONS, Normalisation
from ..wave.detilted import Residual, split
from ..wave.regime import regime
from ..wave.wavefront import Wavefront
from ..window.error_bounds import rounded_up
from ..window.grids import PupilGrid, pupil_grid, pupil_grid_from_polar
from ..window.window import Window
from .mean import NO_CORE, RoughPointSpread, detilted_mean, image_sampling
from .otf import ORDER, LatticeRatio, transfer
from .roughness import Roughness
from .sample import (
    Propagation,
    seen_through,
    speckle_error,
    speckle_pupil,
    speckle_samples,
    spilled,
    wall_fields,
)
from .scattered_light import Halo, Separations
from .source import rough_source
from .view import RoughView

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

#: Phase step between cells for the spline's error estimate, in standard deviations.
STEEP: Final = 3.0
#: First number of nodes relative to the rule of thumb; small, since every wall repeats the sum.
FINENESS: Final = 0.3


def split_scale(wavelength: float, effective_distance: ArrayLike, turn: float = 0.1) -> float:
    """Return the ripple period above which rays describe the effect of a wall's heights.

    Shorter ripples are changed by diffraction on the way from the wall to the pupil.

    Parameters
    ----------
    wavelength : float
        Vacuum wavelength, m.
    effective_distance : float or array_like (2, 2)
        Effective distance d_eff of `WallView`, m; for a matrix its norm is used.
    turn : float
        Largest propagation phase q, rad. A ripple reaches the pupil as phase times cos(q) and
        amplitude times sin(q).

    Returns
    -------
    float
        ``sqrt(pi lambda d_eff/q)``, m.

    Raises
    ------
    SceneError
        If a number is not above 0.

    See Also
    --------
    two_scale_point_spread : PSF of coarse and fine roughness.
    Roughness : Height statistics of a rough wall.

    Examples
    --------
    Wall 1 m from both object and camera, so that d_eff = 0.5 m:

    >>> from nlosoptics import psf
    >>> print(f"{1e3 * psf.split_scale(632.8e-9, 0.5):.2f} mm")
    3.15 mm
    """
    positive("wavelength", wavelength, unit="m")
    positive("turn", turn)
    distance = np.asarray(effective_distance, dtype=np.float64)
    if distance.shape not in ((), (2, 2)) or not np.isfinite(distance).all():
        raise SceneError(
            f"effective_distance has shape {distance.shape}; give a number or a finite (2, 2), m"
        )
    longest = abs(float(distance)) if distance.ndim == 0 else float(np.linalg.norm(distance, 2))
    positive("effective_distance", longest, unit="m")
    return math.sqrt(math.pi * wavelength * longest / turn)


def two_scale_point_spread(
    source: Wavefront | Scene | SceneOptics,
    roughness: Roughness,
    *,
    seed: int,
    cutoff: float | None = None,
    independent_patterns: int = 1,
    footprint: ArrayLike | None = None,
    cos_sum: float | None = None,
    effective_distance: ArrayLike | None = None,
    propagation: Propagation = "geometric",
    tol: float = 1e-3,
    pitch: float | None = None,
    shape: int | tuple[int, int] | None = None,
    normalisation: Normalisation = "unit-sum",
    pixel_integrated: bool = False,
) -> RoughPointSpread:
    """Compute the point spread of a rough wall, random in its long waves, averaged over short ones.

    Parameters
    ----------
    source : Wavefront, Scene or SceneOptics
        Wave that the wall without roughness would give, or a scene whose wall is the mean surface.
        The pupil of a scene is sampled as finely as the long waves, the halo and ``tol`` require.
    roughness : Roughness
        Statistics of the wall's heights.
    seed : int
        Random seed. The same seed and sampling yield the same long waves.
    cutoff : float, optional
        Cutoff period of `Roughness.split`, m, 0 to infinity. Default `split_scale` of the effective
        distance. At 0 all waves are random, as in `sample_point_spread`; at infinity the result is
        `mean_point_spread`.
    independent_patterns : int
        Number of walls whose patterns are averaged; the first one is that of a single wall.
    footprint, cos_sum, effective_distance
        Geometry of `sample_point_spread`. Required with a wavefront; a scene defines it.
    propagation : {"geometric", "fresnel"}
        Propagation of the long waves from the wall to the pupil, see `sample_point_spread`.
    tol : float
        Largest error of the part scattered by the short waves, relative to the peak.
    pitch, shape, normalisation, pixel_integrated
        Options of `mean_point_spread`.

    Returns
    -------
    RoughPointSpread
        ``coherent`` is the pattern of the long waves, times ``exp(-s^2)`` of the short waves.
        ``rayleigh_parameter`` and the fractions derived from it are those of the short waves.

    Raises
    ------
    SceneError
        If ``footprint``, ``cos_sum`` or ``effective_distance`` is missing with a wavefront or
        given with a scene, or if the roughness cannot be split.
    SamplingError
        If the long waves cannot be sampled, or the short waves do not reach ``tol``.
    MemoryLimitError
        If the phase screen would not fit into memory.

    See Also
    --------
    split_scale : Default cutoff.

    Notes
    -----
    The transfer function of each random wall is multiplied by ``exp(-s^2 [1 - C(M d)])`` of the
    short waves. This adds the slopes of both parts at the same wall point. It neglects the lateral
    displacement of the long waves' field by scattering at short waves. That displacement is 0 for
    geometric propagation, and small compared with the long waves if the cutoff is at least
    `split_scale`. The mean over walls is exact for any cutoff, since both parts are independent
    and stationary. As in `mean_point_spread`, the values remain correct if the halo is much wider
    than the window.
    """
    one_of("normalisation", normalisation, NORMALISATIONS)
    one_of("propagation", propagation, ("fresnel", "geometric"))
    in_range("tol", tol, 0.0, 1.0, open_low=True)
    count = whole("independent_patterns", independent_patterns)
    seed = whole("seed", seed, 0, 2**64 - 1)
    smooth = rough_source(source, roughness, footprint, cos_sum, effective_distance)
    view, wave = smooth.view, smooth.residual.wavefront
    if cutoff is None:
        if view.effective_distance is None:
            raise SceneError(
                "effective_distance is missing, from which the default cutoff is computed; give "
                "effective_distance or cutoff"
            )
        cutoff = split_scale(wave.wavelength, view.effective_distance)
    long, short = (view.of(part) for part in roughness.split(cutoff))
    step, size = image_sampling(smooth.residual, view, pitch, shape)
    if long.rayleigh_parameter == 0:
        return smooth.refined(
            lambda residual: detilted_mean(
                residual,
                view,
                tol,
                step,
                size,
                normalisation=normalisation,
                pixel_integrated=pixel_integrated,
            )
        )
    window = Window.centred(step, size)

    def drawn(residual: Residual) -> tuple[Residual, Array, Array, float]:
        walls = _Walls(residual, long, short, window, pixel_integrated, tol)
        return residual, *walls.mean(seed, count, propagation)

    residual, coherent, diffuse, error = smooth.refined(drawn)
    wave, level = residual.wavefront, residual.pixel_share(step)
    scale = {"unit-sum": 1.0, "flux": wave.flux, "ideal-peak": 1 / level}[normalisation]
    return RoughPointSpread(
        intensity=(coherent + diffuse) * scale,
        coherent=coherent * scale,
        pitch=step,
        method=f"{propagation} screen + mdft + separations",
        error_estimate=error,
        model_error=speckle_model_error(residual, normalisation),
        normalisation=normalisation,
        wavelength=wave.wavelength,
        f_number=wave.f_number,
        pixel_integrated=pixel_integrated,
        enclosed_energy=float((coherent + diffuse).sum()),
        rayleigh_parameter=short.rayleigh_parameter,
        regime=regime(residual, step, rayleigh_parameter=view.rayleigh_parameter),
        reason=f"two scales were requested: {propagation} phase screens of the long waves, "
        "sum over separations for the short waves",
    )


@dataclass(frozen=True, eq=False)
class _Walls:
    """Long and short waves of a rough wall, with the samples of the image.

    Parameters
    ----------
    residual : Residual
        Wave of the smooth wall.
    long, short : RoughView
        Views of both parts of the roughness.
    window : Window
        Samples or pixels.
    pixel_integrated : bool
        Whether to integrate over pixels.
    tol : float
        Wanted error of the short waves' part, relative to the peak.
    """

    residual: Residual
    long: RoughView
    short: RoughView
    window: Window
    pixel_integrated: bool
    tol: float

    def mean(self, seed: int, count: int, propagation: str) -> tuple[Array, Array, float]:
        """Return coherent pattern and halo (ny, nx), averaged over walls, and the expected error.

        Values are energies per sample, relative to the whole plane; the error is relative to the
        peak.
        """
        samples, rule = speckle_samples(self.residual, self.window, self.pixel_integrated)
        grid = speckle_pupil(self.residual, self.long, samples)
        s = self.short.rayleigh_parameter
        level = math.exp(-(s**2)) * self.residual.pixel_share(self.window.pitch)
        fields, between = wall_fields(self.residual, self.long, grid, seed, propagation)
        first = next(fields)
        coherent, diffuse, error = np.zeros(self.window.shape), np.zeros(self.window.shape), 0.0
        scattering = None
        for field in chain([first], islice(fields, count - 1)):
            seen = seen_through(grid, field, between)
            if self.short.coherent_fraction > NO_CORE:
                coherent += level * mdft.intensity_in(self.residual, seen, samples, rule)
            if s > 0:
                scattering = scattering or self._scattering(seen, coherent, spilled(first))
                diffuse += scattering.image(seen)
        coherent, diffuse = coherent / count, diffuse / count
        peak = float((coherent + diffuse).max())
        if scattering is not None:
            error = scattering.error / peak
        if self.short.coherent_fraction > NO_CORE:
            drawn = speckle_error(
                self.residual,
                grid,
                self.window,
                coherent / level,
                spilled(first),
                self.pixel_integrated,
            )
            error += drawn * float(coherent.max()) / peak
        return coherent, diffuse, error

    def _scattering(self, seen: PupilGrid, coherent: Array, spill: float) -> _Scattering:
        """Return nodes that have converged for the first wall, for use with all walls."""
        wave = self.residual.wavefront
        flat = split(replace(wave, aberration=np.zeros_like(wave.aberration)))
        polar = wave.layout == "polar"
        # The clear pupil is computed, since a softened rim can be negative and has no modulus.
        plain = pupil_grid_from_polar(flat, seen.pitch) if polar else pupil_grid(flat)
        clear, ratios = transfer(flat), LatticeRatio(plain.values.real, seen.pitch)
        ratio = ratios.of(seen.values)
        spread = self.residual.rays.reach + self.long.halo(wave)
        halo = Halo(
            self.residual, self.short, self.window, self.pixel_integrated, clear.reach, spread
        )
        found, nodes, smooth, missed = halo.converged(
            lambda du, dv: clear.at(du, dv) * ratio(du, dv), coherent, self.tol, FINENESS
        )
        lag = seen.pitch * float(np.linalg.norm(self.long.footprint, 2))
        variance = 2 * self.long.rayleigh_parameter**2 * float(self.long.roughness.structure(lag))
        step = STEEP * math.sqrt(variance) + 2 * math.pi * seen.jump
        # error of the lattice ratio as in `transfer`
        n = 2 * wave.pupil_radius / seen.pitch
        lattice = step ** (ORDER + 1) / 3e4 + 0.25 / n**1.5 + 0.6 * step / (2 * math.pi * n)
        share = clear.error + lattice + spill
        error = missed + share * float(np.abs(nodes.factor * smooth).sum())
        peak = float((coherent + found).max())
        if error > self.tol * peak:
            raise SamplingError(
                f"the mean over the short waves has an error of {error / peak:.2g}, limit tol "
                f"= {self.tol:g}; use tol = {rounded_up(1.5 * error / peak)}, or a wavefront of "
                "more pupil nodes"
            )
        return _Scattering(halo, nodes, clear.at(nodes.du, nodes.dv), ratios, error)


@dataclass(frozen=True, eq=False)
class _Scattering:
    """Scattering of each random wall's pattern into a halo by the short waves.

    Parameters
    ----------
    halo : Halo
        Sum over separations.
    nodes : Separations
        Nodes of the sum.
    clear : ndarray, (n_lags, n_directions)
        Transfer function of the pupil without phases, at the nodes.
    ratios : LatticeRatio
        Ratio of the random walls' transfer functions to that.
    error : float
        Expected error, energy per sample.
    """

    halo: Halo
    nodes: Separations
    clear: ComplexArray
    ratios: LatticeRatio
    error: float

    def image(self, seen: PupilGrid) -> Array:
        """Return the halo (ny, nx) of a pupil function, energy per sample."""
        ratio = self.ratios.of(seen.values)
        return self.halo.image(self.nodes, self.clear * ratio(self.nodes.du, self.nodes.dv))
