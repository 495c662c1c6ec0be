"""Pictures: axes or plotters in and out; nothing is computed and nothing is shown.

matplotlib and pyvista are the extra ``nlosoptics[views]`` and are imported by the first picture
that needs them. Figures are made without pyplot, so they need no display and keep no global state;
plotters draw off the screen. `save` writes either.
"""

from .canvas import save
from .light import irradiance
from .limits import feasibility
from .maps import hybrid_parts, image, point_spread, reconstruction, wavefront
from .pages import html_page
from .phasor_volumes import phasor_volume
from .probing import rendering_works, window
from .rooms import ray_paths, scene_3d
from .sketch import scene_sketch
from .volumes import volume

__all__ = [
    "feasibility",
    "html_page",
    "hybrid_parts",
    "image",
    "irradiance",
    "phasor_volume",
    "point_spread",
    "ray_paths",
    "reconstruction",
    "rendering_works",
    "save",
    "scene_3d",
    "scene_sketch",
    "volume",
    "wavefront",
    "window",
]
