"""Object and wall from images alone: one door to three recipes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..._checks import one_of
from ..._progress import Progress
from ..data.reconstruction import Reconstruction
from ..published.wu2024 import wu2024_fit
from ..wave.pupil_psf import PupilPSF
from .evidence import evidence_fit
from .staged import staged_fit

#: Solver of each recipe.
RECIPES: dict[str, Callable[..., Reconstruction]] = {
    "staged": staged_fit,
    "evidence": evidence_fit,
    "wu2024": wu2024_fit,
}


def pcin(
    images: Any,
    pupil_psf: PupilPSF,
    *,
    defocus: Any = None,
    recipe: str = "staged",
    noise_sigma: Any = None,
    max_iterations: int | None = None,
    seed: int = 0,
    start: Any = None,
    progress: Progress | None = None,
    **options: Any,
) -> Reconstruction:
    """Object and wall from images, neither known.

    Parameters
    ----------
    images : ndarray or Tensor
        (K, H, W) or (H, W), any unit. Two images of one scene, the second with a known defocus of
        half a wave to a wave, make the answer sure; one image does not in general.
    pupil_psf : PupilPSF
        Leaves of the unknown wave; their values are where the fit starts.
    defocus : array_like, optional
        (K,), known further defocus of each image, m rms (Noll 4).
    recipe : {"staged", "evidence", "wu2024"}
        - ``staged``: object first, then both by small steps, starts judged by their free energy;
          see `staged_fit`.
        - ``evidence``: a search from random starts by the free energy; see `evidence_fit`.
        - ``wu2024``: a U-net and the angles by turns, as published; see `wu2024_fit`.
    noise_sigma : float or array_like, optional
        Image units; None: estimated.
    max_iterations : int, optional
        By default as many as the recipe needs.
    seed : int
        Of all that is drawn.
    start : mapping, optional
        A state of the same recipe, from which it goes on; see `checkpoints`.
    progress : callable or None
        Called repeatedly with a text and the completed fraction; may raise `Stop`.
    **options
        Handed to the recipe, which refuses what it does not know.

    Returns
    -------
    Reconstruction

    Raises
    ------
    SceneError
        If ``recipe`` is none of the three, or a value is out of range.
    SamplingError
        If the arrays do not fit each other.
    TypeError
        If an option is not the recipe's.
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
