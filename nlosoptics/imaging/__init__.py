"""Object and point spread to electrons: fields, chief rays, radiance chain, camera noise."""

from .detector import speckles_per_pixel
from .forward_model import ForwardModel
from .image_fields import image_field
from .images import SpeckleImage, diffuse_background, form_image
from .radiometry import photon_rate
from .shadows import Shadows, cast_shadows

__all__ = [
    "ForwardModel",
    "Shadows",
    "SpeckleImage",
    "cast_shadows",
    "diffuse_background",
    "form_image",
    "image_field",
    "photon_rate",
    "speckles_per_pixel",
]
