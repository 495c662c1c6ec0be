"""Spot diagram, spot radius and centroid of a wave."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..._checks import expect, whole
from ..._nouns import Noun
from ..._vectors import Array
from ..transform.point_spread import PointSpread
from ..wave.detilted import split
from ..wave.wavefront import Wavefront


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
        Wave in the exit pupil, of any ``layout``. Rays start at its sample points.
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
    wavefront = expect("wavefront", wavefront, "Wavefront")
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
        airy_radius=1.2196698912665045 * residual.airy_unit,
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

    Notes
    -----
    For a wave the result is ``image_distance`` times the mean gradient of the aberration, weighted
    by energy. This is the centroid of the rays, and also that of the diffracted intensity [1]_.

    References
    ----------
    .. [1] Goodman, Introduction to Fourier Optics, 3rd ed., sec. 6.4.
    """
    source = expect("source", source, "PointSpread", "Wavefront")
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
        Wave in the exit pupil, of any ``layout``.

    Returns
    -------
    float
        Rms radius, m.

    See Also
    --------
    spot_diagram : Points at which rays meet the image plane.
    """
    wavefront = expect("wavefront", wavefront, "Wavefront")
    rays = split(wavefront).rays
    x, y = (float((rays.energy * v).sum()) for v in (rays.x, rays.y))
    square = rays.energy * ((rays.x - x) ** 2 + (rays.y - y) ** 2)
    return math.sqrt(float(square.sum()))
