"""Object and point spread to electrons: chief rays, radiance chain, camera noise."""

from .detector import speckles_per_pixel
from .forward_model import ForwardModel
from .images import SpeckleImage, diffuse_background, form_image
from .radiometry import photon_rate

__all__ = [
    "ForwardModel",
    "SpeckleImage",
    "diffuse_background",
    "form_image",
    "photon_rate",
    "speckles_per_pixel",
]
