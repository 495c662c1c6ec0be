"""What tracing light finds: paths where they are wanted, and the budget of the light."""

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
#: What a status of a path means, by its number.
STATUS: Final = ("detected", "escaped", "absorbed", "left", "blocked")


def _nothing() -> Mapping[str, float]:
    return MappingProxyType({})


@dataclass(frozen=True, eq=False, kw_only=True)
class RayPaths(Noun):
    """Light paths through a scene, and where the light went.

    Parameters
    ----------
    points : ndarray, (n, k, 3)
        Vertices from source to end, world, m: the source, ``n_bounces`` reflections, the end.
        Shorter paths repeat their end. Empty when paths were not kept.
    path_length : ndarray, (n,)
        Length from source to end, m; also the optical path, in air.
    weight : ndarray, (n,)
        Power that the path carries at its end, W. The detected ones add up to ``flux + stray``.
    n_bounces : ndarray of int32, (n,)
        Reflections on the way.
    status : ndarray of int8, (n,)
        0 detected; 1 escaped from the scene; 2 absorbed, or not resolved; 3 left when
        ``max_bounces`` was reached; 4 blocked by the lens: beside the detector, the
        field stop, or lost in the glass.
    ledger : mapping of str to float
        Power by fate, W; the names are those of `STATUS`, absorption by surface. What cannot be
        resolved in float64 is ``unresolved``.
    ledger_error : mapping of str to float
        Standard errors of the ledger, W.
    flux : float
        Detected power of light that met the hidden object, W.
    standard_error : float
        Of ``flux``, W.
    by_bounce, by_bounce_error : ndarray, (max_bounces + 1,)
        ``flux`` by the number of reflections, and its standard errors, W.
    stray, stray_error : float
        Detected power of light that never met the hidden object, and its standard error, W.
    wall_to_wall : float
        Power that arrives at the wall straight from the wall, over all reflections, W.
    trapped, trapped_error : float
        What the wall absorbs of that, its light-trap loss, and the standard error, W.
    mean_path_length : float
        Of the light in ``flux``, by power, m; 0 when there is none.
    n_rays : int
        Rays traced.
    stopped : {"rays", "tol", "time"}
        Which limit ended the tracing.
    seconds : float
        Wall-clock time.
    queries : mapping of str to int
        How often rays were held against each kind of surface, by name; what is absent or 0 was
        skipped.
    """

    points: Array
    path_length: Array
    weight: Array
    n_bounces: NDArray[np.int32]
    status: NDArray[np.int8]
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
    seconds: float = 0.0
    queries: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))

    def __post_init__(self) -> None:
        arrays = (self.points, self.path_length, self.weight, self.n_bounces, self.status)
        for array in (*arrays, self.by_bounce, self.by_bounce_error):
            array.flags.writeable = False
