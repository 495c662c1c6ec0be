"""Time-resolved light: captures off a relay wall, rendered or measured, and their pictures.

- `captures`: `TransientCapture`, light at wall points over optical path.
- `rendering`: `render`, captures of hidden meshes; three bounces by quadrature, more by Monte
  Carlo (`multiple_bounces`).
- `volumes`: `Volume`, where a hidden scene is looked for, and `VolumeImage`, what was seen there.
"""

from .captures import TransientCapture, wall_grid
from .rendering import render
from .volumes import Volume, VolumeImage

__all__ = ["TransientCapture", "Volume", "VolumeImage", "render", "wall_grid"]
