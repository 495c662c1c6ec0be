"""Vector diffraction at high aperture: Debye integral of a wave that obeys the sine condition.

The pupil coordinates over the image distance are direction cosines, so that each component of the
electric field is a Fourier transform of the pupil function times a real weight.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, Literal

import numpy as np

from ..._checks import one_of, real
from ..._vectors import Array
from ...errors import SceneError
from ..aperture.aperture import Aperture
from ..aperture.cell_nodes import pupil_points
from ..wave.detilted import Residual
from .nufft import Nodes

Polarisation = Literal["unpolarised", "x", "y"] | float

#: Relative error to which the nodes resolve the weights near grazing directions.
WEIGHTS: Final = 1e-15


def check_polarisation(polarisation: Polarisation) -> Polarisation:
    """Check a polarisation; return ``"unpolarised"`` or the angle of the field from x to y, rad."""
    if not isinstance(polarisation, str):
        return real("polarisation", polarisation)
    one_of("polarisation", polarisation, ("unpolarised", "x", "y"))
    return {"x": 0.0, "y": math.pi / 2}.get(polarisation, "unpolarised")


def largest_sine(residual: Residual) -> float:
    """Return the sine of the half angle of the cone of light, over all lit nodes and the rim."""
    return residual.farthest / abs(residual.wavefront.image_distance)


def check_cone(residual: Residual) -> float:
    """Return `largest_sine`; raise `SceneError` if it is not below 1."""
    sine = largest_sine(residual)
    if sine >= 1:
        wave = residual.wavefront
        raise SceneError(
            f"the pupil reaches {sine * abs(wave.image_distance):.4g} m from the axis at "
            f"F/{1 / (2 * sine):.3g}, limit F/0.5, where it is as wide as the wave's sphere of "
            f"radius |wavefront.image_distance| = {abs(wave.image_distance):.4g} m; use a smaller "
            "pupil or a larger image_distance"
        )
    return sine


def field_weights(
    u: Array, v: Array, distance: float, polarisation: Polarisation | None
) -> list[Array | float]:
    """Return the weights of the field's components at pupil coordinates.

    The sum of the squared transforms is the intensity. The factor ``cos^(-1/2)`` is the square root
    of the cosine that conserves energy on the sphere, over the cosine of the sphere's area.

    Parameters
    ----------
    u, v : ndarray
        Pupil coordinates, m, of one shape.
    distance : float
        Image distance, m.
    polarisation : "unpolarised" or float, or None
        As returned by `check_polarisation`; None for the scalar model.

    Returns
    -------
    list of ndarray
        Five weights of an unpolarised wave, three of a polarised one, of the shape of u; a single
        1 for the scalar model.
    """
    if polarisation is None:
        return [1.0]
    a, b = u / distance, v / distance
    cosine = np.sqrt(1 - a**2 - b**2)
    root = 1 / np.sqrt(cosine)
    mean = root * (1 + cosine) / 2
    bend = root / (1 + cosine)
    along, across = bend * (a**2 - b**2) / 2, bend * a * b
    if isinstance(polarisation, str):
        half = math.sqrt(0.5) * root
        # Mean of two waves, polarised along x and y: the cross terms of their components cancel.
        return [mean, along, across, half * a, half * b]
    c, s = math.cos(polarisation), math.sin(polarisation)
    return [
        c * (mean - along) - s * across,
        s * (mean + along) - c * across,
        root * (c * a + s * b),
    ]


def more_nodes(residual: Residual) -> tuple[int, ...]:
    """Return how many more nodes along each axis resolve the weights' singularity at grazing.

    A function with a singularity at z > 1 is integrated over -1..1 by n Gauss-Legendre nodes with
    an error of about ``(z + sqrt(z^2 - 1))^(-2 n)``.
    """

    def more(z: float) -> int:
        return math.ceil(-math.log(WEIGHTS) / (2 * math.log(z + math.sqrt(z * z - 1))))

    sine, outline = largest_sine(residual), residual.wavefront.aperture
    if outline is None:
        return more(2 / sine**2 - 1), 4
    gap = (1 / sine - 1) * residual.farthest
    return 0, *(more(1 + 2 * gap / size) for size in outline.patch_size)


def levels(nodes: Nodes, distance: float, polarisation: Polarisation | None) -> tuple[float, float]:
    """Return the ideal peak, relative to the scalar one, and the mean of 1/cos over the energy.

    The energy in the image plane is the squared field's integral, by Parseval's theorem the
    transmitted energy times this mean. ``distance`` is that of the image, m. Both are 1 for the
    scalar model, a ``polarisation`` of None.
    """
    if polarisation is None:
        return 1.0, 1.0
    weights = field_weights(nodes.u, nodes.v, distance, polarisation)
    peak = sum(float(np.sum(nodes.share * weight)) ** 2 for weight in weights)
    cosine = np.sqrt(1 - (nodes.u**2 + nodes.v**2) / distance**2)
    return peak, float(np.sum(nodes.energies / cosine)) / nodes.energy


@lru_cache(maxsize=64)
def clear_levels(
    radius: float,
    obscuration: float,
    outline: Aperture | None,
    counts: tuple[int, ...],
    distance: float,
) -> tuple[float, float]:
    """Return `levels` of an unpolarised wave of uniform amplitude on the nodes of a pupil.

    The arguments are those of `pupil_points`, and the image distance, m.
    """
    u, v, areas = pupil_points(radius, obscuration, outline, counts)
    return levels(Nodes(u, v, np.zeros_like(u), np.ones_like(u), areas), distance, "unpolarised")
