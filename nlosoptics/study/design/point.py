"""One point of a study: its scene, and the stages that its figures of merit share."""

from __future__ import annotations

import json
import warnings
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from ...errors import NlosError, ValidityWarning
from ...scene.file.addresses import NOT_IN_POINT_SPREAD, changed, value_at

if TYPE_CHECKING:
    from ...limits import Feasibility
    from ...psf import ScenePointSpread
    from ...scene import Scene
    from .base import Base


def point_spread_key(delta: Mapping[str, Any]) -> str:
    """Return a text that is equal for points with the same point spread."""
    read = {
        address: value
        for address, value in delta.items()
        if not address.startswith(NOT_IN_POINT_SPREAD)
    }
    return json.dumps(read, sort_keys=True)


class StageCache:
    """Latest ``most`` results of a stage by key, including refusals and warnings."""

    def __init__(self, most: int = 4) -> None:
        self._most = most
        self._results: OrderedDict[str, tuple[Any, tuple[str, ...]]] = OrderedDict()

    def get(self, key: str, make: Callable[[], Any]) -> tuple[Any, tuple[str, ...]]:
        """Return the result of ``make`` and its warnings; raise the `NlosError` that it raised."""
        entry = self._results.get(key)
        if entry is None:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("ignore")
                warnings.simplefilter("always", ValidityWarning)
                try:
                    result = make()
                except NlosError as error:
                    result = error
            texts = tuple(dict.fromkeys(str(warning.message) for warning in caught))
            entry = self._results[key] = result, texts
            if len(self._results) > self._most:
                self._results.popitem(last=False)
        if isinstance(entry[0], NlosError):
            raise entry[0]
        return entry


def stage_caches() -> dict[str, StageCache]:
    """Return the caches that the points of a study share in one process."""
    return {
        "scene": StageCache(),
        "point spread": StageCache(),
        "forecast": StageCache(),
        "figure": StageCache(64),
    }


class StudyPoint:
    """One point of a study, a variant of its scene: argument of a figure of merit of your own.

    Such a figure of merit is a Python function that takes a point and returns a number. It can use
    the point's `scene`, `point_spread` and `forecast`, which are computed at first use and shared
    between points.

    Parameters
    ----------
    base : Base
        Base scene of the study.
    delta : mapping of str to value
        Values of the scene that this point changes, by address (table and key of the scene file,
        such as "wall.radius").
    seed : int
        Seed of this point.
    tol : float
        Error tolerance of point spread functions (PSFs), max |dI|/max I, with I the intensity.
    caches : mapping of str to StageCache
        Results that the points of a study share in one process.

    Attributes
    ----------
    seed : int
        Seed for random numbers of a figure of merit. It depends on the values of the point and the
        study's seed only.
    tol : float
        Error tolerance of PSFs, max |dI|/max I.
    base : Base
        Base scene of the study.

    See Also
    --------
    Study : Figures of merit over the points of a design.
    """

    def __init__(
        self,
        base: Base,
        delta: Mapping[str, Any],
        seed: int,
        tol: float,
        caches: Mapping[str, StageCache],
    ) -> None:
        self.seed, self.tol = seed, tol
        self.base, self._delta, self._caches = base, delta, caches
        self._adjusted: dict[str, StudyPoint] = {}
        self._key = json.dumps(dict(delta), sort_keys=True)
        self.warnings: dict[str, None] = {}

    def value(self, address: str) -> Any:
        """Return a value of the scene, written as in a scene file; None if it is absent.

        ``address`` is table and key of the value, such as "wall.radius".
        """
        return value_at(changed(self.base.tables, self._delta), address)

    def changed(self, delta: Mapping[str, Any]) -> StudyPoint:
        """Return a copy of the point with some values changed and the same seed.

        ``delta`` maps addresses (table and key of the scene file, such as "wall.radius") to values
        written as in a scene file.
        """
        return StudyPoint(self.base, {**self._delta, **delta}, self.seed, self.tol, self._caches)

    def adjusted(self, key: str, make: Callable[[], StudyPoint]) -> StudyPoint:
        """Return the point after compensation: with some values adjusted to improve it.

        Compensation stands for the adjustments of a real setup, such as refocusing the camera after
        its parts were mounted with errors. ``make`` is a function without arguments that returns
        the adjusted `StudyPoint`. It is called once for each ``key`` (str); later calls of this
        method with the same key return the stored point.
        """
        if key not in self._adjusted:
            self._adjusted[key] = make()
        return self._adjusted[key]

    @property
    def scene(self) -> Scene:
        """Scene of this point."""
        scene: Scene = self._stage("scene", self._key, lambda: self.base.scene(self._delta))
        return scene

    @property
    def point_spread(self) -> ScenePointSpread:
        """Wave and PSF of the object's reference point.

        Points that differ only in values on which the PSF does not depend share it.
        """
        from ... import psf

        key = point_spread_key(self._delta)
        found: ScenePointSpread = self._stage(
            "point spread", key, lambda: psf.scene_point_spread(self.scene, self.tol)
        )
        return found

    @property
    def forecast(self) -> Feasibility:
        """Prediction by `limits.feasibility` of what an image of the scene shows."""
        from ... import limits

        found: Feasibility = self._stage(
            "forecast", self._key, lambda: limits.feasibility(self.scene)
        )
        return found

    def of_point_spread(self, name: str, make: Callable[[], Any]) -> Any:
        """Return a figure of merit that depends on the point spread only.

        ``make`` is a function without arguments that returns the figure of merit. The result is
        stored under ``name`` (str), and points with the same point spread share it.
        """
        _ = self.point_spread  # its warnings belong to every point
        return self._stage("figure", f"{name} {point_spread_key(self._delta)}", make)

    def _stage(self, name: str, key: str, make: Callable[[], Any]) -> Any:
        result, texts = self._caches[name].get(key, make)
        self.warnings |= dict.fromkeys(texts)
        return result
