"""Time-resolved light: captures off a relay wall, rendered or measured, and their pictures.

- `captures`: `TransientCapture`, light at wall points over optical path; files of it are read and
  written by `capture_files`, `tal_files`, `foreign_files` and `mat_files`.
- `detectors`: `Detector`, which counts a capture's photons.
- `rendering`: `render`, captures of hidden meshes; three bounces by quadrature.
- `volumes`: `Volume`, where a hidden scene is looked for, and `VolumeImage`, what was seen there.
"""

from .captures import TransientCapture, wall_grid
from .detectors import Detector
from .rendering import render
from .volumes import Volume, VolumeImage

__all__ = ["Detector", "TransientCapture", "Volume", "VolumeImage", "render", "wall_grid"]
