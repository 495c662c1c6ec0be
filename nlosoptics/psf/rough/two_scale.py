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
    """Return the period of wall ripples above which diffraction at them is negligible.

    Ripples of longer periods only change the path length of rays. Shorter ripples are changed by
    diffraction between wall and pupil.

    Parameters
    ----------
    wavelength : float
        Vacuum wavelength, m.
    effective_distance : float or array_like (2, 2)
        Distance d over which ripples diffract, m. For a flat wall at normal incidence it is
        ``d1 d2/(d1 + d2)``, with d1 and d2 the distances from the wall to object and lens. For a
        matrix, such as `WallView.effective_distance`, its largest singular value is used.
    turn : float
        Largest negligible diffraction phase q, rad, above 0. A phase ripple of amplitude a on the
        wall reaches the pupil as a phase of amplitude ``a cos(q)`` and a modulation of the field's
        amplitude ``a sin(q)``.

    Returns
    -------
    float
        Period ``sqrt(pi wavelength d/q)``, m.

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
    Wall 1 m from both object and camera, so that d = 0.5 m:

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
    """Compute the point spread of a random rough wall, averaged over its fine heights only.

    It shows the speckle of the coarse heights, which `mean_point_spread` averages out. Unlike
    `sample_point_spread` it needs no samples of the fine heights.

    Parameters
    ----------
    source : Wavefront, Scene or SceneOptics
        Wave that the wall without roughness gives; or a scene, from which wave and geometry are
        computed (once for all calls that share a `SceneOptics`). The pupil of a scene is sampled as
        finely as required.
    roughness : Roughness
        Statistics of the wall's heights.
    seed : int
        Random seed, 0 or more. The same seed and sampling yield the same coarse heights.
    cutoff : float, optional
        Period between coarse and fine heights, m, 0 to infinity, see `Roughness.split`. Default
        `split_scale`, above which diffraction between wall and pupil is negligible. At 0 all
        heights are coarse, as in `sample_point_spread`; at infinity all are fine, as in
        `mean_point_spread`.
    independent_patterns : int
        Number of random walls whose patterns are averaged.
    footprint : float or array_like (2, 2), optional
        Matrix M: seen from a pupil point displaced by (du, dv), the object's light comes from a
        wall point displaced by M (du, dv), in steps along two tangents of the wall, see `WallView`.
        A number stands for a multiple of the unit matrix. For a flat wall at normal incidence it is
        ``d1/(d1 + d2)``, with d1 and d2 the distances from the wall to object and lens. Required
        with a wavefront, not allowed with a scene.
    cos_sum : float, optional
        Sum of the cosines of the angles of incidence and reflection at the wall, above 0 and at
        most 2. Required with a wavefront, not allowed with a scene.
    effective_distance : float or array_like (2, 2), optional
        Distance over which wall ripples diffract on their way to the pupil, m. For a flat wall at
        normal incidence it is ``d1 d2/(d1 + d2)``, see `WallView`. Required with a wavefront, not
        allowed with a scene.
    propagation : {"geometric", "fresnel"}
        Propagation from the wall to the pupil of the phase due to the coarse heights: along rays,
        or by a Fresnel integral.
    tol : float
        Largest error of the light scattered by the fine heights, relative to the peak; above 0, at
        most 1.
    pitch : float, optional
        Distance between image samples, or pixel side, m. Default lambda N/4, with the wavelength
        lambda and the F-number N.
    shape : int or (int, int), optional
        Samples or pixels (ny, nx); one number means a square. By default at least 256 per side, and
        enough for all rays, a margin of 16 lambda N for diffraction, and the scattered light.
    normalisation : {"unit-sum", "ideal-peak", "flux"}
        Quantity that has the value 1, for the smooth wall: the energy in the whole image plane, the
        peak without aberration, or the energy that a clear disc of the pupil's radius transmits.
        With "unit-sum" and "flux", values are energies per pixel: the intensity times ``pitch^2``.
    pixel_integrated : bool
        Integrate over square pixels of side ``pitch`` instead of sampling at their centres.

    Returns
    -------
    RoughPointSpread
        Intensity (ny, nx), row 0 at the lowest y. Its part ``coherent`` is the speckle pattern of
        the coarse heights, times ``exp(-s^2)``. The rest is scattered by the fine heights. Here s
        is ``rayleigh_parameter``, the rms phase of the fine heights alone, rad.

    Raises
    ------
    SceneError
        If ``footprint``, ``cos_sum`` or ``effective_distance`` is missing with a wavefront or
        given with a scene, or if the roughness cannot be split at the cutoff.
    SamplingError
        If the pupil has too few samples for the coarse heights, or ``tol`` cannot be reached for
        the fine ones.
    MemoryLimitError
        If the samples of the wall would not fit into memory.

    See Also
    --------
    split_scale : Default cutoff.

    Notes
    -----
    The optical transfer function of each random coarse wall is multiplied by the factor of
    `mean_point_spread` for the fine heights. This neglects that light scattered by fine heights
    arrives at the pupil displaced sideways. The displacement is 0 for geometric propagation, and
    small compared with the coarse structure if the cutoff is at least `split_scale`. The mean over
    walls is exact for any cutoff. The values are also correct if the light scattered by the fine
    heights extends far beyond the window.
    """
    one_of("normalisation", normalisation, NORMALISATIONS)
    one_of("propagation", propagation, ("fresnel", "geometric"))
    in_range("tol", tol, 0.0, 1.0, open_low=True)
    count = whole("independent_patterns", independent_patterns)
    seed = whole("seed", seed, 0, 2**64 - 1)
    if not isinstance(roughness, Roughness):
        raise SceneError(
            f"roughness is a {type(roughness).__name__}, but only the statistics of heights can be "
            "split into two scales; give a Roughness, or call sample_point_spread for one wall"
        )
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
        clear, ratios = transfer(flat), LatticeRatio(plain.values.real)
        ratio = ratios.of(seen.values, seen.pitch)
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
        ratio = self.ratios.of(seen.values, seen.pitch)
        return self.halo.image(self.nodes, self.clear * ratio(self.nodes.du, self.nodes.dv))
