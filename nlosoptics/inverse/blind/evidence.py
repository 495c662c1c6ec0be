"""Blind fit of object and wall from random starts, ranked by the evidence (object marginalised)."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import torch

from ..._checks import counted, in_range, one_of, positive, whole
from ..._progress import Progress
from ..._random import checked_seed
from ...errors import SamplingError, SceneError
from ...imaging.forward_model import ForwardModel
from ..data._threads import gradients, single_thread
from ..data.checkpoints import State, goes_on, state_of
from ..data.measurement import Measurement
from ..data.reconstruction import Reconstruction, frozen
from ..data.status import Status
from ..known.total_variation import tv_deconvolve
from ..published.deep_image_prior import deep_image_prior
from ..wave.frames import Frames, frames_of
from ..wave.pupil_psf import PupilPSF
from .evidence_search import ROUNDS, Search
from .free_energy import Floats, FreeEnergy, Starts
from .verdict import Verdict
from .wall_proposals import wall_proposals

#: Smallest range of the known defoci, waves rms, at which a wave without blur cannot explain all
#: images.
_DIVERSE = 0.1
#: Largest accepted error of given coefficients, waves rms.
_MOST_ERROR = 0.25


@single_thread()
@gradients()
def evidence_fit(
    images: Any,
    pupil_psf: PupilPSF,
    *,
    defocus: Any = None,
    walls: Any = None,
    start_error: float | None = None,
    known_object: Any = None,
    support: Any = None,
    object_model: str = "pixels",
    fit_gains: bool = False,
    noise_sigma: Any = None,
    background: Any = 0.0,
    fit_background: bool = True,
    background_shape: Any = None,
    gain: float | None = None,
    strength: float | None = None,
    max_iterations: int | None = None,
    max_seconds: float | None = None,
    seed: int = 0,
    start: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Fit object and wall to images from random starts, by maximising the evidence.

    Give two images if possible, one of them with a known additional defocus of half a wave rms
    (one wave rms if the wall's aberration is about one wave rms). The trivial answer, a wave
    without blur and the image itself as the object, then cannot explain both images, and most
    random starts lead to the true object. With one image a trained network proposes further
    starts, the search takes many times longer, and the answer is reliable only if ``status`` is
    "converged".

    Parameters
    ----------
    images : ndarray or Tensor
        Images, (K, H, W) or (H, W), any unit, of one object via one wall with K known defoci, or
        via several walls. The object must lie inside the frame.
    pupil_psf : PupilPSF
        Point spread with Zernike coefficients, (M,) or (n_walls, M). Coefficients other than 0 are
        an additional start of the fit. A known wave or transmission in it is kept fixed. Its shape
        is that of the images or larger.
    defocus : array_like, optional
        Known additional defocus of each image, (K,), m rms (Noll 4).
    walls : array_like of int, optional
        Number of the wall of each image, (K,), counted from 0; by default one wall for all.
    start_error : float, optional
        Expected rms error of the whole wave that ``pupil_psf`` has at the start, waves, at most
        0.25. Each of the M coefficients then has a Gaussian prior of standard deviation
        ``start_error/sqrt(M)``, and one image can be sufficient. Overestimate it if in doubt. By
        default there is no prior, and the coefficients are only an additional start.
    known_object : array_like, optional
        Known object, (H, W); only its brightness and the walls are fitted then.
    support : array_like, optional
        Mask, (H, W), 0 where the object is known to be dark.
    object_model : {"pixels", "unet"}
        Final object for one image without ``support``. "pixels": mean of the fitted object and that
        of `tv_deconvolve`. "unet": mean of the fitted object and that of `deep_image_prior`, which
        takes longer and tolerates more noise.
    fit_gains : bool
        Whether to fit the relative brightness of the images.
    noise_sigma : float or array_like, optional
        Standard deviation of the noise: one number, (K,), (H, W) or (K, H, W), image units; pixels
        of infinite noise are left out. None: estimated.
    background : float or array_like
        Known background: one number, (K,), (H, W) or (K, H, W), image units.
    fit_background : bool
        Whether to fit the strength of an additional background for each image.
    background_shape : array_like or None
        Shape of the additional background, (H, W), non-negative; None: uniform.
    gain : float or None
        Known image units per object unit; None: the object is scaled to a maximum of 1.
    strength : float or None
        Rms of the wall's wave, waves. None: unknown; several values are tried.
    max_iterations : int, optional
        Maximum number of search rounds. The default is 2 if a known object or a defocused image
        excludes the answer without blur, otherwise 4. A round optimises 32 random walls. For a
        single image it optimises about 400 walls, including variations of the best. If the network
        is confident of its proposals, a search from these alone comes first.
    max_seconds : float, optional
        Time after which the search starts no further step, s; it first completes one answer. The
        result then depends on the speed of the machine.
    seed : int
        Seed of the random starts.
    start : mapping, optional
        Saved state of this solver with the same images and options, to resume from with the same
        result bit for bit; see `inverse.data.checkpoints`.
    progress : callable or None
        Called repeatedly with a text and the completed fraction. It may raise `Stop`, which ends
        the search before its next step.

    Returns
    -------
    Reconstruction
        Object, status and score. ``physical_parameters`` also contains

        - ``coefficients``, (M,) or (n_walls, M), waves rms,
        - ``more_modes`` (L,) and ``more_coefficients``, (L,) or (n_walls, L): Noll indices and
          coefficients of modes that were added because the residual exceeded the noise,
        - ``image_gains`` (K,), relative brightness of the images,
        - ``free_energy`` of the answer,
        - ``margin``: free energy minus that of fits started without blur; negative values favour
          the answer; NaN if the images exclude a wave without blur,
        - ``sharp_margin``: free energy minus that of a fit in which the image itself is the
          object; NaN also with ``start_error``,
        - ``model_error``: rms of the residual in excess of the noise, over the images' range.

        ``background`` is (K,) for several images. The history has one entry per wall that
        was fitted to the end, with the values of the best so far.

    Raises
    ------
    SamplingError
        If array shapes do not match, or several images have the same wall and defocus.
    SceneError
        If a value is out of range or not finite.

    See Also
    --------
    pcin : Entry point of the blind solvers.
    tv_deconvolve : Object via a known wall.
    PupilPSF : Differentiable PSF of a wave.

    Notes
    -----
    The answer is the wall with the least variational free energy of the images, in which the object
    is integrated out. A criterion of squared residuals would, for one image, prefer the answer
    without blur to the truth.

    For one image without ``start_error``, a network proposes walls of the Noll modes 4 to 21 if the
    pixels are no wider than Nyquist's, the frame has 24 to 96 of Nyquist's pixels along each side,
    and the pupil has no known wave or transmission. They are accepted or rejected by the free
    energy, as all other starts.

    The answer must explain the images to be "converged": ``model_error`` is at most 0.004, plus
    0.003 times the wall's rms in waves (0.01 times with one image), counted up to one wave. Three
    standard errors of the mean squared residual are added to the square of this limit. Images of
    one wall whose defoci differ by less than 0.1 waves are judged like one image. If the residual
    exceeds the noise significantly, modes up to radial orders 5, 7 and 8 are added to fits
    of several images, as long as they lower the free energy by more than the additional parameters
    alone would.

    One image must also exclude a wave without blur. Without ``start_error``, ``margin`` must be
    below -70, or ``sharp_margin`` below -0.092 per pixel (-0.146 at 0.3 % noise), because fits
    without blur can also find a weak wall. With ``start_error``, ``margin`` must be below -50; or
    at most 100 (at 1 % noise; 20 at 5 %) if the prior of the coefficients puts the no-blur fit at
    least 100 above the answer, and the residual is at least 0.93 of the noise, because a smaller
    residual shows that noise was fitted. The status is "trivial" if the answer has almost no blur,
    or equals the answer of a fit that starts without blur.
    """
    started = time.perf_counter()
    checked_seed(seed)
    gain = None if gain is None else positive("gain", gain)
    if strength is not None:
        strength = in_range("strength", strength, 0.0, 10.0, open_low=True, unit="waves")
    if start_error is not None:
        remedy = "leave it out; a search needs no start"
        start_error = in_range(
            "start_error", start_error, 0.0, _MOST_ERROR, open_low=True, unit="waves", remedy=remedy
        )
    one_of("object_model", object_model, ("pixels", "unet"))
    rounds = None if max_iterations is None else whole("max_iterations", max_iterations)
    seconds = math.inf if max_seconds is None else positive("max_seconds", max_seconds, unit="s")
    frames = frames_of(
        images,
        pupil_psf,
        defocus=defocus,
        walls=walls,
        noise_sigma=noise_sigma,
        background=background,
        fit_background=fit_background,
        background_shape=background_shape,
    )
    known = frames.picture("known_object", known_object)
    mask = frames.picture("support", support)
    several = known is not None or _diverse(frames, pupil_psf.wavelength)
    single = len(frames.images) == 1 and known is None and mask is None
    if object_model == "unet" and not single:
        raise SceneError(
            f"object_model = 'unet' with {counted(len(frames.images), 'image')}, a support or a "
            "known object; it needs one image without these, use 'pixels'"
        )

    @cache
    def energies(padding: float, modes: tuple[int, ...]) -> FreeEnergy:
        rows, columns = (8 * math.ceil(padding * side / 8) for side in frames.shape)
        return FreeEnergy(
            frames,
            pupil_psf,
            grid=(rows, columns),
            modes=modes,
            support=mask,
            known_object=known,
            fit_gains=fit_gains,
        )

    verdict = Verdict(frames, pupil_psf.modes, several)
    if all(one.is_background() for one in frames.measured):
        return _without_object(frames, pupil_psf, gain, started)
    searched = not several and start_error is None
    search = Search(
        energies,
        verdict,
        first=_first_coefficients(frames, pupil_psf),
        start_error=start_error,
        strength=strength,
        proposals=wall_proposals(frames, pupil_psf) if searched else None,
        rounds=ROUNDS[not several] if rounds is None else rounds,
        seed=seed,
        state=_search_state(start),
    )
    ended = False

    def watch(text: str, done: float) -> bool:
        nonlocal ended
        ended = not goes_on(progress, f"evidence: {text}", done, snapshot)
        late = time.perf_counter() > started + seconds
        return ended or (late and len(search.place.best) > 0)

    def snapshot() -> State:
        best = search.best()
        level = search.energy().objects(best)[0].astype(np.float64) * frames.scale
        return state_of(torch.from_numpy(level), **search.place.saved())

    search.run(watch)
    search.finished()
    best, energy = search.best(), search.energy()
    margin, sharp_margin = search.margins
    status: Status = "unconverged"
    reasons: tuple[str, ...] = ("the progress callback ended the search; resume it",)
    if not ended:
        reasons = search.faults
        status = verdict.status(best, margin, reasons)
    error = verdict.model_error(best)
    if not ended:
        goes_on(progress, "evidence: done", 1.0, snapshot)
        if single:
            best = _refined(frames, energy, best, object_model, seed)
    return _assembled(
        frames,
        energy,
        best,
        gain=gain,
        status=status,
        reasons=reasons,
        history=search.place.history,
        started=started,
        given=len(pupil_psf.modes),
        margin=margin,
        sharp_margin=sharp_margin,
        model_error=error,
    )


def _diverse(frames: Frames, wavelength: float) -> bool:
    """Return whether the images themselves exclude a wave without blur."""
    sights = {(int(w), float(d)) for w, d in zip(frames.walls, frames.defocus, strict=True)}
    if len(sights) < len(frames.images):
        raise SamplingError(
            f"{counted(len(frames.images), 'image')} with {counted(len(sights), 'pair')} of wall "
            "and defocus: equal ones tell no more than their mean; average them, or give the known "
            "defocus of each image, for example [0, half a wavelength]"
        )
    return frames.n_walls > 1 or bool(np.ptp(frames.defocus) >= _DIVERSE * wavelength)


def _first_coefficients(frames: Frames, pupil_psf: PupilPSF) -> Floats:
    """Return the given coefficients of all walls, (n_walls M,), waves rms."""
    given = pupil_psf.coefficients.detach().double().cpu().numpy()
    if given.ndim == 1:
        given = np.tile(given, (frames.n_walls, 1))
    if given.shape != (frames.n_walls, len(pupil_psf.modes)):
        raise SamplingError(
            f"pupil_psf.coefficients have shape {given.shape} for "
            f"{counted(frames.n_walls, 'wall')}; give (M,) or (n_walls, M)"
        )
    return given.ravel()


def _search_state(start: Any) -> Mapping[str, Any] | None:
    if start is not None and not isinstance(start, Mapping):
        raise SceneError(
            f"start of type {type(start).__name__} is no saved state; give a state of "
            "evidence_fit, or leave it out"
        )
    return start


def _refined(
    frames: Frames, energy: FreeEnergy, best: Starts, object_model: str, seed: int
) -> Starts:
    """Return the answer for one image with an object refined by a solver for known walls."""
    data: Measurement = frames.measured[0]
    kernel = energy.point_spread(best)
    model = ForwardModel(kernel, shape=frames.shape)
    sigma: Any = data.sigma if data.weights is None else data.sigma / data.weights.sqrt()
    options: dict[str, Any] = {
        "fit_background": data.fit_background,
        "background_shape": data.background_shape,
        "gain": frames.scale,
    }
    if object_model == "unet":
        # the network's input already contains the total-variation solution
        options |= {"noise_sigma": sigma, "tv_weight": 0.0, "guide_share": 0.0, "seed": seed}
        other = deep_image_prior(data.data, model, **options).object
    else:
        # errors of the wall's modes must not be fitted, like noise
        excess = math.sqrt(max(1.0, float(best.chi_square[0, 0])))
        other = tv_deconvolve(data.data, model, noise_sigma=sigma * excess, **options).object
    # Both priors have different errors, so that the mean correlates better with the truth than
    # either of them. Among seven walls and objects at 1 and 5 % noise, exceptions are
    # below 0.006.
    mean = 0.5 * (energy.objects(best) + other.double().cpu().numpy())
    return energy.judged(replace(best, free=energy.parameters(mean)))[0]


def _without_object(
    frames: Frames, pupil_psf: PupilPSF, gain: float | None, started: float
) -> Reconstruction:
    """Return a zero object for images that their background explains."""
    strengths = np.array([one.background_strength(one.data) for one in frames.measured])
    scores = [
        one.score(one.background(b)) for one, b in zip(frames.measured, strengths, strict=True)
    ]
    data, single = frames.measured[0], len(frames.measured) == 1
    sigmas = frames.sigmas * frames.scale
    return Reconstruction(
        object=data.like_input(torch.zeros(frames.shape, dtype=torch.float64)),
        physical_parameters={
            "gain": 1.0 if gain is None else gain,
            "background": float(strengths[0]) if single else strengths,
            "noise_sigma": float(sigmas[0]) if single else sigmas,
            "coefficients": np.zeros(_walls_first(frames, len(pupil_psf.modes))),
        },
        status="too_few_photons",
        reasons=("no object was detected above the noise, so the object is zero; expose longer",),
        score=math.sqrt(float(np.mean(np.square(scores)))),
        history=frozen({"objective": [], "residual": [], "change": []}),
        seconds=time.perf_counter() - started,
    )


def _walls_first(frames: Frames, count: int) -> tuple[int, ...]:
    return (count,) if frames.n_walls == 1 else (frames.n_walls, count)


def _assembled(
    frames: Frames,
    energy: FreeEnergy,
    best: Starts,
    *,
    gain: float | None,
    status: Status,
    reasons: tuple[str, ...],
    history: Mapping[str, list[float]],
    started: float,
    given: int,
    **figures: float,
) -> Reconstruction:
    """Assemble the reconstruction in image units; ``given`` is the number of given modes."""
    best, levels = energy.judged(best)
    object_level = energy.objects(best)[0].astype(np.float64) * frames.scale
    gains = best.gains[0]
    if energy.known:  # its brightness
        object_level, gains = object_level * gains.mean(), gains / gains.mean()
    brightest = float(object_level.max())
    if gain is None:
        gain = brightest if brightest > 0.0 else 1.0
    single = len(frames.measured) == 1
    backgrounds, sigmas = levels[0] * frames.scale, frames.sigmas * frames.scale
    walls = best.coefficients[0].astype(np.float64).reshape(frames.n_walls, -1)
    more = walls[:, given:].reshape(_walls_first(frames, walls.shape[1] - given))
    data = frames.measured[0]
    return Reconstruction(
        object=data.like_input(torch.from_numpy(object_level / gain)),
        physical_parameters={
            "gain": gain,
            "background": float(backgrounds[0]) if single else backgrounds,
            "noise_sigma": float(sigmas[0]) if single else sigmas,
            "coefficients": walls[:, :given].reshape(_walls_first(frames, given)),
            "more_modes": np.array(energy.modes[given:]),
            "more_coefficients": more,
            "image_gains": gains,
            "free_energy": float(best.energy[0]),
            **figures,
        },
        status=status,
        reasons=reasons,
        score=math.sqrt(float(np.average(best.chi_square[0], weights=frames.counted))),
        history=frozen(history),
        seconds=time.perf_counter() - started,
    )
