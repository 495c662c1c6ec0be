"""Reconstruction of the hidden object from camera images.

The solvers take numpy arrays or torch tensors, and return an object of the same type.
Solvers with a known point spread, or past a known occluder, run in numpy; the others need torch.
`nlosoptics.limits.feasibility` predicts how well a fit can recover the object.

Every solver takes a `Measurement`: one or several images with all that is known of their noise,
background, masked and saturated pixels and gain. An array alone is a measurement of which nothing
is known. The measurement is checked against the image model once. Dead, hot and clipped pixels are
sought there and ignored, and the noise is measured at the frequencies that the optics do not pass;
a stated noise gives its shape over the image.

Options of a solver are about its method alone: ``max_iterations`` and ``tolerance`` say when it
stops, ``start`` is an initial object or a saved state, and ``progress`` is a callback that may end
the fit (`Stop`). One driver makes the iterations of all of them. A solver is a class with a step, a
criterion and an object, which holds all that changes.

Every solver returns a `Reconstruction`: the object, fitted and measured parameters, the records of
the iterations, and a status with its reasons. The status says whether the model fits the image,
whether there is an object, and whether the iteration ended: "converged", "does_not_fit",
"too_few_photons", "ambiguous" (of a fit of object and wall: another answer fits as well) or
"unconverged". How much blur and noise have taken from the object is a number,
``expected_correlation``, and no verdict.

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
