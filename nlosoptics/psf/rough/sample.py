"""Point spread function of one random rough wall: a static speckle pattern."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import islice

import ducc0
import numpy as np
from numpy.typing import ArrayLike

from ..._checks import one_of, whole
from ..._vectors import Array, ComplexArray
from ...errors import SamplingError, SceneError
from ...scene import Scene
from ..pupil.scene_optics import SceneOptics
from ..transform import mdft
from ..transform.models import speckle_model_error
from ..transform.point_spread import NORMALISATIONS, Normalisation, PointSpread
from ..wave.detilted import Residual
from ..wave.regime import regime
from ..wave.wavefront import Wavefront
from ..window import error_bounds
from ..window.grids import PupilGrid, pupil_grid, pupil_grid_from_polar
from ..window.pixels import PixelRule, pixel_rule
from ..window.window import Window
from .mean import image_sampling
from .phase_screens import Between, Screens, screens, stride, throw, widest_pitch
from .relief import Relief, ReliefScreen, ReliefView, relief_screen, relief_stride
from .roughness import Roughness
from .source import rough_source
from .view import RoughView


def sample_point_spread(
    source: Wavefront | Scene | SceneOptics,
    roughness: Roughness | Relief,
    *,
    seed: int | None = None,
    independent_patterns: int = 1,
    footprint: ArrayLike | None = None,
    cos_sum: float | None = None,
    effective_distance: ArrayLike | None = None,
    pitch: float | None = None,
    shape: int | tuple[int, int] | None = None,
    normalisation: Normalisation = "unit-sum",
    pixel_integrated: bool = False,
) -> PointSpread:
    """Compute the point spread function of one random rough wall: a speckle pattern.

    Parameters
    ----------
    source, footprint, cos_sum, pitch, shape, pixel_integrated
        As in `mean_point_spread`. The pupil of a scene is sampled as finely as the heights require.
    roughness : Roughness, FacetWall, GaussianWall or HeightMapWall
        Statistics of the heights, from which a random wall is drawn (`Roughness`), or one wall of
        given heights. The latter is the same wall for every object point, pupil and sampling.
    seed : int, optional
        Random seed, 0 or more. Required with a `Roughness`, and not allowed with given heights. The
        same seed and sampling yield the same wall.
    independent_patterns : int
        Number of random walls whose patterns are averaged. Fully developed speckle then has the
        contrast ``1/sqrt(independent_patterns)``. Use it to model a wall that moves during the
        exposure, or light of several wavelengths, see Notes. Must be 1 with given heights.
    effective_distance : float or array_like (2, 2), optional
        Distance over which wall ripples diffract on their way to the pupil, m. For a flat wall at
        normal incidence it is ``d1 d2/(d1 + d2)``, see `WallView`. Required with a wavefront, not
        allowed with a scene.
    normalisation : {"unit-sum", "ideal-peak", "flux"}
        Quantity that has the value 1, for the smooth wall: the energy in the whole image plane, the
        peak without aberration, or the energy that a clear disc of the pupil's radius transmits.
        The energy of a single random wall can differ from that of the smooth one.

    Returns
    -------
    PointSpread
        Intensity (ny, nx), row 0 at the lowest y. The mean over many seeds is that of
        `mean_point_spread`.

    Raises
    ------
    SceneError
        If ``footprint``, ``cos_sum`` or ``effective_distance`` is missing with a wavefront or
        given with a scene; or if no surface can have the autocorrelation.
    SamplingError
        If the samples of a wave on a grid are too coarse for the heights, the window is too narrow
        for the rays,.

    See Also
    --------
    mean_point_spread : Mean over all walls in closed form.

    Notes
    -----
    The heights are a thin phase screen in the plane that touches the wall where the chief ray meets
    it. The wall's curvature and tilt enter by ``footprint`` and ``effective_distance``.

    With Fresnel propagation, a ripple of period L that has the phase amplitude a on the wall
    reaches the pupil as a phase of amplitude ``a cos(q)`` and a modulation of the field's amplitude
    ``a sin(q)``, with ``q = pi lambda d/L^2`` and the effective distance d [1]_.

    For a wall that moves during the exposure, set ``independent_patterns`` to the distance moved
    divided by the correlation length. For light of several wavelengths, set it to the bandwidth
    divided by ``lambda/s``, with s the rms phase due to the heights, rad.

    References
    ----------
    .. [1] Goodman, Speckle Phenomena in Optics, 2nd ed., ch. 4.

    Examples
    --------
    Speckle pattern of a flat wall, seen at normal incidence halfway between object and lens:

    >>> from nlosoptics import psf
    >>> wave = psf.Wavefront.from_zernike(
    ...     {}, wavelength=632.8e-9, pupil_radius=12.5e-3, image_distance=1.0
    ... )
    >>> rough = psf.Roughness(height_rms=50e-9, correlation_length=4e-3)
    >>> geometry = {"footprint": 0.5, "cos_sum": 2.0, "effective_distance": 0.5}
    >>> one = psf.sample_point_spread(wave, rough, seed=1, shape=65, **geometry)
    >>> one.shape, one.method
    ((65, 65), 'fresnel screen + mdft')
    """
    one_of("normalisation", normalisation, NORMALISATIONS)
    patterns = whole("independent_patterns", independent_patterns)
    seed = _checked_draw(roughness, seed, patterns)
    smooth = rough_source(source, roughness, footprint, cos_sum, effective_distance, pattern=True)
    view = smooth.view
    pitch, shape = image_sampling(smooth.residual, view, pitch, shape)
    samples = speckle_samples(smooth.residual, Window.centred(pitch, shape), pixel_integrated)[0]
    residual, grid = smooth.refined(lambda found: (found, speckle_pupil(found, view, samples)))
    return detilted_sample(
        residual,
        grid,
        view,
        pitch,
        shape,
        seed=seed,
        patterns=patterns,
        normalisation=normalisation,
        pixel_integrated=pixel_integrated,
        reason="a phase screen with Fresnel propagation, and one mdft for each pattern",
    )[0]


def detilted_sample(
    residual: Residual,
    grid: PupilGrid,
    view: RoughView,
    pitch: float,
    shape: tuple[int, int],
    *,
    seed: int = 0,
    patterns: int = 1,
    normalisation: Normalisation = "unit-sum",
    pixel_integrated: bool,
    reason: str,
) -> tuple[PointSpread, PupilGrid]:
    """Compute `sample_point_spread` for a split wave and its pupil function from `speckle_pupil`.

    Returns the mean of the patterns, and the pupil function of the first wall.
    """
    wave, window = residual.wavefront, Window.centred(pitch, shape)
    samples, rule = speckle_samples(residual, window, pixel_integrated)
    seen, spill = grid, 0.0
    if view.rayleigh_parameter == 0:
        mean = mdft.intensity_in(residual, grid, samples, rule)
    else:
        n = grid.values.shape[0]
        screen, step = wall_screen(wave, view, n, grid.pitch)
        between = Between(screen.size, step, n) if step > 1 else None
        mean = np.zeros(shape)
        for k, field in enumerate(islice(screen.draw(seed), patterns)):
            phases = field[:n, :n] if between is None else between(field)
            through = replace(grid, values=grid.values * phases)
            mean += mdft.intensity_in(residual, through, samples, rule)
            if k == 0:
                seen, spill = through, spilled(field)
        mean /= patterns
    level = residual.pixel_share(pitch)
    scale = {"unit-sum": level, "flux": level * wave.flux, "ideal-peak": 1.0}[normalisation]
    spread = PointSpread(
        intensity=mean * scale,
        pitch=pitch,
        method="fresnel screen + mdft",
        error_estimate=speckle_error(residual, grid, window, mean, spill, pixel_integrated),
        model_error=speckle_model_error(residual, normalisation),
        normalisation=normalisation,
        wavelength=wave.wavelength,
        f_number=wave.f_number,
        pixel_integrated=pixel_integrated,
        enclosed_energy=float(mean.sum()) * level,
        regime=regime(residual, pitch, rayleigh_parameter=view.rayleigh_parameter),
        reason=reason,
    )
    return spread, seen


def _checked_draw(roughness: Roughness | Relief, seed: int | None, patterns: int) -> int:
    """Return the seed; refuse to draw where the heights are given, or without a seed."""
    if not isinstance(roughness, Relief):
        if seed is None:
            raise SceneError("seed is missing, which selects the random wall; give seed = 0")
        return whole("seed", seed, 0, 2**64 - 1)
    if seed is not None:
        raise SceneError(
            f"seed = {seed!r} is given with the heights of one wall; leave it out, or give the "
            "wall another seed"
        )
    if patterns > 1:
        raise SceneError(
            f"independent_patterns = {patterns} with the heights of one wall, limit 1; give a "
            "Roughness, or average over walls of several seeds"
        )
    return 0


def speckle_samples(
    residual: Residual, window: Window, pixel_integrated: bool
) -> tuple[Window, PixelRule | None]:
    """Return the sample points of a pattern, and the rule that averages them over pixels."""
    pitch, shape = window.pitch, window.shape
    if pixel_integrated:
        rule = pixel_rule(pitch, residual.nyquist_pitch, max(shape))
        return rule.window(pitch, shape), rule
    if pitch > residual.nyquist_pitch * (1 + 1e-9):
        raise SamplingError(
            f"pitch = {pitch:.3g} m is wider than the Nyquist pitch {residual.nyquist_pitch:.3g} "
            "m and does not resolve the speckles; use pixel_integrated=True"
        )
    return window, None


def finest_pitch(view: RoughView, wavelength: float) -> float:
    """Return the widest pupil pitch, m, that resolves the field of a rough wall."""
    return view.widest_pitch(wavelength) if isinstance(view, ReliefView) else widest_pitch(view)


def reach(residual: Residual, view: RoughView, samples: Window) -> float:
    """Return the distance, m, from the axis to the end of the window, with rays and halo."""
    halo = view.halo(residual.wavefront)
    return max(samples.reach_from(residual.shift)) + residual.rays.reach + halo


def pupil_pitch(residual: Residual, view: RoughView, samples: Window) -> float:
    """Return the pupil pitch, m, for the image of a rough wall in a window.

    The pitch that resolves the wall's field is a multiple of it, so that the field can be computed
    on the coarser lattice.
    """
    wave = residual.wavefront
    finest = finest_pitch(view, wave.wavelength)
    # A period of 3 reaches keeps the leak of the softened rim outside, see `antialiased_disc`.
    scale = wave.wavelength * abs(wave.image_distance)
    widest = scale / (3 * reach(residual, view, samples))
    pitch = min(finest, widest, 2 * wave.pupil_radius / 256)
    return pitch if math.isinf(finest) else finest / math.ceil(finest / pitch * (1 - 1e-9))


def speckle_pupil(residual: Residual, view: RoughView, samples: Window) -> PupilGrid:
    """Return the smooth pupil function on a grid fine enough for the screen, halo and window."""
    wave = residual.wavefront
    if wave.is_spectral:
        return pupil_grid_from_polar(residual, pupil_pitch(residual, view, samples))
    far = reach(residual, view, samples)
    limit = min(
        finest_pitch(view, wave.wavelength), wave.wavelength * abs(wave.image_distance) / far
    )
    n = wave.u.shape[0]
    if wave.pupil_pitch > limit * (1 + 1e-9):
        raise SamplingError(
            f"the pupil's pitch is {wave.pupil_pitch:.3g} m, limit {limit:.3g} m for a wall of "
            f"Rayleigh parameter {view.rayleigh_parameter:.3g} whose image reaches {far:.3g} m; "
            "use a smaller shape, or a wavefront of "
            f"{math.ceil(n * wave.pupil_pitch / limit) + 1} or more pupil samples (now {n}), or of "
            "polar nodes"
        )
    return pupil_grid(residual)


def wall_screen(
    wave: Wavefront, view: RoughView, n: int, pitch: float
) -> tuple[Screens | ReliefScreen, int]:
    """Return the phase screen of a wall for n x n pupil points of a pitch, m.

    The second result is the spacing of its lattice in pupil points.
    """
    wavelength = wave.wavelength
    if isinstance(view, ReliefView):
        step = relief_stride(view, pitch, wavelength)
        centre = n // 2 / step
        return relief_screen(view, _lattice(n, step), step * pitch, wavelength, centre), step
    step = stride(view, pitch)
    spread = throw(view, view.halo(wave) / abs(wave.image_distance))
    return screens(view, _lattice(n, step), step * pitch, wavelength, spread), step


def _lattice(n: int, step: int) -> int:
    """Return the lattice points per side that enclose n pupil points, at every ``step``-th."""
    return n if step == 1 else -(-n // step) + 1


def spilled(field: ComplexArray) -> float:
    """Estimate the fraction of a field's energy beyond the band limit of its lattice.

    It is ten times that in the last tenth of the band. This holds for the spectrum of an
    exponential C, which decays most slowly.
    """
    waves = ducc0.fft.c2c(field, nthreads=1)
    last = np.nonzero(np.abs(np.fft.fftfreq(len(field))) > 0.45)[0]
    a, b = int(last[0]), int(last[-1]) + 1  # the highest frequencies are in the middle
    parts = waves[a:b], waves[:a, a:b], waves[b:, a:b]
    share = sum(float(np.vdot(part, part).real) for part in parts)
    return 10 * share / (field.size * float(np.vdot(field, field).real))


def speckle_error(
    residual: Residual,
    grid: PupilGrid,
    window: Window,
    mean: Array,
    spill: float,
    pixel_integrated: bool,
) -> float:
    """Estimate the error relative to the peak, due to the sampled rim and to aliasing.

    ``mean`` (ny, nx) is the intensity in the window, 1 at the ideal peak, and ``spill`` is the
    fraction of the energy beyond the lattice's band, from `spilled`.
    """
    wave = residual.wavefront
    edge = error_bounds.edge_errors(residual, grid, window.x, window.y)
    rim, energy = edge.field + edge.spill, edge.energy
    # The screen distributes the rim's error over the window, and aliased energy over the period.
    period = wave.wavelength * abs(wave.image_distance) / grid.pitch
    folded = spill / residual.pixel_share(period)
    field = math.sqrt(float(np.mean(rim**2)) * 9 + 9 * folded) + residual.truncation
    level = residual.pixel_share(window.pitch)
    pixel = window.pitch / residual.airy_unit if pixel_integrated else 0.0
    return error_bounds.intensity_error(mean, field, energy + spill, pixel=pixel, level=level)
