"""Image formation: from object and point spread to the electrons that the camera reads."""

from .camera_files import CameraImage, camera_image, read_camera_file
from .coherence import spot_coherence
from .forward_model import ForwardModel
from .image_fields import image_field
from .images import SpeckleImage, diffuse_background, form_image
from .shadows import Shadows, cast_shadows

__all__ = [
    "CameraImage",
    "ForwardModel",
    "Shadows",
    "SpeckleImage",
    "camera_image",
    "cast_shadows",
    "diffuse_background",
    "form_image",
    "image_field",
    "read_camera_file",
    "spot_coherence",
]
