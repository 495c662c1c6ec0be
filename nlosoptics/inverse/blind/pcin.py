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
RECIPES: dict[str, Callable[..., Reconstruction]] = {"evidence": evidence_fit, "wu2024": wu2024_fit}


def pcin(
    images: Any,
    pupil_psf: PupilPSF,
    *,
    defocus: Any = None,
    recipe: str = "evidence",
    max_iterations: int | None = None,
    seed: int = 0,
    start: Any = None,
    progress: Progress | None = None,
    **options: Any,
) -> Reconstruction:
    """Reconstruct the hidden object via an unknown wall, by a fit of both object and wall.

    The default solver, `evidence_fit`, is the recommended one. The other, `wu2024_fit`, is the
    published physics-constrained inverse network (PCIN), which gave this function its name.

    Parameters
    ----------
    images, pupil_psf, defocus, max_iterations, seed, start, progress
        See `evidence_fit`.
    recipe : {"evidence", "wu2024"}
        Solver. "evidence": `evidence_fit`, which makes many fits from random starts and returns the
        one with the largest Bayesian evidence (marginal likelihood: the probability of the images
        for a wall, averaged over all objects). "wu2024": `wu2024_fit`, which fits a neural network
        (U-net) and the coefficients in turn to one image. It is included for comparison.
    **options
        Further options of the solver, see `evidence_fit` and `wu2024_fit`.

    Returns
    -------
    Reconstruction
        Object, status and score. ``physical_parameters`` contains the fitted ``coefficients``.

    Raises
    ------
    SceneError
        If ``recipe`` is unknown, or a value is out of range.
    SamplingError
        If array shapes do not match.
    TypeError
        If the solver does not have one of the options.

    See Also
    --------
    evidence_fit, wu2024_fit : The two solvers with all their options.
    """
    solver = RECIPES[one_of("recipe", recipe, RECIPES)]
    if max_iterations is not None:
        options["max_iterations"] = max_iterations
    return solver(
        images, pupil_psf, defocus=defocus, seed=seed, start=start, progress=progress, **options
    )
