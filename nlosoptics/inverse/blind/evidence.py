"""Blind fit of object and wall from random starts, ranked by the evidence (object marginalised)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from ..._checks import counted, in_range, one_of, positive, whole
from ..._progress import Progress
from ..._random import checked_seed
from ...errors import SamplingError
from ...imaging.forward_model import ForwardModel
from ..data.driver import State, goes_on, state_of
from ..data.measurement import measured
from ..data.noisy_image import NoisyImage
from ..data.reconstruction import Reconstruction, frozen
from ..data.status import Status
from ..known.total_variation import sharpest
from ..published.wu2024 import wu2024_fit
from ..wave.frames import Frames, fitting, frames_of
from ..wave.pupil_psf import PupilPSF
from .evidence_search import HISTORY, Search
from .free_energy import Floats, FreeEnergy, Starts
from .verdict import Verdict
from .wall_proposals import wall_proposals


@fitting()
def evidence_fit(
    images: Any,
    pupil_psf: PupilPSF,
    *,
    defocus: Any = None,
    start_error: float | None = None,
    known_object: Any = None,
    strength: float | None = None,
    max_iterations: int | None = None,
    max_seconds: float | None = None,
    seed: int = 0,
    start: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Fit the hidden object and the unknown wall's aberration to one or several camera images.

    This is the recommended solver if the wall is unknown. Give two images if possible, one of them
    with a known additional defocus of half a wave rms (one wave rms if the wall's aberration is
    about one wave rms). One image alone can always be explained by no blur, with the image itself
    as the object. Two images of different defocus exclude this, and most random starts of the fit
    then lead to the true object. With one image the search takes many times longer, and the result
    is reliable only if ``status`` is "converged".

    Parameters
    ----------
    images : Measurement, ndarray or Tensor
        K camera images, (K, H, W), or one, (H, W), with their noise and backgrounds. All show the
        same object via one wall, with K known defoci. The object must lie inside the image.
    pupil_psf : PupilPSF
        Point spread function (PSF) of the wall and lens as a function of the M Zernike coefficients
        to fit, (M,). Coefficients other than 0 are an additional start of the fit. A known wave or
        transmission in ``pupil_psf`` is kept fixed. The PSF must have at least the shape of the
        images.
    defocus : array_like, optional
        Known additional defocus of each image, (K,), m rms over the pupil (Noll 4). Positive values
        mean a detector too close to the lens.
    start_error : float, optional
        Expected rms error, waves, at most 0.25, of the wave that the coefficients in ``pupil_psf``
        describe, if the wall is roughly known. Each coefficient then has a Gaussian prior of
        standard deviation ``start_error/sqrt(M)`` about its given value, and one image can be
        sufficient. Overestimate the error if in doubt. By default there is no prior.
    known_object : array_like, optional
        Object, (H, W), if it is known. Then only its brightness and the wall are fitted.
    strength : float or None
        Rms aberration of the wall, waves, if known. None: several values are tried.
    max_iterations : int, optional
        Maximum number of search rounds. The default is 2 if a known object or a defocused image
        excludes the answer without blur, and 4 if noise then hides the residual of a wrong wall. It
        is 1 for one image with proposals of the network, see the Notes, otherwise 5. A round starts
        from 24 proposals or 32 random walls, and continues with random variations of the best.
    max_seconds : float, optional
        Time, s, after which the search ends with the running step, once it has a first result. With
        such a limit, the result depends on the speed of the machine. By default
        there is no limit.
    seed : int
        Seed of the random starts.
    start : mapping, optional
        Saved state of this solver with the same images and options (see `Stop`), from which the
        search resumes with the same result bit for bit.
    progress : callable or None
        Function that is called repeatedly with a text and the completed fraction, 0 to 1. It may
        raise `Stop` to end the search before its next step.

    Returns
    -------
    Reconstruction
        Object, status and score. ``physical_parameters`` also contains the values below. The Notes
        explain the free energy.

        - ``coefficients``, (M,): Zernike coefficients, waves rms.
        - ``more_modes``, (L,), and ``more_coefficients``, (L,): Noll indices and coefficients,
          waves rms, of modes that were added because the residual exceeded the noise.
        - ``image_gains``, (K,): relative brightness of the images.
        - ``free_energy``: free energy of the result.
        - ``margin``: free energy of the result minus that of the best fit that starts with an
          unaberrated wave, which causes no blur. A negative value favours the result. NaN where
          an unaberrated wave cannot explain the data anyway: with images of different defocus, or
          with ``known_object``.
        - ``sharp_margin``: free energy of the result minus that of a fit in which the image itself
          is the object. NaN if ``margin`` is NaN, or with ``start_error``.
        - ``model_error``: rms residual in excess of the noise, as a fraction of the images' range.

        For several images ``background`` is (K,) and ``bad_pixel_map`` (K, H, W). ``history`` has
        one entry for each wall that was fitted to the end, with the values of the best wall so far.

    See Also
    --------
    pcin : Reconstruction via an unknown wall.
    tv_deconvolve : Object via a known wall.
    PupilPSF : Differentiable PSF of a wave.

    Notes
    -----
    **Criterion.** Many walls are fitted, and the one with the least free energy is returned: a
    variational approximation of -log(evidence). The evidence of a wall is the probability of the
    images for this wall, averaged over all objects. Comparing squared residuals instead would
    prefer no blur to the truth if there is only one image.

    **One image.** Without ``start_error``, a trained network proposes the starts, with the Noll
    modes 4 to 21, if the pixels are at most as wide as the Nyquist pitch lambda N/2 (wavelength
    lambda, F-number N), the image is 24 to 96 Nyquist pitches wide and high, and the pupil has no
    known wave or transmission. If ``strength`` or the network says that the wall has more than 0.35
    waves, walls are ranked by the free energy plus ``0.2 n ln(q/q_0)``, for n pixels and the sum q
    of the squares of the PSF above the value q_0 that 90 % of the expected walls exceed: waves of
    little blur have a low free energy long before the right one is found.

    **Residual.** For the status "converged", ``model_error`` must be at most
    ``sqrt(a^2 + 3 s^2 sqrt(2/n))``. For several images a is ``0.004 + 0.003 w``, for one
    ``0.004 + 0.01 w``; w is the smaller of 1 and the wall's rms aberration in waves, and s the rms
    noise as a fraction of the images' range. Images whose defoci differ by less than 0.1 waves
    count as one. If the residual of several images exceeds the noise, further modes are
    fitted, up to radial order 5, then 7, then 8. If noise hides the residual of a wrong wall (the
    root of the second term exceeds 0.0035), two rounds must find the same object instead.

    **No blur.** One image must also exclude that there is no blur. Without ``start_error``,
    ``margin`` must be below -70, or ``sharp_margin`` per pixel below -0.092 (for s below 0.01:
    ``-0.092 - 0.045 ln(0.01/s)``), while all different walls have 100 more free energy, and the
    wall has at least 0.6 of its expected strength. With ``start_error``, ``margin`` must be below
    -50, or three conditions must be met: ``margin - P`` is below -100, where P is what the prior
    adds to the fit without blur; ``margin`` is below 1/s; and the rms residual is at least 0.93 of
    the noise.

    The status is "ambiguous" if the result has almost no blur (less than 0.12 waves rms), or is the
    same as that of a fit that starts without blur.
    """
    started = time.perf_counter()
    checked_seed(seed)
    gain = measured(images).gain
    if strength is not None:
        strength = in_range("strength", strength, 0.0, 10.0, open_low=True, unit="waves")
    if start_error is not None:
        remedy = "leave it out; a search needs no start"
        start_error = in_range(
            "start_error", start_error, 0.0, 0.25, open_low=True, unit="waves", remedy=remedy
        )
    rounds = None if max_iterations is None else whole("max_iterations", max_iterations)
    seconds = math.inf if max_seconds is None else positive("max_seconds", max_seconds, unit="s")
    frames = frames_of(images, pupil_psf, defocus=defocus)
    first = pupil_psf.coefficients.detach().double().cpu().numpy()
    if first.ndim != 1:
        raise SamplingError(
            f"pupil_psf.coefficients have shape {first.shape}, must be (M,); give those of one wall"
        )
    known = frames.picture("known_object", known_object)
    several = known is not None or _diverse(frames, pupil_psf.wavelength)

    @cache
    def energies(padding: float, modes: tuple[int, ...]) -> FreeEnergy:
        rows, columns = (8 * math.ceil(padding * side / 8) for side in frames.shape)
        return FreeEnergy(frames, pupil_psf, grid=(rows, columns), modes=modes, known_object=known)

    verdict = Verdict(frames, pupil_psf.modes, several)
    if all(one.is_background() for one in frames.measured):
        strengths = np.array([one.background_strength(one.data) for one in frames.measured])
        pairs = zip(frames.measured, strengths, strict=True)
        score = float(np.mean([one.score(one.background(b)) ** 2 for one, b in pairs])) ** 0.5
        reason = "no object was detected above the noise, so the object is zero; expose longer"
        return _answer(
            frames,
            np.zeros(frames.shape),
            strengths,
            gain,
            started,
            dict.fromkeys(HISTORY, ()),
            ("too_few_photons", (reason,), score),
            coefficients=np.zeros(len(pupil_psf.modes)),
        )
    searched = not several and start_error is None
    search = Search(
        energies,
        verdict,
        first=first,
        start_error=start_error,
        strength=strength,
        proposals=wall_proposals(frames, pupil_psf) if searched else None,
        rounds=rounds,
        seed=seed,
        state=start,
    )
    ended = False

    def watch(text: str, done: float) -> bool:
        nonlocal ended
        ended = not goes_on(progress, f"evidence: {text}", done, snapshot)
        late = time.perf_counter() > started + seconds and len(search.place.best) > 0
        return ended or late

    def snapshot() -> State:
        best = search.best()
        level = search.energy().objects(best)[0].astype(np.float64) * frames.scale
        return state_of(level, **search.place.saved())

    search.run(watch)
    search.finished()
    best, energy = search.best(), search.energy()
    margin, sharp_margin = search.margins
    error = verdict.model_error(best)
    status: Status = "unconverged"
    reasons: tuple[str, ...] = ("the progress callback ended the search; resume it",)
    if not ended:
        reasons = search.faults
        status = verdict.status(best, margin, reasons)
        goes_on(progress, "evidence: done", 1.0, snapshot)
        if len(frames.images) == 1 and known is None:
            best = _refined(frames, energy, best)
    best, levels = energy.judged(best)
    level, gains = energy.objects(best)[0].astype(np.float64) * frames.scale, best.gains[0]
    if energy.known:  # its brightness
        level, gains = level * gains.mean(), gains / gains.mean()
    wall, given = best.coefficients[0].astype(np.float64), len(pupil_psf.modes)
    score = math.sqrt(float(np.average(best.chi_square[0], weights=frames.counted)))
    return _answer(
        frames,
        level,
        levels[0] * frames.scale,
        gain,
        started,
        search.place.history,
        (status, reasons, score),
        coefficients=wall[:given],
        more_modes=np.array(energy.modes[given:]),
        more_coefficients=wall[given:],
        image_gains=gains,
        free_energy=float(best.energy[0]),
        margin=margin,
        sharp_margin=sharp_margin,
        model_error=error,
    )


def _diverse(frames: Frames, wavelength: float) -> bool:
    """Return whether the images themselves exclude a wave without blur."""
    sights = len(np.unique(frames.defocus))
    if sights < len(frames.images):
        raise SamplingError(
            f"{counted(len(frames.images), 'image')} with {counted(sights, 'defocus', 'defoci')}: "
            "equal ones tell no more than their mean; average them, or give the known defocus of "
            "each image, for example [0, half a wavelength]"
        )
    return bool(np.ptp(frames.defocus) >= 0.1 * wavelength)


def _refined(frames: Frames, energy: FreeEnergy, best: Starts) -> Starts:
    """Return the answer for one image, its object averaged with that of `tv_deconvolve`.

    Both priors have different errors, so that the mean correlates better with the truth than either
    of them. Among seven walls and objects at 1 and 5 % noise, exceptions are below 0.006.
    """
    data: NoisyImage = frames.measured[0]
    model = ForwardModel(energy.point_spread(best), shape=frames.shape)
    # errors of the wall's modes must not be fitted, like noise
    excess = math.sqrt(max(1.0, float(best.chi_square[0, 0])))
    data = replace(data, sigma=data.sigma * excess)
    mean = 0.5 * (energy.objects(best) + sharpest(data, model)[0] / frames.scale)
    return energy.judged(replace(best, free=energy.parameters(mean)))[0]


def _answer(
    frames: Frames,
    level: Floats,
    backgrounds: Floats,
    gain: float | None,
    started: float,
    history: Mapping[str, Sequence[float]],
    verdict: tuple[Status, tuple[str, ...], float],
    **parameters: Any,
) -> Reconstruction:
    """Return the result for an object in image units; numbers for one image, else arrays."""
    one, sigmas = len(frames.measured) == 1, frames.sigmas * frames.scale
    gain = gain or float(level.max()) or 1.0
    levels = {
        "gain": gain,
        "background": float(backgrounds[0]) if one else backgrounds,
        "noise_sigma": float(sigmas[0]) if one else sigmas,
    }
    none = np.zeros(frames.shape, dtype=bool)
    bad = np.stack([none if (b := each.bad_pixels) is None else b for each in frames.measured])
    if bad.any():
        levels |= {"bad_pixels": int(bad.sum()), "bad_pixel_map": bad[0] if one else bad}
    status, reasons, score = verdict
    return Reconstruction(
        object=frames.measured[0].like_input(level / gain),
        physical_parameters=levels | parameters,
        status=status,
        reasons=reasons,
        score=score,
        history=frozen(history),
        seconds=time.perf_counter() - started,
    )


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
