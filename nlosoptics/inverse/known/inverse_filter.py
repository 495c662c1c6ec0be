"""Inverse filter: image spectrum divided by the transfer function, without its near-zeros."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from ..._checks import in_range
from ..._progress import Progress
from ...imaging.forward_model import ForwardModel
from ..data.arrays import half_spectrum_weights
from ..data.driver import reconstructed
from ..data.models import one_kernel_shape, squared
from ..data.noisy_image import NoisyImage
from ..data.reconstruction import Reconstruction, beside
from ..data.status import Ending

Array = NDArray[np.float64]


def inverse_filter(
    image: Any,
    model: ForwardModel,
    *,
    guard: float | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Reconstruct an object by dividing the image's spectrum by the transfer function.

    Frequencies at which the modulus of the transfer function is close to zero are left out.

    Parameters
    ----------
    image, model
        See `tv_deconvolve`; a single point spread function.
    guard : float or None
        Least modulus of the transfer function relative to its maximum, 1e-13 to 1. Frequencies with
        a smaller modulus are left out. None: the largest value for which the residual does not
        exceed the noise.
    progress : callable or None
        Function that is called once at the end, with a text and 1.

    Returns
    -------
    Reconstruction
        The object may have negative values. ``physical_parameters`` also contains ``guard``.

    See Also
    --------
    wiener : Linear filter that weighs the noise.
    tv_deconvolve : Non-negative deconvolution with total variation.

    Notes
    -----
    The object is the inverse Fourier transform of I/Phi, with the image's spectrum I and the
    transfer function Phi [1]_. Frequencies beyond the cut-off of the pupil, at which Phi is zero
    but for rounding, are always left out. The automatic guard follows the discrepancy principle for
    a truncated spectrum [2]_. If the model has the boundary "padded", the object is assumed to be
    dark outside the image. An additional background of the measurement is first estimated from the
    pixels at the image's border and then fitted to the residual.

    References
    ----------
    .. [1] Wu et al., Advanced Photonics Nexus 3 (2024) 026010, eq. 1.
    .. [2] Hansen, Discrete Inverse Problems, SIAM (2010), sec. 5.2.
    """
    guard = None if guard is None else in_range("guard", guard, 1e-13, 1.0)

    def solve(data: NoisyImage) -> dict[str, Any]:
        level, used = _divided(data, model, guard)
        strength, score = beside(data, level, model)
        if progress is not None:
            progress(f"inverse filter: residual {score:.2g} of the noise", 1.0)
        objective = 0.5 * data.counted * score**2
        history = {"objective": [objective], "residual": [score], "change": [1.0]}
        ending = Ending(converged=True, history=history)
        return {"level": level, "background": strength, "ending": ending, "guard": used}

    one_kernel_shape(model)
    return reconstructed(solve, image, model)


def _divided(data: NoisyImage, model: ForwardModel, guard: float | None) -> tuple[Array, float]:
    """Return the inverse-filtered object (H, W) in image units, and the guard that was used.

    The guard is the smallest transfer modulus, relative to its maximum, that is divided by; None
    for the automatic one.
    """
    rows, columns = model.shape
    clean = data.data - data.background(data.border_strength())
    spectrum = scipy.fft.rfft2(clean, s=model.grid)
    transfer = model.transfer
    size = np.abs(transfer)
    size = size / size.max()
    if guard is None:
        guard = _noise_guard(data, spectrum, size, model.grid)
    kept = size >= guard
    divided = np.where(kept, spectrum / np.where(kept, transfer, 1.0), 0.0)
    level: Array = scipy.fft.irfft2(divided, s=model.grid)
    return level[:rows, :columns], guard


def _noise_guard(
    data: NoisyImage, spectrum: NDArray[Any], size: Array, grid: tuple[int, int]
) -> float:
    """Return the largest guard at which the omitted frequencies carry no more power than the noise.

    ``spectrum`` is the ``rfft2`` of the image on ``grid``, and ``size`` the transfer modulus
    relative to its maximum, both (rows, columns//2 + 1).
    """
    power = squared(spectrum) * half_spectrum_weights(grid[1])
    order = np.argsort(size.ravel(), kind="stable")
    left_out = np.cumsum(power.ravel()[order]) / (grid[0] * grid[1])
    first_kept = int(np.searchsorted(left_out, data.noise_power(), side="right"))
    return max(float(size.ravel()[order][min(first_kept, size.size - 1)]), 1e-13)
