"""Exit pupil and waves of a scene, computed once and shared by several computations."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import cached_property
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ..._checks import expect
from ..._vectors import Array
from ...errors import SamplingError
from ...scene import Scene
from .aiming import point_of
from .exit_pupil import ExitPupil, exit_pupil
from .wall_view import WallView, view_along
from .wall_wavefront import AimedWave, aimed_wave

Found = TypeVar("Found")

#: Numbers of pupil samples to try after those of ``nodes="auto"``: radii of polar nodes, with four
#: times as many angles, or cells per side of a grid.
FINER: Final = {"polar": (48, 96), "grid": (1024, 2048)}


class PointOptics:
    """Store of the wave of one object point, so that several computations share it.

    `SceneOptics.at` returns one.

    Parameters
    ----------
    scene : Scene
        Scene with the wall and the camera.
    pupil : ExitPupil
        Exit pupil of the scene.
    object_point : ndarray, (3,)
        Object point in world coordinates, m.

    Attributes
    ----------
    first : AimedWave
        Wave of the object point with the default sampling of `wavefront`, and the rays that it was
        computed from; ``first.wave`` is the `Wavefront`.
    """

    def __init__(self, scene: Scene, pupil: ExitPupil, object_point: Array) -> None:
        self.scene, self.exit_pupil, self.object_point = scene, pupil, object_point
        # Aimed here: the lock of a cached property would make threads for several points wait.
        self.first = aimed_wave(scene, pupil, object_point)
        self._kept: dict[Hashable, Any] = {}

    @property
    def zoom(self) -> float:
        """Size of the exit pupil divided by that of the cone of light on the lens.

        It is 1 if the lens is the stop. If the wall is the stop, it is negative, because the image
        of the wall is inverted.
        """
        return self.exit_pupil.image_distance / self.scene.image_distance

    @cached_property
    def view(self) -> WallView:
        """Linear map from the exit pupil to the wall for this object point, see `wall_view`."""
        return view_along(self.scene, self.zoom, self.object_point, self.first.rays.points[0])

    def once(self, key: Hashable, make: Callable[[], Found]) -> Found:
        """Return the result of ``make()``, which is computed once and then stored under the key."""
        if key not in self._kept:
            self._kept[key] = make()
        found: Found = self._kept[key]
        return found

    def refined(self, use: Callable[[AimedWave], Found]) -> tuple[AimedWave, Found]:
        """Return the wave and the result of a function of it that may raise `SamplingError`.

        Then it is repeated with more pupil samples, up to the largest number.
        """
        aimed, layout = self.first, self.first.wave.layout
        for samples in FINER[layout]:
            try:
                return aimed, use(aimed)
            except SamplingError:
                aimed = aimed_wave(self.scene, self.exit_pupil, self.object_point, layout, samples)
        return aimed, use(aimed)


class SceneOptics:
    """Store of a scene's exit pupil and wave, so that several calls compute them only once.

    Give it in place of the scene to functions that accept ``Scene or SceneOptics``.

    Parameters
    ----------
    scene : Scene
        Scene with the wall, the camera and the hidden object.
    pupil : ExitPupil, optional
        Exit pupil of the scene; by default `exit_pupil` computes it.

    See Also
    --------
    scene_point_spread : Wave and PSF of a scene.

    Notes
    -----
    The exit pupil and the wave of the object's reference point are computed when they are first
    needed. The reference point is the centre of a planar object or the centroid of a mesh. Results
    are stored in this object only; there is no global cache.

    Examples
    --------
    Two point spreads that share one computed wave:

    >>> from nlosoptics import Scene, psf
    >>> optics = psf.SceneOptics(Scene.load("examples/scenes/letter_flat.toml"))
    >>> coarse = psf.scene_point_spread(optics, tol=1e-2)
    >>> wide = psf.scene_point_spread(optics, tol=1e-2, pitch=2 * coarse.point_spread.pitch)
    >>> coarse.wavefront is wide.wavefront is optics.at().first.wave
    True
    """

    def __init__(self, scene: Scene, pupil: ExitPupil | None = None) -> None:
        self.scene: Scene = expect("scene", scene, "Scene")
        if pupil is not None:
            expect("pupil", pupil, "ExitPupil")
        scene.check_black_occluders()
        self._pupil = pupil
        self._kept: dict[tuple[float, ...], PointOptics] = {}

    @cached_property
    def exit_pupil(self) -> ExitPupil:
        """Exit pupil of the scene."""
        return exit_pupil(self.scene) if self._pupil is None else self._pupil

    @cached_property
    def reference(self) -> PointOptics:
        """Wave of the hidden object's reference point; the same as ``at()``."""
        return PointOptics(self.scene, self.exit_pupil, self.scene.object_point)

    def at(self, object_point: ArrayLike | None = None) -> PointOptics:
        """Return the waves of an object point.

        Parameters
        ----------
        object_point : array_like, (3,), optional
            Object point in world coordinates, m. Default: the hidden object's reference point, that
            is the centre of a planar object or the centroid of a mesh. The waves of the first 16
            points are stored.

        Returns
        -------
        PointOptics
            Store of this object point. Its first wave, ``first.wave``, is the `Wavefront` that
            `wavefront` returns by default. Computations that need more pupil samples compute
            further waves of this point.
        """
        point = point_of(self.scene, object_point)
        if np.array_equal(point, self.scene.object_point):
            return self.reference
        place = tuple(point.tolist())
        found = self._kept.get(place) or PointOptics(self.scene, self.exit_pupil, point)
        # enough for the reference point, corners and edges, and a few more
        if len(self._kept) < 16:
            self._kept[place] = found
        return found


def optics_of(scene: Scene | SceneOptics) -> SceneOptics:
    """Return a scene's optics; a `SceneOptics` is returned unchanged."""
    return scene if isinstance(scene, SceneOptics) else SceneOptics(scene)
