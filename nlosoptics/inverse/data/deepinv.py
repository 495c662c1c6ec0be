"""The image model as a physics of deepinv, whose solvers then run on it unchanged.

deepinv is an optional extra, loaded with the first look at `NlosPhysics`; this module imports
without it.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from torch import Tensor

from ...errors import MissingExtraError, SamplingError
from ...imaging.forward_model import ForwardModel
from .forward import TorchForwardModel, model_shape

__all__ = ["NlosPhysics"]

if TYPE_CHECKING:
    NlosPhysics: type[Any]


def __getattr__(name: str) -> Any:
    if name == "NlosPhysics":
        return _physics_class()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


@cache
def _physics_class() -> type[Any]:
    """`NlosPhysics`, made where deepinv is first needed, or the error that names the extra."""
    try:
        from deepinv.physics import LinearPhysics
    except (ImportError, RuntimeError) as error:
        # A torchvision built for another torch raises RuntimeError when it is loaded.
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise MissingExtraError(
            f"deepinv cannot be loaded ({reason}); pip install 'nlosoptics[deepinv]', with a "
            "torchvision that is built for the torch that is there"
        ) from None

    class NlosPhysics(LinearPhysics):  # type: ignore[misc]
        """Image of a hidden object by one point spread, as a linear physics of deepinv.

        Parameters
        ----------
        model : ForwardModel or TorchForwardModel
            Of one point spread; of a numpy model the twin in single precision.
        **options
            Passed on to deepinv's ``LinearPhysics``, such as ``noise_model``.

        Notes
        -----
        Objects and images are (B, C, H, W), (H, W) being the model's shape; channels are seen by
        the same wall.
        """

        def __init__(self, model: ForwardModel | TorchForwardModel, **options: Any) -> None:
            super().__init__(img_size=(1, *model_shape(model)), **options)
            if isinstance(model, ForwardModel):
                model = TorchForwardModel.from_numpy(model)
            self.model = model

        def A(self, x: Tensor, **parameters: Any) -> Tensor:
            """Image (B, C, H, W) of an object; deepinv's parameters of other physics: none here."""
            _none(parameters)
            image: Tensor = self.model(x)
            return image

        def A_adjoint(self, y: Tensor, **parameters: Any) -> Tensor:
            """Transpose of `A`."""
            _none(parameters)
            return self.model.adjoint(y)

    NlosPhysics.__module__, NlosPhysics.__qualname__ = __name__, "NlosPhysics"
    return NlosPhysics


def _none(parameters: dict[str, Any]) -> None:
    if parameters:
        raise SamplingError(
            f"NlosPhysics takes no parameters, was given {', '.join(parameters)}; "
            "make another physics for another point spread"
        )
