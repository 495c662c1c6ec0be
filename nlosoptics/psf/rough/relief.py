"""Field of one given rough wall at the exit pupil, by a Fresnel integral from wall to pupil."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import ducc0
import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ..._vectors import Array, ComplexArray
from ...errors import SceneError
from ...scene import FacetWall, GaussianWall, HeightMapWall
from ..wave.wavefront import Wavefront
from .phase_screens import phase_field, propagated, spreading_matrix
from .view import RoughView

#: Walls with given heights.
Relief = FacetWall | GaussianWall | HeightMapWall

#: Steepest slope whose light is followed, in rms slopes per axis.
STEEPEST = 5.0
#: Memory of the screen per lattice point, bytes: heights, coordinates, field and its transform.
SCREEN_BYTES: Final = 72.0


@dataclass(frozen=True, eq=False)
class ReliefView(RoughView):
    """View of one wall whose heights are given.

    Parameters
    ----------
    roughness : FacetWall, GaussianWall or HeightMapWall
        The wall's heights over its mean surface.
    footprint, rayleigh_parameter, effective_distance
        As in `RoughView`.
    origin : ndarray, (2,)
        World x and y of the wall point on the chief ray, m.
    axes : ndarray, (2, 2)
        World x and y (columns) of a unit step along each axis of the wall's tangent plane (rows).
    """

    roughness: Relief  # type: ignore[assignment]
    origin: Array = None  # type: ignore[assignment]
    axes: Array = None  # type: ignore[assignment]

    @property
    def length(self) -> float:
        """Scale on which the heights change along the wall, m."""
        return math.sqrt(2) * self.roughness.height_rms / self.roughness.slope_rms

    @property
    def has_tails(self) -> bool:
        """True: the light of one wall is no Gaussian."""
        return True

    def cos_sum(self, wavelength: float) -> float:
        """Return the sum of the cosines of incidence and exitance, at a wavelength, m."""
        return wavelength * self.rayleigh_parameter / (2 * math.pi * self.roughness.height_rms)

    def turn(self, wavelength: float) -> float:
        """Return the rms slope per axis of the wave in the pupil, rad, at a wavelength, m.

        It is ``(cos_i + cos_o) |M| slope_rms``, or the diffraction angle of the heights' scale if
        that is larger, as for heights below a wavelength.
        """
        s = self.rayleigh_parameter
        if s == 0:
            return 0.0
        across = float(np.linalg.norm(self.footprint, 2))
        steep = self.cos_sum(wavelength) * self.roughness.slope_rms * across
        return steep * max(1.0, 1.0 / s)

    def halo(self, wave: Wavefront) -> float:
        """Return the radius of the halo in the image, m: 3 standard deviations."""
        return 3 * self.turn(wave.wavelength) * abs(wave.image_distance)

    def widest_pitch(self, wavelength: float) -> float:
        """Return the widest pupil pitch, m, that resolves slopes and creases of the heights."""
        turn, relief = self.turn(wavelength), self.roughness
        if turn == 0:
            return math.inf
        across = float(np.linalg.norm(self.footprint, 2))
        finest = self.length / (6 * across)
        if isinstance(relief, FacetWall):
            # the spectrum of creases falls slowly
            finest = relief.cell / (16 * across)
        elif isinstance(relief, HeightMapWall):
            finest = relief.pitch / across
        return min(wavelength / (12 * turn), finest)


@dataclass(frozen=True, eq=False)
class ReliefScreen:
    """Phase screen of one wall on a periodic lattice of pupil points."""

    view: ReliefView  # View of the wall
    size: int  # Lattice points per side, one period
    cells: int  # Lattice points per side that are used; they are the first ones of the lattice
    # Points on each side of these with the wall's full heights. Beyond them the heights fall
    # smoothly to 0, so that the period has no edge.
    margin: int
    pitch: float  # Lattice pitch in the pupil, m
    wavelength: float  # m
    centre: float  # Lattice coordinate of the pupil's axis

    def heights(self) -> Array:
        """Return the wall's heights (size, size), m, in the order of the lattice."""
        band, steps = (self.size - self.cells) // 2, np.arange(self.size)
        steps[self.cells + band :] -= self.size
        out = np.maximum(np.maximum(-steps, steps - (self.cells - 1)) - self.margin, 0.0)
        fall = np.cos(np.minimum(out / max(1, band - self.margin), 1.0) * math.pi / 2) ** 2
        across = (steps - self.centre) * self.pitch
        m = self.view.axes.T @ self.view.footprint
        (x0, y0), relief = self.view.origin, self.view.roughness
        found = np.empty((self.size, self.size))
        rows = max(1, 2**22 // self.size)  # blocks keep the coordinates small
        for start in range(0, self.size, rows):
            v = across[start : start + rows, None]
            x = x0 + m[0, 0] * across + m[0, 1] * v
            y = y0 + m[1, 0] * across + m[1, 1] * v
            if isinstance(relief, HeightMapWall):
                x, y = _on_map(relief, x, y, (out == 0) & (out[start : start + rows, None] == 0))
            found[start : start + rows] = relief.height(x, y)
        found -= found[self.cells // 2, self.cells // 2]
        found *= fall
        found *= fall[:, None]
        return found

    def field(self) -> ComplexArray:
        """Return the complex field (size, size) at the pupil points, 1 for a smooth wall."""
        fits_memory(
            f"a phase screen of {self.size} x {self.size} cells of {self.pitch:.3g} m in the pupil",
            SCREEN_BYTES * float(self.size) ** 2,
            "use a smaller slope_rms, or realisation = 'mean', which needs no screen",
        )
        per_metre = self.view.rayleigh_parameter / self.view.roughness.height_rms
        field = phase_field(self.heights(), per_metre)
        return propagated(field, spreading_matrix(self.view), self.pitch, self.wavelength)

    def draw(self, seed: int | None = None) -> Iterator[ComplexArray]:
        """Yield the field of the wall; there is no other. ``seed`` is not used."""
        yield self.field()


def relief_stride(view: ReliefView, pitch: float, wavelength: float) -> int:
    """Return the spacing of the screen's lattice in pupil cells of a pitch, m.

    The field is interpolated spectrally between the points of a coarser lattice.
    """
    return max(1, math.floor(min(view.widest_pitch(wavelength) / pitch * (1 + 1e-9), 1e6)))


def relief_screen(
    view: ReliefView,
    cells: int,
    pitch: float,
    wavelength: float,
    centre: float,
) -> ReliefScreen:
    """Prepare the phase screen of one wall over ``cells`` lattice points per side.

    ``pitch``, m, is at most `ReliefView.widest_pitch`, and ``centre`` is the lattice coordinate of
    the pupil's axis.
    """
    margin, band = margins(view, pitch, wavelength)
    size = int(ducc0.fft.good_size(cells + 2 * (margin + band)))
    return ReliefScreen(view, size, cells, margin, pitch, wavelength, centre)


def margins(view: ReliefView, pitch: float, wavelength: float) -> tuple[int, int]:
    """Return the lattice points of margin and of the band beyond it, on each side.

    The margin holds all wall points whose light reaches the pupil: those within the throw of the
    steepest slopes, and some Fresnel zones.
    """
    spread = spreading_matrix(view)
    wide = float(np.linalg.norm(spread, 2))
    back = np.linalg.inv(view.footprint)
    # a slope of the wave in the pupil shifts its origin by spread times that slope
    far = wide * STEEPEST * view.turn(wavelength) + 6 * math.sqrt(wavelength * wide)
    band = 6 * view.length * float(np.linalg.norm(back, 2))
    return math.ceil(far / pitch), math.ceil(max(band / pitch, 16))


def _on_map(
    relief: HeightMapWall, x: Array, y: Array, needed: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Return points moved to the edge of a height map; refuse if those needed are outside."""
    half = [side / 2 * (1 - 1e-12) for side in relief.size]
    outside = needed & ((np.abs(x) > half[0]) | (np.abs(y) > half[1]))
    if outside.any():
        i = int(np.argmax(outside))
        raise SceneError(
            f"the height map of {relief.size[0]:.3g} x {relief.size[1]:.3g} m ends before x = "
            f"{x.flat[i]:.3g} m, y = {y.flat[i]:.3g} m, whose light reaches the pupil; give a "
            "larger map, or move the object so that its mirror point is nearer to the centre"
        )
    return np.clip(x, -half[0], half[0]), np.clip(y, -half[1], half[1])
