"""Reconstructions of the hidden object, in torch.

Arrays or tensors in, the same kind out. Everything here needs torch; nothing else in the package
does.
"""

from ..errors import MissingExtraError

try:
    import torch as _torch  # noqa: F401
except ImportError:
    raise MissingExtraError(
        "nlosoptics.inverse needs torch, which is not installed; pip install 'nlosoptics[inverse]'"
    ) from None

from .cnn_baseline import CnnBaseline, Training, train_cnn
from .image_prior import deep_image_prior
from .measurements import estimate_noise
from .pupil_psf import PupilPSF
from .reconstructions import Reconstruction
from .registration import registered_correlation
from .torch_model import TorchForwardModel
from .total_variation import tv_deconvolve
from .training_pairs import TrainingPairs, training_pairs
from .unets import UNet, UNetObject
from .wiener_filter import wiener
from .wu2024_fit import wu2024_fit

__all__ = [
    "CnnBaseline",
    "PupilPSF",
    "Reconstruction",
    "TorchForwardModel",
    "Training",
    "TrainingPairs",
    "UNet",
    "UNetObject",
    "deep_image_prior",
    "estimate_noise",
    "registered_correlation",
    "train_cnn",
    "training_pairs",
    "tv_deconvolve",
    "wiener",
    "wu2024_fit",
]
