"""Figures of merit of a wave and of its point spread."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy  # loads scipy.special on first use, a tenth of a second
from numpy.typing import ArrayLike, NDArray

from ..._checks import fits_memory, one_of, whole
from ..._nouns import Noun
from ...errors import SamplingError, SceneError
from ..aperture.quadrature_nodes import circle_shares, gauss_legendre
from ..transform import quadrature
from ..transform.point_spread import PointSpread
from ..wave.detilted import Residual, split
from ..wave.fits import fitted_terms
from ..wave.wavefront import Wavefront
from ..wave.zernikes import ORDERINGS, Ordering, zernike_basis
from ..window.window import Window

Array = NDArray[np.float64]
ALIKE = ("shape", "pitch", "normalisation", "wavelength", "f_number", "pixel_integrated")


@dataclass(frozen=True, eq=False, kw_only=True)
class MetricEstimate(Noun):
    """A metric of a mean point spread, known from so many patterns.

    Parameters
    ----------
    value : ndarray
        The metric of the mean of all patterns.
    standard_error : ndarray
        Of the value's shape: the standard deviation of the value over other such draws.
    n_patterns : int
    """

    value: Array
    standard_error: Array
    n_patterns: int


def metric_estimate(
    metric: Callable[[PointSpread], Any], patterns: Iterable[PointSpread]
) -> MetricEstimate:
    """Metric of the mean of independent patterns, with its standard error by the jackknife.

    Parameters
    ----------
    metric : callable
        Function of a point spread that returns a number or an array of them, such as
        ``lambda p: psf.encircled_energy(p, radii)``, `fwhm` or `centroid`.
    patterns : iterable of PointSpread
        Two or more, drawn independently on one grid, such as ``psf.sample_point_spread(scene,
        roughness, seed=s)`` for many s. Averages of several patterns do, if of equally many.

    Returns
    -------
    MetricEstimate

    Raises
    ------
    SceneError
        If there are fewer than two patterns, or they differ in grid or meaning.
    SamplingError
        If the metric is not finite.

    Notes
    -----
    ``s^2 = (n - 1)/n sum_i (t_i - mean t)^2``, t_i the metric of the mean of all patterns but the
    i-th [1]_. The true value lies within t standard errors as often as Student's t of n - 1
    degrees tells, for metrics that change smoothly with the image; one that jumps, as the width
    through the brightest pixel does from speckle to speckle, needs many patterns. What all patterns
    lack, such as light outside their window, no error bar tells, and a modulus such as `mtf` is too
    large where it sinks into its own error.

    References
    ----------
    .. [1] Efron and Stein, The jackknife estimate of variance, Ann. Stat. 9, 586 (1981).
    """
    drawn = list(patterns)
    n = len(drawn)
    if n < 2:
        raise SceneError(f"{n} patterns tell no error; draw two or more, with a seed each")
    for name in ALIKE:
        found = {getattr(pattern, name) for pattern in drawn}
        if len(found) > 1:
            raise SceneError(
                f"patterns differ in {name}, {sorted(found)[:2]}; draw all with the same options"
            )
    total = np.zeros(drawn[0].shape)
    energy = 0.0
    for pattern in drawn:
        total += pattern.intensity
        energy += pattern.enclosed_energy
    value = _measured(metric, drawn[0], total / n, energy / n)
    others = np.stack(
        [
            _measured(
                metric,
                pattern,
                (total - pattern.intensity) / (n - 1),
                (energy - pattern.enclosed_energy) / (n - 1),
            )
            for pattern in drawn
        ]
    )
    error = np.sqrt((n - 1) / n * np.sum((others - others.mean(axis=0)) ** 2, axis=0))
    return MetricEstimate(value=value, standard_error=np.asarray(error), n_patterns=n)


def _measured(
    metric: Callable[[PointSpread], Any], like: PointSpread, mean: Array, energy: float
) -> Array:
    spread = replace(like, intensity=mean, enclosed_energy=energy)
    value = np.asarray(metric(spread), dtype=np.float64)
    if not np.isfinite(value).all():
        raise SamplingError(f"the metric is {value}; give one that is finite for these patterns")
    return value


ComplexArray = NDArray[np.complex128]
TERMS = ("piston", "tilt", "defocus")


def strehl(wavefront: Wavefront, *, remove: Iterable[str] = ("piston",)) -> float:
    """Intensity at the reference point over that of the same pupil without aberration.

    Parameters
    ----------
    wavefront : Wavefront
        Polar or cells (exact: more nodes are taken where the phase needs them), or a grid or
        scattered (as sampled).
    remove : iterable of {"piston", "tilt", "defocus"}
        Terms fitted by least squares, weighted by amplitude, and taken out first. Without tilt
        and defocus in it, this is the value at the reference point, not at the peak.

    Returns
    -------
    float
        ``|sum A w exp(ikW)|^2 / (sum A w)^2``.
    """
    residual = split(_without(wavefront, remove))
    if residual.wavefront.is_spectral:
        centre = Window.centred(residual.airy_unit, (1, 1))
        pupil, weights = pupil_function(residual, *quadrature.node_counts(residual, centre))
        total = complex(np.sum(pupil * weights))
        return abs(total) ** 2 / float(np.sum(np.abs(pupil) * weights)) ** 2
    wave = residual.wavefront
    phase = np.exp(1j * residual.wavenumber * wave.aberration)
    return abs(complex(np.sum(wave.amplitude * wave.weights * phase))) ** 2 / (
        residual.amplitude_sum**2
    )


def rms_aberration(wavefront: Wavefront, *, remove: Iterable[str] = ("piston", "tilt")) -> float:
    """Root mean square of the aberration over the pupil, weighted by amplitude.

    Parameters
    ----------
    wavefront : Wavefront
    remove : iterable of {"piston", "tilt", "defocus"}
        Terms fitted by least squares and taken out first.

    Returns
    -------
    float
        m.
    """
    rest = _without(wavefront, remove)
    weights = rest.amplitude * rest.weights
    return math.sqrt(float(np.sum(weights * rest.aberration**2) / np.sum(weights)))


def fit_zernike(
    wavefront: Wavefront, n_terms: int, *, ordering: Ordering = "noll"
) -> dict[int, float]:
    """Least-squares Zernike coefficients of an aberration, weighted by amplitude.

    Parameters
    ----------
    wavefront : Wavefront
        An obscured pupil is fitted with the polynomials of the full disc.
    n_terms : int
        The first so many indices of the ordering.
    ordering : {"noll", "osa", "fringe"}

    Returns
    -------
    dict of int to float
        Index to coefficient, m; what `Wavefront.from_zernike` takes.
    """
    one_of("ordering", ordering, ORDERINGS)
    whole("n_terms", n_terms)
    weights = np.sqrt(wavefront.amplitude * wavefront.weights)
    lit = weights > 0
    if np.count_nonzero(lit) < n_terms:
        raise SamplingError(
            f"{np.count_nonzero(lit)} lit nodes cannot determine {n_terms} Zernike terms; use "
            "fewer terms"
        )
    n_bytes = 24.0 * n_terms * np.count_nonzero(lit)
    fits_memory(f"a fit of {n_terms} Zernike terms", n_bytes, "use fewer terms or nodes")
    u, v = wavefront.u[lit] / wavefront.pupil_radius, wavefront.v[lit] / wavefront.pupil_radius
    first = 0 if ordering == "osa" else 1
    indices = range(first, first + n_terms)
    basis = zernike_basis(indices, np.hypot(u, v), np.arctan2(v, u), ordering=ordering)
    fit, _, rank, _ = np.linalg.lstsq(
        (basis * weights[lit]).T, wavefront.aberration[lit] * weights[lit], rcond=None
    )
    if rank < n_terms:
        raise SamplingError(
            f"the nodes tell only {rank} of {n_terms} Zernike terms apart; use fewer terms or more "
            "nodes"
        )
    return {index: float(value) for index, value in zip(indices, fit, strict=True)}


def encircled_energy(source: Wavefront | PointSpread, radius: ArrayLike) -> Array:
    """Share of the transmitted energy within circles around the reference point.

    Parameters
    ----------
    source : Wavefront or PointSpread
        A polar wavefront gives it to rounding, ``2 pi sum_m int |U_m|^2 r dr`` over the angular
        orders of the image field. A point spread adds up pixels, those on the circle by the area
        within.
    radius : array_like
        m.

    Returns
    -------
    ndarray
        Of the radii's shape.
    """
    radii = np.asarray(radius, dtype=np.float64)
    if not np.all(np.isfinite(radii)) or np.any(radii < 0):
        raise SceneError(f"radius = {radius!r} m; give finite radii of at least 0")
    if isinstance(source, Wavefront):
        residual = split(source)
        if source.layout != "polar":
            raise SamplingError(
                f"the energy of a {source.layout} wavefront is summed over its point spread; give "
                "psf.point_spread(wavefront), or sample a round pupil with nodes='polar'"
            )
        values = [_energy_within(residual, float(r)) for r in radii.ravel()]
        return np.array(values).reshape(radii.shape)
    edge = min(-source.x[0], source.x[-1], -source.y[0], source.y[-1]) + source.pitch / 2
    if radii.size and radii.max() > edge:
        raise SamplingError(
            f"radius = {radii.max():.3g} m passes the window's edge at {edge:.3g} m; use a larger "
            "shape"
        )
    per_energy = source.enclosed_energy / float(np.sum(source.intensity))
    values = [
        float(np.sum(source.intensity * circle_shares(source.x, source.y, source.pitch, float(r))))
        if r > 0
        else 0.0
        for r in radii.ravel()
    ]
    return np.array(values).reshape(radii.shape) * per_energy


def mtf(source: Wavefront | PointSpread, frequency: ArrayLike, *, azimuth: float = 0.0) -> Array:
    """Modulation transfer along one direction.

    Parameters
    ----------
    source : Wavefront or PointSpread
        An unobscured polar wavefront gives it to rounding, by quadrature of the overlap of two
        shifted pupils. A point spread gives the modulus of its spectrum over that at 0, which
        lacks what lies outside its window and holds the pixels' sinc where it is integrated.
    frequency : array_like
        Cycles per m in the image; 0 beyond 1/(lambda N).
    azimuth : float
        Direction, rad from x toward y.

    Returns
    -------
    ndarray
        Of the frequencies' shape.
    """
    frequencies = np.asarray(frequency, dtype=np.float64)
    if not np.all(np.isfinite(frequencies)) or not math.isfinite(azimuth):
        raise SceneError("frequency and azimuth must be finite; give 1/m and rad")
    if isinstance(source, PointSpread):
        spectrum = spectrum_along(source, frequencies.ravel(), azimuth)
        modulus = np.abs(spectrum) / float(np.sum(source.intensity))
        return np.asarray(modulus.reshape(frequencies.shape))
    if source.layout != "polar" or source.obscuration > 0:
        raise SamplingError(
            "the overlap of shifted pupils is known for an unobscured polar wavefront; give "
            "psf.point_spread(wavefront) instead"
        )
    residual = split(source)
    values = [_overlap(residual, abs(float(f)), azimuth) for f in frequencies.ravel()]
    return np.array(values).reshape(frequencies.shape)


def spectrum_along(point_spread: PointSpread, frequencies: Array, azimuth: float) -> ComplexArray:
    """Fourier sums (n,) of a point spread at frequencies (n,), 1/m, along one direction, rad."""
    along_x = 2 * math.pi * math.cos(azimuth) * frequencies[:, None]
    along_y = 2 * math.pi * math.sin(azimuth) * frequencies[:, None]
    half = np.einsum("fx,yx->fy", np.exp(-1j * along_x * point_spread.x), point_spread.intensity)
    return np.asarray(np.einsum("fy,fy->f", np.exp(-1j * along_y * point_spread.y), half))


def fwhm(point_spread: PointSpread) -> tuple[float, float]:
    """Full width at half maximum along x and y through the brightest sample, m.

    Samples are interpolated by tenth-degree polynomials: 1e-5 of the width at a quarter of
    lambda N, 1e-9 at a tenth.

    Parameters
    ----------
    point_spread : PointSpread

    Returns
    -------
    (float, float)
        m.
    """
    row, column = np.unravel_index(
        int(np.argmax(point_spread.intensity)), point_spread.intensity.shape
    )
    cuts = (point_spread.intensity[row], point_spread.intensity[:, column])
    x, y = (_width(cut, point_spread.pitch) for cut in cuts)
    return x, y


def _without(wavefront: Wavefront, remove: Iterable[str]) -> Wavefront:
    names = (remove,) if isinstance(remove, str) else tuple(remove)
    for name in names:
        one_of("remove", name, TERMS)
    scale = wavefront.pupil_radius
    u, v = wavefront.u / scale, wavefront.v / scale
    shapes = {"piston": (np.ones_like(u),), "tilt": (u, v), "defocus": (u**2 + v**2,)}
    terms = [shape for name in dict.fromkeys(names) for shape in shapes[name]]
    if not terms:
        return wavefront
    basis = np.stack(terms)
    fit = fitted_terms(wavefront.aberration, wavefront.amplitude * wavefront.weights, basis)
    return replace(wavefront, aberration=wavefront.aberration - np.tensordot(fit, basis, 1))


def pupil_function(residual: Residual, *counts: int) -> tuple[ComplexArray, Array]:
    """A exp(ikW), tilt included, and weights on nodes of a shape, see `Wavefront.nodes`."""
    wave = residual.wavefront
    u, v, weights = wave.nodes(*counts)
    path = residual.series.at_nodes(*counts) + residual.tilt[0] * u + residual.tilt[1] * v
    amplitude = (
        np.full_like(u, wave.amplitude.flat[0])
        if residual.is_uniform
        else residual.amplitude_series.at_nodes(*counts)
    )
    return amplitude * np.exp(1j * residual.wavenumber * path), weights


def _energy_within(residual: Residual, radius: float) -> float:
    if radius == 0:
        return 0.0
    wave = residual.wavefront
    # The window counts nodes for a reach of radius/sqrt(2) along both axes.
    half = radius / math.sqrt(2)
    window = Window(2 * half, (2, 2), (-half, -half))
    pupil, weights = pupil_function(residual, *quadrature.node_counts(residual, window))
    inner = wave.obscuration**2
    fraction, _ = gauss_legendre(pupil.shape[0])
    rho = wave.pupil_radius * np.sqrt(inner + (1 - inner) * fraction)
    v = math.pi * radius / residual.airy_unit
    share, image_weights = gauss_legendre(math.ceil(0.58 * v + 12))
    r = radius * np.sqrt(share)
    waves = np.fft.fft(pupil, axis=1)  # sums over the angles
    waves *= weights[:, :1]
    strength = np.sum(np.abs(waves) ** 2, axis=0)
    argument = np.outer(r, rho) * (2 * math.pi / (wave.wavelength * abs(wave.image_distance)))
    total = 0.0
    n_theta = pupil.shape[1]
    for m in np.nonzero(strength > 1e-32 * strength.max())[0]:
        order = min(int(m), n_theta - int(m))
        field = np.einsum("ri,i->r", scipy.special.jv(order, argument), waves[:, m])
        total += float(np.sum(image_weights * np.abs(field) ** 2))
    energy = float(np.sum(np.abs(pupil) ** 2 * weights))
    disc = math.pi * radius**2
    return total * disc / (energy * (wave.wavelength * wave.image_distance) ** 2)


def _overlap(residual: Residual, frequency: float, azimuth: float) -> float:
    """|autocorrelation| of the pupil at a shift lambda d f, over that at 0."""
    wave = residual.wavefront
    a = wave.pupil_radius
    shift = wave.wavelength * abs(wave.image_distance) * frequency
    if shift >= 2 * a:
        return 0.0
    v = 2 * residual.wavenumber * residual.rays.slope * a
    series, amplitude = residual.polar_series
    n = math.ceil(0.6 * v) + 32 + series.n_r
    fraction, share = gauss_legendre(n)
    # Across: y = a sin t; along: half width a cos t - shift/2. Both are smooth up to the tips.
    widest = math.acos(shift / (2 * a))
    t = widest * (2 * fraction - 1)
    half = a * np.cos(t) - shift / 2
    along = half[:, None] * (2 * fraction - 1)
    area = (2 * widest * share * a * np.cos(t) * 2 * half)[:, None] * share
    c, s = math.cos(azimuth), math.sin(azimuth)
    across = np.broadcast_to((a * np.sin(t))[:, None], along.shape)
    pair = []
    for side in (0.5, -0.5):
        p = along + side * shift
        u, w = c * p - s * across, s * p + c * across
        pupil = np.exp(1j * residual.wavenumber * series.at(u, w, 1e-13))
        if amplitude is not None:
            pupil = pupil * amplitude.at(u, w, 1e-13)
        pair.append(pupil)
    total = abs(complex(np.sum(area * pair[0] * np.conj(pair[1]))))
    if residual.is_uniform:
        return total / (math.pi * a**2)
    return total / float(np.sum(wave.amplitude**2 * wave.weights))


def _width(cut: Array, pitch: float) -> float:
    """Distance between the half-maximum crossings on either side of the largest sample."""
    top = int(np.argmax(cut))
    # The peak lies within half a sample of the largest one; a parabola through fine samples of
    # the interpolant finds its height.
    heights = np.array([_interpolated(cut, top + p) for p in np.arange(-24, 25) / 48])
    best = min(max(int(np.argmax(heights)), 1), heights.size - 2)
    left, middle, right = heights[best - 1 : best + 2]
    bend = left - 2 * middle + right
    peak = middle - (left - right) ** 2 / (8 * bend) if bend < 0 else middle
    return pitch * (_crossing(cut, top, 1, peak / 2) + _crossing(cut, top, -1, peak / 2))


def _crossing(cut: Array, top: int, step: int, level: float) -> float:
    index = top
    while cut[index] >= level:
        index += step
        if not 0 <= index < cut.size:
            raise SamplingError(
                f"the spot stays above half its peak up to the window's edge, {cut.size} samples; "
                "use a larger shape"
            )
    low, high = float(index), float(index - step)  # below, above the level
    for _ in range(50):
        middle = (low + high) / 2
        if _interpolated(cut, middle) < level:
            low = middle
        else:
            high = middle
    return abs((low + high) / 2 - top)


def _interpolated(cut: Array, place: float) -> float:
    """Polynomial through the eleven samples around a place, in samples."""
    n = min(11, cut.size)
    start = min(max(round(place) - n // 2, 0), cut.size - n)
    t = place - start
    if t == round(t):
        return float(cut[start + round(t)])
    signs = np.array([(-1) ** k * math.comb(n - 1, k) for k in range(n)])
    terms = signs / (t - np.arange(n))
    return float(np.sum(terms * cut[start : start + n]) / np.sum(terms))
