"""Metrics of a wave and of its point spread function: Strehl ratio, MTF, widths, energies."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import ducc0
import numpy as np
import scipy  # loads its parts on first use
from numpy.typing import ArrayLike

from ..._checks import counted, expect, fits_memory, numbers, one_of, real, shown, whole
from ..._vectors import Array, ComplexArray
from ...errors import SamplingError, SceneError
from ..aperture.quadrature_nodes import circle_shares, gauss_legendre
from ..transform import nufft, quadrature
from ..transform.point_spread import PointSpread
from ..wave.detilted import Residual, split
from ..wave.fits import fitted_terms
from ..wave.wavefront import Wavefront
from ..wave.zernikes import ORDERINGS, Ordering, zernike_basis
from ..window.window import Window
from .pupil_overlap import transfer


def strehl(wavefront: Wavefront, *, remove: Iterable[str] = ("piston",)) -> float:
    """Compute the Strehl ratio of a wave: intensity on the axis, relative to a perfect wave's.

    Parameters
    ----------
    wavefront : Wavefront
        Wave in the exit pupil, of any ``layout``.
    remove : iterable of {"piston", "tilt", "defocus"}
        Terms that are removed from the aberration first, by a least-squares fit weighted by the
        amplitude. Add "tilt" for the Strehl ratio at the centre of a shifted spot, and "defocus"
        (u^2 + v^2) for that in best focus.

    Returns
    -------
    float
        Ratio, 0 to 1: ``|sum A w exp(ikW)|^2 / (sum A w)^2`` over the sample points of the pupil,
        with amplitude A, aberration W, area w, and k = 2 pi/wavelength.

    Raises
    ------
    SceneError
        If a term of ``remove`` is unknown.

    See Also
    --------
    rms_aberration : Root mean square aberration over the pupil.

    Notes
    -----
    The sum is taken at x = y = 0, where the axis meets the image plane. For the layouts "polar" and
    "cells" the wave is interpolated to as many points as the sum needs to converge.

    Examples
    --------
    A tenth of a wave rms of defocus:

    >>> from nlosoptics import psf
    >>> wave = psf.Wavefront.from_zernike(
    ...     {4: 50e-9}, wavelength=500e-9, pupil_radius=5e-3, image_distance=0.1
    ... )
    >>> focused = psf.strehl(wave, remove=("defocus",))
    >>> print(f"{psf.strehl(wave):.4f}, {focused:.4f}")
    0.6626, 1.0000
    """
    wavefront = expect("wavefront", wavefront, "Wavefront")
    return intensity_at(split(_without(wavefront, remove)), (0.0, 0.0))


def intensity_at(residual: Residual, place: tuple[float, float]) -> float:
    """Return the intensity at an image point (x, y), m, relative to the peak of a perfect wave."""
    point, nodes = Window(residual.airy_unit, (1, 1), place), nufft.own_nodes(residual)
    if residual.has_series:
        nodes = quadrature.nodes(residual, point, quadrature.node_counts(residual, point))
    return float(np.abs(nufft.field(residual, nodes, point)[0, 0]) ** 2)


def rms_aberration(wavefront: Wavefront, *, remove: Iterable[str] = ("piston", "tilt")) -> float:
    """Compute the root mean square (rms) aberration of a wave over the pupil.

    Parameters
    ----------
    wavefront : Wavefront
        Wave in the exit pupil, of any ``layout``. The mean is weighted by the amplitude.
    remove : iterable of {"piston", "tilt", "defocus"}
        Terms that are removed from the aberration first, by a least-squares fit. If any term is
        removed, so is the piston. If empty, nothing is removed.

    Returns
    -------
    float
        Root mean square aberration, m.

    Raises
    ------
    SceneError
        If a term of ``remove`` is unknown.

    See Also
    --------
    fit_zernike : Zernike coefficients of a wave.

    Examples
    --------
    A Noll coefficient is the rms of its term:

    >>> from nlosoptics import psf
    >>> wave = psf.Wavefront.from_zernike(
    ...     {4: 50e-9}, wavelength=500e-9, pupil_radius=5e-3, image_distance=0.1
    ... )
    >>> print(f"{1e9 * psf.rms_aberration(wave):.1f} nm")
    50.0 nm
    """
    wavefront = expect("wavefront", wavefront, "Wavefront")
    rest = _without(wavefront, remove)
    weights = rest.amplitude * rest.weights
    return math.sqrt(float(np.sum(weights * rest.aberration**2) / np.sum(weights)))


def fit_zernike(
    wavefront: Wavefront, n_terms: int = 15, *, ordering: Ordering = "noll"
) -> dict[int, float]:
    """Fit Zernike polynomials to the aberration of a wave.

    The fit is by least squares, weighted by the amplitude.

    Parameters
    ----------
    wavefront : Wavefront
        Wave in the exit pupil, of any ``layout``. A pupil with a hole is fitted with the
        polynomials of the full disc.
    n_terms : int, default 15
        Number of polynomials: the first ``n_terms`` of the index scheme.
    ordering : {"noll", "osa", "fringe"}
        Index scheme and normalisation of the polynomials, see `zernike`.

    Returns
    -------
    dict of int to float
        Zernike index to coefficient, m, positive for a longer path. `Wavefront.from_zernike` takes
        them, with the same ``ordering``.

    Raises
    ------
    SamplingError
        If the sample points of the wave do not determine all coefficients.

    See Also
    --------
    zernike : Zernike polynomial.
    """
    wavefront = expect("wavefront", wavefront, "Wavefront")
    one_of("ordering", ordering, ORDERINGS)
    whole("n_terms", n_terms)
    weights = np.sqrt(wavefront.amplitude * wavefront.weights)
    lit = weights > 0
    if np.count_nonzero(lit) < n_terms:
        raise SamplingError(
            f"{counted(int(np.count_nonzero(lit)), 'lit node')} cannot determine "
            f"{counted(n_terms, 'Zernike term')}; use fewer terms"
        )
    n_bytes = 24.0 * n_terms * np.count_nonzero(lit)
    fits_memory(f"a fit of {counted(n_terms, 'Zernike term')}", n_bytes, "use fewer terms or nodes")
    u, v = wavefront.u[lit] / wavefront.pupil_radius, wavefront.v[lit] / wavefront.pupil_radius
    first = 0 if ordering == "osa" else 1
    indices = range(first, first + n_terms)
    basis = zernike_basis(indices, np.hypot(u, v), np.arctan2(v, u), ordering=ordering)
    fit, _, rank, _ = np.linalg.lstsq(
        (basis * weights[lit]).T, wavefront.aberration[lit] * weights[lit], rcond=None
    )
    if rank < n_terms:
        raise SamplingError(
            f"the nodes determine only {rank} of {n_terms} Zernike terms; use fewer terms or more "
            "nodes"
        )
    return {index: float(value) for index, value in zip(indices, fit, strict=True)}


def encircled_energy(source: Wavefront | PointSpread, radius: ArrayLike) -> Array:
    """Compute the fraction of the transmitted energy within circles around the optical axis.

    Parameters
    ----------
    source : Wavefront or PointSpread
        Wave in the exit pupil whose ``layout`` is "polar" or "cells" (see `Wavefront`), for which
        the result is accurate to rounding. Or a computed point spread, whose pixels are weighted by
        their area within the circle.
    radius : array_like
        Radii of the circles, m, of any shape. All circles are centred on x = y = 0, where the axis
        meets the image plane.

    Returns
    -------
    ndarray
        Fraction of the energy, 0 to 1, in the shape of ``radius``.

    Raises
    ------
    SceneError
        If a radius is negative or not finite.
    SamplingError
        If the wave's layout is "grid" or "scattered", or a circle extends beyond the window of the
        point spread.

    See Also
    --------
    ensquared_energy : Energy within squares.

    Notes
    -----
    For a wave, one Legendre series of the radial intensity serves all radii: 60 radii cost as much
    as the largest alone, 3 ms to 5 lambda N and 0.9 CPU s to 240 lambda N.

    Examples
    --------
    Energy within the first dark ring of the Airy pattern, at 1.22 lambda N:

    >>> from nlosoptics import psf
    >>> wave = psf.Wavefront.from_zernike(
    ...     {}, wavelength=500e-9, pupil_radius=5e-3, image_distance=0.1
    ... )
    >>> print(f"{psf.encircled_energy(wave, 6.0983e-6):.4f}")
    0.8378
    """
    source = expect("source", source, "PointSpread", "Wavefront")
    radii = _lengths("radius", radius, "radii")
    if isinstance(source, Wavefront):
        residual = split(source)
        if not residual.has_series:
            raise SamplingError(
                f"a wavefront of layout '{source.layout}' has no series, which encircled energy "
                "needs; give psf.point_spread(wavefront)"
            )
        return _energies_within(residual, radii.ravel()).reshape(radii.shape)
    edge = min(-source.x[0], source.x[-1], -source.y[0], source.y[-1]) + source.pitch / 2
    if radii.size and radii.max() > edge:
        raise SamplingError(
            f"radius = {radii.max():.3g} m passes the window's edge at {edge:.3g} m; use a larger "
            "shape"
        )
    per_energy = source.enclosed_energy / float(np.sum(source.intensity))
    energies = np.zeros(radii.shape)
    for place, r in np.ndenumerate(radii):
        if r > 0:
            inside = circle_shares(source.x, source.y, source.pitch, float(r))
            energies[place] = np.sum(source.intensity * inside)
    return energies * per_energy


def ensquared_energy(point_spread: PointSpread, side: ArrayLike) -> Array:
    """Compute the fraction of the transmitted energy within squares around the optical axis.

    Parameters
    ----------
    point_spread : PointSpread
        Computed point spread, whose pixels are weighted by their area within the square.
    side : array_like
        Sides of the squares, m, of any shape. All squares are centred on x = y = 0, where the axis
        meets the image plane.

    Returns
    -------
    ndarray
        Fraction of the energy, 0 to 1, in the shape of ``side``.

    Raises
    ------
    SceneError
        If a side is negative or not finite.
    SamplingError
        If a square extends beyond the window of the point spread.

    See Also
    --------
    encircled_energy : Energy within circles.
    """
    point_spread = expect("point_spread", point_spread, "PointSpread")
    sides = _lengths("side", side, "sides")
    x, y, pitch = point_spread.x, point_spread.y, point_spread.pitch
    edge = 2 * min(-x[0], x[-1], -y[0], y[-1]) + pitch
    if sides.size and sides.max() > edge * (1 + 1e-12):
        raise SamplingError(
            f"side = {sides.max():.3g} m passes the window, which holds {edge:.3g} m; use a larger "
            "shape"
        )
    per_energy = point_spread.enclosed_energy / float(point_spread.intensity.sum())
    values = []
    for half in (sides.ravel() / 2).tolist():
        on_x, on_y = (np.clip((half - np.abs(v)) / pitch + 0.5, 0.0, 1.0) for v in (x, y))
        # A square narrower than the central pixel covers the fraction 2 half/pitch of its width.
        on_x, on_y = (np.minimum(on, 2 * half / pitch) for on in (on_x, on_y))
        values.append(float(np.einsum("y,yx,x->", on_y, point_spread.intensity, on_x)))
    return np.array(values).reshape(sides.shape) * per_energy


def _lengths(name: str, value: ArrayLike, plural: str) -> Array:
    """Check lengths, m."""
    lengths = numbers(name, value)
    if not np.all(np.isfinite(lengths)) or np.any(lengths < 0):
        raise SceneError(f"{name} = {shown(value)} m; give finite {plural} of at least 0")
    return lengths


def mtf(source: Wavefront | PointSpread, frequency: ArrayLike, *, azimuth: float = 0.0) -> Array:
    """Compute the modulation transfer function (MTF) along one direction in the image.

    Parameters
    ----------
    source : Wavefront or PointSpread
        Wave in the exit pupil whose ``layout`` is "polar" (samples on rings, see `Wavefront`),
        without obscuration. The MTF is the autocorrelation of this wave; its error is below 1e-9 if
        the samples resolve the wave. Or a computed point spread, whose Fourier transform is taken:
        the MTF then includes the blur by its pixels, and neglects energy outside its window.
    frequency : array_like
        Spatial frequencies, cycles per m in the image, of any shape. For a wave on a round pupil
        the MTF is 0 beyond 1/(lambda N), with the wavelength lambda and the F-number N. For a point
        spread, frequencies above 1/(2 pitch) are aliased.
    azimuth : float
        Direction along which the frequencies are counted, rad from x toward y.

    Returns
    -------
    ndarray
        Modulation, 0 to 1, in the shape of ``frequency``; 1 at frequency 0.

    Raises
    ------
    SceneError
        If a frequency or the azimuth is not finite.
    SamplingError
        If the wave has an obscuration or another layout; give ``point_spread(wavefront)`` instead.

    See Also
    --------
    ptf : Phase of the optical transfer function.

    Examples
    --------
    MTF without aberration at half the cutoff frequency 1/(lambda N) = 200 cycles per mm:

    >>> from nlosoptics import psf
    >>> wave = psf.Wavefront.from_zernike(
    ...     {}, wavelength=500e-9, pupil_radius=5e-3, image_distance=0.1
    ... )
    >>> print(f"{psf.mtf(wave, 100e3):.4f}")
    0.3910
    """
    source = expect("source", source, "Wavefront", "PointSpread")
    return np.abs(_transfer(source, frequency, azimuth))


def ptf(source: Wavefront | PointSpread, frequency: ArrayLike, *, azimuth: float = 0.0) -> Array:
    """Compute the phase transfer function (PTF) along one direction in the image.

    It is the phase of the optical transfer function, whose modulus is `mtf`.

    Parameters
    ----------
    source, frequency, azimuth
        As in `mtf`.

    Returns
    -------
    ndarray
        Phase, rad, above -pi and at most pi, in the shape of ``frequency``. A spot at positive x
        has a phase that decreases with the frequency along x.

    Raises
    ------
    SceneError, SamplingError
        As in `mtf`.

    See Also
    --------
    mtf : Modulus of the optical transfer function.
    """
    source = expect("source", source, "Wavefront", "PointSpread")
    return np.asarray(np.angle(_transfer(source, frequency, azimuth)))


def _transfer(
    source: Wavefront | PointSpread, frequency: ArrayLike, azimuth: float
) -> ComplexArray:
    """Return the optical transfer function, 1 at frequency 0, in the shape of ``frequency``."""
    frequencies, azimuth = numbers("frequency", frequency), real("azimuth", azimuth)
    if not np.all(np.isfinite(frequencies)):
        raise SceneError("frequency is NaN or infinite; give finite numbers in 1/m")
    if isinstance(source, PointSpread):
        values = spectrum_along(source, frequencies.ravel(), azimuth) / source.intensity.sum()
    elif (residual := split(source)).is_disc:
        values = np.array([transfer(residual, f, azimuth) for f in frequencies.ravel().tolist()])
    else:
        raise SamplingError(
            "the transfer function of a wave needs polar nodes without obscuration, not layout "
            f"'{source.layout}'; give psf.point_spread(wavefront)"
        )
    return np.asarray(values.reshape(frequencies.shape))


def spectrum_along(point_spread: PointSpread, frequencies: Array, azimuth: float) -> ComplexArray:
    """Return the Fourier sums (n,) of a point spread at frequencies (n,), 1/m.

    The frequencies lie along the direction ``azimuth``, rad from x toward y.
    """
    along_x = 2 * math.pi * math.cos(azimuth) * frequencies[:, None]
    along_y = 2 * math.pi * math.sin(azimuth) * frequencies[:, None]
    half = np.einsum("fx,yx->fy", np.exp(-1j * along_x * point_spread.x), point_spread.intensity)
    return np.asarray(np.einsum("fy,fy->f", np.exp(-1j * along_y * point_spread.y), half))


def fwhm(point_spread: PointSpread) -> tuple[float, float]:
    """Compute the full width at half maximum of a point spread, along x and along y.

    The widths are taken through the brightest sample.

    Parameters
    ----------
    point_spread : PointSpread
        Point spread whose window is wide enough for the intensity to fall below half its peak.

    Returns
    -------
    (float, float)
        Widths along x and y, m.

    Raises
    ------
    SamplingError
        If the intensity stays above half its peak up to the window's edge.

    See Also
    --------
    encircled_energy : Energy within circles.

    Notes
    -----
    Samples are interpolated by polynomials of degree 10. The relative error of the width is 1e-5
    for samples lambda N/4 apart and 1e-9 for lambda N/10, with the wavelength lambda and the
    F-number N.

    Examples
    --------
    The Airy pattern has a width of 1.029 lambda N:

    >>> from nlosoptics import psf
    >>> wave = psf.Wavefront.from_zernike(
    ...     {}, wavelength=500e-9, pupil_radius=5e-3, image_distance=0.1
    ... )
    >>> x, y = psf.fwhm(psf.point_spread(wave, shape=33))
    >>> print(f"{1e6 * x:.2f} um, {1e6 * y:.2f} um")
    5.14 um, 5.14 um
    """
    point_spread = expect("point_spread", point_spread, "PointSpread")
    row, column = np.unravel_index(
        int(np.argmax(point_spread.intensity)), point_spread.intensity.shape
    )
    cuts = (point_spread.intensity[row], point_spread.intensity[:, column])
    x, y = (_width(cut, point_spread.pitch) for cut in cuts)
    return x, y


def _without(wavefront: Wavefront, remove: Iterable[str]) -> Wavefront:
    """Return the wavefront without the least-squares fit of the named terms and a piston."""
    names = (remove,) if isinstance(remove, str) or remove is None else tuple(remove)
    for name in names:
        one_of("remove", name, ("piston", "tilt", "defocus"))
    if not names:
        return wavefront
    scale = wavefront.pupil_radius
    u, v = wavefront.u / scale, wavefront.v / scale
    shapes = {"piston": (np.ones_like(u),), "tilt": (u, v), "defocus": (u**2 + v**2,)}
    basis = np.stack([s for name in dict.fromkeys(("piston", *names)) for s in shapes[name]])
    fit = fitted_terms(wavefront.aberration, wavefront.amplitude * wavefront.weights, basis)
    return replace(wavefront, aberration=wavefront.aberration - np.tensordot(fit, basis, 1))


def _energies_within(residual: Residual, radii: Array) -> Array:
    """Return the fractions of the energy of a wave with a series within radii (n,), m.

    The field is summed on circles, by a non-uniform FFT between the points of pupil and image. The
    energy of each circle, at Gauss-Legendre nodes of the squared radius up to the largest, gives a
    Legendre series, which is integrated.
    """
    wave, radius = residual.wavefront, float(radii.max(initial=0.0))
    if radius == 0.0:
        return np.zeros(radii.shape)
    # A square window with the circle's radius as half its diagonal, to count the nodes.
    half = radius / math.sqrt(2)
    window = Window(2 * half, (2, 2), (-half, -half))
    nodes = quadrature.nodes(residual, window, quadrature.node_counts(residual, window))
    # phase at the rim, and twice the nodes that integrals over the whole disc need, for the series
    v = residual.wavenumber * residual.farthest * radius / abs(wave.image_distance)
    n, n_angle = 2 * math.ceil(0.58 * v + 12), 2 * math.ceil(v + 12 * v ** (1 / 3) + 12)
    fits_memory(
        f"the field on {n} circles of {n_angle} points", 100.0 * n * n_angle, "use a smaller radius"
    )
    share, image_weights = gauss_legendre(n)
    r, angle = radius * np.sqrt(share)[:, None], 2 * math.pi * np.arange(n_angle) / n_angle
    image = np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1).reshape(-1, 2)
    path = nodes.path + residual.tilt[0] * nodes.u + residual.tilt[1] * nodes.v
    field = ducc0.nufft.experimental.nu2nu(
        points_in=(nodes.share * np.exp(1j * residual.wavenumber * path)).ravel(),
        coord_in=np.stack([nodes.u.ravel(), nodes.v.ravel()], axis=1),
        coord_out=image * (residual.wavenumber / wave.image_distance),
        forward=True,
        epsilon=1e-13,
        nthreads=1,
    )
    light = np.mean((field.real**2 + field.imag**2).reshape(n, n_angle), axis=1)
    legendre = np.polynomial.legendre
    degrees = legendre.legvander(2 * share - 1, n - 1)
    series = (2 * np.arange(n) + 1) * ((image_weights * light) @ degrees)
    within = legendre.legval(2 * (radii / radius) ** 2 - 1, legendre.legint(series, lbnd=-1)) / 2
    scale = math.pi * (radius * nodes.total / (wave.wavelength * wave.image_distance)) ** 2
    return np.asarray(within * scale / nodes.energy)


def _width(cut: Array, pitch: float) -> float:
    """Return the distance, m, between the half-maximum crossings around the largest sample."""
    if cut.size < 3:
        raise SamplingError(f"the window has {cut.size} samples, must have 3; use a larger shape")
    top = int(np.argmax(cut))
    # The true peak lies within half a sample of the largest sample. Its height is that of a
    # parabola through fine samples of the interpolant.
    heights = np.array([_interpolated(cut, top + p) for p in np.arange(-24, 25) / 48])
    best = min(max(int(np.argmax(heights)), 1), heights.size - 2)
    left, middle, right = heights[best - 1 : best + 2]
    bend = left - 2 * middle + right
    peak = middle - (left - right) ** 2 / (8 * bend) if bend < 0 else middle
    return pitch * (_crossing(cut, top, 1, peak / 2) + _crossing(cut, top, -1, peak / 2))


def _crossing(cut: Array, top: int, step: int, level: float) -> float:
    """Return the distance, samples, from ``top`` to the crossing of ``level`` on one side."""
    index = top
    while cut[index] >= level:
        index += step
        if not 0 <= index < cut.size:
            raise SamplingError(
                "the intensity stays above half its peak up to the edge of the window of "
                f"{cut.size} samples; use a larger shape"
            )
    low, high = sorted((index, index - step))
    root = scipy.optimize.brentq(lambda at: _interpolated(cut, at) - level, low, high, xtol=1e-14)
    return abs(float(root) - top)


def _interpolated(cut: Array, place: float) -> float:
    """Interpolate at a position, in samples, by a polynomial through the nearest eleven samples."""
    n = min(11, cut.size)
    start = min(max(round(place) - n // 2, 0), cut.size - n)
    near = scipy.interpolate.BarycentricInterpolator(np.arange(n), cut[start : start + n])
    return float(near(place - start))
