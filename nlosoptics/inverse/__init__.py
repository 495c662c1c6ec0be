"""Reconstruction of the hidden object, in torch.

Solvers accept arrays or tensors and return the same kind. Only this subpackage needs torch.
"""

from ..errors import MissingExtraError

try:
    import torch as _torch  # noqa: F401
except ImportError:
    raise MissingExtraError(
        "nlosoptics.inverse needs torch, which is not installed; pip install 'nlosoptics[inverse]'"
    ) from None

from ..limits import Feasibility, feasibility
from .blind.evidence import evidence_fit
from .blind.pcin import pcin
from .data.checkpoints import Stop
from .data.forward import TorchForwardModel
from .data.measurement import estimate_noise
from .data.reconstruction import Reconstruction
from .data.scores import RegisteredScores, registered_correlation, registered_scores
from .known.inverse_filter import inverse_filter
from .known.richardson_lucy import richardson_lucy
from .known.total_variation import tv_deconvolve
from .known.wiener import wiener
from .published.cnn import CnnBaseline, Training, train_cnn
from .published.deep_image_prior import deep_image_prior
from .published.phase_retrieval import object_from_autocorrelation, phase_retrieval
from .published.training_pairs import TrainingPairs, training_pairs
from .published.unet import UNet
from .published.wu2024 import wu2024_fit
from .wave.facet_psf import FacetPSF
from .wave.pupil_psf import PupilPSF
from .wave.scene_parameters import SceneLeaves

__all__ = [
    "CnnBaseline",
    "FacetPSF",
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
    "train_cnn",
    "training_pairs",
    "tv_deconvolve",
    "wiener",
    "wu2024_fit",
]
