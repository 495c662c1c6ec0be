"""Time-resolved light: captures off a relay wall, rendered or measured, and their pictures.

- `captures`: `TransientCapture`, light at wall points over optical path.
- `phasor_cameras`: `phasor_image`, virtual cameras by the waves of `phasor_fields`, set up by
  `phasor_setups` and carried by `plane_convolutions` or by
  `rayleigh_sommerfeld`; `phasor_images`: `PhasorImage`; `phasor_validity`: what limits it.
- `volumes`: `Volume`, where a hidden scene is looked for, and `VolumeImage`, what was seen there.
"""

from .captures import TransientCapture, wall_grid
from .phasor_cameras import phasor_image
from .phasor_images import PhasorImage
from .volumes import Volume, VolumeImage

__all__ = [
    "PhasorImage",
    "TransientCapture",
    "Volume",
    "VolumeImage",
    "phasor_image",
    "wall_grid",
]
