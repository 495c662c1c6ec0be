"""Exit pupil and waves of a scene, computed once and shared by several computations."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import cached_property
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import vector
from ...errors import SamplingError, SceneError
from ...scene import Scene
from .exit_pupil import ExitPupil, exit_pupil
from .wall_view import WallView, view_along
from .wall_wavefront import AimedWave, aimed_wave

Array = NDArray[np.float64]
Found = TypeVar("Found")

#: Numbers of pupil samples to try after those of ``nodes="auto"``: radii of polar nodes, with four
#: times as many angles, or cells per side of a grid.
FINER: Final = {"polar": (48, 96), "grid": (1024, 2048)}


class PointOptics:
    """Exit pupil, rays and wave for one object point seen by the wall.

    Parameters
    ----------
    scene : Scene
        Scene with the wall and the camera.
    pupil : ExitPupil
        Exit pupil of the scene.
    object_point : ndarray, (3,)
        Object point, world frame, m.

    Attributes
    ----------
    first : AimedWave
        Wave at the nodes that ``nodes="auto"`` selects, with its rays, including the chief ray.
    """

    def __init__(self, scene: Scene, pupil: ExitPupil, object_point: Array) -> None:
        self.scene, self.exit_pupil, self.object_point = scene, pupil, object_point
        # Aimed here: the lock of a cached property would make threads for several points wait.
        self.first = aimed_wave(scene, pupil, object_point)
        self._kept: dict[Hashable, Any] = {}

    @property
    def zoom(self) -> float:
        """Ratio of the exit pupil's size to that of the cone on the lens.

        It is 1 if the lens is the stop, and negative if the wall is, whose image is inverted.
        """
        return self.exit_pupil.image_distance / self.scene.image_distance

    @cached_property
    def view(self) -> WallView:
        """First-order view of the wall from the exit pupil about the chief ray of this point."""
        return view_along(self.scene, self.zoom, self.object_point, self.first.rays.points[0])

    def once(self, key: Hashable, make: Callable[[], Found]) -> Found:
        """Return the result of ``make``, which is called once for a key and then kept."""
        if key not in self._kept:
            self._kept[key] = make()
        found: Found = self._kept[key]
        return found

    def refined(self, use: Callable[[AimedWave], Found]) -> tuple[AimedWave, Found]:
        """Apply a function to the wave, with more pupil nodes each time they are too few.

        Parameters
        ----------
        use : callable
            Function of an `AimedWave` that raises `SamplingError` if its nodes are too few.

        Returns
        -------
        aimed : AimedWave
            Wave with enough nodes.
        found : object
            Result of the function for it.

        Raises
        ------
        SamplingError
            If even the largest number of nodes is too few.
        """
        aimed, layout = self.first, self.first.wave.layout
        for samples in FINER[layout]:
            try:
                return aimed, use(aimed)
            except SamplingError:
                aimed = aimed_wave(self.scene, self.exit_pupil, self.object_point, layout, samples)
        return aimed, use(aimed)


class SceneOptics:
    """Store of a scene's exit pupil and waves, so that several calls compute them only once.

    Parameters
    ----------
    scene : Scene
        Scene with the wall, the camera and the hidden object.
    pupil : ExitPupil, optional
        Exit pupil of the scene; computed if omitted.

    See Also
    --------
    scene_point_spread : Wave and PSF of a scene.
    wavefront : Wave aberration of a scene.

    Notes
    -----
    Functions that document ``scene : Scene or SceneOptics`` accept either. If several calls get the
    same `SceneOptics`, the exit pupil and the wave of the reference point are computed only once.
    Results are stored in this object only; there is no global cache.

    Examples
    --------
    >>> from nlosoptics import Scene, psf
    >>> optics = psf.SceneOptics(Scene.load("examples/scenes/letter_flat.toml"))
    >>> optics.at().first.wave.layout, optics.exit_pupil.stop
    ('polar', 'lens')
    """

    def __init__(self, scene: Scene, pupil: ExitPupil | None = None) -> None:
        if not isinstance(scene, Scene):
            raise SceneError(
                f"scene is a {type(scene).__name__}; give a Scene, such as Scene.load()"
            )
        if not isinstance(pupil, ExitPupil | None):
            raise SceneError(
                f"pupil is a {type(pupil).__name__}; give an ExitPupil, or leave it out"
            )
        self.scene, self._pupil = scene, pupil

    @cached_property
    def exit_pupil(self) -> ExitPupil:
        """Exit pupil of the scene."""
        return exit_pupil(self.scene) if self._pupil is None else self._pupil

    @cached_property
    def reference(self) -> PointOptics:
        """Pupil and waves for the hidden object's reference point, as returned by `at`."""
        return PointOptics(self.scene, self.exit_pupil, self.scene.object_point)

    def at(self, object_point: ArrayLike | None = None) -> PointOptics:
        """Return pupil and waves for an object point.

        Parameters
        ----------
        object_point : array_like, (3,), optional
            Object point, world frame, m; by default the hidden object's reference point. Only the
            optics of the reference point are stored.

        Returns
        -------
        PointOptics
            Optics of the point. Its ``first.wave`` is the `Wavefront` that `wavefront` returns for
            this point with ``nodes="auto"``.
        """
        if object_point is None:
            return self.reference
        point = np.array(vector("object_point", object_point))
        if np.array_equal(point, self.scene.object_point):
            return self.reference
        return PointOptics(self.scene, self.exit_pupil, point)


def optics_of(scene: Scene | SceneOptics) -> SceneOptics:
    """Return a scene's optics; a `SceneOptics` is returned unchanged."""
    return scene if isinstance(scene, SceneOptics) else SceneOptics(scene)
