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

#: Rounding error of any of the transforms, relative to max I.
ROUNDING = 1e-13
#: Error of the pixel means, relative to max I, see `pixels.BETA`.
FILTER = 4e-11
#: Measured moment about the rim of the part of a softened rim outside it, cells cubed.
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
    """Bound the error of an intensity, max |dI|/max I, from that of its field.

    Parameters
    ----------
    intensity : ndarray
        Intensity, 1 at the ideal peak, of any shape; means over pixels if ``pixel`` is above 0.
    field_error : ndarray or float
        Bound on the field's error, relative to the ideal peak; broadcasts to the intensity.
    energy_error : float
        Bound on the energy of this error, as a fraction of the total energy.
    spill : ndarray or float
        Bound on a further error of the field, for which there is no bound on the energy.
    pixel : float
        Pixel side in Airy units, lambda N; 0 for point samples.
    level : float
        Fraction of the total energy in a pixel of mean intensity 1.
    """
    if np.ndim(field_error) == np.ndim(spill) == 0:
        intensity = np.asarray(np.max(intensity))  # the bound below increases with intensity
    error = np.square(field_error)
    if pixel > 0:
        error = np.minimum(error, energy_error / level)
    error = np.square(np.sqrt(error) + spill)
    difference = 2 * beat(pixel) * np.sqrt(intensity * error) + error
    floor = ROUNDING if pixel == 0 else FILTER
    return float(np.max(difference) / np.max(intensity)) + floor


def beat(pixel: float) -> float:
    """Return the factor by which averaging over a pixel reduces interference of field and error.

    The cross term of both oscillates over about lambda N, so that a wide pixel averages it.
    ``pixel`` is the side in Airy units; the factor is 1 for 0. It was measured on defocus, which
    oscillates most regularly; other aberrations stay well below.
    """
    return min(1.0, 0.8 / pixel) if pixel > 0 else 1.0


def transform_error(intensity: Array, epsilon: float, *, pixel: float) -> float:
    """Bound the error of an intensity from a non-uniform transform of accuracy ``epsilon``.

    The transform's error is noise of at most ``epsilon`` times the field's rms; a pixel (side in
    Airy units) averages it. Measured errors, for 0.3 to 30 waves and epsilon from 1e-5 to 1e-10,
    are a fifth of this bound or less.
    """
    spread = math.sqrt(float(np.mean(intensity)) / float(np.max(intensity)))
    return 2 * epsilon * spread * min(1.0, 1 / pixel if pixel > 0 else 1.0)


@dataclass(frozen=True, eq=False)
class EdgeErrors:
    """Errors caused by a pupil's sampled edge, as arguments of `intensity_error`.

    Attributes
    ----------
    field, energy, spill
        The arguments ``field_error``, ``energy_error`` and ``spill``.
    """

    field: Array | float
    energy: float
    spill: Array | float = 0.0


def edge_errors(
    residual: Residual, grid: PupilGrid, x: Array, y: Array, half: float = 0.0
) -> EdgeErrors:
    """Bound the errors of a sampled pupil edge at image points (x, y) or pixels about them.

    Parameters
    ----------
    residual : Residual
        Wave without piston and tilt.
    grid : PupilGrid
        Its samples.
    x, y : ndarray, (nx,) and (ny,)
        Image coordinates, m.
    half : float
        Half the pixel side, m; 0 for point samples.

    Notes
    -----
    A rim diffracts to a distance s from its rays' landing points, with the amplitude of an Airy
    tail; in the middle of a symmetric spot it acts as a focused ring. The error depends on ``rim``:

    - "cut": each rim cell acts from its centre with its area as weight, so that the rim is
      convolved with a cell. The field at s is damped by sinc(s/P), P the image period, with
      1 - sinc <= 1.65 (s/P)^2. Its repeats are damped alike. In a wide pixel their energy lies
      near the edge next to the repeat; the mean is less by its distance over the width.
    - "soft": the error is twice `antialiased_disc.leak`, for damping and repeat, plus that of the
      aberration's curvature, which is not continued outside the rim.
    - "map": no error, since the samples are the pupil by definition and their sum is exact.

    The rims of an aperture diffract as `rim_tails.tail`; all repeats add up to 3.3 times the first.
    A grid square that two of its cells share holds the wave of one of them.
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
        """Return the field diffracted by the rims to the distances (a, b), m."""
        if outline is None:
            return tail(np.hypot(a, b) / unit)
        return rim_tails.tail(outline, a / scale, b / scale)

    def repeat(a: Array, b: Array) -> Array:
        """Return the field of a periodic repeat at distances (a, b), m.

        It is averaged over a wide pixel.
        """
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
    """Bound the field error of a softened rim at distances, m, from the tilt's image point.

    ``pitch`` is that of the pupil grid, m. ``continuation`` is `CONTINUATION`, or 0 for a wave that
    continues smoothly outside the rim. The terms are explained in `edge_errors`.
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
    edges = 1 / (1 - wave.obscuration)  # length of both rims over area, 1 for a disc
    return np.asarray(edges * (field + focus + edge))


def damping_error(residual: Residual, grid: PupilGrid, pixel: float) -> float:
    """Relative energy lost by a pixel of side ``pixel``, m, that holds the spot, for rim "cut".

    The sinc damping of `edge_errors` causes it. It is the mean of ``3.3 (s/P)^2`` times the Airy
    tail over the pixel, divided by the pixel's energy.
    """
    if grid.rim != "cut":
        return 0.0
    edges = rim_tails.edge_ratio(residual.wavefront)
    return 1.34 * residual.airy_unit * pixel / _period(residual, grid) ** 2 * edges


def _period(residual: Residual, grid: PupilGrid) -> float:
    """Distance after which the image of a sampled pupil repeats, m."""
    wave = residual.wavefront
    return wave.wavelength * abs(wave.image_distance) / grid.pitch


def tail(r: Array) -> Array:
    """Upper envelope of the Airy field at a distance of ``r`` Airy units, 1 at the peak."""
    v = np.maximum(math.pi * r, 1.0)
    return np.asarray(np.minimum(1.0, np.sqrt(8 / (math.pi * v**3))))


def rounded_up(value: float) -> str:
    """Return a value rounded up to two digits, so that a limit named in an error suffices."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / step) * step:.2g}"
