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

from ..limits import Feasibility, feasibility
from .callbacks import Stop
from .cnn_baseline import CnnBaseline, Training, train_cnn
from .evidence_fit import evidence_fit
from .image_prior import deep_image_prior
from .lucy import richardson_lucy
from .measurements import estimate_noise
from .pcin import pcin
from .phase_retrieval import object_from_autocorrelation, phase_retrieval
from .pupil_psf import PupilPSF
from .reconstructions import Reconstruction
from .registration import RegisteredScores, registered_correlation, registered_scores
from .scene_leaves import SceneLeaves
from .simple_filters import inverse_filter
from .staged_fit import staged_fit
from .torch_model import TorchForwardModel
from .total_variation import tv_deconvolve
from .training_pairs import TrainingPairs, training_pairs
from .unets import UNet
from .wiener_filter import wiener
from .wu2024_fit import wu2024_fit

__all__ = [
    "CnnBaseline",
    "Feasibility",
    "PupilPSF",
    "Reconstruction",
    "RegisteredScores",
    "SceneLeaves",
    "Stop",
    "TorchForwardModel",
    "Training",
    "TrainingPairs",
    "UNet",
    "deep_image_prior",
    "estimate_noise",
    "evidence_fit",
    "feasibility",
    "inverse_filter",
    "object_from_autocorrelation",
    "pcin",
    "phase_retrieval",
    "registered_correlation",
    "registered_scores",
    "richardson_lucy",
    "staged_fit",
    "train_cnn",
    "training_pairs",
    "tv_deconvolve",
    "wiener",
    "wu2024_fit",
]
