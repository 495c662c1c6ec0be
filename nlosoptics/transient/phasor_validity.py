"""Where sampling limits a phasor picture, in words."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import SamplingError
from .captures import TransientCapture
from .volumes import Volume

Array = NDArray[np.floating]

#: Share of the volume's paths that may lie beyond the capture's bins unmentioned.
CUT = 0.01
#: Share of the pitch by which steps of a grid may differ unmentioned.
UNEVEN = 1e-3


def grid_note(name: str, points: Array, wavelength: float, ways: int) -> str | None:
    """Steps of a grid of wall points against the wavelength; None where they are fine enough.

    Parameters
    ----------
    name : str
        Of the points.
    points : ndarray
        (..., 3), m.
    wavelength : float
        m of optical path.
    ways : int
        2 where light leaves from and comes back to the same points, else 1.
    """
    steps = [
        np.linalg.norm(np.diff(points, axis=axis), axis=-1).ravel()
        for axis in range(points.ndim - 1)
        if points.shape[axis] > 1
    ]
    if not steps or points.ndim != 3:
        return None
    largest = max(float(step.max()) for step in steps)
    limit = wavelength / (2 * ways)
    if largest > limit * (1.0 + 1e-9):
        return (
            f"{name} are up to {largest:.4g} m apart, limit {limit:.4g} m, wl_mean/{2 * ways}: "
            f"copies of the scene may appear; take wl_mean of {2 * ways * largest:.4g} m or more"
        )
    spread = max(float(np.ptp(step)) / float(step.mean()) for step in steps)
    if spread > UNEVEN:
        return (
            f"{name} are unevenly spaced by {spread:.2g} of their pitch, limit {UNEVEN:g}: dense "
            "parts weigh more"
        )
    return None


def bin_note(delta_t: float, wavelength: float) -> str | None:
    """Bins against the wavelength.

    Raises
    ------
    SamplingError
        If a wave has less than two bins.
    """
    if delta_t > 0.5 * wavelength:
        raise SamplingError(
            f"delta_t = {delta_t:.4g} m holds over half of wl_mean = {wavelength:.4g} m, which "
            f"is not sampled then; take wl_mean of {4 * delta_t:.4g} m or more"
        )
    if delta_t > 0.25 * wavelength:
        return (
            f"delta_t = {delta_t:.4g} m is over a quarter of wl_mean = {wavelength:.4g} m: bins "
            f"blur the wave's phase; take wl_mean of {4 * delta_t:.4g} m or more"
        )
    return None


def window_note(capture: TransientCapture, volume: Volume, paths: Array) -> str | None:
    """Share of the volume's paths that the capture's bins do not hold.

    Parameters
    ----------
    capture : TransientCapture
    volume : Volume
    paths : ndarray
        A sample of path lengths as the capture counts them, m.
    """
    edges = capture.edges
    early = float(np.mean(paths < edges[0]))
    late = float(np.mean(paths > edges[-1]))
    if early + late <= CUT:
        return None
    return (
        f"bins from {edges[0]:.4g} to {edges[-1]:.4g} m leave out {100 * (early + late):.2g} % of "
        f"the paths of a volume from z = {volume.z[0]:.4g} to {volume.z[-1]:.4g} m "
        f"({paths.min():.4g} to {paths.max():.4g} m): those parts look darker than they are"
    )
