"""Where the light of a point lies: centroid, rays, energy in squares, phase, peak."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import whole
from ..._nouns import Noun
from ...errors import SamplingError, SceneError
from ..transform import quadrature
from ..transform.point_spread import PointSpread, point_spread
from ..wave.detilted import split
from ..wave.wavefront import Wavefront
from ..window.window import Window
from .psf_metrics import pupil_function, spectrum_along

Array = NDArray[np.float64]

#: First zero of J1 over pi: the dark ring of a round pupil without aberration, in lambda N.
DARK_RING: Final = 1.2196698912665045


@dataclass(frozen=True, eq=False, kw_only=True)
class SpotDiagram(Noun):
    """Where the rays of a wave land in the image plane, diffraction left out.

    Parameters
    ----------
    x, y : ndarray
        (n,), read-only, m from the reference point.
    energy : ndarray
        (n,), read-only: each ray's share of the light, above 0; sum 1.
    centroid : (float, float)
        Mean of the rays, (x, y), m.
    radius : float
        Their root mean square distance from it, m.
    airy_radius : float
        Of the first dark ring of a round pupil of this F-number without aberration, m.
    """

    x: Array
    y: Array
    energy: Array
    centroid: tuple[float, float]
    radius: float
    airy_radius: float


def spot_diagram(wavefront: Wavefront, *, rings: int = 24) -> SpotDiagram:
    """Rays of a wave in the image plane, ``image_distance`` times the gradient of its aberration.

    Parameters
    ----------
    wavefront : Wavefront
        Of any layout; one ray from every lit node.
    rings : int
        Of a polar wavefront, the least number of rings of rays, each of twice as many.

    Returns
    -------
    SpotDiagram
    """
    rings = whole("rings", rings)
    residual = split(wavefront)
    polar = wavefront.layout == "polar"
    rays = residual.traced(rings, 2 * rings) if polar else residual.rays
    lit = rays.energy > 0
    x, y, energy = (values[lit] for values in (rays.x, rays.y, rays.energy))
    x, y = x + residual.shift[0], y + residual.shift[1]
    for values in (x, y, energy):
        values.setflags(write=False)
    return SpotDiagram(
        x=x,
        y=y,
        energy=energy,
        centroid=centroid(wavefront),
        radius=spot_radius(wavefront),
        airy_radius=DARK_RING * residual.airy_unit,
    )


def centroid(source: Wavefront | PointSpread) -> tuple[float, float]:
    """Centre of the light in the image plane, (x, y), m.

    Parameters
    ----------
    source : Wavefront or PointSpread
        A wavefront gives the mean of its rays, ``image_distance`` times the energy-weighted mean
        gradient of the aberration, which is also the centroid of its diffracted intensity
        (Goodman, Introduction to Fourier Optics, 3rd ed., sec. 6.4). A point spread gives the mean
        over its window, which the slow tails of diffraction reach beyond.
    """
    if isinstance(source, PointSpread):
        total = float(source.intensity.sum())
        x = float((source.intensity.sum(axis=0) * source.x).sum()) / total
        y = float((source.intensity.sum(axis=1) * source.y).sum()) / total
        return x, y
    residual = split(source)
    rays, (x, y) = residual.rays, residual.shift
    return x + float((rays.energy * rays.x).sum()), y + float((rays.energy * rays.y).sum())


def spot_radius(wavefront: Wavefront) -> float:
    """Root mean square distance of the rays from their centroid in the image plane, m.

    Diffraction has no second moment where the pupil has a hard edge, and no part in this.

    Parameters
    ----------
    wavefront : Wavefront
        Of any layout.
    """
    rays = split(wavefront).rays
    x, y = (float((rays.energy * v).sum()) for v in (rays.x, rays.y))
    square = rays.energy * ((rays.x - x) ** 2 + (rays.y - y) ** 2)
    return math.sqrt(float(square.sum()))


def ensquared_energy(point_spread: PointSpread, side: ArrayLike) -> Array:
    """Share of the transmitted energy within squares around the reference point.

    Parameters
    ----------
    point_spread : PointSpread
        Its pixels count with the part of their area that lies within.
    side : array_like
        Of the squares, m.

    Returns
    -------
    ndarray
        Of the sides' shape.

    Raises
    ------
    SceneError
        If a side is negative or not finite.
    SamplingError
        If a square passes the window's edge.
    """
    sides = np.asarray(side, dtype=np.float64)
    if not np.all(np.isfinite(sides)) or np.any(sides < 0):
        raise SceneError(f"side = {side!r} m; give finite sides of at least 0")
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
        # a square narrower than the central pixel is cut on both of its sides
        on_x, on_y = (np.minimum(on, 2 * half / pitch) for on in (on_x, on_y))
        values.append(float(np.einsum("y,yx,x->", on_y, point_spread.intensity, on_x)))
    return np.array(values).reshape(sides.shape) * per_energy


def ptf(point_spread: PointSpread, frequency: ArrayLike, *, azimuth: float = 0.0) -> Array:
    """Phase of the optical transfer function along one direction, rad.

    Parameters
    ----------
    point_spread : PointSpread
        What lies outside its window is missing.
    frequency : array_like
        Cycles per m in the image.
    azimuth : float
        Direction, rad from x toward y.

    Returns
    -------
    ndarray
        In (-pi, pi], of the frequencies' shape; a spot at +x has a falling phase.
    """
    frequencies = np.asarray(frequency, dtype=np.float64)
    if not np.all(np.isfinite(frequencies)) or not math.isfinite(azimuth):
        raise SceneError("frequency and azimuth must be finite; give 1/m and rad")
    spectrum = spectrum_along(point_spread, frequencies.ravel(), azimuth)
    return np.asarray(np.angle(spectrum).reshape(frequencies.shape))


def peak_strehl(wavefront: Wavefront) -> float:
    """Largest intensity anywhere in the image plane over that without aberration.

    Parameters
    ----------
    wavefront : Wavefront
        Polar or cells, or a grid as sampled.

    Returns
    -------
    float
        To about 1e-12: Newton steps from the brightest sample at a third of lambda N. `strehl` has
        the value at the reference point.
    """
    residual = split(wavefront)
    unit, wave = residual.airy_unit, residual.wavefront
    centred = replace(wave, aberration=residual.aberration)
    found = point_spread(centred, pitch=unit / 3, normalisation="ideal-peak", tol=0.05)
    row, column = np.unravel_index(int(np.argmax(found.intensity)), found.shape)
    if wave.is_spectral:
        counts = quadrature.node_counts(split(centred), Window.centred(unit / 3, found.shape))
        u, v, weights = wave.nodes(*counts)
        pupil, _ = pupil_function(split(centred), *counts)
        pupil = pupil * weights
    else:
        u, v = wave.u, wave.v
        phase = np.exp(1j * residual.wavenumber * residual.aberration)
        pupil = wave.amplitude * wave.weights * phase
    scale = 2 * math.pi / (wave.wavelength * wave.image_distance)
    place, best = np.array([found.x[column], found.y[row]]), -1.0
    # moments of the pupil are the derivatives of the field
    for _ in range(30):
        spread = pupil * np.exp(-1j * scale * (place[0] * u + place[1] * v))
        field = spread.sum()
        first = -1j * scale * np.array([(spread * t).sum() for t in (u, v)])
        second = -(scale**2) * np.array([[(spread * s * t).sum() for s in (u, v)] for t in (u, v)])
        best = max(best, abs(field) ** 2)
        slope = 2 * (np.conj(field) * first).real
        bend = 2 * (np.conj(field) * second + np.outer(np.conj(first), first)).real
        # Newton's step to the top of the cap; where it bends upward, as far the other way, uphill
        bends, axes = np.linalg.eigh(bend)
        bends = np.abs(bends).clip(min=1e-9 * np.abs(bends).max())  # a ring has none along it
        move = axes @ (axes.T @ slope / bends)
        place = place + move
        if float(np.hypot(*move)) < 1e-9 * unit:
            break
    return best / residual.amplitude_sum**2
