"""Reconstruction of the hidden object from camera images.

The solvers take numpy arrays or torch tensors, and return an object of the same type.
`tv_deconvolve`, `shadow_fit`, `occluder_fit` and `registered_correlation` run without torch; the
other solvers need it.
`nlosoptics.limits.feasibility` predicts how well a fit can recover the object.

All functions raise a `SamplingError` if an array does not have the shape of the image model or of
the other arrays, and a `SceneError` if a value is out of range, not finite or not a real number.
"""

from typing import Any

import lazy_loader as _lazy

from ..errors import MissingExtraError

_found, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    try:
        return _found(name)
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise MissingExtraError(
            f"nlosoptics.inverse.{name} needs torch, which is not installed; pip install "
            "'nlosoptics[inverse]'"
        ) from None
