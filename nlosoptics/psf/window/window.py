"""Windows of the image plane: coordinates, default sizes, and checks that they hold the image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..._checks import expect, in_range, is_single, shown, whole
from ..._vectors import Array
from ...errors import SamplingError, SceneError
from ..aperture.aperture import Aperture
from ..wave.detilted import Residual, split
from ..wave.wavefront import Wavefront
from . import rim_tails

#: Fraction of the ray energy that may fall outside a window.
LOST_RAYS = 0.01
#: Largest side of a window that can be requested, samples.
MOST_SIDE = 2**31 - 1
#: Widest default window, samples per side.
WIDEST_DEFAULT = 4096


@dataclass(frozen=True)
class Window:
    """Grid of evenly spaced points on a rectangle of the image plane.

    Parameters
    ----------
    pitch : float
        Distance between neighbouring points along x and y, m.
    shape : (int, int)
        Number of points (ny, nx).
    first : (float, float)
        Coordinates (x, y) of point [0, 0], m.
    """

    pitch: float
    shape: tuple[int, int]
    first: tuple[float, float]

    @classmethod
    def centred(cls, pitch: float, shape: tuple[int, int]) -> Window:
        """Return a window with point [ny//2, nx//2] at x = y = 0, on the optical axis.

        Parameters
        ----------
        pitch : float
            Distance between neighbouring points, m.
        shape : (int, int)
            Number of points (ny, nx).
        """
        ny, nx = shape
        return cls(pitch, shape, (-(nx // 2) * pitch, -(ny // 2) * pitch))

    @property
    def x(self) -> Array:
        """Coordinates x of the columns, (nx,), m."""
        return self.first[0] + np.arange(self.shape[1], dtype=np.float64) * self.pitch

    @property
    def y(self) -> Array:
        """Coordinates y of the rows, (ny,), m."""
        return self.first[1] + np.arange(self.shape[0], dtype=np.float64) * self.pitch

    def reach_from(self, point: tuple[float, float]) -> tuple[float, float]:
        """Return the largest distances along x and y from a point (x, y) to window points, m."""
        far = []
        for first, n, centre in zip(self.first, self.shape[::-1], point, strict=True):
            far.append(max(abs(first - centre), abs(first + (n - 1) * self.pitch - centre)))
        return far[0], far[1]


def shape_of(shape: int | tuple[int, int]) -> tuple[int, int]:
    """Check a window's shape and return it as (ny, nx); one number means a square."""
    if isinstance(shape, int) or is_single(shape):
        return (whole("shape", shape, 1, MOST_SIDE),) * 2
    if isinstance(shape, str) or not hasattr(shape, "__len__") or len(shape) != 2:
        raise SceneError(f"shape = {shown(shape)}; give one whole number or (ny, nx)")
    ny, nx = (whole("shape", n, 1, MOST_SIDE) for n in shape)
    return ny, nx


def middle(shape: tuple[int, ...], inner: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the slices that cut a window out of a larger one with the same centre."""
    rows, columns = (
        slice(n // 2 - m // 2, n // 2 - m // 2 + m) for n, m in zip(shape, inner, strict=True)
    )
    return rows, columns


def default_shape(residual: Residual, pitch: float) -> tuple[int, int]:
    """Return the shape of a square window that holds the rays and a margin for diffraction.

    The margin is 16 lambda N. The window has at least 256 samples per side; ``pitch`` is in m.

    Raises
    ------
    SamplingError
        If it would need more than 4096 samples per side.
    """
    half = ray_reach(residual) + 16 * residual.airy_unit
    n = max(256, 2 * math.ceil(half / pitch))
    if n > WIDEST_DEFAULT:
        raise SamplingError(
            f"the spot reaches {half:.3g} m from the axis, which takes {n} samples of {pitch:.3g} "
            f"m across, limit {WIDEST_DEFAULT}; give a wider pitch with pixel_integrated=True, or "
            "a shape"
        )
    return n, n


def check_rays(residual: Residual, pitch: float, shape: tuple[int, int], remedy: str = "") -> None:
    """Raise `SamplingError` if more than 1 % of the ray energy falls outside a window.

    ``remedy`` is added to the message.
    """
    lost = _lost_rays(residual, pitch, shape)
    if lost <= LOST_RAYS:
        return
    ny, nx = shape
    x, y = residual.rays.x + residual.shift[0], residual.rays.y + residual.shift[1]
    need = 2 * math.ceil(max(np.abs(x).max(), np.abs(y).max()) / pitch) + 1
    raise SamplingError(
        f"the geometric spot reaches x = {_widest(x):.3g} m, y = {_widest(y):.3g} m and a "
        f"window of {ny} x {nx} samples of {pitch:.3g} m loses {100 * lost:.3g} % of the ray "
        f"energy, limit {100 * LOST_RAYS:g} %; use shape = ({need}, {need}) or more{remedy}"
    )


def holds_rays(residual: Residual, pitch: float, shape: tuple[int, int]) -> bool:
    """Return whether at most 1 % of the ray energy falls outside a window."""
    return _lost_rays(residual, pitch, shape) <= LOST_RAYS


def _lost_rays(residual: Residual, pitch: float, shape: tuple[int, int]) -> float:
    """Return the fraction of the ray energy outside a window."""
    rays, (shift_x, shift_y) = residual.rays, residual.shift
    ny, nx = shape
    # One Airy unit of slack: rays within it do not differ from a diffraction-limited point.
    slack = max(pitch / 2, residual.airy_unit)
    half_x, half_y = (nx // 2) * pitch + slack, (ny // 2) * pitch + slack
    if abs(shift_x) + rays.reach <= half_x and abs(shift_y) + rays.reach <= half_y:
        return 0.0
    x, y = rays.x + shift_x, rays.y + shift_y
    inside = (np.abs(x) <= half_x) & (np.abs(y) <= half_y)
    return float(rays.energy[~inside].sum())


def window_shape(wavefront: Wavefront, *, pitch: float, tol: float = 1e-3) -> int:
    """Return the number of pixels per side of an image that contains the whole point spread.

    Outside it, the energy in each pixel is below ``tol`` times that of the brightest pixel.

    Parameters
    ----------
    wavefront : Wavefront
        Wave in the exit pupil, with any ``layout`` (arrangement of the sample points, see
        `Wavefront`).
    pitch : float
        Pixel side, m.
    tol : float
        Largest energy of a pixel outside, divided by that of the brightest pixel; above 0, at most
        1.

    Returns
    -------
    int
        Odd number of pixels per side of a square centred on x = y = 0, where the optical axis meets
        the image plane. If a tilt shifts the spot, the square is large enough to contain it.

    Raises
    ------
    SceneError
        If ``pitch`` or ``tol`` is out of range.

    See Also
    --------
    point_spread : Takes this number as ``shape``.

    Notes
    -----
    The square contains all points at which rays arrive. Around them, diffraction at the rim of the
    pupil causes a faint tail. At the distance r from the outermost ray, the tail of a round pupil
    has at most the fraction ``2 lambda N/(pi^3 r^3)`` of the total energy per area, with the
    wavelength lambda and the F-number N. Straight edges of an aperture cause spikes, which the
    square contains as well.

    Examples
    --------
    Pixels per side that hold the image of an F/2 beam on pixels of 9 micrometres:

    >>> from nlosoptics import psf
    >>> wave = psf.Wavefront.from_zernike(
    ...     {4: 50e-9}, wavelength=632.8e-9, pupil_radius=0.0125, image_distance=0.05
    ... )
    >>> psf.window_shape(wave, pitch=9e-6, tol=1e-3)
    5
    """
    wavefront = expect("wavefront", wavefront, "Wavefront")
    in_range("pitch", pitch, 1e-100, 1e100, unit="m")
    in_range("tol", tol, 0.0, 1.0, open_low=True)
    return window_side(split(wavefront), pitch, tol)


def window_side(
    residual: Residual, pitch: float, tol: float, outline: Aperture | None = None
) -> int:
    """Return the side of the square window that holds a wave's image, as in `window_shape`.

    Parameters
    ----------
    residual : Residual
        Wave without piston and tilt. The window also covers the image shift by that tilt.
    pitch, tol : float
        Pixel side, m, and the largest value outside the window relative to the brightest pixel.
    outline : Aperture, optional
        Outline of the pupil if the wave has none.

    Returns
    -------
    int
        Pixels, odd.
    """
    peak = peak_pixel(residual, pitch)
    # The tail's energy per pixel at a distance r from the last ray, solved for r.
    tail = (2 * residual.airy_unit * pitch**2 / (math.pi**3 * tol * peak)) ** (1 / 3)
    wave = residual.wavefront
    outline = outline or wave.aperture
    if outline is not None:
        scale = wave.wavelength * abs(wave.image_distance)
        tail *= rim_tails.edge_ratio(wave, outline) ** (1 / 3)
        tail = max(tail, rim_tails.reach(outline, scale, pitch, tol * peak))
    half = ray_reach(residual) + tail
    return int(2 * math.ceil(max(half / pitch - 0.5, 0.0)) + 1)


def peak_pixel(residual: Residual, pitch: float) -> float:
    """Estimate the energy fraction in the brightest pixel from the rays and the Airy disc."""
    rays, unit = residual.rays, residual.airy_unit
    # Bins are not finer than the Airy disc, which blurs the rays.
    side = max(pitch, 2 * unit)
    # Several rays per bin: otherwise a single ray would count as a peak.
    rays = residual.dense_rays(math.ceil(4 * rays.reach / side))
    ratio = pitch / unit
    # A product, since a power of a huge ratio would raise OverflowError.
    airy = min(1.0, math.pi / 4 * (ratio * ratio))
    if residual.wavefront.aperture is not None:
        airy = min(1.0, residual.pixel_share(pitch))
    return float(min(rays.densest(side) * min(1.0, (pitch / side) ** 2), airy))


def ray_reach(residual: Residual) -> float:
    """Half the side of the square about the axis that contains every ray, m."""
    shift = residual.shift
    return residual.rays.reach + max(abs(shift[0]), abs(shift[1]))


def _widest(values: Array) -> float:
    """Return the value with the largest magnitude."""
    return float(values.flat[int(np.argmax(np.abs(values)))])
