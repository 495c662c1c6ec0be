"""Pictures in matplotlib: axes in, axes out; nothing is computed and nothing is shown.

matplotlib is the extra ``nlosoptics[views]`` and is imported by the first picture. Figures are made
without pyplot, so they need no display and keep no global state: `save` writes them.
"""

from .canvas import save
from .comparisons import compare_methods
from .curves import encircled_energy, history, mtf
from .films import save_film, transient, transient_film
from .light import irradiance, ray_paths
from .limits import feasibility
from .maps import hybrid_parts, image, point_spread, reconstruction, wavefront
from .plans import plan
from .sketch import scene_sketch
from .spots import spot_diagram
from .volumes import volume

__all__ = [
    "compare_methods",
    "encircled_energy",
    "feasibility",
    "history",
    "hybrid_parts",
    "image",
    "irradiance",
    "mtf",
    "plan",
    "point_spread",
    "ray_paths",
    "reconstruction",
    "save",
    "save_film",
    "scene_sketch",
    "spot_diagram",
    "transient",
    "transient_film",
    "volume",
    "wavefront",
]
