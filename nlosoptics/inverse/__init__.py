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

from .evidence_fit import evidence_fit
from .measurements import estimate_noise
from .pcin import pcin
from .pupil_psf import PupilPSF
from .reconstructions import Reconstruction
from .registration import registered_correlation
from .staged_fit import staged_fit
from .torch_model import TorchForwardModel
from .total_variation import tv_deconvolve
from .wiener_filter import wiener

__all__ = [
    "PupilPSF",
    "Reconstruction",
    "TorchForwardModel",
    "estimate_noise",
    "evidence_fit",
    "pcin",
    "registered_correlation",
    "staged_fit",
    "tv_deconvolve",
    "wiener",
]
