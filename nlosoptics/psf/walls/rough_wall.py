"""Ways to the image of an object point by one given rough wall: by rays, and by propagation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from ..._checks import lasting, memory_limit
from ..._html import Figures, Shown
from ..._nouns import Noun
from ..._vectors import Array, ComplexArray
from ...errors import CausticError, SamplingError
from ...scene import FacetWall
from ..pupil.scene_optics import PointOptics
from ..pupil.wall_wavefront import AimedWave, aimed_wave
from ..rough.aberration import aberration_error, rough_wave
from ..rough.relief import SCREEN_BYTES, STEEPEST, ReliefView, relief_stride
from ..rough.sample import (
    detilted_sample,
    pupil_pitch,
    speckle_pupil,
    speckle_samples,
    wall_screen,
)
from ..rough.scattered_light import FAR, WORTH, inner_window
from ..rough.source import rough_view
from ..rough.view import RoughView
from ..transform import costs
from ..transform.point_spread import PointSpread
from ..transform.wide_pixels import binned, detilted_wide_spread
from ..wave.detilted import split
from ..window.grids import grid_size
from ..window.window import Window, ray_reach

#: Radii, or cells per side, at which a relief's wave is sampled, and the nodes over their square.
RELIEF_NODES: Final = {"polar": (48, 4), "grid": (1024, 1)}
#: Memory of Python and numpy besides the arrays, bytes.
HELD: Final = 4e6


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
class Cost:
    """Predicted cost of a computation."""

    seconds: float  # Run time on one core, s
    n_bytes: float  # Peak memory, bytes


#: Wave, image, and pupil function if the field was propagated from the wall. The image is the
#: energy per pixel relative to that of the smooth wall.
Image = tuple[AimedWave, PointSpread, PupilField | None]


@dataclass(frozen=True, eq=False)
class WallImage:
    """One way to the image of an object point by a wall: its limits, cost and computation.

    A plan and its run ask the same object.
    """

    seen: PointOptics  # Optics of the object point
    pitch: float  # Pixel side, m
    shape: tuple[int, int]  # Pixels (ny, nx)
    tol: float  # Largest error relative to the peak

    @property
    def reason(self) -> str:
        """Way, sampling and reason in words."""
        raise NotImplementedError

    def refusal(self) -> str:
        """Return why this way is not used; empty if it may be."""
        return ""

    def cost(self, cells: int = 0) -> Cost:
        """Predict the cost without refinement of the pupil nodes.

        ``cells`` is the number of cells across a pupil grid that is still to be made; 0 for the
        wave's own nodes. Raises `NlosError` if the transforms would raise it before they compute
        anything.
        """
        raise NotImplementedError

    def run(self) -> Image:
        """Compute wave and image."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class ByAberration(WallImage):
    """Rays on the relief give the wave aberration; valid if they are hardly diffracted."""

    view: ReliefView  # View of the wall

    @cached_property
    def error(self) -> float:
        """Change of the image by diffraction between wall and pupil, relative to the peak."""
        return aberration_error(self.view, self.seen.first.wave.wavelength)

    @property
    def reason(self) -> str:
        """Way and reason in words."""
        return (
            f"wave aberration of this wall by rays: {steepness(self.view)} shift them so little "
            f"that diffraction between wall and pupil changes {self.error:.1g} of the peak"
        )

    def refusal(self) -> str:
        """Return how much diffraction changes, if that exceeds ``tol``."""
        if self.error <= self.tol:
            return ""
        return f"diffraction between wall and pupil changes {self.error:.2g} of the peak"

    @property
    def _layout(self) -> str:
        """Layout of the pupil nodes; creases of facets have no short series."""
        facets = isinstance(self.view.roughness, FacetWall)
        return "grid" if facets else self.seen.first.wave.layout

    def cost(self, cells: int = 0) -> Cost:
        """Predict the cost of the rays."""
        n, along = RELIEF_NODES[self._layout]
        nodes = float(along * n * n)
        return Cost(self.view.roughness.ray_seconds * nodes, HELD + 2e3 * nodes)

    def run(self) -> Image:
        """Compute wave and image by rays, or by propagation if the relief is too fine for them."""
        layout, seen = self._layout, self.seen
        samples = RELIEF_NODES[layout][0]
        try:
            aimed = aimed_wave(seen.scene, seen.exit_pupil, seen.object_point, layout, samples)
            wave = rough_wave(aimed.wave, self.view)
            spread = detilted_wide_spread(split(wave), self.pitch, self.shape, self.tol)
        except (CausticError, SamplingError):
            return _propagation(seen, self.pitch, self.shape, self.tol, self.view).run()
        share = wave.flux / aimed.wave.flux
        spread = replace(
            spread,
            intensity=spread.intensity * share,
            enclosed_energy=spread.enclosed_energy * share,
            reason=f"{self.reason}; {spread.reason}",
        )
        return replace(aimed, wave=wave), spread, None


@dataclass(frozen=True, eq=False)
class ByPropagation(WallImage):
    """The field on the wall, a phase screen, is propagated to the pupil."""

    view: ReliefView  # View of the wall

    @cached_property
    def _light(self) -> tuple[Window, int]:
        """Window of the light within a window of wide pixels, and its parts per pixel.

        Wide pixels are divided. Where the light fills the window, it is the window itself.
        """
        residual, window = self.seen.first.residual, Window.centred(self.pitch, self.shape)
        steep = STEEPEST * self.view.turn(residual.wavefront.wavelength)
        half = ray_reach(residual) + steep * abs(residual.wavefront.image_distance)
        half += FAR * residual.airy_unit
        if 2 * half >= WORTH * self.pitch * min(self.shape):
            return window, 1
        return inner_window(window, half)

    @cached_property
    def _samples(self) -> Window:
        return speckle_samples(self.seen.first.residual, self._light[0], True)[0]

    @cached_property
    def _screen(self) -> tuple[int, int, float, int]:
        """Points per side of pupil and screen, the screen's pitch, m, and pitch in pupil points."""
        residual = self.seen.first.residual
        pitch = pupil_pitch(residual, self.view, self._samples)
        n = grid_size(residual.wavefront.pupil_radius, pitch)
        screen, step = wall_screen(residual.wavefront, self.view, n, pitch)
        return n, screen.size, screen.pitch, step

    @property
    def reason(self) -> str:
        """Way, sampling and reason in words."""
        _, size, pitch, _ = self._screen
        return (
            f"this wall's field, propagated from wall to pupil: {steepness(self.view)} need a "
            f"phase screen of {size} x {size} points of {1e6 * pitch:.3g} um in the pupil"
        )

    def cost(self, cells: int = 0) -> Cost:
        """Predict the cost of screen, propagation and transform."""
        n, size, _, step = self._screen
        seconds = self.view.roughness.screen_seconds * float(size) ** 2
        seconds += costs.map_sums(n, self._samples) + 5e-8 * float(n) ** 2
        if step > 1:
            # interpolation from a coarser screen
            seconds += 6.5e-9 * step * size * (float(size) + n)
        held = SCREEN_BYTES * float(size) ** 2 + 48.0 * n * (n + max(self._samples.shape))
        return Cost(seconds, HELD + held)

    def refusal(self) -> str:
        """Return why the screen is too large; empty if it is not."""
        cost, size, longest = self.cost(), self._screen[1], 60.0
        if cost.seconds <= longest and cost.n_bytes <= memory_limit():
            return ""
        return (
            f"{steepness(self.view)} need a phase screen of {size} x {size} points, "
            f"{lasting(cost.seconds)} and {cost.n_bytes / 2**30:.3g} GiB, limits "
            f"{longest:g} s and {memory_limit() / 2**30:.3g} GiB; use realisation = 'mean', a "
            "smaller slope_rms, or rays alone by raytrace.trace_image"
        )

    def run(self) -> Image:
        """Compute wave, image and pupil function."""
        light, parts = self._light
        aimed, grid = self.seen.refined(
            lambda found: speckle_pupil(found.residual, self.view, self._samples)
        )
        spread, through = detilted_sample(
            aimed.residual,
            grid,
            self.view,
            light.pitch,
            light.shape,
            pixel_integrated=True,
            reason=self.reason,
        )
        if light.shape != self.shape:
            fine = float(spread.intensity.max())
            wide = binned(spread.intensity, parts, self.shape)
            # errors of the fine pixels are speckle, independent of each other
            error = spread.error_estimate * parts * fine / float(wide.max())
            spread = replace(spread, intensity=wide, pitch=self.pitch, error_estimate=error)
        # the pupil function's samples add up to 1 for a smooth wall
        wave = aimed.wave
        area = float(np.sum(wave.weights * wave.amplitude)) / grid.pitch**2
        # the field is resolved by a coarser lattice than that of the image
        step = relief_stride(self.view, grid.pitch, wave.wavelength)
        kept = slice(grid.centre % step, None, step)
        field = PupilField(values=through.values[kept, kept] * area, pitch=step * grid.pitch)
        return aimed, spread, field


def steepness(view: ReliefView) -> str:
    """Return the slopes of a relief in words."""
    what = "facets" if isinstance(view.roughness, FacetWall) else "slopes"
    return f"{what} of {view.roughness.slope_rms:.2g} rad"


def relief_image(
    seen: PointOptics, pitch: float, shape: tuple[int, int], tol: float, view: ReliefView
) -> WallImage:
    """Return the first way to the image by a given wall that holds; refuse if none does."""
    rays = ByAberration(seen, pitch, shape, tol, view)
    return _propagation(seen, pitch, shape, tol, view) if rays.refusal() else rays


def _propagation(
    seen: PointOptics, pitch: float, shape: tuple[int, int], tol: float, view: ReliefView
) -> ByPropagation:
    """Return the propagation from wall to pupil; refuse if its screen is too large."""
    way = ByPropagation(seen, pitch, shape, tol, view)
    if why := way.refusal():
        raise SamplingError(why)
    return way


def roughness_view(seen: PointOptics, *, pattern: bool | None = None) -> RoughView:
    """Return the view of the wall's roughness from the exit pupil.

    ``pattern`` selects this wall or the mean over all walls; by default as the scene says.
    """
    rough = seen.scene.wall_roughness
    assert rough is not None
    if pattern is None:
        pattern = rough.realisation == "pattern"
    return rough_view(seen.first.wave, seen.view, rough.heights, pattern=pattern)
