"""Reconstruction of the hidden object, in numpy and torch.

Solvers accept arrays or tensors and return the same kind. `tv_deconvolve` and the scores run
without torch; the others need it. `nlosoptics.limits.feasibility` predicts what a fit can reach.
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
