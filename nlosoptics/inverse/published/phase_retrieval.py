"""Phase retrieval: objects from the modulus of their spectrum, with unknown phase of the wall."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
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
from ..data.arrays import shape_of
from ..data.driver import Iterate, Solver, run
from ..data.forward import TorchForwardModel, torch_model
from ..data.measurement import measurement
from ..data.models import one_kernel_shape
from ..data.reconstruction import Reconstruction, frozen
from ..data.scores import registered_correlation
from ..data.status import Status
from .autocorrelations import SpectrumModulus, checked_lags, image_lags, spectrum_modulus
from .projections import (
    CHUNK,
    allowed,
    alternating_minimisation,
    averaged,
    fourier_errors,
    projected,
    settled,
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
    start: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct an object from its speckle image via an unknown wall, by the autocorrelation.

    The autocorrelation of the image approximates that of the object. The object is computed from it
    by phase retrieval.

    Parameters
    ----------
    image : ndarray or Tensor
        Camera image, (H, W), in any unit, which is called the image unit below. A uniform
        background has no effect.
    model : ForwardModel or TorchForwardModel or None
        Image model, if the modulus of its transfer function is known. The image's power spectrum is
        divided by the squared modulus; the phase is not used. None: the wall is assumed to transmit
        all spatial frequencies equally on average, like a diffuser.
    method : {"alternating", "hio", "raar"}
        Algorithm. Prefer "raar" (relaxed averaged alternating reflections) or "hio" (hybrid
        input-output) for hidden objects: both use that the object is not negative. The default,
        "alternating" (alternating minimisation from a truncated spectral start), does not; it is
        included for comparison and accepts objects of either sign.
    object_size : (int, int) or None
        Rows and columns of a box that contains the object. None: half the extent of the
        autocorrelation's central peak above its background, plus a margin.
    restarts : int
        Number of runs, at least 2. They start from different random numbers; with "alternating",
        each run starts from a random half of the measured values.
    noise_sigma : float, array_like or None
        Standard deviation of the noise, one number or (H, W), image units. None: it is estimated
        by `estimate_noise`.
    background : float or array_like
        Known background of the image, one number or (H, W), image units.
    max_iterations : int
        Maximum number of iterations of each run.
    seed : int
        Seed of the random starts.
    start : mapping or None
        Saved state of this solver with the same image and options (see `Stop`), from which the run
        resumes with the same result bit for bit.
    progress : callable or None
        Function that is called repeatedly with a text and the completed fraction, 0 to 1. It may
        raise `Stop`; the mean of the runs so far is then returned. The entry ``"object"`` of a
        saved state has a maximum of 1.

    Returns
    -------
    Reconstruction
        Object at the centre of the image, with a maximum of 1. Its true position is unknown, and it
        may be turned by half a turn. ``score`` is the correlation between the mean objects of two
        halves of the runs, at the best shift. ``status`` is "unconverged" even if they agree,
        because agreement does not show that the image's autocorrelation is that of the object.
        ``history["fourier_error"]`` holds, for each run, the deviation of the object's spectrum
        from the measured modulus. ``physical_parameters`` contains the least ``fourier_error``,
        ``object_size`` and ``noise_sigma``.

    Raises
    ------
    SamplingError
        If an array does not have the model's shape, or the autocorrelation shows no object.
    SceneError
        If a value is out of range or not finite.

    See Also
    --------
    object_from_autocorrelation : Object from a given autocorrelation.
    pcin : Reconstruction via an unknown wall.

    Notes
    -----
    The point spread function of a diffuser is a speckle pattern. Its autocorrelation is a sharp
    peak on a broad background. The autocorrelation of the image is therefore that of the object
    plus a background [1]_. The random deviations decrease with the number of speckle grains in the
    image. The object may fill at most half of the image's width. The result is the mean of the runs
    with nearly the least Fourier error.

    Agreement of the two halves of the runs is no proof. Without the constraint to non-negative
    values they can agree on a wrong object. In a box much larger than the object, a copy turned by
    half a turn can be superimposed. A tight ``object_size`` helps most. The method "alternating"
    [2]_ is proven to converge for random measurements, but not for the modulus of a Fourier
    spectrum.

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
    options = _Options(method, object_size, restarts, max_iterations, seed)
    if data.is_background():
        status: Status = "too_few_photons"
        found, score = torch.zeros(shape, dtype=torch.float64), 0.0
        errors: list[float] = []
        parameters: dict[str, Any] = {}
    else:
        data = data.in_torch()
        twin = None if model is None else torch_model(model, data.data.device, torch.float64)
        found, score, errors, parameters, _ = _retrieved(
            options, image_lags(data, twin), shape, data.data.device, start, progress
        )
        status = "unconverged"
    return Reconstruction(
        object=data.like_input(found),
        physical_parameters={**parameters, "noise_sigma": data.sigma},
        status=status,
        score=score,
        history=frozen({"fourier_error": errors}),
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
    start: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct an object from its measured autocorrelation, by phase retrieval.

    Parameters
    ----------
    autocorrelation : array_like (rows, columns)
        Autocorrelation of the object, in any unit, with an arbitrary constant background. Rows and
        columns are odd numbers, with zero shift at the centre. The value at zero shift, which also
        contains noise, is ignored.
    method : {"alternating", "hio", "raar"}
        Algorithm. "raar": relaxed averaged alternating reflections. "hio": hybrid input-output.
        Both require a non-negative object. "alternating": alternating minimisation from a truncated
        spectral start, for real objects of either sign.
    object_size : (int, int) or None
        Rows and columns of a box that contains the object. None: half the extent of the central
        peak above the background, plus a margin.
    restarts : int
        Number of runs, at least 2. They start from different random numbers; with "alternating",
        each run starts from a random half of the measured values.
    max_iterations : int
        Maximum number of iterations of each run.
    seed : int
        Seed of the random starts.
    start : mapping or None
        Saved state of this solver with the same data and options (see `Stop`), from which the run
        resumes with the same result bit for bit.
    progress : callable or None
        Function that is called repeatedly with a text and the completed fraction, 0 to 1. It may
        raise `Stop`; the mean of the runs so far is then returned.

    Returns
    -------
    Reconstruction
        Object in an array of the autocorrelation's shape, with a maximum of 1. Its true position is
        unknown, and it may be turned by half a turn. ``score`` is the correlation between the mean
        objects of two halves of the runs, at the best shift. ``status`` is "converged" if the score
        is at least 0.9.

    Raises
    ------
    SamplingError
        If the numbers of rows and columns are not odd, or the array shows no object.
    SceneError
        If a value is out of range or not finite.

    See Also
    --------
    phase_retrieval : Object from a speckle image.
    """
    started = time.perf_counter()
    lags = checked_lags(autocorrelation)
    options = _Options(method, object_size, restarts, max_iterations, seed)
    found, score, errors, parameters, stopped = _retrieved(
        options, lags, lags.shape, torch.device("cpu"), start, progress
    )
    return Reconstruction(
        object=found.numpy(),
        physical_parameters=parameters,
        status="converged" if score >= _AGREED and not stopped else "unconverged",
        score=score,
        history=frozen({"fourier_error": errors}),
        seconds=time.perf_counter() - started,
    )


@dataclass
class _Options:
    """Options of a phase retrieval, which are checked."""

    method: Method
    object_size: tuple[int, int] | None
    restarts: int
    iterations: int
    seed: int

    def __post_init__(self) -> None:
        one_of("method", self.method, METHODS)
        self.restarts = whole("restarts", self.restarts, 2)
        self.iterations = whole("max_iterations", self.iterations)
        self.seed = checked_seed(self.seed)
        size = self.object_size
        if size is not None:
            if not hasattr(size, "__len__") or len(size) != 2:
                raise SceneError(f"object_size = {size!r} is not a size; give (rows, columns)")
            rows, columns = (whole(f"object_size[{i}]", v, 2) for i, v in enumerate(size))
            self.object_size = rows, columns


def _retrieved(
    options: _Options,
    lags: Any,
    shape: tuple[int, ...],
    device: torch.device,
    start: Mapping[str, Any] | None,
    progress: Progress | None,
) -> tuple[Tensor, float, list[float], dict[str, Any], bool]:
    """Retrieve an object of a given shape from its autocorrelation.

    Returns object, correlation of two halves of the restarts, their errors, parameters, and whether
    a callback stopped the run. The errors are rms differences of the spectra's moduli, relative.
    """
    spectrum = spectrum_modulus(lags, options.object_size)
    kind = _Alternating if options.method == "alternating" else _Projecting
    search = kind(options, spectrum, shape, device)
    ended = run(search, start, progress)
    objects = search.settled(ended.state)
    errors = fourier_errors(objects, search.modulus)
    score = 0.0
    if len(objects) > 1:
        halves = [averaged(objects[i::2], errors[i::2]).cpu().numpy() for i in (0, 1)]
        score = registered_correlation(halves[0], halves[1], flip=True)
    parameters = {"fourier_error": float(errors.min()), "object_size": spectrum.object_size}
    frame = _framed(averaged(objects, errors), spectrum, shape)
    return frame, score, errors.tolist(), parameters, ended.stopped


@dataclass(eq=False, kw_only=True)
class _Objects(Iterate):
    """State of the restarts: their objects, (R, g_y, g_x)."""

    objects: Tensor


class _Restarts(Solver[_Objects]):
    """Random restarts of a phase retrieval."""

    name, records, takes_object = "phase_retrieval", (), False

    def __init__(
        self,
        options: _Options,
        spectrum: SpectrumModulus,
        shape: tuple[int, ...],
        device: torch.device,
    ) -> None:
        self._options, self._spectrum, self._shape = options, spectrum, shape
        self.report = f"phase retrieval: {counted(options.restarts, 'restart')} by {options.method}"
        self.modulus = torch.from_numpy(spectrum.modulus).to(device, torch.float32)
        rows, columns = spectrum.object_size
        self._support = torch.zeros(spectrum.grid, dtype=torch.bool, device=device)
        self._support[:rows, :columns] = True
        random = generator(options.seed, _STARTS)
        starts = random.random((options.restarts, *spectrum.grid), dtype=np.float32)
        self._first = torch.from_numpy(starts).to(self.modulus) * self._support
        draws = random.random((options.restarts, *self.modulus.shape)) < 0.5
        self._used = torch.from_numpy(draws).to(device)
        self._per_chunk = max(1, CHUNK // self._support.numel())
        chunks = -(-options.restarts // self._per_chunk)
        whole_restarts = options.method == "alternating"
        self.max_iterations = options.restarts if whole_restarts else chunks * options.iterations

    def init(self, first: Tensor | None) -> _Objects:
        """Return the random objects of all restarts; a given object has no effect."""
        return _Objects(objects=self._first.clone())

    @abstractmethod
    def begun(self, state: _Objects) -> Tensor:
        """Return the objects of those restarts that were begun."""

    def settled(self, state: _Objects) -> Tensor:
        """Return these objects with all constraints met."""
        return self.begun(state)

    def level(self, state: _Objects) -> Tensor:
        """Return a preview of the object (H, W), with a maximum of 1."""
        objects = self.begun(state)
        errors = fourier_errors(objects, self.modulus)
        return _framed(averaged(objects, errors), self._spectrum, self._shape)


class _Projecting(_Restarts):
    """Projections of many restarts at once; the first chunk is finished before the next begins."""

    every = 20

    def step(self, state: _Objects) -> tuple[float, ...]:
        """Make one iteration of the restarts of the current chunk."""
        chunk, iteration = divmod(state.count, self._options.iterations)
        part = slice(chunk * self._per_chunk, (chunk + 1) * self._per_chunk)
        objects = state.objects[part]
        share = iteration / self._options.iterations
        objects = projected(objects, self.modulus, self._support, self._options.method, share)
        if iteration + 1 == self._options.iterations:
            objects = settled(objects, self.modulus, self._support)
        state.objects[part] = objects
        return ()

    def begun(self, state: _Objects) -> Tensor:
        """Return the objects of those restarts that were begun, where they may be bright."""
        chunks = -(-state.count // self._options.iterations)
        return allowed(state.objects[: chunks * self._per_chunk], self._support)

    def settled(self, state: _Objects) -> Tensor:
        """Return the objects, those of an unfinished chunk after alternating projections."""
        chunks, rest = divmod(state.count, self._options.iterations)
        done = state.objects[: chunks * self._per_chunk]
        if not rest:
            return done
        last = state.objects[chunks * self._per_chunk :][: self._per_chunk]
        return torch.cat((done, settled(last, self.modulus, self._support)))


class _Alternating(_Restarts):
    """Alternating minimisation; an iteration of the search is a whole restart."""

    every, unit = 1, "restart"

    def step(self, state: _Objects) -> tuple[float, ...]:
        """Make one restart."""

        def within(spectrum: Tensor) -> Tensor:
            # This is also the least-squares solution, because the transform is unitary.
            picture: Tensor = torch.fft.irfft2(spectrum, s=self._spectrum.grid)
            return picture * self._support

        start = spectral_start(
            self.modulus,
            torch.fft.rfft2,
            within,
            first=self._first[state.count],
            used=self._used[state.count],
        )
        found, _ = alternating_minimisation(
            self.modulus,
            torch.fft.rfft2,
            within,
            start,
            max_iterations=self._options.iterations,
            tolerance=_TOLERANCE,
        )
        # The modulus does not determine the overall sign.
        state.objects[state.count] = found if float(found.sum()) >= 0.0 else -found
        return ()

    def begun(self, state: _Objects) -> Tensor:
        """Return the objects of the completed restarts."""
        return state.objects[: state.count]


def _framed(objects: Tensor, spectrum: SpectrumModulus, shape: tuple[int, ...]) -> Tensor:
    """Place an object at the centre of an image of a given shape, scaled to a maximum of 1."""
    rows, columns = spectrum.object_size
    box = objects[:rows, :columns].double()
    frame = torch.zeros(shape, dtype=torch.float64, device=box.device)
    top, left = (shape[0] - rows) // 2, (shape[1] - columns) // 2
    brightest = float(box.max())
    frame[top : top + rows, left : left + columns] = box / (brightest if brightest > 0.0 else 1.0)
    return frame
