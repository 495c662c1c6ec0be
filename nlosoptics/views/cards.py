"""Pictures on the cards that nouns show in notebooks; the figures are their own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from .. import views

#: How a noun is drawn, by the name of its class or of a base; no class is loaded for it.
PICTURES: Final[Mapping[str, Callable[[Any], Any]]] = {
    "Scene": lambda noun: views.scene_sketch(noun),
    "Wavefront": lambda noun: views.wavefront(noun),
    "PointSpread": lambda noun: views.point_spread(noun),
    "SpeckleImage": lambda noun: views.image(noun),
    "Reconstruction": lambda noun: views.reconstruction(noun),
    "Feasibility": lambda noun: views.feasibility(noun),
    "TransientCapture": lambda noun: views.transient(noun, at=()),
    "VolumeImage": lambda noun: views.volume(noun),
}


def axes(noun: Any) -> Any:
    """Matplotlib axes, or several of one figure, that show a noun.

    Raises
    ------
    NlosError
        If matplotlib is missing, or the noun cannot be drawn.
    """
    names = (base.__name__ for base in type(noun).__mro__)
    return next(PICTURES[name] for name in names if name in PICTURES)(noun)
