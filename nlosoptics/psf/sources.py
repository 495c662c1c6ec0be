"""Functions of a wave or a point spread that take a scene as well, as `nlosoptics.psf` has them."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any, Concatenate, ParamSpec, TypeVar

from ..scene import Scene
from .exchange import prysm_maps
from .metrics import focus, psf_metrics
from .metrics import spot_diagram as spots
from .pupil.scene_optics import SceneOptics
from .pupil.wall_wavefront import wavefront
from .transform import point_spread as transforms
from .transform.point_spread import PointSpread
from .walls.scene_psf import scene_point_spread

P = ParamSpec("P")
R = TypeVar("R")


def _wave(source: Any, **options: Any) -> Any:
    """Return the wave of a scene; all else unchanged."""
    scene = source.scene if isinstance(source, SceneOptics) else source
    return wavefront(scene, **options) if isinstance(scene, Scene) else source


def _spread(source: Any) -> Any:
    """Return the point spread of a scene; all else unchanged."""
    if isinstance(source, Scene | SceneOptics):
        return scene_point_spread(source).point_spread
    return source


def _taking(
    function: Callable[Concatenate[Any, P], R], of: Callable[[Any], Any]
) -> Callable[Concatenate[Any, P], R]:
    """Return a function whose first argument is what ``of`` makes of that given."""
    name = next(iter(inspect.signature(function).parameters))
    call: Any = function

    @functools.wraps(function)
    def taking(*arguments: Any, **options: Any) -> R:
        if arguments:
            arguments = of(arguments[0]), *arguments[1:]
        else:
            arguments = (of(options.pop(name, None)),)
        result: R = call(*arguments, **options)
        return result

    taking.__module__ = __name__  # where pickle finds it
    return taking


@functools.wraps(transforms.point_spread)
def point_spread(wavefront: Any, **options: Any) -> PointSpread:
    """Return the point spread of a wave, or of a scene or result by `scene_point_spread`."""
    source = getattr(wavefront, "scene", wavefront)
    if isinstance(source, Scene):
        return scene_point_spread(source, **options).point_spread
    return transforms.point_spread(wavefront, **options)


point_spread.__module__ = __name__
best_focus = _taking(focus.best_focus, _wave)
focus_shifted = _taking(focus.focus_shifted, _wave)
through_focus = _taking(focus.through_focus, _wave)
fit_zernike = _taking(psf_metrics.fit_zernike, _wave)
mtf = _taking(psf_metrics.mtf, _wave)
ptf = _taking(psf_metrics.ptf, _wave)
rms_aberration = _taking(psf_metrics.rms_aberration, _wave)
strehl = _taking(psf_metrics.strehl, _wave)
spot_diagram = _taking(spots.spot_diagram, _wave)
spot_radius = _taking(spots.spot_radius, _wave)
to_prysm = _taking(prysm_maps.to_prysm, functools.partial(_wave, nodes="grid"))
centroid = _taking(spots.centroid, _spread)
encircled_energy = _taking(psf_metrics.encircled_energy, _spread)
ensquared_energy = _taking(psf_metrics.ensquared_energy, _spread)
fwhm = _taking(psf_metrics.fwhm, _spread)
