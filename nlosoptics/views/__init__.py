"""Pictures in matplotlib: axes in, axes out; nothing is computed and nothing is shown.

matplotlib is the extra ``nlosoptics[views]`` and is imported by the first picture. Figures are made
without pyplot, so they need no display and keep no global state: `save` writes them.
"""

from .canvas import save
from .light import irradiance, ray_paths
from .limits import feasibility
from .maps import hybrid_parts, image, point_spread, reconstruction, wavefront
from .sketch import scene_sketch
from .volumes import volume

__all__ = [
    "feasibility",
    "hybrid_parts",
    "image",
    "irradiance",
    "point_spread",
    "ray_paths",
    "reconstruction",
    "save",
    "scene_sketch",
    "volume",
    "wavefront",
]
