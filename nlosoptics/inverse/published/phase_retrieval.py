"""Phase retrieval: objects from the modulus of their spectrum, with unknown phase of the wall."""

from __future__ import annotations

import time
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from ..._checks import counted, one_of, whole
from ..._progress import Progress
from ..._random import checked_seed, generator
from ...errors import SamplingError, SceneError
from ...imaging.forward_model import ForwardModel
from ..data.arrays import half_spectrum_weights, shape_of
from ..data.driver import goes_on, state_of
from ..data.measurement import measured
from ..data.models import one_kernel_shape
from ..data.noisy_image import noisy_image
from ..data.reconstruction import Reconstruction, frozen, registered_correlation
from .autocorrelations import SpectrumModulus, checked_lags, image_lags, spectrum_modulus

Method = Literal["alternating", "hio", "raar"]
Array = NDArray[Any]


def phase_retrieval(
    image: Any,
    model: ForwardModel | None = None,
    *,
    method: Method = "alternating",
    object_size: tuple[int, int] | None = None,
    restarts: int = 12,
    max_iterations: int = 400,
    seed: int = 0,
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct an object from its speckle image via an unknown wall, by the autocorrelation.

    The autocorrelation of the image approximates that of the object. The object is computed from it
    by phase retrieval.

    Parameters
    ----------
    image : Measurement, ndarray or Tensor
        Camera image, (H, W), with its noise and background. A uniform background has no effect. The
        measurement must have neither a ``gain`` nor a ``background_shape``, since the brightness of
        the object is not found.
    model : ForwardModel or None
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
    max_iterations : int
        Maximum number of iterations of each run.
    seed : int
        Seed of the random starts.
    progress : callable or None
        Function that is called repeatedly with a text and the completed fraction, 0 to 1. It may
        raise `Stop`; the mean of the runs is then returned as they are.

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

    Agreement of the two halves of the runs is no proof: without the constraint to non-negative
    values they can agree on a wrong object, and in a box much larger than the object, a copy turned
    by half a turn can be superimposed. A tight ``object_size`` helps most. The method "alternating"
    [2]_ is proven to converge for random measurements, but not for the modulus of a spectrum.

    References
    ----------
    .. [1] Katz, Heidmann, Fink and Gigan, Nature Photonics 8 (2014) 784.
    .. [2] Netrapalli, Jain and Sanghavi, Advances in Neural Information Processing Systems 26
       (2013) 2796.
    """
    started = time.perf_counter()
    given = measured(image)
    if given.gain is not None or given.background_shape is not None:
        raise SceneError(
            "gain or background_shape is given, but phase retrieval finds no brightness; give a "
            "Measurement without them"
        )
    shape = shape_of("image", given.image) if model is None else one_kernel_shape(model)
    if len(shape) != 2:
        raise SamplingError(f"image has shape {shape}; give one image, (H, W)")
    data = noisy_image(given, (shape[0], shape[1]))
    search = _Search(method, object_size, restarts, max_iterations, seed, progress)
    if data.is_background():
        return Reconstruction(
            object=data.like_input(np.zeros(shape)),
            physical_parameters={"noise_sigma": data.sigma},
            status="too_few_photons",
            score=0.0,
            history=frozen({"fourier_error": []}),
            seconds=time.perf_counter() - started,
            reasons=("the spectrum is that of noise, so that no object is seen; expose longer",),
        )
    level, score, errors, parameters = search.run(image_lags(data, model), shape)
    return Reconstruction(
        object=data.like_input(level),
        physical_parameters={**parameters, "noise_sigma": data.sigma},
        status="unconverged",
        score=score,
        history=frozen({"fourier_error": errors}),
        seconds=time.perf_counter() - started,
    )


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
    """Reconstruct an object from its measured autocorrelation, by phase retrieval.

    Parameters
    ----------
    autocorrelation : array_like (rows, columns)
        Autocorrelation of the object, in any unit, with an arbitrary constant background. Rows and
        columns are odd numbers, with zero shift at the centre. The value at zero shift, which also
        contains noise, is ignored.
    method, object_size, restarts, max_iterations, seed, progress
        See `phase_retrieval`.

    Returns
    -------
    Reconstruction
        As from `phase_retrieval`, in an array of the autocorrelation's shape. ``status`` is
        "converged" if the score is at least 0.9.

    See Also
    --------
    phase_retrieval : Object from a speckle image.
    """
    started = time.perf_counter()
    lags = checked_lags(autocorrelation)
    search = _Search(method, object_size, restarts, max_iterations, seed, progress)
    level, score, errors, parameters = search.run(lags, lags.shape)
    return Reconstruction(
        object=level,
        physical_parameters=parameters,
        status="converged" if score >= 0.9 and not search.stopped else "unconverged",
        score=score,
        history=frozen({"fourier_error": errors}),
        seconds=time.perf_counter() - started,
    )


class _Search:
    """Many random starts at once; the options are those of `phase_retrieval`."""

    def __init__(
        self,
        method: Method,
        object_size: tuple[int, int] | None,
        restarts: int,
        max_iterations: int,
        seed: int,
        progress: Progress | None,
    ) -> None:
        self.method = one_of("method", method, ("alternating", "hio", "raar"))
        self.restarts = whole("restarts", restarts, 2)
        self.iterations = whole("max_iterations", max_iterations)
        self.seed, self.progress = checked_seed(seed), progress
        self.stopped, self.size = False, object_size
        if object_size is not None:
            if not hasattr(object_size, "__len__") or len(object_size) != 2:
                raise SceneError(
                    f"object_size = {object_size!r} is not a size; give (rows, columns)"
                )
            rows, columns = (whole(f"object_size[{i}]", v, 2) for i, v in enumerate(object_size))
            self.size = rows, columns

    def run(
        self, lags: Array, shape: tuple[int, ...]
    ) -> tuple[Array, float, list[float], dict[str, Any]]:
        """Retrieve an object of a given shape from its autocorrelation.

        Returns object, correlation of two halves of the restarts, their errors, and parameters. The
        errors are rms differences of the spectra's moduli, relative.
        """
        spectrum = spectrum_modulus(lags, self.size)
        modulus = spectrum.modulus.astype(np.float32)
        rows, columns = spectrum.object_size
        support = np.zeros(spectrum.grid, dtype=np.float32)
        support[:rows, :columns] = 1.0
        random = generator(self.seed, 0x70686173)
        objects = random.random((self.restarts, *spectrum.grid), dtype=np.float32) * support
        if self.method == "alternating":
            used = random.random((self.restarts, *modulus.shape)) < 0.5
            objects = _spectral_start(objects, modulus, support, used)
        text = f"phase retrieval: {counted(self.restarts, 'restart')} by {self.method}"
        for count in range(1, self.iterations + 1):
            share = (count - 1) / self.iterations
            objects = _stepped(objects, modulus, support, self.method, share)
            snapshot = partial(state_of, _framed(objects[0], spectrum, shape))
            last = count == self.iterations
            if (last or count % 20 == 0) and not goes_on(
                self.progress, text, count / self.iterations, snapshot
            ):
                self.stopped = not last
                break
        if self.method == "alternating":  # the modulus does not determine the overall sign
            objects = objects * np.where(objects.sum(axis=(1, 2), keepdims=True) < 0.0, -1.0, 1.0)
        else:
            for _ in range(50):
                objects = _allowed(_with_modulus(objects, modulus), support)
        twice = half_spectrum_weights(support.shape[1])
        misfits = ((np.abs(fft.rfft2(objects)) - modulus) ** 2 * twice).sum(axis=(1, 2))
        errors = np.sqrt(misfits / (modulus**2 * twice).sum())
        halves = [_averaged(objects[i::2], errors[i::2]) for i in (0, 1)]
        score = registered_correlation(*halves, flip=True)
        parameters = {"fourier_error": float(errors.min()), "object_size": spectrum.object_size}
        level = _framed(_averaged(objects, errors), spectrum, shape)
        return level, score, errors.tolist(), parameters


def _spectral_start(objects: Array, modulus: Array, support: Array, used: Array) -> Array:
    """Return the leading eigenvectors of ``sum y_i^2 a_i a_i'``, scaled to the moduli y [1]_.

    ``objects`` (R, H, W) start the power iteration, in which only the frequencies that are ``used``
    (R, H, W//2 + 1) count, without those above three times the rms, which would dominate the sum.

    References
    ----------
    .. [1] Chen and Candes, Advances in Neural Information Processing Systems 28 (2015) 739.
    """
    squares = modulus * modulus
    mean = np.mean(np.broadcast_to(squares, used.shape), axis=(1, 2), keepdims=True, where=used)
    weights = np.where(used & (squares <= 9.0 * mean), squares, np.float32(0.0))
    for _ in range(50):
        objects = fft.irfft2(weights * fft.rfft2(objects), support.shape) * support
        objects /= np.maximum(_norms(objects), 1e-30)
    return objects * (_norms(used * modulus) / _norms(used * np.abs(fft.rfft2(objects))))


def _norms(values: Array) -> Array:
    """Return the norms (R, 1, 1) of arrays (R, H, W)."""
    return np.asarray(np.sqrt((values * values).sum(axis=(1, 2), keepdims=True)))


def _stepped(objects: Array, modulus: Array, support: Array, method: str, share: float) -> Array:
    """Make one iteration towards objects (R, H, W) whose spectra have a given modulus.

    ``objects`` (R, H, W): objects of the restarts. ``modulus`` (H, W//2 + 1): modulus of the
    object's ``rfft2``. ``support`` (H, W): 1 at pixels that may be bright, else 0. ``method``:
    alternating minimisation (Netrapalli 2013) for objects of either sign, whose least-squares
    solution is the adjoint, as the transform is unitary; hybrid input-output (Fienup 1982), with
    feedback decreasing from 2 to 0; or relaxed averaged alternating reflections (Luke 2005), with
    relaxation decreasing from 0.9 to 0.5. The last two keep objects non-negative. ``share``:
    completed fraction of the iterations.
    """
    projection = _with_modulus(objects, modulus)
    if method == "alternating":
        return projection * support
    if method == "hio":
        feedback = 2.0 * (1.0 - share)
        return np.where(projection * support > 0.0, projection, objects - feedback * projection)
    relaxation = 0.9 - 0.4 * share
    reflection = _allowed(2.0 * projection - objects, support)
    return relaxation * (reflection + objects) + (1.0 - 2.0 * relaxation) * projection


def _averaged(objects: Array, errors: Array) -> Array:
    """Average the best restart and those within 2 % of its error, after aligning them to the best.

    If the modulus is noisy, the restarts end at the same object with different errors, which their
    mean reduces. Each is shifted by whole pixels, and turned by half a turn if that is better.
    """
    best = objects[np.argmin(errors)]
    spectrum, aligned = fft.rfft2(best - best.mean()), []
    for picture in objects[errors <= 1.02 * errors.min()]:
        overlaps = []
        for turned in (picture, picture[::-1, ::-1]):
            overlap = fft.irfft2(spectrum * np.conj(fft.rfft2(turned)), picture.shape)
            place = np.unravel_index(overlap.argmax(), overlap.shape)
            overlaps.append((float(overlap.max()), np.roll(turned, place, (0, 1))))
        aligned.append(max(overlaps, key=lambda pair: pair[0])[1])
    return np.asarray(np.mean(aligned, axis=0))


def _allowed(objects: Array, support: Array) -> Array:
    """Return the non-negative parts of objects (R, H, W) within their support."""
    return np.maximum(objects, 0.0) * support


def _with_modulus(objects: Array, modulus: Array) -> Array:
    """Return the objects closest to the given ones whose spectra have the given modulus."""
    spectrum = fft.rfft2(objects)
    spectrum *= modulus / np.maximum(np.abs(spectrum), np.float32(1e-37))
    return np.asarray(fft.irfft2(spectrum, objects.shape[1:]))


def _framed(objects: Array, spectrum: SpectrumModulus, shape: tuple[int, ...]) -> Array:
    """Place an object at the centre of an image of a given shape, scaled to a maximum of 1."""
    rows, columns = spectrum.object_size
    box, frame = objects[:rows, :columns], np.zeros(shape)
    top, left = (shape[0] - rows) // 2, (shape[1] - columns) // 2
    brightest = float(box.max())
    frame[top : top + rows, left : left + columns] = box / (brightest if brightest > 0.0 else 1.0)
    return frame
