"""Point spread of one rough wall drawn at random: a static speckle pattern."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import islice
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import one_of, whole
from ...errors import SamplingError
from ...scene import Scene
from ..pupil.scene_optics import SceneOptics
from ..transform import mdft
from ..transform.point_spread import NORMALISATIONS, Normalisation, PointSpread
from ..wave.detilted import Residual
from ..wave.regime import regime
from ..wave.wavefront import Wavefront
from ..window import error_bounds
from ..window.grids import PupilGrid, pupil_grid, pupil_grid_from_polar
from ..window.pixels import PixelRule, pixel_rule
from ..window.window import Window
from .mean import image_sampling
from .phase_screens import Between, screens, stride, throw, widest_pitch
from .roughness import Roughness
from .view import RoughView, rough_source

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Propagation = Literal["fresnel", "geometric"]

#: Largest turn of a screen's waves on their way that geometry may leave out, rad.
LARGEST_TURN: Final = 0.1
#: Fewest cells across the pupil when a polar wave is put on a grid.
LEAST_CELLS: Final = 256


def sample_point_spread(
    source: Wavefront | Scene | SceneOptics,
    roughness: Roughness,
    *,
    seed: int,
    independent_patterns: int = 1,
    footprint: ArrayLike | None = None,
    cos_sum: float | None = None,
    effective_distance: ArrayLike | None = None,
    propagation: Propagation = "fresnel",
    pitch: float | None = None,
    shape: int | tuple[int, int] | None = None,
    normalisation: Normalisation = "unit-sum",
    pixel_integrated: bool = False,
) -> PointSpread:
    """Point spread of a rough wall drawn at random.

    Parameters
    ----------
    source : Wavefront, Scene or SceneOptics
        The wave of the smooth wall; or the scene it is computed from, whose wall is the mean one.
        The pupil of a scene is sampled as finely as the screen and its halo take.
    roughness : Roughness
    seed : int
        The same seed and sampling give the same wall.
    independent_patterns : int
        Walls whose patterns are averaged; the first is that of a single one. An average over time
        or partial coherence is the same: one pattern for each correlation length that a wall moves
        by during the exposure, or for each wavelength lambda/s from the next, s the phase rms in
        rad. Developed speckle then has the contrast ``1/sqrt(independent_patterns)``.
    footprint, cos_sum
        As of `mean_point_spread`.
    effective_distance : float or array_like (2, 2), optional
        m, ``d1 d2/(d1 + d2)`` at normal incidence; as of `WallView`. Needed with a wavefront.
    propagation : {"fresnel", "geometric"}
        How the wall's phase comes to the pupil: as a wave; or as it is, along rays, where that is
        the same: the aberration then is ``-(cos_i + cos_o) h``.
    pitch, shape, normalisation, pixel_integrated
        As of `mean_point_spread`; 1 is what the smooth wall sends, about which walls scatter.

    Returns
    -------
    PointSpread
        The mean over seeds is that of `mean_point_spread`.

    Raises
    ------
    SceneError
        If geometry is missing, or given with a scene; or C is not that of a surface.
    SamplingError
        If a grid wavefront is too coarse for the screen or its halo, or geometry does not hold.
    MemoryLimitError
        If the screen that the pupil needs does not fit.

    Notes
    -----
    A thin screen of Gaussian heights on the tangent plane at the chief ray, its curvature and
    obliquity in M and the effective distance. Drawn on the pupil's lattice as seen on the wall,
    ``w = M p``, or on every so many points of it where the field between them follows from its
    waves; see `phase_screens.screens`. A ripple of period L comes
    to the pupil as phase times cos(q) and amplitude times sin(q), q = pi lambda d_eff/L^2 [1]_.

    References
    ----------
    .. [1] Goodman, Speckle Phenomena in Optics, 2nd ed., ch. 4.
    """
    one_of("normalisation", normalisation, NORMALISATIONS)
    one_of("propagation", propagation, ("fresnel", "geometric"))
    patterns = whole("independent_patterns", independent_patterns)
    seed = whole("seed", seed, 0, 2**64 - 1)
    smooth = rough_source(source, roughness, footprint, cos_sum, effective_distance)
    view = smooth.view
    pitch, shape = image_sampling(smooth.residual, view, pitch, shape)
    window = Window.centred(pitch, shape)
    samples, rule = speckle_samples(smooth.residual, window, pixel_integrated)
    residual, grid = smooth.refined(lambda found: (found, speckle_pupil(found, view, samples)))
    wave = residual.wavefront
    mean, spill = _patterns(
        residual, view, grid, samples, rule, seed=seed, patterns=patterns, propagation=propagation
    )
    level = residual.pixel_share(pitch)
    scale = {"unit-sum": level, "flux": level * wave.flux, "ideal-peak": 1.0}[normalisation]
    return PointSpread(
        intensity=mean * scale,
        pitch=pitch,
        method=f"{propagation} screen + mdft",
        error_estimate=speckle_error(residual, grid, window, mean, spill, pixel_integrated),
        normalisation=normalisation,
        wavelength=wave.wavelength,
        f_number=wave.f_number,
        pixel_integrated=pixel_integrated,
        enclosed_energy=float(mean.sum()) * level,
        regime=regime(residual, pitch, rayleigh_parameter=view.rayleigh_parameter),
        reason=f"{propagation} was asked for: a screen on the pupil's lattice, one chirp a pattern",
    )


def speckle_samples(
    residual: Residual, window: Window, pixel_integrated: bool
) -> tuple[Window, PixelRule | None]:
    """Points at which a pattern is taken, and how pixels are made of them."""
    pitch, shape = window.pitch, window.shape
    if not pixel_integrated and pitch > residual.nyquist_pitch * (1 + 1e-9):
        raise SamplingError(
            f"pitch = {pitch:.3g} m is wider than Nyquist's {residual.nyquist_pitch:.3g} m, which "
            "loses speckles; use pixel_integrated=True"
        )
    if not pixel_integrated:
        return window, None
    rule = pixel_rule(pitch, residual.nyquist_pitch, max(shape))
    return rule.window(pitch, shape), rule


def speckle_pupil(residual: Residual, view: RoughView, samples: Window) -> PupilGrid:
    """Smooth pupil function on a grid that the screen, its halo and the window allow."""
    wave = residual.wavefront
    halo = view.halo(wave)
    far = max(samples.reach_from(residual.shift)) + residual.rays.reach + halo
    finest = widest_pitch(view)
    scale = wave.wavelength * abs(wave.image_distance)
    if wave.layout == "polar":
        # a third of the period keeps the softened rim's leak off the window, see `antialiased_disc`
        pitch = min(finest, scale / (3 * far), 2 * wave.pupil_radius / LEAST_CELLS)
        return pupil_grid_from_polar(residual, pitch)
    n = wave.u.shape[0]
    if wave.pupil_pitch > finest * (1 + 1e-9):
        raise SamplingError(
            f"the pupil's pitch is {wave.pupil_pitch:.3g} m, limit {finest:.3g} m for a wall of "
            f"Rayleigh parameter {view.rayleigh_parameter:.3g}; use a wavefront of "
            f"{math.ceil(n * wave.pupil_pitch / finest) + 1} or more pupil samples (now {n}), or "
            "of polar nodes"
        )
    if far > scale / wave.pupil_pitch:
        need = math.ceil(n * far * wave.pupil_pitch / scale) + 1
        raise SamplingError(
            f"the pupil samples repeat the image every {scale / wave.pupil_pitch:.3g} m, and "
            f"window and halo need {far:.3g} m; use a smaller shape, or a wavefront of {need} or "
            f"more pupil samples (now {n}) or of polar nodes"
        )
    return pupil_grid(residual)


def _patterns(
    residual: Residual,
    view: RoughView,
    grid: PupilGrid,
    samples: Window,
    rule: PixelRule | None,
    *,
    seed: int,
    patterns: int,
    propagation: str,
) -> tuple[Array, float]:
    """Mean of the patterns, 1 at the ideal peak, and the light beyond the lattice's band."""
    if view.rayleigh_parameter == 0:
        return mdft.intensity_in(residual, grid, samples, rule), 0.0
    fields, between = wall_fields(residual, view, grid, seed, propagation)
    first = next(fields)
    total = mdft.intensity_in(residual, seen_through(grid, first, between), samples, rule)
    for field in islice(fields, patterns - 1):
        total += mdft.intensity_in(residual, seen_through(grid, field, between), samples, rule)
    return total / patterns, spilled(first)


def wall_fields(
    residual: Residual, view: RoughView, grid: PupilGrid, seed: int, propagation: str
) -> tuple[Iterator[ComplexArray], Between | None]:
    """Fields of one wall after the other on a lattice, and what takes them to the grid's points."""
    wave = residual.wavefront
    angle = view.halo(wave) / abs(wave.image_distance)
    reach = throw(view, angle)
    turn = math.pi / wave.wavelength * reach * angle
    if propagation == "geometric":
        if turn > LARGEST_TURN:
            shortest = wave.wavelength / angle
            raise SamplingError(
                f"waves of the screen down to {shortest:.3g} m in the pupil turn by q = "
                f"{turn:.3g} on their way to it, limit {LARGEST_TURN} for geometry; use "
                "propagation='fresnel'"
            )
        reach = 0.0
    n, step = grid.values.shape[0], stride(view, grid.pitch)
    # the farthest pupil point lies between two of the lattice
    cells = n if step == 1 else -(-n // step) + 1
    walls = screens(view, cells, step * grid.pitch, wave.wavelength, reach)
    fields = walls.draw(seed)
    return fields, (Between(walls.heights.shape[0], step, n) if step > 1 else None)


def seen_through(grid: PupilGrid, field: ComplexArray, between: Between | None) -> PupilGrid:
    """Pupil function with a wall's field."""
    n = grid.values.shape[0]
    phases = field[:n, :n] if between is None else between(field)
    return PupilGrid(grid.values * phases, grid.pitch, grid.jump, grid.rim)


def spilled(field: ComplexArray) -> float:
    """Light of a screen beyond its lattice's band: ten times that in the band's last tenth.

    So it is for the slowest decay, of an exponential C; others fall faster.
    """
    spectrum = np.abs(np.fft.fft2(field)) ** 2
    frequency = np.abs(np.fft.fftfreq(field.shape[0]))
    last = frequency > 0.45
    share = spectrum[last].sum() + spectrum[~last][:, last].sum()
    return float(10 * share / spectrum.sum())


def speckle_error(
    residual: Residual,
    grid: PupilGrid,
    window: Window,
    mean: Array,
    spill: float,
    pixel_integrated: bool,
) -> float:
    """Expected error relative to the peak, of the rim's sampling and of light that is folded."""
    wave = residual.wavefront
    edge = error_bounds.edge_errors(residual, grid, window.x, window.y)
    rim, energy = edge.field + edge.spill, edge.energy
    # the screen spreads the rim's error over the window, and what is folded over the period
    period = wave.wavelength * abs(wave.image_distance) / grid.pitch
    folded = spill / residual.pixel_share(period)
    field = math.sqrt(float(np.mean(rim**2)) * 9 + 9 * folded) + residual.truncation
    level = residual.pixel_share(window.pitch)
    pixel = window.pitch / residual.airy_unit if pixel_integrated else 0.0
    return error_bounds.intensity_error(mean, field, energy + spill, pixel=pixel, level=level)
