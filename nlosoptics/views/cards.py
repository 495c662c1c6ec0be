"""Figures on the cards that result objects show in notebooks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from .. import views

#: Drawing function by class name, so that no class is imported before an object of it exists.
PICTURES: Final[Mapping[str, Callable[[Any], Any]]] = {
    "Scene": lambda noun: views.scene_sketch(noun),
    "Wavefront": lambda noun: views.wavefront(noun),
    "PupilField": lambda noun: views.pupil_field(noun),
    "PointSpread": lambda noun: views.point_spread(noun),
    "ThroughFocus": lambda noun: views.through_focus(noun),
    "SpeckleImage": lambda noun: views.image(noun),
    "TracedImage": lambda noun: views.traced_image(noun),
    "Reconstruction": lambda noun: views.reconstruction(noun),
    "Feasibility": lambda noun: views.feasibility(noun),
    "TransientCapture": lambda noun: views.transient(noun, at=()),
    "VolumeImage": lambda noun: views.volume(noun),
}


def axes(noun: Any) -> Any:
    """Draw an object by the function for its class, or for the nearest base class.

    Parameters
    ----------
    noun : object
        Object of a class that has an entry in `PICTURES`, or of a subclass.

    Returns
    -------
    Axes or tuple of Axes
        Matplotlib axes of one new figure.

    Raises
    ------
    NlosError
        If matplotlib is missing, or the object cannot be drawn.
    """
    names = (base.__name__ for base in type(noun).__mro__)
    return next(PICTURES[name] for name in names if name in PICTURES)(noun)
