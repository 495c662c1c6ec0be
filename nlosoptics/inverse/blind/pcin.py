"""Blind reconstruction of object and wall: common entry point of three solvers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..._checks import one_of
from ..._progress import Progress
from ..data.reconstruction import Reconstruction
from ..published.wu2024 import wu2024_fit
from ..wave.pupil_psf import PupilPSF
from .evidence import evidence_fit
from .network_fit import network_fit

#: Solver of each recipe.
RECIPES: dict[str, Callable[..., Reconstruction]] = {
    "evidence": evidence_fit,
    "network": network_fit,
    "wu2024": wu2024_fit,
}


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

    The default solver, `evidence_fit`, is the recommended one. The recipes "network" and "wu2024"
    represent the object by an untrained neural network (U-net). The latter, `wu2024_fit`, is the
    published physics-constrained inverse network (PCIN), which gave this function its name.

    Parameters
    ----------
    images, pupil_psf, defocus, max_iterations, seed, start, progress
        See `evidence_fit`.
    recipe : {"evidence", "network", "wu2024"}
        Solver. "evidence": `evidence_fit`, which makes many fits from proposed or random walls and
        returns the one with the largest Bayesian evidence (marginal likelihood: the probability of
        the images for a wall, averaged over all objects). "network": one image; U-nets with noise
        as their input are fitted together with walls that a trained network proposes, the evidence
        chooses the wall and states the status, and a U-net gives the object. "wu2024":
        `wu2024_fit`, which fits a U-net and the coefficients in turn to one image, from random
        angles. It is included for comparison.
    **options
        Further options of the solver, see `evidence_fit` and `wu2024_fit`. Those of "network" are
        ``proposals``, the number of proposed walls that are fitted (3), and ``base``, the width of
        the U-net (8); its ``max_iterations`` is the number of steps from each wall (160), a third
        of those for the object. It cannot resume from ``start``.

    Returns
    -------
    Reconstruction
        Object, status and score. ``physical_parameters`` contains the fitted ``coefficients``. With
        "network" the values are those of `evidence_fit`, with the U-net's object and score, and
        ``agreement``, the correlation of the objects of both. If it is below 0.9, the status
        "converged" becomes "ambiguous".

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
    evidence_fit, wu2024_fit : Two of the solvers with all their options.
    """
    solver = RECIPES[one_of("recipe", recipe, RECIPES)]
    if max_iterations is not None:
        options["max_iterations"] = max_iterations
    return solver(
        images, pupil_psf, defocus=defocus, seed=seed, start=start, progress=progress, **options
    )
