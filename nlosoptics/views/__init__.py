"""Figures, films and 3-D views of results; `save` writes them to files.

Every function draws on the axes or the plotter that is passed, or on a new one, and returns it.
Nothing is computed here, and no window opens. matplotlib and pyvista belong to the extra
``nlosoptics[views]`` and are imported when the first figure needs them. Figures are made without
pyplot, so that they need no display and keep no global state; plotters render off screen.
"""

from .curves import (
    compare_methods,
    encircled_energy,
    history,
    mtf,
    spot_diagram,
    through_focus,
)
from .films import transient, transient_film
from .forecasts import feasibility, plan
from .maps import (
    hybrid_parts,
    image,
    irradiance,
    point_spread,
    pupil_field,
    reconstruction,
    wavefront,
)
from .overview import overview
from .pages import html_page
from .rooms import ray_paths, scene_3d
from .saving import save
from .sketch import scene_sketch
from .stages import rendering_works, window
from .volumes import phasor_volume, volume

__all__ = [
    "compare_methods",
    "encircled_energy",
    "feasibility",
    "history",
    "html_page",
    "hybrid_parts",
    "image",
    "irradiance",
    "mtf",
    "overview",
    "phasor_volume",
    "plan",
    "point_spread",
    "pupil_field",
    "ray_paths",
    "reconstruction",
    "rendering_works",
    "save",
    "scene_3d",
    "scene_sketch",
    "spot_diagram",
    "through_focus",
    "transient",
    "transient_film",
    "volume",
    "wavefront",
    "window",
]
