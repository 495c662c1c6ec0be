"""Time-resolved captures of a relay wall, and images reconstructed from them.

`render` and `render_scene` compute a `TransientCapture`; `TransientCapture.load` reads one from a
file of this or another program. `phasor_image`, `fk_migration`, `lct`, `backprojection` and
`inverse_image` reconstruct a `VolumeImage`, and `depth_map` returns its depths.
"""

from .capture.capture import TransientCapture
from .capture.detector import Detector, without_pile_up
from .capture.hidden_light import hidden_light
from .capture.preprocessing import downsampled, gated, normal_moveout, without_outer_legs
from .capture.wall_points import wall_grid
from .imaging.advice import advise
from .imaging.backprojection import backprojection
from .imaging.depth import depth_error, depth_map, true_depths
from .imaging.fk_migration import fk_migration
from .imaging.inverse import inverse_image
from .imaging.light_cone_transform import lct
from .imaging.phasor_camera import phasor_image
from .imaging.volume import PhasorImage, Volume, VolumeImage
from .rendering.render import render
from .rendering.scan import Scan
from .rendering.scene import render_scene

__all__ = [
    "Detector",
    "PhasorImage",
    "Scan",
    "TransientCapture",
    "Volume",
    "VolumeImage",
    "advise",
    "backprojection",
    "depth_error",
    "depth_map",
    "downsampled",
    "fk_migration",
    "gated",
    "hidden_light",
    "inverse_image",
    "lct",
    "normal_moveout",
    "phasor_image",
    "render",
    "render_scene",
    "true_depths",
    "wall_grid",
    "without_outer_legs",
    "without_pile_up",
]


def __getattr__(name: str) -> object:
    """Name the right call for one that other libraries have."""
    instead = "; use TransientCapture.load(path)" if name == "load_capture" else ""
    raise AttributeError(f"nlosoptics.transient has no {name}{instead}")


def __dir__() -> list[str]:
    """Return the public names, for completion."""
    return __all__
