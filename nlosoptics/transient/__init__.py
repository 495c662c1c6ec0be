"""Time-resolved light: captures off a relay wall, rendered or measured, and their pictures.

- `captures`: `TransientCapture`, light at wall points over optical path.
- `gating`: what measured captures need before imaging.
- `volumes`: `Volume`, where a hidden scene is looked for, and `VolumeImage`, what was seen there.
- `backprojections`, `migration`, `light_cones`: such pictures by the classic methods.
- `depths`: depth maps of them, of meshes, and their errors.
"""

from .backprojections import backprojection
from .captures import TransientCapture, wall_grid
from .depths import DepthError, DepthMap, depth_error, depth_map, true_depths, voxelised
from .gating import distance_weighted, downsampled, gated, smoothed, without_outer_legs
from .light_cones import lct
from .migration import fk_migration
from .volumes import Volume, VolumeImage

__all__ = [
    "DepthError",
    "DepthMap",
    "TransientCapture",
    "Volume",
    "VolumeImage",
    "backprojection",
    "depth_error",
    "depth_map",
    "distance_weighted",
    "downsampled",
    "fk_migration",
    "gated",
    "lct",
    "smoothed",
    "true_depths",
    "voxelised",
    "wall_grid",
    "without_outer_legs",
]
