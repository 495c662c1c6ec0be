"""Sum of spherical waves from the pupil nodes at points of any image surface."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import fits_memory, one_of
from ..._nouns import Noun
from ...errors import SamplingError, SceneError
from ..wave.detilted import Residual, split
from ..wave.wavefront import Wavefront
from . import quadrature

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
SurfaceNormalisation = Literal["ideal-peak", "irradiance"]
Pupil = Literal["plane", "sphere"]

#: The error is estimated at the brightest points and about `SPREAD` further ones, spaced evenly.
BRIGHTEST: Final = 32
SPREAD: Final = 96
#: Approximate number of points searched for the steepest phase.
STEEPEST: Final = 20_000
#: Relative error due to rounding.
ROUNDING: Final = 1e-12


@dataclass(frozen=True, eq=False, kw_only=True)
class SurfacePointSpread(Noun):
    """Point spread function at arbitrary points in space, for example on a curved detector.

    Parameters
    ----------
    points : ndarray
        Points, of shape (..., 3), m, read-only. The origin is the pupil's centre; x and y are
        parallel to the pupil coordinates u and v; the image plane is at z =
        ``wavefront.image_distance``, with the wave given to `huygens_point_spread`.
    intensity : ndarray
        Intensity (...), read-only, in the shape of the points without their last axis.
    normalisation : {"ideal-peak", "irradiance"}
        Unit of the intensity: "ideal-peak" is relative to the intensity at the focus without
        aberration; "irradiance" is energy per m^2, if the pupil transmits the energy 1.
    error_estimate : float
        Largest error of the intensity due to the finite number of pupil nodes, relative to the
        largest intensity; an upper bound.
    wavelength : float
        Vacuum wavelength, m.
    f_number : float
        Working F-number, image distance over pupil diameter.

    See Also
    --------
    huygens_point_spread : Computes it, by a sum of spherical waves.
    """

    points: Array
    intensity: Array
    normalisation: str
    error_estimate: float
    wavelength: float
    f_number: float


@dataclass(frozen=True, eq=False)
class SurfaceField:
    """Intensity at points, its normalisation and its error.

    Parameters
    ----------
    intensity : ndarray, (n,)
        1 at the peak without aberration.
    density : float
        Fraction of the transmitted energy per m^2 at intensity 1.
    error : float
        Upper bound of the error, relative to the largest intensity.
    """

    intensity: Array
    density: float
    error: float


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Pupil nodes.

    Parameters
    ----------
    u, v, path : ndarray, (n,)
        Positions and path excess, tilt included, m.
    size : ndarray, (n,)
        Amplitude times area, m^2.
    energy : float
        Integral of the squared amplitude, m^2.
    """

    u: Array
    v: Array
    path: Array
    size: Array
    energy: float


def huygens_point_spread(
    wavefront: Wavefront,
    points: ArrayLike,
    *,
    normalisation: SurfaceNormalisation = "ideal-peak",
    pupil: Pupil = "sphere",
) -> SurfacePointSpread:
    """Compute the intensity of a focused wave at any points in space, by Huygens' principle.

    Each point of the pupil emits a spherical wave; the waves are summed. Use this function for
    image points off the image plane, such as a curved detector, or to check `point_spread`.

    Parameters
    ----------
    wavefront : Wavefront
        Wave in the exit pupil. Terms listed in ``wavefront.removed`` are not added back. For the
        layouts "polar" and "cells" the wave is interpolated to as many points as needed.
    points : array_like, (..., 3)
        Image points (x, y, z), m. The origin is the pupil's centre; x and y are parallel to the
        pupil coordinates u and v; the image plane is at z = ``wavefront.image_distance``.
    normalisation : {"ideal-peak", "irradiance"}
        Unit of the intensity: "ideal-peak" is relative to the intensity at the focus without
        aberration; "irradiance" is energy per m^2, if the pupil transmits the energy 1.
    pupil : {"sphere", "plane"}
        Surface on which the pupil coordinates (u, v) lie. ``sphere`` is the reference sphere about
        the image point on the axis, as in `point_spread` and for a lens that satisfies the sine
        condition. ``plane`` is the plane through the pupil's centre, as for an ideal thin lens.

    Returns
    -------
    SurfacePointSpread
        Intensity (...) at the points, with an error estimate.

    Raises
    ------
    SceneError
        If points lie closer than 100 wavelengths to the pupil or on its other side, or the
        F-number is 0.5 or less with ``pupil="sphere"``.
    SamplingError
        If the samples of a wave with the layout "grid" or "scattered" are too far apart for the
        phase of the spherical waves, or if such a wave has a ``Wavefront.aperture`` (an outline
        that is neither disc nor ring).
    MemoryLimitError
        If the interpolated wave would not fit into memory.

    See Also
    --------
    point_spread : PSF in the image plane, much faster.
    propagate : Free-space propagation to a parallel plane.

    Notes
    -----
    The complex field at the image point x is the first Rayleigh-Sommerfeld integral without its
    near-field term [1]_, as a sum over pupil points p:

    ``U(x) = (1/lambda) sum S E exp(ik [W + s (|x - p| - |c - p|)]) cos(n, x - p)/|x - p|``

    Here W is the aberration, k = 2 pi/lambda, d the image distance, s its sign, c = (0, 0, d) the
    image point on the axis, n the normal of the pupil surface, and S the area of that surface that
    the pupil point represents. The factor E converts the wave's ``amplitude`` A, whose square is
    the power per area of (u, v), to the field on the pupil surface. The power is the same, hence
    ``E^2 S cos(n, c - p)`` is A^2 times the area of (u, v) that the pupil point represents. The
    intensity is ``|U|^2``.

    `point_spread` uses a small-angle approximation of this sum. For beams slower than F/10 the two
    results differ by an amount that scales as 1/N^2, with N the F-number. Relative to the peak
    without aberration it is

    - for the sphere, at most ``1/(32 N^2)``; 0.0047/N^2 for the Airy disc (5e-7 at F/100),
    - for the plane, 0.078/N^2 for the Airy disc, and more far off the axis, because (u, v) are then
      tangents of the angles to the axis instead of sines.

    References
    ----------
    .. [1] Goodman, Introduction to Fourier Optics, 3rd ed., sec. 3.5.

    Examples
    --------
    Intensity at the focus and on the first dark ring of the Airy pattern, at 1.22 lambda N:

    >>> from nlosoptics import psf
    >>> wave = psf.Wavefront.from_zernike(
    ...     {}, wavelength=500e-9, pupil_radius=5e-3, image_distance=0.1
    ... )
    >>> found = psf.huygens_point_spread(wave, [(0, 0, 0.1), (6.1e-6, 0, 0.1)])
    >>> print(" ".join(f"{value:.3f}" for value in found.intensity))
    1.000 0.000
    """
    one_of("normalisation", normalisation, ("ideal-peak", "irradiance"))
    places = np.array(points, dtype=np.float64, order="C")
    if places.ndim == 0 or places.shape[-1] != 3 or places.size == 0:
        raise SceneError(f"points have shape {places.shape}; give (..., 3), x, y and z in m")
    one_of("pupil", pupil, ("plane", "sphere"))
    flat = places.reshape(-1, 3)
    result = surface_field(split(wavefront), flat, pupil)
    scale = 1.0 if normalisation == "ideal-peak" else result.density
    intensity = (result.intensity * scale).reshape(places.shape[:-1])
    for array in (places, intensity):
        array.setflags(write=False)
    return SurfacePointSpread(
        points=places,
        intensity=intensity,
        normalisation=normalisation,
        error_estimate=result.error,
        wavelength=wavefront.wavelength,
        f_number=wavefront.f_number,
    )


def surface_field(residual: Residual, points: Array, pupil: Pupil = "sphere") -> SurfaceField:
    """Compute the intensity at points (n, 3), m, in the pupil's frame, and its error."""
    check_points(residual.wavefront, points, pupil)
    nodes, finer = _nodes(residual, points)
    field, peak = _field(residual.wavefront, nodes, points, pupil)
    intensity = np.abs(field / peak) ** 2
    density = peak**2 / nodes.energy
    error = ROUNDING
    if finer is not None:
        order = np.argsort(intensity, kind="stable")
        step = max(1, len(points) // SPREAD)
        chosen = np.unique(np.concatenate([order[-BRIGHTEST:], order[::step]]))
        better, better_peak = _field(residual.wavefront, finer, points[chosen], pupil)
        change = np.abs(better / better_peak) ** 2
        worst = np.abs(change - intensity[chosen]).max()
        share = better_peak**2 / finer.energy / density
        worst = max(worst, np.abs(change * share - intensity[chosen]).max())
        error += 2 * float(worst) / float(intensity.max())
    return SurfaceField(intensity, density, error + _lost(residual, intensity))


def check_points(wave: Wavefront, points: Array, pupil: Pupil) -> None:
    """Refuse points that are not on the image's side of the pupil, or too near to it."""
    if not np.isfinite(points).all():
        raise SceneError("points hold NaN or infinity; give finite coordinates in m")
    depth = points[:, 2] * math.copysign(1.0, wave.image_distance)
    # closer to the pupil, the neglected near field of each node matters
    limit = 100 * wave.wavelength
    if pupil == "sphere":
        if 2 * wave.f_number <= 1:
            raise SceneError(
                f"pupil = 'sphere' at F/{wave.f_number:.3g}, limit F/0.5, where the pupil is wider "
                "than its sphere; use pupil='plane'"
            )
        share = (wave.pupil_radius / wave.image_distance) ** 2
        limit += abs(wave.image_distance) * share / (1 + math.sqrt(1 - share))
    if depth.min() < limit:
        worst = int(np.argmin(depth))
        raise SceneError(
            f"point {worst} at z = {points[worst, 2]:.6g} m is not beyond the pupil: points must "
            f"lie at least {limit:.3g} m from it, on the side of the image at z = "
            f"{wave.image_distance:.6g} m; give z in the pupil's frame"
        )


def node_counts(residual: Residual, points: Array) -> tuple[int, ...]:
    """Return the shape of the nodes that resolve the phase toward points (n, 3), m.

    The rule is that of `quadrature.node_counts`, with a margin.
    """
    wave = residual.wavefront
    slope = steepness(residual, points) + residual.rays.slope
    if wave.layout == "cells":
        n_patches, n_s, n_t = quadrature.cell_counts(residual, slope, 1e-9)
        return n_patches, n_s + 8, n_t + 8
    v = residual.wavenumber * wave.pupil_radius * slope
    degree_r, degree_theta = residual.degrees(1e-9 / residual.wavenumber)
    if not residual.is_uniform:
        more_r, more_theta = residual.amplitude_series.degrees(1e-9)
        degree_r, degree_theta = degree_r + more_r, degree_theta + more_theta
    n_r, n_theta = wave.u.shape
    return (
        max(n_r, math.ceil(0.29 * v + 15 + degree_r)),
        max(n_theta, math.ceil(v + 12 * v ** (1 / 3) + 16 + degree_theta)),
    )


def steepness(residual: Residual, points: Array) -> float:
    """Return the largest slope over the pupil of the path to a point, tilt included.

    The path is counted relative to that to the reference point.
    """
    wave = residual.wavefront
    extremes = [np.argmin(c) for c in points.T] + [np.argmax(c) for c in points.T]
    few = np.concatenate([points[:: max(1, len(points) // STEEPEST)], points[extremes]])
    angles = 2 * math.pi * np.arange(16) / 16
    side, worst = math.copysign(1.0, wave.image_distance), 0.0
    for share in (1.0, 0.5, 0.0):
        for angle in angles if share > 0 else angles[:1]:
            u, v = (share * wave.pupil_radius * f(angle) for f in (math.cos, math.sin))
            x, y = u - few[:, 0], v - few[:, 1]
            r = np.sqrt(x * x + y * y + few[:, 2] ** 2)
            c = math.sqrt(u * u + v * v + wave.image_distance**2)
            du = residual.tilt[0] + side * (x / r - u / c)
            dv = residual.tilt[1] + side * (y / r - v / c)
            worst = max(worst, float(np.hypot(du, dv).max()))
    return worst


def seconds(residual: Residual, points: Array) -> float:
    """Predict the run time on two cores, order of magnitude, s."""
    refined = residual.wavefront.is_spectral
    count = math.prod(node_counts(residual, points)) if refined else residual.wavefront.u.size
    return 1e-2 + 1.5e-8 * count * len(points)


def _nodes(residual: Residual, points: Array) -> tuple[_Nodes, _Nodes | None]:
    """Return the nodes to sum over, and finer ones for the error estimate.

    The finer ones are None for a pixel map, which defines the wave exactly.
    """
    wave = residual.wavefront
    if wave.is_spectral:
        counts = node_counts(residual, points)
        more = (math.ceil(1.3 * n) for n in counts[-2:])
        return _refined(residual, counts), _refined(residual, (*counts[:-2], *more))
    if wave.aperture is not None:
        raise SamplingError(
            f"spherical waves from the {wave.layout} nodes of an aperture have no reference from "
            "which to estimate their error; sample it with nodes='cells'"
        )
    _check_steps(residual, points)
    lit = wave.amplitude * wave.weights > 0
    own = _gathered(
        residual,
        wave.u[lit],
        wave.v[lit],
        residual.aberration[lit],
        wave.amplitude[lit],
        wave.weights[lit],
    )
    if wave.layout == "grid" and np.ptp(wave.weights) == 0:
        return own, None  # a pixel map defines the wave exactly
    slope = steepness(residual, points) + residual.rays.slope
    v = residual.wavenumber * wave.pupil_radius * slope
    n_r, n_theta = math.ceil(0.29 * v + 27), math.ceil(v + 12 * v ** (1 / 3) + 40)
    fits_memory(f"{n_r} x {n_theta} pupil nodes", 600.0 * n_r * n_theta, "use nearer points")
    a, b, weights, path, amplitude, doubt = residual.local.on_polar(wave, n_r, n_theta)
    # The interpolation error is added to the path, so that it enters the error estimate.
    return own, _gathered(residual, a, b, path + doubt, amplitude, weights)


def _refined(residual: Residual, counts: tuple[int, ...]) -> _Nodes:
    """Return polar nodes, or nodes of cells, of the given shape."""
    wave = residual.wavefront
    fits_memory(
        f"{' x '.join(map(str, counts))} pupil nodes",
        150.0 * math.prod(counts),
        "give points nearer to the focus",
    )
    u, v, weights = wave.nodes(*counts)
    if residual.is_uniform:
        amplitude = np.full_like(u, wave.amplitude.flat[0])
    else:
        amplitude = residual.amplitude_series.at_nodes(*counts)
    return _gathered(residual, u, v, residual.series.at_nodes(*counts), amplitude, weights)


def _gathered(
    residual: Residual, u: Array, v: Array, path: Array, amplitude: Array, weights: Array
) -> _Nodes:
    """Return nodes with the tilt added back, since on a sphere it is not an exact shift."""
    tilted = path + residual.tilt[0] * u + residual.tilt[1] * v
    energy = float(np.sum(amplitude**2 * weights))
    return _Nodes(u.ravel(), v.ravel(), tilted.ravel(), (amplitude * weights).ravel(), energy)


def _field(
    wave: Wavefront, nodes: _Nodes, points: Array, pupil: Pupil
) -> tuple[ComplexArray, float]:
    """Return the field (n,) at the points, and the unaberrated one at the reference point, 1/m."""
    from . import _transform_kernels

    d = wave.image_distance
    square = nodes.u**2 + nodes.v**2
    if pupil == "plane":
        w = np.zeros_like(square)
        cosine = abs(d) / np.sqrt(square + d * d)
        # E = A/cos^(1/2): a plane met at an angle passes E^2 cos per area, which must equal A^2
        size = nodes.size / np.sqrt(cosine)
        peak = float(np.sum(size * cosine**2))
    else:
        cosine = np.sqrt(1 - square / d**2)
        w = d * (square / d**2) / (1 + cosine)
        # E = A cos^(1/2) on the area w/cos
        size = nodes.size / np.sqrt(cosine)
        peak = float(np.sum(size))
    out = np.empty((len(points), 2))
    _transform_kernels.huygens_field(
        np.ascontiguousarray(points),
        nodes.u,
        nodes.v,
        w,
        nodes.path,
        size / wave.wavelength,
        d,
        2 * math.pi / wave.wavelength,
        pupil == "sphere",
        out,
    )
    return out.view(np.complex128)[:, 0], peak / (wave.wavelength * abs(d))


def _check_steps(residual: Residual, points: Array) -> None:
    """Refuse nodes between which the phase changes by too much."""
    wave = residual.wavefront
    jump, node = residual.grid_jump()
    if jump > 0.5:
        raise SamplingError(
            f"aberration jumps {jump:.2f} waves at node {node}, limit 0.50; use more pupil nodes "
            f"(now {wave.u.size})"
        )
    step = (steepness(residual, points) + residual.rays.slope) * residual.spacing / wave.wavelength
    if step > 1:
        raise SamplingError(
            f"the phase toward the points changes by {step:.2f} waves between nodes, limit 1, "
            "beyond which the nodes repeat the spot there; use "
            f"{math.ceil(wave.u.size * step**2)} or more pupil nodes (now {wave.u.size}), or "
            "points nearer to the focus"
        )


def _lost(residual: Residual, intensity: Array) -> float:
    """Bound the error due to the number of polar nodes in the wavefront itself."""
    lost = residual.truncation
    return float(np.max(2 * np.sqrt(intensity) * lost + lost**2) / intensity.max())
