"""Spot diagram and centroid of a wave; ensquared energy, phase and peak of its image."""

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
from .psf_metrics import pupil_function, spectrum_along, transfers

Array = NDArray[np.float64]

#: First zero of J1 over pi: radius of the first dark ring of the Airy pattern, in lambda N.
DARK_RING: Final = 1.2196698912665045


@dataclass(frozen=True, eq=False, kw_only=True)
class SpotDiagram(Noun):
    """Spot diagram: points at which the rays of a wave meet the image plane, without diffraction.

    Parameters
    ----------
    x, y : ndarray
        Coordinates of the points in the image plane, (n,), m, read-only. The optical axis is at
        x = y = 0.
    energy : ndarray
        Fraction of the energy that each ray carries, above 0, of sum 1; (n,), read-only.
    centroid : (float, float)
        Mean (x, y) of the points, weighted by energy, m.
    radius : float
        Root mean square distance of the points from the centroid, m.
    airy_radius : float
        Radius of the first dark ring of the Airy pattern, 1.22 times wavelength times F-number, m.

    See Also
    --------
    spot_diagram : Computes it.
    spot_radius : Rms radius of a spot.
    nlosoptics.views.spot_diagram : Plot of the points.
    """

    x: Array
    y: Array
    energy: Array
    centroid: tuple[float, float]
    radius: float
    airy_radius: float


def spot_diagram(wavefront: Wavefront, *, rings: int = 24) -> SpotDiagram:
    """Compute the points at which the rays of a wave meet the image plane (spot diagram).

    Parameters
    ----------
    wavefront : Wavefront
        Wave in the exit pupil, with any ``layout`` (arrangement of the sample points, see
        `Wavefront`). Rays start at the sample points of non-zero amplitude.
    rings : int
        For the layout "polar" the wave is interpolated if it has fewer samples than this number of
        rings with ``2 * rings`` rays each. No effect for other layouts.

    Returns
    -------
    SpotDiagram
        Coordinates in the image plane, m, and energies of the rays, (n,) each.

    Raises
    ------
    SceneError
        If ``rings`` is not a whole number above 0.

    See Also
    --------
    spot_radius : Rms radius of a spot.
    point_spread : Image with diffraction.
    nlosoptics.views.spot_diagram : Plot of the points.

    Notes
    -----
    A ray meets the image plane at the image distance times the gradient of the aberration.

    Examples
    --------
    Half a micrometre rms (one wavelength) of defocus at F/10:

    >>> from nlosoptics import psf
    >>> wave = psf.Wavefront.from_zernike(
    ...     {4: 500e-9}, wavelength=500e-9, pupil_radius=5e-3, image_distance=0.1
    ... )
    >>> spots = psf.spot_diagram(wave)
    >>> print(f"rms radius {1e6 * spots.radius:.1f} um, Airy {1e6 * spots.airy_radius:.1f} um")
    rms radius 49.0 um, Airy 6.1 um
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
    """Compute the centroid (centre of energy) of the image of a point.

    Parameters
    ----------
    source : Wavefront or PointSpread
        Wave in the exit pupil, with any ``layout`` (arrangement of the sample points, see
        `Wavefront`); or a computed point spread, whose energy outside the window is then neglected.

    Returns
    -------
    (float, float)
        Coordinates (x, y) of the centroid in the image plane, m. The optical axis is at x = y = 0.

    See Also
    --------
    spot_diagram : Points at which rays meet the image plane.
    encircled_energy : Energy within circles.

    Notes
    -----
    For a wave the result is ``image_distance`` times the mean gradient of the aberration, weighted
    by energy. This is the centroid of the rays, and also that of the diffracted intensity [1]_.

    References
    ----------
    .. [1] Goodman, Introduction to Fourier Optics, 3rd ed., sec. 6.4.
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
    """Compute the rms radius of the spot that the rays of a wave form in the image plane.

    It is the root mean square distance of the rays from their centroid. Rays are weighted by their
    energy, the squared amplitude times the pupil area. Diffraction is neglected, because the rms
    radius of a diffracted spot is infinite if the pupil has a sharp rim.

    Parameters
    ----------
    wavefront : Wavefront
        Wave in the exit pupil, with any ``layout`` (arrangement of the sample points, see
        `Wavefront`).

    Returns
    -------
    float
        Rms radius, m.

    See Also
    --------
    spot_diagram : Points at which rays meet the image plane.
    encircled_energy : Energy within circles.
    """
    rays = split(wavefront).rays
    x, y = (float((rays.energy * v).sum()) for v in (rays.x, rays.y))
    square = rays.energy * ((rays.x - x) ** 2 + (rays.y - y) ** 2)
    return math.sqrt(float(square.sum()))


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
        # A square narrower than the central pixel covers the fraction 2 half/pitch of its width.
        on_x, on_y = (np.minimum(on, 2 * half / pitch) for on in (on_x, on_y))
        values.append(float(np.einsum("y,yx,x->", on_y, point_spread.intensity, on_x)))
    return np.array(values).reshape(sides.shape) * per_energy


def ptf(
    point_spread: PointSpread | Wavefront, frequency: ArrayLike, *, azimuth: float = 0.0
) -> Array:
    """Compute the phase transfer function (PTF) along one direction in the image.

    It is the phase of the optical transfer function, whose modulus is `mtf`.

    Parameters
    ----------
    point_spread : PointSpread or Wavefront
        Computed point spread, whose energy outside the window is neglected. Or a wave in the exit
        pupil whose ``layout`` is "polar" or "cells" (samples on rings or on patches, see
        `Wavefront`); its autocorrelation is the optical transfer function, and the error of the
        phase is below 1e-9 rad divided by the MTF.
    frequency : array_like
        Spatial frequencies, cycles per m in the image, of any shape.
    azimuth : float
        Direction along which the frequencies are counted, rad from x toward y.

    Returns
    -------
    ndarray
        Phase, rad, above -pi and at most pi, in the shape of ``frequency``. A spot at positive x
        has a phase that decreases with the frequency along x.

    Raises
    ------
    SceneError
        If a frequency or the azimuth is not finite.
    SamplingError
        If the wave's layout is neither "polar" nor "cells", or its autocorrelation does not
        converge. In both cases give ``point_spread(wavefront)`` instead.

    See Also
    --------
    mtf : Modulus of the optical transfer function.
    """
    frequencies = np.asarray(frequency, dtype=np.float64)
    if not np.all(np.isfinite(frequencies)) or not math.isfinite(azimuth):
        raise SceneError("frequency or azimuth is NaN or infinite; give finite 1/m and rad")
    if isinstance(point_spread, Wavefront):
        return np.angle(transfers(point_spread, frequencies, azimuth))
    spectrum = spectrum_along(point_spread, frequencies.ravel(), azimuth)
    return np.asarray(np.angle(spectrum).reshape(frequencies.shape))


def peak_strehl(wavefront: Wavefront) -> float:
    """Compute the Strehl ratio at the brightest point of the image, wherever that is.

    It is the peak intensity divided by the peak intensity of the same pupil without aberration.

    Parameters
    ----------
    wavefront : Wavefront
        Wave in the exit pupil, with any ``layout`` (arrangement of the sample points, see
        `Wavefront`).

    Returns
    -------
    float
        Ratio, 0 to 1; not below the Strehl ratio on the axis.

    Raises
    ------
    SamplingError
        If `point_spread` cannot compute the image, because the wave has too few samples.

    See Also
    --------
    strehl : Ratio on the axis.

    Notes
    -----
    The image is first sampled in steps of lambda N/3, with the wavelength lambda and the F-number
    N. Newton's method then finds the peak near the brightest sample, with a relative error of about
    1e-12.
    """
    residual = split(wavefront)
    unit, wave = residual.airy_unit, residual.wavefront
    centred = replace(wave, aberration=residual.aberration)
    found = point_spread(
        centred, pitch=unit / 3, normalisation="ideal-peak", tol=0.05, model="scalar"
    )
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
    # The derivatives of the field are moments of the pupil function.
    for _ in range(30):
        spread = pupil * np.exp(-1j * scale * (place[0] * u + place[1] * v))
        field = spread.sum()
        first = -1j * scale * np.array([(spread * t).sum() for t in (u, v)])
        second = -(scale**2) * np.array([[(spread * s * t).sum() for s in (u, v)] for t in (u, v)])
        best = max(best, abs(field) ** 2)
        slope = 2 * (np.conj(field) * first).real
        bend = 2 * (np.conj(field) * second + np.outer(np.conj(first), first)).real
        # Newton step to the maximum. Taking the modulus of the curvatures keeps the step uphill
        # where the intensity is convex. The floor is for rings, which have none along them.
        bends, axes = np.linalg.eigh(bend)
        bends = np.abs(bends).clip(min=1e-9 * np.abs(bends).max())
        move = axes @ (axes.T @ slope / bends)
        place = place + move
        if float(np.hypot(*move)) < 1e-9 * unit:
            break
    return best / residual.amplitude_sum**2
