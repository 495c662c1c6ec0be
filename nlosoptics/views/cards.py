"""Figures on the cards that result objects show in notebooks and in reports."""

from __future__ import annotations

from typing import Any

from .. import views

#: Drawing function by class name, so that no class is imported before an object of it exists.
PICTURES = {
    "Result": "overview",
    "Scene": "scene_sketch",
    "Wavefront": "wavefront",
    "PupilField": "wavefront",
    "PointSpread": "point_spread",
    "ThroughFocus": "through_focus",
    "SpeckleImage": "image",
    "TracedImage": "traced_image",
    "Reconstruction": "reconstruction",
    "Feasibility": "feasibility",
    "TransientCapture": "transient",
    "VolumeImage": "volume",
}


def axes(noun: Any) -> Any:
    """Draw an object by the function for its class, or for the nearest base class.

    Raises
    ------
    NlosError
        If matplotlib is missing, or the object cannot be drawn.
    """
    names = (base.__name__ for base in type(noun).__mro__)
    return getattr(views, next(PICTURES[name] for name in names if name in PICTURES))(noun)
