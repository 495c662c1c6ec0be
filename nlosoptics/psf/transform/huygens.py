"""Spherical waves from the pupil nodes to points of any image surface."""

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

BRIGHTEST: Final = 32  # points of the error estimate
SPREAD: Final = 96  # further ones, evenly over all
STEEPEST: Final = 20_000  # points among which the steepest phase is looked for, about
ROUNDING: Final = 1e-12


@dataclass(frozen=True, eq=False, kw_only=True)
class SurfacePointSpread(Noun):
    """Image of a point on any points in space.

    Parameters
    ----------
    points : ndarray
        (..., 3), read-only, m, in the pupil's frame: origin at the pupil's centre, x and y along u
        and v, the image plane at z = ``image_distance``.
    intensity : ndarray
        Of the points' leading shape, read-only.
    normalisation : {"ideal-peak", "irradiance"}
        What 1 means: the peak without aberration, or all the light that passes the pupil per m^2.
    error_estimate : float
        Bound of max |dI|/max I for lack of pupil nodes.
    wavelength : float
        m.
    f_number : float
    """

    points: Array
    intensity: Array
    normalisation: str
    error_estimate: float
    wavelength: float
    f_number: float


@dataclass(frozen=True, eq=False)
class SurfaceField:
    """Intensity (n,), 1 at the peak without aberration, and what goes with it.

    ``density`` is the share of the transmitted light per m^2 where the intensity is 1.
    """

    intensity: Array
    density: float
    error: float


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Pupil nodes (n,): places and path excess, m, amplitude times area, m^2, and its energy."""

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
    pupil: Pupil = "plane",
) -> SurfacePointSpread:
    """Point spread on any points by spherical waves from the pupil.

    Parameters
    ----------
    wavefront : Wavefront
        Any layout; polar nodes and cells are refined as the points need. ``removed`` is not put
        back.
    points : array_like
        (..., 3), m, see `SurfacePointSpread`; on the image's side of the pupil.
    normalisation : {"ideal-peak", "irradiance"}
    pupil : {"plane", "sphere"}
        Where the nodes (u, v) lie: in the pupil's plane, as this library's own waves, or on the
        sphere about the reference point through the pupil's centre, as in a lens that keeps the
        sine condition. The other transforms do not tell them apart.

    Returns
    -------
    SurfacePointSpread

    Raises
    ------
    SceneError
        If points lie in the pupil or on its other side.
    SamplingError
        If the nodes of a grid or scattered nodes are too few for the phase.
    MemoryLimitError
        If the refined nodes would not fit.

    Notes
    -----
    Rayleigh and Sommerfeld's first integral [1]_, its near field left out:

    ``U(x) = (1/lambda) sum S E exp(ik [W + s (|x - p| - |c - p|)]) cos(n, x - p)/|x - p|``

    with c = (0, 0, d), s the sign of d, n the pupil's normal, S the node's area on it, and E such
    that ``A^2`` is the power per area of u and v, as in the other transforms. With t the angle at
    c between p and the axis, a node adds ``A w cos(t)^(3/2)/|d|`` at c from the plane and
    ``A w cos(t)^(-1/2)/|d|`` from the sphere. The other transforms have ``A w/|d|`` and the phase
    ``-x.p/d``. Beams slower than F/10 therefore differ from theirs as 1/N^2, relative to the peak
    without aberration: from the sphere by at most ``1/(32 N^2)``, 0.0047/N^2 for the Airy disc
    (5e-7 at F/100); from the plane, whose (u, v) are tangents and not sines, by 0.078/N^2 for the
    Airy disc and more far off the axis. Give another transform (u, v) as sines, and A times
    ``cos(t)^(-1/2)`` of the sphere or, for ``u = s/cos(t)`` of the plane, ``cos(t)^(-5/2)``: it is
    the same image but for ``lambda/d``.

    The intensity is |U|^2, which is the flux through a surface but for the cosine between its
    normal and the rays. The path difference is taken from the difference of the squares, so that
    it keeps about 1e-16 of itself.

    References
    ----------
    .. [1] Goodman, Introduction to Fourier Optics, 3rd ed., sec. 3.5.
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


def surface_field(residual: Residual, points: Array, pupil: Pupil = "plane") -> SurfaceField:
    """Intensity at points (n, 3) of the pupil's frame, and its error."""
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
    """Refuse points that are not beyond the pupil on the image's side."""
    if not np.isfinite(points).all():
        raise SceneError("points hold NaN or infinity; give finite coordinates in m")
    depth = points[:, 2] * math.copysign(1.0, wave.image_distance)
    # nearer than some wavelengths the near field of each node is missing
    limit = 100 * wave.wavelength
    if pupil == "sphere":
        if 2 * wave.f_number <= 1:
            raise SceneError(
                f"pupil = 'sphere' at F/{wave.f_number:.3g}, limit F/0.5: the pupil is wider than "
                "its sphere; use pupil='plane'"
            )
        share = (wave.pupil_radius / wave.image_distance) ** 2
        limit += abs(wave.image_distance) * share / (1 + math.sqrt(1 - share))
    if depth.min() < limit:
        worst = int(np.argmin(depth))
        raise SceneError(
            f"point {worst} at z = {points[worst, 2]:.6g} m is not beyond the pupil on the side of "
            f"the image at {wave.image_distance:.6g} m, limit {limit:.3g} m from the pupil; give z "
            "in the pupil's frame"
        )


def node_counts(residual: Residual, points: Array) -> tuple[int, ...]:
    """Shape of the nodes for the phase slopes toward points; see `quadrature.node_counts`."""
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
    """Largest slope over the pupil of tilt and distance to a point, against the reference's."""
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
    """Expected run time on two cores, order of magnitude."""
    refined = residual.wavefront.is_spectral
    count = math.prod(node_counts(residual, points)) if refined else residual.wavefront.u.size
    return 1e-2 + 1.5e-8 * count * len(points)


def _nodes(residual: Residual, points: Array) -> tuple[_Nodes, _Nodes | None]:
    """Nodes to sum over, and better ones for the error estimate; none where there is no error."""
    wave = residual.wavefront
    if wave.is_spectral:
        counts = node_counts(residual, points)
        more = (math.ceil(1.3 * n) for n in counts[-2:])
        return _refined(residual, counts), _refined(residual, (*counts[:-2], *more))
    if wave.aperture is not None:
        raise SamplingError(
            "spherical waves from the grid of an aperture have no reference to judge their error "
            "by; sample it with nodes='cells'"
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
        return own, None  # a map is the wave itself
    slope = steepness(residual, points) + residual.rays.slope
    v = residual.wavenumber * wave.pupil_radius * slope
    n_r, n_theta = math.ceil(0.29 * v + 27), math.ceil(v + 12 * v ** (1 / 3) + 40)
    fits_memory(f"{n_r} x {n_theta} pupil nodes", 600.0 * n_r * n_theta, "give nearer points")
    a, b, weights, path, amplitude, doubt = residual.local.on_polar(wave, n_r, n_theta)
    # the doubt as a phase of its own: half of it each way
    return own, _gathered(residual, a, b, path + doubt, amplitude, weights)


def _refined(residual: Residual, counts: tuple[int, ...]) -> _Nodes:
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
    """Nodes with the tilt put back, since a sphere has no exact shift."""
    tilted = path + residual.tilt[0] * u + residual.tilt[1] * v
    energy = float(np.sum(amplitude**2 * weights))
    return _Nodes(u.ravel(), v.ravel(), tilted.ravel(), (amplitude * weights).ravel(), energy)


def _field(
    wave: Wavefront, nodes: _Nodes, points: Array, pupil: Pupil
) -> tuple[ComplexArray, float]:
    """Field at the points, and its value at the reference point without aberration, 1/m."""
    from . import _transform_kernels

    d = wave.image_distance
    square = nodes.u**2 + nodes.v**2
    if pupil == "plane":
        w = np.zeros_like(square)
        cosine = abs(d) / np.sqrt(square + d * d)
        # E = A/cos^(1/2), since A^2 passes a plane that it meets aslant
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
    """Refuse nodes between which the phase steps too far."""
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
            f"the phase toward the points turns {step:.2f} waves from node to node, limit 1: the "
            f"nodes repeat the spot there; use {math.ceil(wave.u.size * step**2)} or more pupil "
            f"nodes (now {wave.u.size}), or points nearer to the focus"
        )


def _lost(residual: Residual, intensity: Array) -> float:
    """Error for lack of polar nodes in the wavefront itself."""
    lost = residual.truncation
    return float(np.max(2 * np.sqrt(intensity) * lost + lost**2) / intensity.max())
