"""Geometry of a scene, computed once and handed to everything that needs it."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Final, TypeVar

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

#: Pupil samples that follow those of ``nodes="auto"`` where they are too few: radii of polar nodes,
#: with four times as many angles, or cells along each side of a grid.
FINER: Final = {"polar": (48, 96), "grid": (1024, 2048)}


class PointOptics:
    """Exit pupil, rays and wave of one object point by the wall.

    Parameters
    ----------
    scene : Scene
        Scene with the wall and the camera.
    pupil : ExitPupil
        Exit pupil of the scene.
    object_point : ndarray, (3,)
        World, m.

    Attributes
    ----------
    first : AimedWave
        Wave at the nodes that ``nodes="auto"`` takes, with its rays, the chief ray among them.
    """

    def __init__(self, scene: Scene, pupil: ExitPupil, object_point: Array) -> None:
        self.scene, self.exit_pupil, self.object_point = scene, pupil, object_point
        # aimed at once: threads that look at several points would wait for a cached property
        self.first = aimed_wave(scene, pupil, object_point)

    @property
    def zoom(self) -> float:
        """Size of the exit pupil over that of the lens; 1 where the lens is the stop."""
        return self.exit_pupil.image_distance / self.scene.image_distance

    @cached_property
    def view(self) -> WallView:
        """How the exit pupil sees the wall about the chief ray of this point."""
        return view_along(self.scene, self.zoom, self.object_point, self.first.rays.points[0])

    def refined(self, use: Callable[[AimedWave], Found]) -> tuple[AimedWave, Found]:
        """Apply a function to the wave, with more pupil nodes as long as they are too few.

        Parameters
        ----------
        use : callable
            Takes an `AimedWave`, and raises `SamplingError` where its nodes are too few.

        Returns
        -------
        aimed : AimedWave
            Wave whose nodes are enough.
        found : object
            What the function returns for it.

        Raises
        ------
        SamplingError
            If the largest number of nodes is too few.
        """
        aimed, layout = self.first, self.first.wave.layout
        for samples in FINER[layout]:
            try:
                return aimed, use(aimed)
            except SamplingError:
                aimed = aimed_wave(self.scene, self.exit_pupil, self.object_point, layout, samples)
        return aimed, use(aimed)


class SceneOptics:
    """Geometry of a scene that several computations share, each part computed at most once.

    Parameters
    ----------
    scene : Scene
        Scene to look at.
    pupil : ExitPupil, optional
        Its exit pupil, where that is known.

    Notes
    -----
    Functions that document ``scene : Scene or SceneOptics`` take either. With one `SceneOptics` for
    several calls, the exit pupil and the wave of the reference point are computed once; it lives
    and ends with the variable that holds it, and no scene or wave is kept anywhere else.
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
        """Optics of the hidden object's reference point."""
        return PointOptics(self.scene, self.exit_pupil, self.scene.object_point)

    def at(self, object_point: ArrayLike | None = None) -> PointOptics:
        """Optics of an object point.

        Parameters
        ----------
        object_point : array_like, (3,), optional
            World, m; by default the hidden object's reference point, whose optics are kept.

        Returns
        -------
        PointOptics
        """
        if object_point is None:
            return self.reference
        point = np.array(vector("object_point", object_point))
        if np.array_equal(point, self.scene.object_point):
            return self.reference
        return PointOptics(self.scene, self.exit_pupil, point)


def optics_of(scene: Scene | SceneOptics) -> SceneOptics:
    """Optics of a scene, made where only the scene is given."""
    return scene if isinstance(scene, SceneOptics) else SceneOptics(scene)
