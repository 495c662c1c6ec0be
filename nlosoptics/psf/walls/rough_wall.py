"""Point spread function of a scene whose wall has a roughness, and the choice of its regime."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from ..._checks import lasting, memory_limit
from ..._html import Figures, Shown
from ..._nouns import Noun
from ...errors import CausticError, SamplingError
from ...scene import FacetWall
from ..pupil.scene_optics import PointOptics
from ..pupil.wall_wavefront import AimedWave, aimed_wave
from ..rough.aberration import aberration_error, rough_wave
from ..rough.mean import detilted_mean
from ..rough.relief import SCREEN_BYTES, STEEPEST, ReliefView, margins, relief_stride
from ..rough.sample import detilted_sample, grid_pitch, speckle_pupil, speckle_samples
from ..rough.scattered_light import FAR, WORTH, inner_window
from ..rough.source import rough_view
from ..rough.view import RoughView
from ..transform import costs
from ..transform.point_spread import PointSpread
from ..transform.wide_pixels import binned, detilted_wide_spread
from ..wave.detilted import Residual, split
from ..window.grids import grid_size
from ..window.window import Window, ray_reach, window_side

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Regime = Literal["aberration", "diffraction", "mean"]

#: Radii (with four times as many angles) or cells per side at which a relief's wave is sampled.
RELIEF_NODES: Final = {"polar": 48, "grid": 1024}
#: Most scales of the heights across the wall that the lens sees. Finer roughness scatters to angles
#: far outside any image.
MOST_ACROSS: Final = 2000


@dataclass(frozen=True, eq=False, kw_only=True)
class PupilField(Noun, Shown):
    """Amplitude and phase of the light in the exit pupil of a scene with a rough wall.

    Parameters
    ----------
    values : ndarray, (n, n)
        Complex pupil function ``A exp(ikW)``, read-only, with the amplitude A, k = 2 pi/wavelength
        and the aberration W relative to the reference sphere. The wave of a perfect image has a
        constant phase in the pupil. A smooth wall has the amplitude 1 inside the rim of the pupil.
        Piston and tilt of the same wall without roughness are removed. The first index increases
        with v, the second with u; sample [n//2, n//2] is on the axis.
    pitch : float
        Spacing of the samples in the exit pupil, m.

    See Also
    --------
    Wavefront : Sampled wave in the exit pupil.
    """

    values: ComplexArray
    pitch: float

    def __post_init__(self) -> None:
        self.values.flags.writeable = False

    def _figures(self) -> Figures:
        """Return the key figures of the field, for display in notebooks."""
        n = self.values.shape[0]
        size = self.amplitude[np.isfinite(self.phase)]
        contrast = float(np.std(size**2) / np.mean(size**2)) if size.size else 0.0
        figures = {
            "samples": f"{n} x {n} of {1e6 * self.pitch:.3g} µm",
            "contrast of the intensity": f"{contrast:.3g}",
        }
        return Figures("Pupil field", figures, "Map of the phase over the exit pupil")

    @property
    def amplitude(self) -> Array:
        """Amplitude of the light, (n, n): modulus of ``values``, 1 for a smooth wall."""
        return np.abs(self.values)

    @property
    def phase(self) -> Array:
        """Phase of the light, (n, n), -pi to pi rad; NaN where the amplitude is almost 0."""
        size = np.abs(self.values)
        dark = size <= 1e-3 * float(size.max())
        return np.where(dark, np.nan, np.angle(self.values))


@dataclass(frozen=True)
class RoughChoice:
    """Regime of the point spread function of a rough wall, with sampling and predicted cost."""

    # Rays on the relief give the wave aberration; or the field is propagated from the wall to the
    # pupil; or the mean over all walls in closed form.
    regime: Regime
    cells: int  # Samples per side: pupil nodes or phase screen; 0 for the mean
    pitch: float  # Pitch of the phase screen in the pupil, m; 0 otherwise
    # Predicted run time on one core, s, and memory, bytes.
    seconds: float
    n_bytes: float
    error: float  # Expected error relative to the peak
    reason: str  # Regime, sampling and reason in words


def roughness_view(seen: PointOptics, *, pattern: bool | None = None) -> RoughView:
    """Return the view of the wall's roughness from the exit pupil.

    ``pattern`` selects this wall or the mean over all walls; by default as the scene says.
    """
    rough = seen.scene.wall_roughness
    assert rough is not None
    if pattern is None:
        pattern = rough.realisation == "pattern"
    return rough_view(seen.first.wave, seen.view, rough.heights, pattern=pattern)


def rough_window(seen: PointOptics, pitch: float, tol: float) -> int:
    """Return the odd side of a window outside which the mean image is below ``tol`` of its peak.

    Raises `SamplingError` if the roughness is so fine that the window would be too wide.
    """
    residual = seen.first.residual
    side = window_side(residual, pitch, tol, seen.first.outline)
    view = roughness_view(seen)
    if view.rayleigh_parameter > 0:
        patch = 2 * residual.wavefront.pupil_radius * float(np.linalg.norm(view.footprint, 2))
        if patch > MOST_ACROSS * view.length:
            raise SamplingError(
                f"the wall's roughness changes over {view.length:.3g} m, {patch / view.length:.3g} "
                f"times within the {patch:.3g} m that the lens sees, limit {MOST_ACROSS}; use a "
                "larger cell or correlation_length, or a mirror-like lobe with slope_rms instead"
            )
    halo = view.halo(residual.wavefront) / 3 * math.sqrt(2 * math.log(1 / tol))
    return side + 2 * math.ceil(halo / pitch)


def rough_choice(
    seen: PointOptics, pitch: float, shape: tuple[int, int], tol: float
) -> RoughChoice:
    """Choose how the point spread function of a scene's rough wall is computed.

    The optics keep the choice, so that a plan and its run share it.
    """
    return seen.once(("rough choice", pitch, shape, tol), lambda: _choice(seen, pitch, shape, tol))


def _choice(seen: PointOptics, pitch: float, shape: tuple[int, int], tol: float) -> RoughChoice:
    """Return the first regime that holds for a rough wall, see `rough_choice`."""
    view, residual = roughness_view(seen), seen.first.residual
    if not isinstance(view, ReliefView):
        return RoughChoice("mean", 0, 0.0, 0.0, 0.0, tol, "mean over all walls in closed form")
    found = _aberration(residual, view)
    if found.error <= tol:
        return found
    screen = _screen(residual, view, pitch, shape)
    longest = 60.0
    if screen.seconds > longest or screen.n_bytes > memory_limit():
        raise SamplingError(
            f"{_steepness(view)} need a phase screen of {screen.cells} x {screen.cells} points, "
            f"{lasting(screen.seconds)} and {screen.n_bytes / 2**30:.3g} GiB, limits "
            f"{longest:g} s and {memory_limit() / 2**30:.3g} GiB; use realisation = 'mean', a "
            "smaller slope_rms, or rays alone by raytrace.trace_image"
        )
    return screen


def _steepness(view: ReliefView) -> str:
    """Return the slopes of a relief in words."""
    what = "facets" if isinstance(view.roughness, FacetWall) else "slopes"
    return f"{what} of {view.roughness.slope_rms:.2g} rad"


def _aberration(residual: Residual, view: ReliefView) -> RoughChoice:
    """Return nodes, cost and error of the wave aberration by rays on the relief."""
    error = aberration_error(view, residual.wavefront.wavelength)
    layout = relief_layout(residual.wavefront.layout, view)
    n = RELIEF_NODES[layout]
    nodes = float(n * n if layout == "grid" else 4 * n * n)
    return RoughChoice(
        "aberration",
        n,
        0.0,
        view.roughness.ray_seconds * nodes,
        2e3 * nodes,
        error,
        f"wave aberration of this wall by rays: {_steepness(view)} shift them so little that "
        f"diffraction between wall and pupil changes {error:.1g} of the peak",
    )


def _light_window(
    residual: Residual, view: ReliefView, pitch: float, shape: tuple[int, int]
) -> tuple[Window, int]:
    """Return the window of the light within a window of wide pixels, and its parts per pixel.

    Wide pixels are divided. Where the light fills the window, it is the window itself.
    """
    window = Window.centred(pitch, shape)
    steep = STEEPEST * view.turn(residual.wavefront.wavelength)
    half = ray_reach(residual) + steep * abs(residual.wavefront.image_distance)
    half += FAR * residual.airy_unit
    if 2 * half >= WORTH * pitch * min(shape):
        return window, 1
    return inner_window(window, half)


def _screen(
    residual: Residual, view: ReliefView, pitch: float, shape: tuple[int, int]
) -> RoughChoice:
    """Return sampling and cost of the propagation from wall to pupil."""
    wave = residual.wavefront
    samples = speckle_samples(residual, _light_window(residual, view, pitch, shape)[0], True)[0]
    far = max(samples.reach_from(residual.shift)) + residual.rays.reach + view.halo(wave)
    step = grid_pitch(wave, view.widest_pitch(wave.wavelength), far)
    n = grid_size(wave.pupil_radius, step)
    stride = relief_stride(view, step, wave.wavelength)
    size = n // stride + 2 * sum(margins(view, stride * step, wave.wavelength))
    seconds = view.roughness.screen_seconds * float(size) ** 2
    seconds += costs.map_sums(n, samples) + 5e-8 * float(n) ** 2
    if stride > 1:
        # interpolation from a coarser screen
        seconds += 6.5e-9 * stride * size * (float(size) + n)
    held = SCREEN_BYTES * float(size) ** 2 + 48.0 * n * (n + max(samples.shape))
    reason = (
        f"this wall's field, propagated from wall to pupil: {_steepness(view)} need a phase screen "
        f"of {size} x {size} points of {1e6 * stride * step:.3g} um in the pupil"
    )
    return RoughChoice("diffraction", size, stride * step, seconds, held, 1e-3, reason)


def relief_layout(layout: str, view: ReliefView) -> str:
    """Return the layout of the pupil nodes for a relief; creases of facets have no short series."""
    return "grid" if isinstance(view.roughness, FacetWall) else layout


def rough_image(
    seen: PointOptics, pitch: float, shape: tuple[int, int], tol: float
) -> tuple[AimedWave, PointSpread, PupilField | None]:
    """Compute wave, image and pupil function of an object point seen by a rough wall.

    The wave is that of this wall if it is defined, or else of the smooth wall. The image is the
    energy per pixel relative to that of the smooth wall. The pupil function is None unless the
    field was propagated from the wall.
    """
    choice = rough_choice(seen, pitch, shape, tol)
    if choice.regime == "mean":
        view = roughness_view(seen)

        def mean(aimed: AimedWave) -> PointSpread:
            return detilted_mean(aimed.residual, view, tol, pitch, shape, pixel_integrated=True)

        return *seen.refined(mean), None
    view = roughness_view(seen)
    assert isinstance(view, ReliefView)
    if choice.regime == "aberration":
        try:
            return *_by_aberration(seen, view, pitch, shape, tol, choice.reason), None
        except (CausticError, SamplingError):
            pass  # the relief is too fine for the wave's nodes; propagation samples it as needed
    return _by_diffraction(seen, view, pitch, shape, choice.reason)


def _by_aberration(
    seen: PointOptics,
    view: ReliefView,
    pitch: float,
    shape: tuple[int, int],
    tol: float,
    reason: str,
) -> tuple[AimedWave, PointSpread]:
    """Compute the image by the wave aberration of the relief."""
    layout = relief_layout(seen.first.wave.layout, view)
    aimed = aimed_wave(seen.scene, seen.exit_pupil, seen.object_point, layout, RELIEF_NODES[layout])
    wave = rough_wave(aimed.wave, view)
    spread = detilted_wide_spread(split(wave), pitch, shape, tol)
    share = wave.flux / aimed.wave.flux
    spread = replace(
        spread,
        intensity=spread.intensity * share,
        enclosed_energy=spread.enclosed_energy * share,
        reason=f"{reason}; {spread.reason}",
    )
    return replace(aimed, wave=wave), spread


def _by_diffraction(
    seen: PointOptics, view: ReliefView, pitch: float, shape: tuple[int, int], reason: str
) -> tuple[AimedWave, PointSpread, PupilField]:
    """Compute the image by propagation of the wall's field to the pupil."""
    light, parts = _light_window(seen.first.residual, view, pitch, shape)
    samples = speckle_samples(seen.first.residual, light, True)[0]
    aimed, grid = seen.refined(lambda found: speckle_pupil(found.residual, view, samples))
    residual, wave = aimed.residual, aimed.wave
    spread, through = detilted_sample(
        residual, grid, view, light.pitch, light.shape, pixel_integrated=True, reason=reason
    )
    if light.shape != shape:
        fine = float(spread.intensity.max())
        wide = binned(spread.intensity, parts, shape)
        # errors of the fine pixels are speckle, independent of each other
        error = spread.error_estimate * parts * fine / float(wide.max())
        spread = replace(spread, intensity=wide, pitch=pitch, error_estimate=error)
    # the pupil function's samples add up to 1 for a smooth wall
    area = float(np.sum(wave.weights * wave.amplitude)) / grid.pitch**2
    # the field is resolved by a coarser lattice than that of the image
    step = relief_stride(view, grid.pitch, wave.wavelength)
    kept = slice(grid.centre % step, None, step)
    values = through.values[kept, kept] * area
    return aimed, spread, PupilField(values=values, pitch=step * grid.pitch)
