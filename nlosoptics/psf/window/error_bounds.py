"""Upper bounds of the errors of computed point spreads, relative to their peak."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..._vectors import Array
from ..wave.detilted import Residual
from . import antialiased_disc, rim_tails
from .grids import PupilGrid

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
    """Return an upper bound of the error of an intensity, from the error of the complex field.

    Parameters
    ----------
    intensity : ndarray
        Intensity of any shape, relative to the peak without aberration; means over pixels if
        ``pixel`` is above 0.
    field_error : ndarray or float
        Largest modulus of the field's error, relative to the peak of the field without aberration.
        Its shape broadcasts to that of the intensity.
    energy_error : float
        Largest energy of this error, as a fraction of the total energy; infinite if not known.
    spill : ndarray or float
        Largest modulus of a second error of the field, whose energy is not known.
    pixel : float
        Pixel side in Airy units (lambda N); 0 for point samples.
    level : float
        Fraction of the total energy in a pixel of mean intensity 1.

    Returns
    -------
    float
        Largest error of the intensity divided by the largest intensity.
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
    """Return the factor, 0 to 1, by which averaging over a pixel reduces an intensity error.

    The intensity error is mainly the interference of the field with its error. This interference
    oscillates over about lambda N, so that its mean over a wide pixel is small.

    Parameters
    ----------
    pixel : float
        Pixel side in Airy units (lambda N); 0 for point samples, with the factor 1.

    Notes
    -----
    The factor was measured for defocus, whose image oscillates most regularly. For other
    aberrations the error is well below the bound.
    """
    return min(1.0, 0.8 / pixel) if pixel > 0 else 1.0


def transform_error(intensity: Array, epsilon: float, *, pixel: float) -> float:
    """Return an upper bound of the error that a non-uniform FFT adds to an intensity.

    Parameters
    ----------
    intensity : ndarray
        Intensity of any shape.
    epsilon : float
        Requested accuracy of the non-uniform FFT. Its error is noise of at most ``epsilon`` times
        the rms of the field.
    pixel : float
        Pixel side in Airy units (lambda N), over which the noise is averaged; 0 for point samples.

    Returns
    -------
    float
        Largest error of the intensity divided by the largest intensity.

    Notes
    -----
    Measured errors are at most a fifth of this bound, for aberrations of 0.3 to 30 wavelengths and
    ``epsilon`` from 1e-5 to 1e-10.
    """
    spread = math.sqrt(float(np.mean(intensity)) / float(np.max(intensity)))
    return 2 * epsilon * spread * min(1.0, 1 / pixel if pixel > 0 else 1.0)


@dataclass(frozen=True, eq=False)
class EdgeErrors:
    """Errors of an image because a square grid does not follow the pupil's rim exactly.

    Attributes
    ----------
    field : ndarray or float
        Largest modulus of the field's error, relative to the field's peak without aberration.
    energy : float
        Largest energy of this error, as a fraction of the total energy; infinite if not known.
    spill : ndarray or float
        Largest modulus of a second error of the field, whose energy is not known.
    """

    field: Array | float
    energy: float
    spill: Array | float = 0.0


def edge_errors(
    residual: Residual, grid: PupilGrid, x: Array, y: Array, half: float = 0.0
) -> EdgeErrors:
    """Return upper bounds of the errors that sampling the pupil's rim on a grid causes.

    Parameters
    ----------
    residual : Residual
        Wave without piston and tilt.
    grid : PupilGrid
        Pupil function of this wave on a square grid.
    x, y : ndarray, (nx,) and (ny,)
        Image coordinates of samples or pixel centres, m.
    half : float
        Half the pixel side, m; 0 for point samples.

    Returns
    -------
    EdgeErrors
        Errors (ny, nx) of the field, or one number for all image points.

    Notes
    -----
    The rim diffracts light to a distance s from the points at which its rays arrive; the amplitude
    falls as the tail of the Airy pattern. The image of a sampled pupil repeats with a period P. The
    error depends on ``grid.rim``:

    - "cut": squares that the rim crosses are weighted by their area inside. This multiplies the
      light from the rim by sinc(s/P), with 1 - sinc(s/P) <= 1.65 (s/P)^2. The tails of the
      neighbouring repeats are multiplied in the same way and add to the error. In a pixel that is
      wider than its distance from a repeat, their mean energy is smaller by that ratio.
    - "soft": the rim is blurred over a few squares. The error is twice `antialiased_disc.leak`,
      plus a term for the aberration outside the rim, which is continued without its curvature.
    - "map": no error, since the samples define the pupil.

    The edges of an `Aperture` diffract as `rim_tails.tail`; all repeats together are at most 3.3
    times the nearest. A grid square shared by two cells of the aperture has the wave of one cell
    only, which adds to the error.
    """
    wave, unit = residual.wavefront, residual.airy_unit
    if grid.rim == "map":
        return EdgeErrors(0.0, 0.0)
    shift = residual.shift
    dx, dy = np.abs(x - shift[0]), np.abs(y - shift[1])[:, None]
    if grid.rim == "soft":
        soft = soft_rim_error(residual, grid.pitch, np.hypot(dy, dx))
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


def soft_rim_error(residual: Residual, pitch: float, distance: Array | float) -> Array:
    """Return an upper bound of the field error of a pupil with a blurred rim on a grid.

    Parameters
    ----------
    residual : Residual
        Wave without piston and tilt.
    pitch : float
        Spacing of the pupil grid, m.
    distance : ndarray or float
        Distance of the image point from the spot's centre, m.

    Returns
    -------
    ndarray
        Largest modulus of the error, relative to the field's peak without aberration. The terms are
        explained in `edge_errors`.
    """
    wave = residual.wavefront
    unit, reach = residual.airy_unit, residual.rays.reach
    period = wave.wavelength * abs(wave.image_distance) / pitch
    n = 2 * wave.pupil_radius / pitch
    far = np.asarray(distance) + reach
    field = 3 * antialiased_disc.leak(far / period) * tail(far / unit)
    focus = 2 * antialiased_disc.leak(np.asarray(reach / period)) / max(math.pi * reach / unit, 1.0)
    degree = max(residual.series.degrees(1e-3 * float(np.abs(residual.aberration).max())))
    steep = 2 * math.pi * residual.rays.slope * pitch / wave.wavelength
    edge = CONTINUATION * steep * degree * (2 / n) ** 2
    edges = 1 / (1 - wave.obscuration)  # length of both rims over area, 1 for a disc
    return np.asarray(edges * (field + focus + edge))


def damping_error(residual: Residual, grid: PupilGrid, pixel: float) -> float:
    """Return the fraction of a pixel's energy that is lost by weighting the squares on the rim.

    The pixel, of side ``pixel``, m, contains the whole spot. The result is 0 unless the grid's
    ``rim`` is "cut". The factor sinc(s/P) of `edge_errors` reduces the energy: the loss is the
    integral of ``3.3 (s/P)^2`` times the Airy tail over the pixel, divided by the pixel's energy.
    """
    if grid.rim != "cut":
        return 0.0
    edges = rim_tails.edge_ratio(residual.wavefront)
    return 1.34 * residual.airy_unit * pixel / _period(residual, grid) ** 2 * edges


def _period(residual: Residual, grid: PupilGrid) -> float:
    """Return the distance after which the image of a sampled pupil repeats, m."""
    wave = residual.wavefront
    return wave.wavelength * abs(wave.image_distance) / grid.pitch


def tail(r: Array) -> Array:
    """Return an upper bound of the Airy field, 1 at its centre, at a distance of ``r`` lambda N."""
    v = np.maximum(math.pi * r, 1.0)
    return np.asarray(np.minimum(1.0, np.sqrt(8 / (math.pi * v**3))))


def rounded_up(value: float) -> str:
    """Return a value rounded up to two digits, so that a limit named in an error suffices."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / step) * step:.2g}"
