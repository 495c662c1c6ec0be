"""Results of ray tracing: light paths, and the power balance by fate of the light."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..._nouns import Noun

Array = NDArray[np.float64]

DETECTED: Final = 0
ESCAPED: Final = 1
ABSORBED: Final = 2
LEFT: Final = 3
BLOCKED: Final = 4
#: Names of the status numbers of a path.
STATUS: Final = ("detected", "escaped", "absorbed", "left", "blocked")

#: Surfaces of the points of a path.
NO_SURFACE: Final = -1
ON_WALL: Final = 0
ON_OBJECT: Final = 1


def _no_numbers() -> NDArray[np.int8]:
    """Return an empty array of surfaces or lobes, as a default."""
    return np.zeros((0, 0), dtype=np.int8)


def _nothing() -> Mapping[str, float]:
    """Return an empty read-only mapping, as a default."""
    return MappingProxyType({})


@dataclass(frozen=True, eq=False, kw_only=True)
class RayPaths(Noun):
    """Light paths through a scene, and the balance of the light's power.

    Parameters
    ----------
    points : ndarray, (n, k, 3)
        Vertices of each path, world frame, m: the source, ``n_bounces`` reflections, the end.
        Paths with fewer vertices than k repeat their end. Empty if paths were not kept.
    path_length : ndarray, (n,)
        Length from source to end, m; equal to the optical path in air.
    weight : ndarray, (n,)
        Power carried by the path at its end, W. Detected paths add up to ``flux + stray``.
    n_bounces : ndarray of int32, (n,)
        Number of reflections.
    status : ndarray of int8, (n,)
        0: detected. 1: escaped from the scene. 2: absorbed, or not resolved. 3: not finished when
        ``max_bounces`` was reached. 4: blocked at the lens, by missing the detector, by the field
        stop or by the lens's transmission.
    surface : ndarray of int8, (n, k)
        Surface that reflects the light at each point: 0 for the wall, 1 for the hidden object, -1
        for the source, the end and repeated ends. Empty if unknown.
    lobe : ndarray of int8, (n, k)
        Lobe that reflects most of the path's light at each point, counted from 0 in the order of
        the surface's material; -1 without a surface. A reflection in exactly the mirror direction
        is assigned to the lobe of the smooth mirror. Empty if unknown.
    ledger : mapping of str to float
        Power by what happened to it, W: "detected", "escaped", "left" (status 3) and "blocked" as
        in ``status``; "absorbed by wall", "absorbed by object" and "absorbed by occluders"; and
        "unresolved", the power of rays whose hit could not be resolved in float64.
    ledger_error : mapping of str to float
        Standard errors of the ledger, W.
    flux : float
        Detected power of light that met the hidden object, W.
    standard_error : float
        Standard error of ``flux``, W.
    by_bounce, by_bounce_error : ndarray, (max_bounces + 1,)
        Contributions to ``flux`` by number of reflections, and their standard errors, W.
    stray, stray_error : float
        Detected power of light that never met the hidden object, and its standard error, W.
    wall_to_wall : float
        Power that goes directly from wall to wall, summed over all reflections, W.
    trapped, trapped_error : float
        Part of ``wall_to_wall`` that the wall absorbs (light-trap loss), and its standard error, W.
    mean_path_length : float
        Power-weighted mean path length of the light in ``flux``, m; 0 if ``flux`` is 0.
    n_rays : int
        Number of rays traced.
    stopped : {"rays", "tol", "time"}
        Limit that ended the tracing.
    uncertain : tuple of str
        Names of values whose error is dominated by rare paths: ``"flux"``, ``"stray"`` or, for
        four reflections, ``"bounce 4"``. Their errors are increased, but may still be too small;
        trace more rays.
    unreached : tuple of str
        Kinds of paths that rays find only by chance. The values may miss light on these paths, and
        the errors may not show it.
    seconds : float
        Wall-clock time.
    queries : mapping of str to int
        Number of intersection tests by kind of surface; absent or 0 for a kind that was skipped.

    See Also
    --------
    trace : Light from the laser to the detector.
    pupil_rays : Fan of rays from an object point to the lens.
    nlosoptics.psf.wavefront_from_rays : Wave from traced ray paths.
    nlosoptics.views.ray_paths : 3-D view with light paths.
    """

    points: Array
    path_length: Array
    weight: Array
    n_bounces: NDArray[np.int32]
    status: NDArray[np.int8]
    surface: NDArray[np.int8] = field(default_factory=_no_numbers)
    lobe: NDArray[np.int8] = field(default_factory=_no_numbers)
    ledger: Mapping[str, float] = field(default_factory=_nothing)
    ledger_error: Mapping[str, float] = field(default_factory=_nothing)
    flux: float = 0.0
    standard_error: float = 0.0
    by_bounce: Array = field(default_factory=lambda: np.zeros(0))
    by_bounce_error: Array = field(default_factory=lambda: np.zeros(0))
    stray: float = 0.0
    stray_error: float = 0.0
    wall_to_wall: float = 0.0
    trapped: float = 0.0
    trapped_error: float = 0.0
    mean_path_length: float = 0.0
    n_rays: int = 0
    stopped: str = "rays"
    uncertain: tuple[str, ...] = ()
    unreached: tuple[str, ...] = ()
    seconds: float = 0.0
    queries: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))

    def __post_init__(self) -> None:
        arrays = (self.points, self.path_length, self.weight, self.n_bounces, self.status)
        found = (self.surface, self.lobe, self.by_bounce, self.by_bounce_error)
        for array in (*arrays, *found):
            array.flags.writeable = False

    @property
    def met_object(self) -> NDArray[np.bool_]:
        """Whether the hidden object reflected the light of each path, (n,); False if unknown."""
        if not self.surface.size:
            return np.zeros(len(self.weight), dtype=bool)
        return np.asarray((self.surface == ON_OBJECT).any(axis=1))
