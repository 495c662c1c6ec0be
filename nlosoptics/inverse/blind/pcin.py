"""Blind reconstruction of object and wall: common entry point of two solvers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..._checks import one_of
from ..._progress import Progress
from ..data.reconstruction import Reconstruction
from ..published.wu2024 import wu2024_fit
from ..wave.pupil_psf import PupilPSF
from .evidence import evidence_fit

#: Solver of each recipe.
RECIPES: dict[str, Callable[..., Reconstruction]] = {
    "evidence": evidence_fit,
    "wu2024": wu2024_fit,
}


def pcin(
    images: Any,
    pupil_psf: PupilPSF,
    *,
    defocus: Any = None,
    recipe: str = "evidence",
    noise_sigma: Any = None,
    max_iterations: int | None = None,
    seed: int = 0,
    start: Any = None,
    progress: Progress | None = None,
    **options: Any,
) -> Reconstruction:
    """Reconstruct object and wall from images, both unknown (blind reconstruction).

    Parameters
    ----------
    images : ndarray or Tensor
        Images, (K, H, W) or (H, W), any unit. Two images of the same scene, the second with a known
        defocus of half a wave to one wave rms, give a reliable answer. One image is in general not
        sufficient.
    pupil_psf : PupilPSF
        Point spread with the unknown wave coefficients. Their values are one of the starts of the
        fit.
    defocus : array_like, optional
        Known additional defocus of each image, (K,), m rms (Noll 4).
    recipe : {"evidence", "wu2024"}
        - ``evidence``: minimises the free energy from random starts; see `evidence_fit`.
        - ``wu2024``: for one image; alternates between the weights of a U-net and the wave
          coefficients. The published method, for comparison; see `wu2024_fit`.
    noise_sigma : float or array_like, optional
        Standard deviation of the noise, image units; None: estimated.
    max_iterations : int, optional
        Maximum number of iterations; by default that of the recipe.
    seed : int
        Seed of the random numbers.
    start : mapping, optional
        Saved state of the same recipe to resume from; see `inverse.data.checkpoints`.
    progress : callable or None
        Called repeatedly with a text and the completed fraction; may raise `Stop`.
    **options
        Further options of the recipe.

    Returns
    -------
    Reconstruction
        Object, status, score and the fitted coefficients.

    Raises
    ------
    SceneError
        If ``recipe`` is unknown, or a value is out of range.
    SamplingError
        If array shapes do not match.
    TypeError
        If the recipe does not have one of the options.

    See Also
    --------
    evidence_fit, wu2024_fit : The two solvers with all their options.
    """
    solver = RECIPES[one_of("recipe", recipe, RECIPES)]
    if max_iterations is not None:
        options["max_iterations"] = max_iterations
    return solver(
        images,
        pupil_psf,
        defocus=defocus,
        noise_sigma=noise_sigma,
        seed=seed,
        start=start,
        progress=progress,
        **options,
    )
