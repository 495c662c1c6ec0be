"""Rendering of captures from meshes: checks, and the assembly of all bounces."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..._checks import expect, in_range, one_of, whole
from ..._progress import Progress
from ..._random import checked_seed
from ...errors import SamplingError, SceneError
from ...scene import Material
from ..capture.capture import TransientCapture
from .multiple_bounces import LEAST, MultipleBounces, multiple_bounces
from .scan import Scan
from .surfaces import hidden_surfaces
from .three_bounces import ThreeBounces, three_bounces

if TYPE_CHECKING:
    import trimesh


def render(
    surfaces: Iterable[tuple[trimesh.Trimesh, Material]],
    scan: Scan,
    *,
    min_bounces: int = 3,
    max_bounces: int = 5,
    quantity: Literal["irradiance", "radiance", "radiosity"] = "irradiance",
    tol: float = 1e-3,
    tol_multiple: float = 1e-2,
    n_rays: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> TransientCapture:
    """Compute the light over time that hidden meshes scatter back to a Lambertian relay wall.

    The laser lights points of the wall, and the light returns to points of the wall via the meshes.
    Times are given as optical path, the length that the light has travelled: 1 m is 3.34 ns.

    Parameters
    ----------
    surfaces : iterable of (trimesh.Trimesh, Material)
        Hidden meshes, world frame, m, and their materials: any of `nlosoptics.scene` except a
        mirror of zero slope. Both sides of a triangle scatter alike. Meshes lie in front of the
        wall and may touch it.
    scan : Scan
        Relay wall, its points and their pairing, and time bins.
    min_bounces, max_bounces : int
        Least and greatest number of reflections (bounces) of a path, 3 to 32, including the two at
        the wall. ``min_bounces`` above 3 omits shorter paths, for example to average several seeds
        without computing three bounces again, which use no random numbers.
    quantity : {"irradiance", "radiance", "radiosity"}
        Quantity at the sensor points, per W of laser power on the wall: irradiance E in W/m^2,
        radiance ``wall_albedo E/pi`` in W/(m^2 sr), or radiosity ``wall_albedo E`` in W/m^2.
        A bin has the sum over all paths whose length lies in the bin; it is not divided by the
        width of the bin. For a laser of constant power, the quantity is the sum of all bins. For a
        short pulse, a bin of the irradiance is the energy per area that arrives within the bin, per
        J of the pulse.
    tol, tol_multiple : float
        Errors allowed for each pair of points: sum of the absolute errors of all bins, relative to
        the sum of their values. ``tol`` is for the light of three bounces. ``tol_multiple`` is for
        the light of four bounces, of five, and so on; each of these parts must meet it. They are
        computed with random numbers, so that it limits the expected error.
    n_rays : int, optional
        Largest number of random paths with more than three bounces, at least 8. None: as many as
        take about a minute on one core, but at least 65,536, which take longer for many pairs.
    seed : int
        Seed of the random paths, 0 to 2^64 - 1. Results are identical for any number of threads.
        Three bounces use no random numbers.
    progress : callable(str, float), optional
        Called with a line of text and the completed fraction, 0 to 1.

    Returns
    -------
    TransientCapture
        Capture with the histograms ``H``, their parts by number of bounces ``by_bounce``, and the
        ``standard_error`` of H (0 for three bounces); see `TransientCapture`. Its ``details``
        tell how it was computed. For three bounces they have arrays with one value for each pair of
        points: "error_estimate" (change in the last refinement, summed over bins), "before" and
        "after" (signal outside the bins), and "parts" (number of parts into which the surfaces were
        divided); "shadows" is True if the meshes were searched for shadows. For more bounces,
        "multiple_bounces" has the number of paths, the errors reached and the reason to stop: "tol"
        if ``tol_multiple`` was reached, "paths" if ``n_rays`` was reached first, or "dark" if some
        number of bounces contributes nothing to the bins.

    Raises
    ------
    SceneError
        If a surface, a point or an option is invalid, or no light returns to the wall.
    SamplingError
        If all light arrives outside the bins, or ``tol`` cannot be reached.
    MemoryLimitError
        If the bins exceed the free memory.

    See Also
    --------
    render_scene : Simulated capture of a scene.
    Detector : Photon counts of a capture.

    Notes
    -----
    The wall never blocks light. Three bounces (wall, hidden surface, wall) are integrated by
    adaptive quadrature, more bounces by Monte Carlo.

    Examples
    --------
    >>> import trimesh
    >>> from nlosoptics.scene import Lambert
    >>> from nlosoptics.transient import Scan, render, wall_grid
    >>> corners = [[-0.1, -0.1, 0.5], [0.1, -0.1, 0.5], [0.1, 0.1, 0.5], [-0.1, 0.1, 0.5]]
    >>> plate = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]])
    >>> scan = Scan(
    ...     laser_points=(0.0, 0.0, 0.0),
    ...     sensor_points=wall_grid(side=0.4, count=2),
    ...     t_start=0.95,
    ...     delta_t=0.05,
    ...     n_bins=8,
    ... )
    >>> capture = render([(plate, Lambert(0.8))], scan, max_bounces=3)
    >>> capture.H.shape
    (8, 2, 2)
    >>> print(capture.H.sum(axis=0).round(4))
    [[0.0407 0.0407]
     [0.0407 0.0407]]
    """
    start = time.perf_counter()
    scan = expect("scan", scan, "Scan")
    wanted = in_range("tol", tol, 1e-9, 0.5)
    wanted_multiple = in_range("tol_multiple", tol_multiple, 1e-5, 1.0)
    key = checked_seed(seed)
    paths = None if n_rays is None else whole("n_rays", n_rays, LEAST, 1 << 40)
    fewest = whole("min_bounces", min_bounces, 3, 32)
    most = whole("max_bounces", max_bounces, fewest, 32)
    one_of("quantity", quantity, ("irradiance", "radiance", "radiosity"))
    hidden = hidden_surfaces(surfaces, scan.frame)
    rho = scan.wall_albedo
    # requested quantity over G without the wall's albedo
    factor = rho * {"irradiance": 1.0, "radiance": rho / math.pi, "radiosity": rho}[quantity]
    lasers, sensors, legs = scan.pairs
    bins: dict[str, Any] = {
        "starts": scan.t_start - legs,
        "delta_t": scan.delta_t,
        "n_bins": scan.n_bins,
    }
    three, more = None, MultipleBounces({}, {}, {})
    if fewest == 3:
        three = three_bounces(hidden, lasers, sensors, **bins, tol=wanted, progress=progress)
    if most > 3:
        more = multiple_bounces(
            hidden,
            scan.in_wall_frame(scan.laser_points),
            scan.in_wall_frame(scan.sensor_points),
            pairing=scan.pairing,
            wall_albedo=rho,
            wall_size=scan.wall_size,
            **bins,
            orders=range(max(4, fewest), most + 1),
            tol=wanted_multiple,
            n_rays=paths,
            seed=key,
            progress=progress,
        )
    if not any(light.any() for light in more.by_bounce.values()):
        _check_light(three, scan, (fewest, most))
    by_bounce = {}
    if three is not None:
        by_bounce[3] = np.ascontiguousarray((three.G * factor).T).reshape(scan.shape)
    by_bounce |= {n: factor * light for n, light in more.by_bounce.items()}
    errors = [factor * error for error in more.standard_error.values()]
    H = sum(by_bounce.values(), np.zeros(scan.shape))
    details: dict[str, Any] = {} if three is None else _details(three, factor, scan.shape[1:])
    details |= {
        "multiple_bounces": more.details,
        "wall_albedo": rho,
        "seconds": time.perf_counter() - start,
    }
    normals = {
        f"{side}_normals": None
        if scan.wall_normal is None
        else np.broadcast_to(scan.frame.axes[2], getattr(scan, f"{side}_points").shape)
        for side in ("laser", "sensor")
    }
    return TransientCapture(
        H=H,
        laser_points=scan.laser_points,
        sensor_points=scan.sensor_points,
        delta_t=scan.delta_t,
        t_start=scan.t_start,
        pairing=scan.pairing,
        quantity=quantity,
        outer_legs=scan.outer_legs,
        laser_origin=scan.laser_origin,
        sensor_origin=scan.sensor_origin,
        **normals,
        by_bounce=by_bounce,
        standard_error=np.sqrt(sum((error**2 for error in errors), np.zeros_like(H))),
        details=details,
    )


def _details(three: ThreeBounces, factor: float, shape: tuple[int, ...]) -> dict[str, Any]:
    """Return the details of three bounces for a capture."""
    return {
        "error_estimate": factor * three.error.reshape(shape),
        "before": factor * three.before.reshape(shape),
        "after": factor * three.after.reshape(shape),
        "parts": three.parts.reshape(shape),
        "shadows": three.shadows,
    }


def _check_light(three: ThreeBounces | None, scan: Scan, bounces: tuple[int, int]) -> None:
    """Raise if no light returns to the wall, or none within the bins."""
    if three is not None and three.G.any():
        return
    if three is not None and not (three.before.any() or three.after.any()):
        raise SceneError(
            "no light returns: every triangle is hidden or seen edge-on from the wall points, or "
            "has a material of albedo 0; rotate or move the surfaces"
        )
    legs = " (times include the outer legs)" if scan.outer_legs else ""
    stop = scan.t_start + scan.n_bins * scan.delta_t
    when, more = "", ", raise n_rays, or add a second surface, for example by wall_size"
    if three is not None:
        when, more = f" (all arrives {'before' if three.before.any() else 'after'} them)", ""
    raise SamplingError(
        f"no light of {bounces[0]} to {bounces[1]} bounces arrives in the bins{when}, which hold "
        f"paths from {scan.t_start:g} to {stop:g} m{legs}; change t_start or n_bins{more}"
    )
