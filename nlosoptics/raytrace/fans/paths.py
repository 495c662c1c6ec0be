"""Results of ray tracing: light paths, and the power balance by fate of the light."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ..._nouns import Noun
from ..._xarray import Labelled, Labels, variable

Array = NDArray[np.float64]

#: Status numbers of a path.
DETECTED, ESCAPED, ABSORBED, LEFT, BLOCKED = range(5)
#: Surfaces of the points of a path.
NO_SURFACE, ON_WALL, ON_OBJECT, ON_OCCLUDER = range(-1, 3)


@dataclass(frozen=True, eq=False, kw_only=True)
class RayPaths(Noun, Labelled):
    """Light paths through a scene, and the power of the light, sorted by how its paths end.

    `trace` returns the paths from the laser to the detector, and `pupil_rays` those from one object
    point to the lens. ``ledger`` and all values listed after it include all traced light, even if
    no single paths were kept.

    Parameters
    ----------
    points : ndarray, (n, k, 3)
        Vertices of n paths, m: the source, each point of reflection, and the end. They are in the
        world frame: origin at the centre of the relay wall, z toward the room, y up.
        A path with fewer than k vertices repeats its end. n is 0 if no paths were kept.
    path_length : ndarray, (n,)
        Length of each path from source to end, m; equal to the optical path in air.
    weight : ndarray, (n,)
        Power that each path carries at its end, W. If all detected paths were kept, their weights
        add up to ``flux + stray``.
    n_bounces : ndarray of int32, (n,)
        Number of reflections of each path.
    status : ndarray of int8, (n,)
        How each path ended. 0: at the detector; for `pupil_rays`, at the lens. 1: outside the
        scene. 2: absorbed, or at a hit that could not be resolved in float64. 3: still under way
        when tracing ended, usually after ``max_bounces`` reflections. 4: at the lens, but without
        reaching the detector, because of its edges or of the field stop.
    surface : ndarray of int8, (n, k)
        Surface that reflects the light at each vertex: 0 for the wall, 1 for the hidden object, 2
        for an occluder, -1 for the source and the end. Empty for `pupil_rays`.
    lobe : ndarray of int8, (n, k)
        Index, from 0, of the lobe that reflects most of the path's light at each vertex; -1 for the
        source and the end. Lobes are the parts of the surface's material, each with its own angular
        distribution, such as diffuse or glossy. Light that leaves in exactly the mirror direction
        is assigned to the lobe of a smooth mirror, if the material has one. Empty for `pupil_rays`.
    ledger : mapping of str to float
        Power by where it ended, W. "detected"; "escaped" from the scene; "left", still under way
        when tracing ended; "blocked" at the lens, including its transmission loss; "absorbed by
        wall", "absorbed by object", "absorbed by occluders"; "unresolved", on rays whose hit could
        not be resolved in float64. `pupil_rays` gives only the first three, without any that is 0.
    ledger_error : mapping of str to float
        Standard error of each value in ``ledger``, W.
    flux : float
        Detected power of light that met the hidden object, W. For `pupil_rays`, the power through
        the lens for a source of 1 W/sr.
    standard_error : float
        Standard error of ``flux``, W.
    by_bounce, by_bounce_error : ndarray, (max_bounces + 1,)
        Element j is the part of ``flux`` that was reflected j times, and its standard error, W.
    stray, stray_error : float
        Detected power of light that never met the hidden object, and its standard error, W.
    wall_to_wall : float
        Power that the wall reflects directly to another point of the wall, W. Light that does so
        several times is counted each time.
    trapped, trapped_error : float
        Part of ``wall_to_wall`` that the wall absorbs on arrival (light-trap loss), and its
        standard error, W.
    mean_path_length : float
        Power-weighted mean path length of the light in ``flux``, m; 0 if ``flux`` is 0.
    n_rays : int
        Number of rays traced.
    stopped : {"rays", "tol", "time"}
        Limit that ended the tracing: the number of rays, the requested error, or the time limit.
    uncertain : tuple of str
        Names of results to which a few rare paths contribute most: ``"flux"``, ``"stray"`` or, for
        element 4 of ``by_bounce``, ``"bounce 4"``. Their standard errors were increased, but may
        still be too small; trace more rays.
    unreached : tuple of str
        Kinds of paths that no sampling method aims at, so that rays find them only rarely. The
        results may miss light on these paths, and the errors may not show it.
    seconds : float
        Wall-clock time, s.
    queries : mapping of str to int
        Number of intersection tests by kind: "wall" and "mesh", where rays were tested for a hit;
        "wall shadow" and "shadow", where connecting lines were tested against the wall and against
        meshes; and "wall to wall", the rays in "wall" that start on the wall. A kind that was
        skipped is absent or 0.

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
    surface: NDArray[np.int8] = field(default_factory=lambda: np.zeros((0, 0), np.int8))
    lobe: NDArray[np.int8] = field(default_factory=lambda: np.zeros((0, 0), np.int8))
    ledger: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    ledger_error: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
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
        for name in ("points", "path_length", "weight", "n_bounces", "status", "surface", "lobe"):
            getattr(self, name).flags.writeable = False
        for array in (self.by_bounce, self.by_bounce_error):
            array.flags.writeable = False

    @property
    def met_object(self) -> NDArray[np.bool_]:
        """Whether the light of each path was reflected by the hidden object, (n,) bool.

        It is False everywhere if ``surface`` is empty.
        """
        if not self.surface.size:
            return np.zeros(len(self.weight), dtype=bool)
        return np.asarray((self.surface == ON_OBJECT).any(axis=1))

    def _labels(self) -> Labels:
        arrays = {
            axis: variable(["path", "vertex"], self.points[..., i], "m", f"vertex {axis}")
            for i, axis in enumerate("xyz")
        }
        names = {
            "path_length": ("m", "length from source to end"),
            "weight": ("W", "power at the end"),
            "n_bounces": ("1", "number of reflections"),
            "status": ("1", "end of the path: 0 for the detector"),
            "surface": ("1", "0: wall, 1: object, 2: occluder"),
            "lobe": ("1", "index of the material's lobe"),
        }
        for name, (unit, meaning) in names.items():
            values = getattr(self, name)
            if len(values) == len(self.points):  # fans from one point have no surface and lobe
                arrays[name] = variable(["path", "vertex"][: values.ndim], values, unit, meaning)
        totals = ("flux", "standard_error", "stray", "stray_error", "mean_path_length", "n_rays")
        return Labels(arrays, {}, {name: getattr(self, name) for name in totals})
