"""Time-resolved light: captures off a relay wall, rendered or measured, and their pictures.

- `captures`: `TransientCapture`, light at `wall_points` over optical path; files of it are read
  and written by `capture_files`, `tal_files`, `foreign_files` and `mat_files`.
- `rendering`: `render`, captures of hidden meshes; three bounces by quadrature (`three_bounces`),
  more by Monte Carlo (`multiple_bounces`). `scene_captures`: `render_scene`, of a scene file.
- `detectors`: `Detector`, which counts a capture's photons.
- `gating`: what measured captures need before imaging.
- `volumes`: `Volume`, where a hidden scene is looked for, and `VolumeImage`, what was seen there.
- `phasor_cameras`: `phasor_image`, virtual cameras by the waves of `phasor_fields`, set up by
  `phasor_setups` and carried by `plane_convolutions` or by `rayleigh_sommerfeld`;
  `phasor_images`: `PhasorImage`; `phasor_validity`: what limits it.
- `backprojections`, `migration`, `light_cones`: such pictures without a chosen wavelength, the
  latter two off the even `confocal_grids`.
- `depths`: depth maps of pictures and of meshes, and their errors.
"""

from .backprojections import backprojection
from .captures import TransientCapture
from .depths import DepthError, DepthMap, depth_error, depth_map, true_depths, voxelised
from .detectors import Detector
from .gating import distance_weighted, downsampled, gated, smoothed, without_outer_legs
from .light_cones import lct
from .migration import fk_migration
from .phasor_cameras import phasor_image
from .phasor_images import PhasorImage
from .rendering import render
from .scene_captures import render_scene
from .volumes import Volume, VolumeImage
from .wall_points import wall_grid

__all__ = [
    "DepthError",
    "DepthMap",
    "Detector",
    "PhasorImage",
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
    "phasor_image",
    "render",
    "render_scene",
    "smoothed",
    "true_depths",
    "voxelised",
    "wall_grid",
    "without_outer_legs",
]
