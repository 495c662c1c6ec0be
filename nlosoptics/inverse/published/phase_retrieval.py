"""Phase retrieval: objects from the modulus of their spectrum, with unknown phase of the wall."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from ..._checks import counted, one_of, whole
from ..._progress import Progress
from ..._random import checked_seed, generator
from ...errors import SamplingError, SceneError
from ...imaging.forward_model import ForwardModel
from ..data._threads import single_thread
from ..data.checkpoints import State, goes_on, state_of
from ..data.forward import TorchForwardModel, one_kernel_shape, torch_model
from ..data.measurement import measurement, shape_of
from ..data.reconstruction import Reconstruction
from ..data.scores import registered_correlation
from ..data.status import Status
from .autocorrelations import SpectrumModulus, checked_lags, image_lags, spectrum_modulus
from .projections import (
    alternating_minimisation,
    averaged,
    fourier_errors,
    projected,
    spectral_start,
)

Method = Literal["alternating", "hio", "raar"]

METHODS = ("alternating", "hio", "raar")
# Random stream of the starts.
_STARTS = 0x70686173
# Correlation between two halves of the restarts at which the object counts as found.
_AGREED = 0.9
_TOLERANCE = 1e-6


@single_thread()
def phase_retrieval(
    image: Any,
    model: ForwardModel | TorchForwardModel | None = None,
    *,
    method: Method = "alternating",
    object_size: tuple[int, int] | None = None,
    restarts: int = 12,
    noise_sigma: Any = None,
    background: Any = 0.0,
    max_iterations: int = 400,
    seed: int = 0,
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct an object from the autocorrelation of its speckle image via an unknown wall.

    Parameters
    ----------
    image : ndarray or Tensor
        Image, (H, W), any unit; a uniform background has no effect.
    model : ForwardModel or TorchForwardModel or None
        Image model. The modulus of its transfer function is divided out of the image's power
        spectrum; its phase is not used. None: the wall is assumed to transmit all frequencies
        equally on average, like a diffuser.
    method : {"alternating", "hio", "raar"}
        "alternating": alternating minimisation from a truncated spectral start, for real objects of
        either sign. "hio": hybrid input-output. "raar": relaxed averaged alternating reflections.
        The last two require a non-negative object.
    object_size : (int, int) or None
        Rows and columns of a box that contains the object. None: half the extent of the
        autocorrelation's peak above its ground, plus a margin.
    restarts : int
        Number of random starts, at least 2.
    noise_sigma : float, array_like or None
        Standard deviation of the noise, one number or (H, W), image units; None: estimated by
        `estimate_noise`.
    background : float or array_like
        Known background, one number or (H, W), image units.
    max_iterations : int
        Maximum number of iterations of each restart.
    seed : int
        Seed of the random starts.
    progress : callable or None
        Called repeatedly with a text and the completed fraction; may raise `Stop`, which returns
        the mean of the restarts so far. The state passed to its method ``look`` is only a preview
        with a maximum of 1; a run cannot be resumed from it.

    Returns
    -------
    Reconstruction
        Object at the centre of the frame, with a maximum of 1; its position and a rotation by half
        a turn remain unknown. ``score`` is the registered correlation between two independent
        halves of the restarts. ``status`` is "unconverged" even if they agree, because agreement
        does not show that the image's autocorrelation is the object's. ``physical_parameters``
        contains the least ``fourier_error``, ``object_size`` and ``noise_sigma``; ``history``
        contains the ``fourier_error`` of each restart.

    Raises
    ------
    SamplingError
        If an array does not fit the model, or the autocorrelation shows no object.
    SceneError
        If a value is out of range or not finite.

    See Also
    --------
    object_from_autocorrelation : Object from a given autocorrelation.
    pcin : Entry point of the blind solvers.

    Notes
    -----
    The autocorrelation of a diffuser's point spread is a peak on a broad ground, so that the
    autocorrelation of the image is that of the object on a ground [1]_. The residual influence of
    the wall's speckle decreases with the number of speckle grains in the frame. The object may fill
    at most half of the frame's width. Restarts with nearly the least Fourier error are averaged.

    Agreement of the two halves is no proof. Without the sign constraint they can agree on a wrong
    picture, and in a box much larger than the object its twin can be superimposed. A tight
    ``object_size`` helps most. The alternating method [2]_ is proven for random measurement
    vectors, not for moduli of a plain spectrum; it is included for comparison. Each of its restarts
    starts from a random half of the measurements.

    References
    ----------
    .. [1] Katz, Heidmann, Fink and Gigan, Nature Photonics 8 (2014) 784.
    .. [2] Netrapalli, Jain and Sanghavi, Advances in Neural Information Processing Systems 26
       (2013) 2796.
    """
    started = time.perf_counter()
    shape = shape_of("image", image) if model is None else one_kernel_shape(model)
    if len(shape) != 2:
        raise SamplingError(f"image has shape {shape}; give one image, (H, W)")
    data = measurement(
        image,
        (shape[0], shape[1]),
        noise_sigma=noise_sigma,
        background=background,
        fit_background=True,
        background_shape=None,
    )
    search = _Search(method, object_size, restarts, max_iterations, seed, progress)
    if data.is_background():
        status: Status = "too_few_photons"
        found, score, errors = torch.zeros_like(data.data), 0.0, np.empty(0)
        parameters: dict[str, Any] = {}
    else:
        twin = None if model is None else torch_model(model, data.data.device, torch.float64)
        found, score, errors, parameters = search.run(
            image_lags(data, twin), shape, data.data.device
        )
        status = "unconverged"
    errors.flags.writeable = False
    return Reconstruction(
        object=data.like_input(found),
        physical_parameters={**parameters, "noise_sigma": data.sigma},
        status=status,
        score=score,
        history={"fourier_error": errors},
        seconds=time.perf_counter() - started,
    )


@single_thread()
def object_from_autocorrelation(
    autocorrelation: ArrayLike,
    *,
    method: Method = "raar",
    object_size: tuple[int, int] | None = None,
    restarts: int = 12,
    max_iterations: int = 400,
    seed: int = 0,
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct an object from its measured autocorrelation.

    Parameters
    ----------
    autocorrelation : array_like
        Autocorrelation with odd numbers of rows and columns, zero lag at the centre, and an
        arbitrary constant ground. The value at zero lag is ignored.
    method : {"alternating", "hio", "raar"}
        Algorithm, see `phase_retrieval`.
    object_size : (int, int) or None
        Rows and columns of a box that contains the object. None: half the extent of the peak above
        the ground, plus a margin.
    restarts : int
        Number of random starts, at least 2.
    max_iterations : int
        Maximum number of iterations of each restart.
    seed : int
        Seed of the random starts.
    progress : callable or None
        Called repeatedly with a text and the completed fraction; may raise `Stop`, which returns
        the mean of the restarts so far.

    Returns
    -------
    Reconstruction
        Object in a frame of the autocorrelation's size, with a maximum of 1. ``score`` is the
        correlation between two halves of the restarts; ``status`` is "converged" if it is at
        least 0.9.

    Raises
    ------
    SamplingError
        If the numbers of rows and columns are not odd, or the array shows no object.
    SceneError
        If a value is out of range or not finite.

    See Also
    --------
    phase_retrieval : Object from the modulus of its spectrum.
    """
    started = time.perf_counter()
    lags = checked_lags(autocorrelation)
    search = _Search(method, object_size, restarts, max_iterations, seed, progress)
    found, score, errors, parameters = search.run(lags, lags.shape, torch.device("cpu"))
    errors.flags.writeable = False
    return Reconstruction(
        object=found.numpy(),
        physical_parameters=parameters,
        status=search.status(score),
        score=score,
        history={"fourier_error": errors},
        seconds=time.perf_counter() - started,
    )


class _Search:
    """Options of a phase retrieval, and the random restarts."""

    def __init__(
        self,
        method: Method,
        object_size: tuple[int, int] | None,
        restarts: int,
        max_iterations: int,
        seed: int,
        progress: Progress | None,
    ) -> None:
        one_of("method", method, METHODS)
        self._method: Method = method
        self._restarts = whole("restarts", restarts, 2)
        self._iterations = whole("max_iterations", max_iterations)
        self._seed = checked_seed(seed)
        self._object_size = object_size
        self._progress = progress
        self._ended = False
        if object_size is not None:
            if not hasattr(object_size, "__len__") or len(object_size) != 2:
                raise SceneError(
                    f"object_size = {object_size!r} is not a size; give (rows, columns)"
                )
            rows, columns = (whole(f"object_size[{i}]", v, 2) for i, v in enumerate(object_size))
            self._object_size = (rows, columns)

    def run(
        self, lags: Any, shape: tuple[int, ...], device: torch.device
    ) -> tuple[Tensor, float, Any, dict[str, Any]]:
        """Return object, correlation of two halves of the restarts, errors, and parameters.

        ``lags`` is the autocorrelation and ``shape`` that of the returned object. The errors, one
        per restart, are rms differences of the spectra's moduli, relative.
        """
        spectrum = spectrum_modulus(lags, self._object_size)
        modulus = torch.from_numpy(spectrum.modulus).to(device, torch.float32)

        def watch(done: float, objects: Tensor) -> bool:
            def preview() -> State:
                errors = fourier_errors(objects, modulus)
                return state_of(_framed(averaged(objects, errors), spectrum, shape))

            self._ended = not goes_on(
                self._progress,
                f"phase retrieval: {counted(self._restarts, 'restart')} by {self._method}",
                done,
                preview,
            )
            return not self._ended

        objects, errors = self._objects(spectrum, modulus, watch)
        if not self._ended:
            watch(1.0, objects)
            self._ended = False  # nothing was left to do
        score = 0.0
        if len(objects) > 1:
            halves = [averaged(objects[i::2], errors[i::2]).cpu().numpy() for i in (0, 1)]
            score = registered_correlation(halves[0], halves[1], flip=True)
        parameters = {
            "fourier_error": float(errors.min()),
            "object_size": spectrum.object_size,
        }
        frame = _framed(averaged(objects, errors), spectrum, shape)
        return frame, score, errors.double().cpu().numpy(), parameters

    def status(self, score: float) -> Status:
        """Return "converged" if the objects of two halves of the restarts agree."""
        return "converged" if score >= _AGREED and not self._ended else "unconverged"

    def _objects(
        self, spectrum: SpectrumModulus, modulus: Tensor, watch: Callable[[float, Tensor], bool]
    ) -> tuple[Tensor, Tensor]:
        """Return objects (R, g_y, g_x) and Fourier errors (R,) of the completed restarts."""
        rows, columns = spectrum.object_size
        support = torch.zeros(spectrum.grid, dtype=torch.bool, device=modulus.device)
        support[:rows, :columns] = True
        random = generator(self._seed, _STARTS)
        starts = random.random((self._restarts, *spectrum.grid), dtype=np.float32)
        first = torch.from_numpy(starts).to(modulus)
        if self._method != "alternating":
            return projected(
                modulus,
                support,
                first,
                method=self._method,
                iterations=self._iterations,
                watch=watch,
            )
        draws = random.random((self._restarts, *modulus.shape)) < 0.5
        used = torch.from_numpy(draws).to(modulus.device)
        found: list[Tensor] = []
        for begin in zip(first, used, strict=True):
            found.append(self._alternating(modulus, support, *begin))
            if len(found) < len(first) and not watch(len(found) / len(first), torch.stack(found)):
                break
        return torch.stack(found), fourier_errors(torch.stack(found), modulus)

    def _alternating(self, modulus: Tensor, support: Tensor, first: Tensor, used: Tensor) -> Tensor:
        def within(spectrum: Tensor) -> Tensor:
            # This is also the least-squares solution, because the transform is unitary.
            picture: Tensor = torch.fft.irfft2(spectrum, s=tuple(support.shape))
            return picture * support

        start = spectral_start(modulus, torch.fft.rfft2, within, first=first * support, used=used)
        found, _ = alternating_minimisation(
            modulus,
            torch.fft.rfft2,
            within,
            start,
            max_iterations=self._iterations,
            tolerance=_TOLERANCE,
        )
        # The modulus does not determine the overall sign.
        return found if float(found.sum()) >= 0.0 else -found


def _framed(objects: Tensor, spectrum: SpectrumModulus, shape: tuple[int, ...]) -> Tensor:
    """Place an object at the centre of an image of a given shape, scaled to a maximum of 1."""
    rows, columns = spectrum.object_size
    box = objects[:rows, :columns].double()
    frame = torch.zeros(shape, dtype=torch.float64, device=box.device)
    top, left = (shape[0] - rows) // 2, (shape[1] - columns) // 2
    brightest = float(box.max())
    frame[top : top + rows, left : left + columns] = box / (brightest if brightest > 0.0 else 1.0)
    return frame
