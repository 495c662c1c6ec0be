"""Error bounds for the PSF transforms, max |dI|/max I."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..wave.detilted import Residual
from . import antialiased_disc, rim_tails
from .grids import PupilGrid

Array = NDArray[np.float64]

#: Of any of the transforms.
ROUNDING = 1e-13
#: Of the pixel means, see `pixels.BETA`.
FILTER = 4e-11
#: Moment of a softened rim's outer part about the rim, in cells cubed, measured.
CONTINUATION = 0.05


def intensity_error(
    intensity: Array,
    field_error: Array | float,
    energy_error: float,
    *,
    spill: Array | float = 0.0,
    pixel: float,
    level: float,
) -> float:
    """Error of an intensity from that of its field.

    Parameters
    ----------
    intensity : ndarray
        1 at the ideal peak; means over pixels if ``pixel`` is above 0.
    field_error : ndarray or float
        Bound of the field's error, 1 at the ideal peak.
    energy_error : float
        Bound of that erring field's energy, as a share of the whole.
    spill : ndarray or float
        Further error of the field, whose energy has no bound but its own.
    pixel : float
        Pixel side in Airy units, lambda N; 0 for point samples.
    level : float
        Share of the whole energy that a pixel of mean 1 would hold.
    """
    if np.ndim(field_error) == np.ndim(spill) == 0:
        intensity = np.asarray(np.max(intensity))  # the bound below rises with it
    error = np.square(field_error)
    if pixel > 0:
        error = np.minimum(error, energy_error / level)
    error = np.square(np.sqrt(error) + spill)
    difference = 2 * beat(pixel) * np.sqrt(intensity * error) + error
    floor = ROUNDING if pixel == 0 else FILTER
    return float(np.max(difference) / np.max(intensity)) + floor


def beat(pixel: float) -> float:
    """What a pixel, Airy units wide, leaves of a field's beats with its error; 1 for points.

    The cross term beats over about lambda N, and a wide pixel averages the beats. Measured on
    defocus, the aberration with the most regular beats; others stay well below.
    """
    return min(1.0, 0.8 / pixel) if pixel > 0 else 1.0


def transform_error(intensity: Array, epsilon: float, *, pixel: float) -> float:
    """Error of an intensity by a non-uniform transform of relative accuracy ``epsilon``.

    The transform's error is noise of ``epsilon`` times the field's rms, at most; a pixel averages
    it. Measured from 0.3 to 30 waves, epsilon from 1e-5 to 1e-10: a fifth of this or less.
    """
    spread = math.sqrt(float(np.mean(intensity)) / float(np.max(intensity)))
    return 2 * epsilon * spread * min(1.0, 1 / pixel if pixel > 0 else 1.0)


@dataclass(frozen=True, eq=False)
class EdgeErrors:
    """Arguments of `intensity_error` for a pupil's sampled edge."""

    field: Array | float
    energy: float
    spill: Array | float = 0.0


def edge_errors(
    residual: Residual, grid: PupilGrid, x: Array, y: Array, half: float = 0.0
) -> EdgeErrors:
    """Error of a sampled pupil edge on samples or on pixels of half width ``half``, m.

    A rim sends light a distance s from where its rays land, in amplitude as an Airy disc's tail, or
    as a ring's focus in the middle of a symmetric spot.

    - Cells cut by the rim act from their centre, with weights that are the rim convolved with a
      cell. What arrives at s is damped by sinc(s/P), P the period of the image,
      1 - sinc <= 1.65 (s/P)^2, and so are its repeats; of a wide pixel the edge next to a repeat
      has the most, and the rest less by the distance over the width.
    - A softened rim errs by `antialiased_disc.leak` twice, damping and repeat, and by the
      aberration's curvature, which is not continued beyond the rim.
    - A map is taken at its word: its samples are the pupil, and their sum is exact.

    The rims of an aperture send light by `rim_tails.tail`, whose repeats add up to 3.3 of the
    first, and a square of the grid that two of its cells share counts as one's.
    """
    wave, unit = residual.wavefront, residual.airy_unit
    if grid.rim == "map":
        return EdgeErrors(0.0, 0.0)
    shift = residual.shift
    dx, dy = np.abs(x - shift[0]), np.abs(y - shift[1])[:, None]
    if grid.rim == "soft":
        soft = soft_rim_error(residual, grid.pitch, np.hypot(dy, dx), CONTINUATION)
        return EdgeErrors(soft, math.inf)
    period = _period(residual, grid)
    n = 2 * wave.pupil_radius / grid.pitch
    edges = rim_tails.edge_ratio(wave)
    steep = 2 * math.pi * grid.jump
    dx, dy = dx + half, dy + half
    distance = np.hypot(dy, dx)
    scale = wave.wavelength * abs(wave.image_distance)
    outline = wave.aperture

    def sent(a: Array, b: Array) -> Array:
        """Field that the rims send a distance (a, b)."""
        if outline is None:
            return tail(np.hypot(a, b) / unit)
        return rim_tails.tail(outline, a / scale, b / scale)

    def repeat(a: Array, b: Array) -> Array:
        share = np.sqrt(np.minimum(1.0, np.hypot(a, b) / (2 * half))) if half > 0 else 1.0
        return sent(a, b) * share

    spill = np.minimum(1.65 * (distance / period) ** 2, 2.0) * sent(dx, dy)
    repeats = repeat(np.maximum(period - dx, 0.0), dy - half) * np.abs(np.sinc(1 - dx / period))
    repeats += repeat(dx - half, np.maximum(period - dy, 0.0)) * np.abs(np.sinc(1 - dy / period))
    if outline is not None:
        shared = edges * steep / (2 * n) + residual.mixed_area
        return EdgeErrors(shared, math.inf, spill + 3.3 * repeats)
    cut = edges * steep / (2 * n)
    return EdgeErrors(cut, edges * 0.02 * steep**2 / n, edges * (spill + repeats))


def soft_rim_error(
    residual: Residual, pitch: float | Array, distance: Array | float, continuation: float
) -> Array:
    """Field error of a softened rim at distances from the tilt's point, see `edge_errors`.

    ``continuation`` is 0 for a wave that goes on smoothly beyond the rim.
    """
    wave = residual.wavefront
    unit, reach = residual.airy_unit, residual.rays.reach
    period = wave.wavelength * abs(wave.image_distance) / pitch
    n = 2 * wave.pupil_radius / pitch
    far = np.asarray(distance) + reach
    field = 3 * antialiased_disc.leak(far / period) * tail(far / unit)
    focus = 2 * antialiased_disc.leak(np.asarray(reach / period)) / max(math.pi * reach / unit, 1.0)
    edge: float | Array = 0.0
    if continuation > 0:
        degree = max(residual.degrees(1e-3 * float(np.abs(residual.aberration).max())))
        steep = 2 * math.pi * residual.rays.slope * pitch / wave.wavelength
        edge = continuation * steep * degree * (2 / n) ** 2
    edges = 1 / (1 - wave.obscuration)  # length of both rims over area
    return np.asarray(edges * (field + focus + edge))


def damping_error(residual: Residual, grid: PupilGrid, pixel: float) -> float:
    """Relative loss of a pixel of side ``pixel``, m, that holds the spot, for the sinc above.

    The mean of ``3.3 (s/P)^2`` times the Airy tail over the pixel, over the pixel's energy.
    """
    if grid.rim != "cut":
        return 0.0
    edges = rim_tails.edge_ratio(residual.wavefront)
    return 1.34 * residual.airy_unit * pixel / _period(residual, grid) ** 2 * edges


def _period(residual: Residual, grid: PupilGrid) -> float:
    """Distance at which a sampled pupil repeats its image, m."""
    wave = residual.wavefront
    return wave.wavelength * abs(wave.image_distance) / grid.pitch


def tail(r: Array) -> Array:
    """Upper envelope of the Airy field at ``r`` Airy units."""
    v = np.maximum(math.pi * r, 1.0)
    return np.asarray(np.minimum(1.0, np.sqrt(8 / (math.pi * v**3))))


def rounded_up(value: float) -> str:
    """Two digits, not below the value: what a refusal asks for must do."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / step) * step:.2g}"
