"""Pictures: axes or plotters in and out; nothing is computed and nothing is shown.

matplotlib and pyvista are the extra ``nlosoptics[views]`` and are imported by the first picture
that needs them. Figures are made without pyplot, so they need no display and keep no global state;
plotters draw off the screen. `save` writes either.
"""

from .comparisons import compare_methods
from .curves import encircled_energy, history, mtf, spot_diagram
from .films import transient, transient_film
from .forecasts import feasibility, plan
from .maps import hybrid_parts, image, irradiance, point_spread, reconstruction, wavefront
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
    "ray_paths",
    "reconstruction",
    "rendering_works",
    "save",
    "scene_3d",
    "scene_sketch",
    "spot_diagram",
    "transient",
    "transient_film",
    "volume",
    "wavefront",
    "window",
]
