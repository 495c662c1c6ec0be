"""The image model as a physics of deepinv, so that deepinv's solvers can be applied to it.

deepinv is an optional extra that is loaded when `NlosPhysics` is first accessed; this module can be
imported without it.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from torch import Tensor

from ...errors import MissingExtraError, SamplingError
from ...imaging.forward_model import ForwardModel
from .forward import TorchForwardModel
from .models import model_shape

__all__ = ["NlosPhysics"]

if TYPE_CHECKING:
    NlosPhysics: type[Any]


def __getattr__(name: str) -> Any:
    if name == "NlosPhysics":
        return _physics_class()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


@cache
def _physics_class() -> type[Any]:
    """Create the class `NlosPhysics`; raise an error that names the extra if deepinv is missing."""
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
            Model of one point spread. A numpy model is converted to torch in single precision.
        **options
            Passed on to deepinv's ``LinearPhysics``, such as ``noise_model``.

        Notes
        -----
        Objects and images are (B, C, H, W), where (H, W) is the model's shape. All channels have
        the same point spread.
        """

        def __init__(self, model: ForwardModel | TorchForwardModel, **options: Any) -> None:
            super().__init__(img_size=(1, *model_shape(model)), **options)
            if isinstance(model, ForwardModel):
                model = TorchForwardModel.from_numpy(model)
            self.model = model

        def A(self, x: Tensor, **parameters: Any) -> Tensor:
            """Return the image (B, C, H, W) of an object; it accepts no further parameters."""
            _none(parameters)
            image: Tensor = self.model(x)
            return image

        def A_adjoint(self, y: Tensor, **parameters: Any) -> Tensor:
            """Apply the transpose of `A` to an image (B, C, H, W)."""
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
