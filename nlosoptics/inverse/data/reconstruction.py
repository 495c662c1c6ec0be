"""Result of a reconstruction, its assembly by the solvers, and its correlation with the truth."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import whole
from ..._html import Figures, Shown
from ..._nouns import Noun
from ...errors import SamplingError
from ...imaging.forward_model import ForwardModel
from .arrays import check_finite, real_array
from .noisy_image import NoisyImage
from .status import LIMITS, Ending, Status, judged

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Reconstruction(Noun, Shown):
    """Object that a solver recovered from an image, with its status and the fitted parameters.

    Solvers fit the image by ``gain * model.forward(object) + background``, with the image model
    that they were given. Values in the unit of the image's pixels are called image units.

    Parameters
    ----------
    object : ndarray or Tensor, (H, W)
        Object, [y, x], on the pixels of the image. It has the type of the given image and, for a
        tensor, its dtype and device. Its maximum is 1 unless the gain was given.
    physical_parameters : mapping of str to float or ndarray
        Fitted and given values. ``gain``: image units per unit of the object. ``background``: mean
        of the fitted background, image units; a background that was given to the solver comes on
        top. ``noise_sigma``: rms noise, image units; for a noise map sigma_i it is
        ``mean(1/sigma_i^2)^(-1/2)``. If dead or hot pixels were found and ignored: their number
        ``bad_pixels`` and the mask ``bad_pixel_map``, (H, W); ``saturated_pixels`` of them are
        saturated. With a known point spread: ``expected_correlation`` of the object with the truth
        if the model is right, and ``expected_correlation_range``, (2,), in which two thirds of the
        correlations lie. The docstring of a solver names further values and the shapes of arrays,
        such as the wave's ``coefficients`` if the wall was fitted as well.
    status : {"converged", "does_not_fit", "too_few_photons", "ambiguous", "unconverged"}
        "converged": the solver met its stopping criterion, and no test found a contradiction
        between image and model. "does_not_fit": the image contradicts the model, so the object is
        not reliable. "too_few_photons": the noise hides most of the object, and ``object`` is a
        rough estimate; it is zero if no object was detected. "ambiguous": in a fit of object and
        wall, another answer, such as no blur and the image itself as the object, fits as well.
        "unconverged": the stopping criterion was not met, and the object is not reliable.
    score : float
        Rms of the residual divided by the noise; 1 if only noise remains. For phase retrieval:
        the restarts are divided into two halves, the objects of each are averaged, and the score is
        the correlation between the two averages; 1 is full agreement.
    history : mapping of str to ndarray, (n_iterations,)
        Values after each iteration, float64, read-only. ``objective``: the minimised function.
        ``residual``: as ``score``. ``change``: relative change of the object in the iteration. For
        phase retrieval there is only ``fourier_error``, with one value for each restart.
    seconds : float
        Wall-clock time of the fit, s.
    reasons : tuple of str
        Sentences that say why the status is not "converged", with values and limits. Empty for
        "converged", and for solvers that do not test the model.

    See Also
    --------
    tv_deconvolve : Non-negative deconvolution with total variation.
    pcin : Reconstruction via an unknown wall.
    registered_correlation : Correlation with the truth.
    nlosoptics.views.reconstruction : Object next to the truth.
    """

    object: Any
    physical_parameters: Mapping[str, Any]
    status: Status
    score: float
    history: Mapping[str, Array]
    seconds: float
    reasons: tuple[str, ...] = ()

    def _figures(self) -> Figures:
        rows, columns = self.object.shape
        meaning, repeats = "residual, rms of the noise", "iterations"
        if "fourier_error" in self.history:
            meaning, repeats = "agreement of halves", "restarts"
        figures = {
            "status": self.status.replace("_", " "),
            meaning: f"{self.score:.3g}",
            repeats: f"{max(map(len, self.history.values()), default=0)}",
            "seconds": f"{self.seconds:.3g}",
        }
        for name, value in self.physical_parameters.items():
            if np.ndim(value) == 0:
                text = f"{value:.4g}" if isinstance(value, float) else str(value)
                figures[name.replace("_", " ")] = text
        alt = f"Reconstructed object, {rows} x {columns} pixels, {figures['status']}"
        return Figures("Reconstruction", figures, alt)


def frozen(history: Mapping[str, Sequence[float]]) -> dict[str, Array]:
    """Return the records of a fit as read-only arrays."""
    records = {name: np.array(values, dtype=np.float64) for name, values in history.items()}
    for record in records.values():
        record.flags.writeable = False
    return records


def assemble(
    data: NoisyImage,
    level: Array,
    *,
    model: ForwardModel,
    background: float,
    gain: float | None,
    status: Status,
    history: Mapping[str, Sequence[float]],
    started: float,
    reasons: tuple[str, ...] = (),
    error: Array | None = None,
    **parameters: Any,
) -> Reconstruction:
    """Return the `Reconstruction` for an object in image units.

    ``level`` (H, W) is the object times the gain and ``background`` the fitted strength of the
    unknown background, image units. If ``gain`` is None, the object's maximum becomes 1.
    ``reasons`` speak against "converged". ``error`` (H, W) is that of the object, image units, and
    becomes the parameter ``object_error``. ``started`` is ``time.perf_counter()`` at the start, and
    ``parameters`` are further entries of ``physical_parameters``.
    """
    explained = model.forward(level) + data.background(background)
    if gain is None:
        brightest = float(level.max())
        gain = brightest if brightest > 0.0 else 1.0
    if data.bad_pixels is not None:
        parameters["bad_pixels"] = int(data.bad_pixels.sum())
        parameters["bad_pixel_map"] = data.bad_pixels
    if data.saturated is not None:
        parameters["saturated_pixels"] = int(data.saturated.sum())
    if error is not None:
        parameters["object_error"] = data.like_input(error / gain)
    return Reconstruction(
        object=data.like_input(level / gain),
        physical_parameters={
            "gain": gain,
            "background": background,
            "noise_sigma": data.sigma,
            **parameters,
        },
        status=status,
        score=data.score(explained),
        history=frozen(history),
        seconds=time.perf_counter() - started,
        reasons=reasons,
    )


def concluded(
    data: NoisyImage,
    level: Array,
    *,
    model: ForwardModel,
    background: float,
    ending: Ending,
    **more: Any,
) -> Reconstruction:
    """Return the `Reconstruction` of a fit with a known point spread, its status tested.

    Parameters as in `assemble`, with how the solver ended in place of status, history, reasons and
    error.
    """
    found = judged(data, level, background, model, ending)
    if found.expected_correlation is not None:
        more["expected_correlation"] = found.expected_correlation
        lack = 1.0 - found.expected_correlation
        least, most = 1.0 - min(LIMITS.spread * lack, 1.0), 1.0 - lack / LIMITS.spread
        more["expected_correlation_range"] = np.array([least, most])
    return assemble(
        data,
        level,
        model=model,
        background=background,
        status=found.status,
        history=ending.history,
        reasons=found.reasons,
        error=found.error,
        **more,
    )


def beside(data: NoisyImage, level: Array, model: ForwardModel) -> tuple[float, float]:
    """Fit the unknown background for a given object.

    Returns its strength, image units, and the rms residual of object and background over the noise.
    ``level`` (H, W) is the object in image units.
    """
    seen = model.forward(level)
    strength = data.background_strength(data.data - seen)
    return strength, data.score(seen + data.background(strength))


def registered_correlation(
    reconstruction: Any, truth: Any, *, upsampling: int = 20, flip: bool = False
) -> float:
    """Return the Pearson correlation of a reconstruction with the truth at the best shift.

    Brightness, offset and position of the reconstruction do not matter. An image does not determine
    the position of the object, because a tilt of the wavefront shifts the image.

    Parameters
    ----------
    reconstruction : Reconstruction, ndarray or Tensor
        Reconstructed object, (H, W).
    truth : ndarray or Tensor
        True object, (H, W).
    upsampling : int
        Number of steps per pixel in which the shift is searched; 1 for whole pixels.
    flip : bool
        Whether to try the reconstruction turned by half a turn as well. Phase retrieval needs this,
        since an object and its turned copy have the same autocorrelation.

    Returns
    -------
    float
        Largest correlation over all shifts, 0 to 1; 0 if an image is uniform.

    See Also
    --------
    Reconstruction : Result of every solver.

    Notes
    -----
    Both images are treated as periodic. Their circular cross-correlation, after subtraction of the
    means and division by the product of the norms, is the Pearson correlation at each shift. Its
    mean over all shifts is 0, so that its largest value is not negative. The largest value among
    whole pixels is refined by a matrix Fourier transform with band-limited interpolation [1]_.

    References
    ----------
    .. [1] Guizar-Sicairos, Thurman and Fienup, Optics Letters 33 (2008) 156.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.inverse import registered_correlation
    >>> truth = np.random.default_rng(0).random((16, 16))
    >>> round(registered_correlation(3.0 * np.roll(truth, (2, 5), (0, 1)) + 1.0, truth), 6)
    1.0
    """
    upsampling = whole("upsampling", upsampling)
    first, second = _mean_free("reconstruction", reconstruction), _mean_free("truth", truth)
    if first.shape != second.shape:
        raise SamplingError(
            f"reconstruction has shape {first.shape} and truth {second.shape}; "
            "resample one to the other's pixels"
        )
    norm = math.sqrt(float((first * first).sum()) * float((second * second).sum()))
    if norm == 0.0:
        return 0.0
    turns = (first, first[::-1, ::-1]) if flip else (first,)
    return max(_highest_peak(turned, second, upsampling) for turned in turns) / norm


def _highest_peak(first: Array, second: Array, upsampling: int) -> float:
    """Return the largest circular cross-correlation, at shifts of 1/``upsampling`` pixel."""
    spectrum = np.conj(np.fft.fft2(first)) * np.fft.fft2(second)
    correlation = np.fft.ifft2(spectrum).real
    peak = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
    steps = np.arange(-upsampling, upsampling + 1) / upsampling
    rows, columns = spectrum.shape
    by_row = np.exp(2j * np.pi * np.outer(peak[0] + steps, np.fft.fftfreq(rows)))
    by_column = np.exp(2j * np.pi * np.outer(np.fft.fftfreq(columns), peak[1] + steps))
    near = (by_row @ spectrum @ by_column).real / spectrum.size
    return float(max(correlation[peak], near.max() if upsampling > 1 else -math.inf))


def _mean_free(name: str, image: Any) -> Array:
    """Return an image minus its mean, checked."""
    values = real_array(name, image.object if isinstance(image, Reconstruction) else image)
    if values.ndim != 2 or not values.size:
        raise SamplingError(f"{name} has shape {values.shape}; give one image, (H, W)")
    check_finite(name, values, "replace them before comparing")
    centred: Array = values - values.mean()
    # Rounding errors of a uniform image must not count as structure.
    if np.abs(centred).max() <= 1e-14 * np.abs(values).max():
        centred[:] = 0.0
    return centred
