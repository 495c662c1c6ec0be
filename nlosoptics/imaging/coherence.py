"""Degree of coherence of the light that the laser spot sends into the room."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import fits_memory
from ..errors import SceneError
from ..psf.aperture.quadrature_nodes import polar_nodes
from ..raytrace import intersect
from ..scene import Scene
from .radiometry import laser_spot

Array = NDArray[np.float64]

#: Points for which all paths from the spot are in memory at a time.
BLOCK = 256


def spot_coherence(
    scene: Scene, points: ArrayLike, reference: ArrayLike | None = None
) -> NDArray[np.complex128]:
    """Compute how coherent the laser spot's light is at two points of the room.

    The laser spot on the rough wall acts as an extended incoherent source. The light that it sends
    into the room is partially coherent: the fields at two points are correlated if the points are
    close to each other.

    Parameters
    ----------
    scene : Scene
        Scene that defines the laser and the wall.
    points : array_like, (..., 3)
        First point of each pair, in the room, world frame (origin at the centre of the relay wall,
        z toward the room, y up), m.
    reference : array_like, (3,), optional
        Second point, common to all pairs, world frame, m. None: the centre of the hidden planar
        object, or the centroid of the hidden mesh.

    Returns
    -------
    ndarray of complex, (...)
        Complex degree of coherence between each point and the reference; its modulus is at most 1,
        and it is 1 at the reference itself.

    Raises
    ------
    SceneError
        If the points are not finite, lie in or behind the wall's mean plane, or the beam misses the
        wall.
    MemoryLimitError
        If the points are so far apart that the sum over the spot would need too many terms.

    See Also
    --------
    form_image : Image with speckle.

    Notes
    -----
    By the van Cittert-Zernike theorem [1]_, the degree of coherence between points x and x0 is
    ``mu = sum E exp(ik(|p - x| - |p - x0|)) / sum E``. The sums run over the points p of the spot,
    E is the irradiance there, and k = 2 pi/lambda with the wavelength lambda. The beam is uniform
    across its diameter. The formula is the mean over all realisations of the wall's microscopic
    heights. In this mean, the light of different points p is mutually incoherent. The reflectance
    of the wall and the decrease of the amplitude with distance and obliquity are taken as equal for
    all p; only the phase depends on the distance.

    For polarised light, the correlation of the speckle intensities at both points is ``|mu|^2``. A
    round spot of diameter D, seen at normal incidence from the distance z, has
    ``mu = 2 J1(v)/v`` with ``v = pi D s/(lambda z)`` at a separation s of the points, where J1 is a
    Bessel function. The first zero is at ``s = 1.22 lambda z/D``. A surface much wider than this s
    can be treated as spatially incoherent.

    References
    ----------
    .. [1] Goodman, Statistical Optics, 2nd ed., sec. 5.7.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics import Scene, imaging
    >>> scene = Scene.load("examples/scenes/letter_flat.toml")
    >>> nearby = np.add(scene.object_point, [0.0, 1e-4, 0.0])
    >>> print(f"{abs(imaging.spot_coherence(scene, nearby)):.2f}")
    0.75
    """
    second = _points("reference", scene.object_point if reference is None else reference)
    if second.shape != (3,):
        raise SceneError(f"reference has shape {second.shape}; give one point (3,), m")
    first = _points("points", points)
    flat = first.reshape(-1, 3)
    wavenumber = 2 * math.pi / scene.laser.wavelength
    spot = laser_spot(scene)
    # Phase change across the spot's longest radius: the difference of both directions to it.
    directions = [at - spot.point for at in (flat, second)]
    away = [d / np.sqrt((d * d).sum(axis=-1))[..., None] for d in directions]
    cosine = float((spot.incident * spot.normal).sum())
    longest = scene.laser.beam_diameter / 2 / cosine
    steep = float(np.abs(away[0] - away[1]).max(initial=0.0)) * math.sqrt(3)
    near = min(float(np.sqrt((d * d).sum(axis=-1)).min(initial=math.inf)) for d in directions)
    v = wavenumber * longest * (steep + longest / near * min(steep + 0.5, 2.0))
    n_r, n_theta = math.ceil(0.29 * v + 12), math.ceil(v + 12 * math.cbrt(v) + 16)
    fits_memory(
        f"the spot's coherence by {n_r} x {n_theta} nodes",
        120.0 * n_r * n_theta * min(BLOCK, max(len(flat), 1)),
        "give points nearer to the reference",
    )
    nodes, share = _spot_nodes(scene, spot.incident, n_r, n_theta)
    start = np.sqrt(((nodes - second) ** 2).sum(axis=1))
    found = np.empty(len(flat), dtype=np.complex128)
    for k in range(0, len(flat), BLOCK):
        part = flat[k : k + BLOCK, None]
        # a difference of squares over the sum keeps the digits of nearby points
        total = np.sqrt(((nodes - part) ** 2).sum(axis=2)) + start
        step = ((second - part) * (2 * nodes - part - second)).sum(axis=2)
        found[k : k + BLOCK] = np.einsum("pn,n->p", np.exp(1j * wavenumber * step / total), share)
    return found.reshape(first.shape[:-1])


def _spot_nodes(scene: Scene, incident: Array, n_r: int, n_theta: int) -> tuple[Array, Array]:
    """Return points of the spot on the wall, (n, 3), m, and their shares of the power, (n,)."""
    u, v, weights = (a.ravel() for a in polar_nodes(scene.laser.beam_diameter / 2, n_r, n_theta))
    across = np.cross(incident, np.eye(3)[int(np.argmin(np.abs(incident)))])
    across /= math.sqrt(float((across * across).sum()))
    up = np.cross(incident, across)
    starts = np.asarray(scene.laser.position) + u[:, None] * across + v[:, None] * up
    hits = intersect(scene.wall, starts, np.broadcast_to(-incident, starts.shape))
    if not np.all(hits.hit):
        raise SceneError(
            f"{int(np.sum(~hits.hit))} of {len(starts)} rays of the beam miss the wall; aim the "
            "laser further inside its edges"
        )
    return np.asarray(hits.points), weights / weights.sum()


def _points(name: str, values: ArrayLike) -> Array:
    """Return finite points (..., 3) in front of the wall's mean plane."""
    try:
        found = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise SceneError(f"{name} are not numbers; give (..., 3), m") from None
    if found.ndim == 0 or found.shape[-1] != 3:
        raise SceneError(f"{name} have shape {found.shape}; give (..., 3), m")
    if not np.isfinite(found).all():
        raise SceneError(f"{name} contain NaN or infinity; give finite coordinates, m")
    if found.size and float(found[..., 2].min()) <= 0:
        raise SceneError(
            f"{name} reach z = {float(found[..., 2].min()):.4g} m, in or behind the wall; give "
            "points with z above 0"
        )
    return found
