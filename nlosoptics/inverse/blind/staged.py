"""Blind fit of object and walls in stages, from several starts ranked by their free energy."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..._checks import counted, in_range, one_of, positive, whole
from ..._progress import Progress
from ..._random import checked_seed, generator
from ...errors import SamplingError, SceneError
from ...imaging.forward_model import ForwardModel
from ..data._threads import gradients, single_thread
from ..data.checkpoints import started_from
from ..data.measurement import real_array
from ..data.reconstruction import Reconstruction, frozen
from ..data.scores import registered_correlation
from ..data.status import Status
from ..known.total_variation import tv_deconvolve
from ..published.deep_image_prior import deep_image_prior
from ..wave.frames import Frames, frames_of
from ..wave.pupil_psf import PupilPSF
from .stages import (
    BATCH,
    BlindFit,
    NoBlur,
    NoBlurReport,
    Report,
    Stage,
    State,
    far_stages,
    near_stages,
    taken_up,
)

STARTS = 603  # stream of the random generator
#: Assumed rms error of the initial coefficients, waves: given ones, and zero by default.
_GIVEN_ERROR = 0.1
_UNKNOWN_ERROR = 0.5
#: Largest start error, waves, for which the object is first fitted with the initial coefficients.
_NEAR = 0.25
#: Criteria for an answer from one image. SURE_MARGIN: it is right if its free energy is below that
#: of the no-blur fit by at least this. SURE_START: if the prior of a well-known start puts the
#: no-blur fit above the answer by at least this, the answer's own energy may be higher, by at most
#: LITTLE_ABOVE over the relative noise: errors of the modes weigh more if the noise is low. Then
#: its residual must be at least OVERFITTED times the noise, because wrong answers fit the noise.
_SURE_MARGIN = 50.0
_SURE_START = 100.0
_LITTLE_ABOVE = 1.0
_OVERFITTED = 0.93
#: Correlation of object and image above which the answer counts as the image itself.
_LIKE_THE_IMAGE = 0.9
#: Largest rms residual beyond the noise for several images, relative to the brightest pixel.
_UNEXPLAINED = 0.014
_TOLERANCE = 2e-5


@single_thread()
@gradients()
def staged_fit(
    images: Any,
    pupil_psf: PupilPSF,
    *,
    defocus: Any = None,
    walls: Any = None,
    start_error: float | None = None,
    starts: int | None = None,
    known_object: Any = None,
    support: Any = None,
    object_model: str = "pixels",
    boundary: str = "padded",
    fit_gains: bool = False,
    noise_sigma: Any = None,
    background: Any = 0.0,
    fit_background: bool = True,
    background_shape: Any = None,
    gain: float | None = None,
    max_iterations: int | None = None,
    tolerance: float = _TOLERANCE,
    seed: int = 0,
    start: Any = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Fit object and walls to one or more images in stages: first the object, then both.

    Parameters
    ----------
    images : ndarray or Tensor
        Images, (K, H, W) or (H, W), any unit, of one object via one wall with K known defoci, or
        via several walls.
    pupil_psf : PupilPSF
        Point spread with Zernike coefficients, (M,) or (n_walls, M), whose values are the start of
        the fit. It has the images' shape or a larger one.
    defocus : array_like, optional
        Known additional defocus of each image, (K,), m rms (Noll 4).
    walls : array_like of int, optional
        Number of the wall of each image, (K,), counted from 0; by default one wall for all.
    start_error : float, optional
        Expected rms error of the start, waves. By default 0.1, or 0.5 if all coefficients are 0 (no
        prior knowledge). Overestimate it if in doubt.
    starts : int, optional
        Number of starts, drawn with that error; by default 4, or 16 for errors above 0.25 waves.
    known_object : array_like, optional
        Known object, (H, W); only the walls are fitted then.
    support : array_like, optional
        Mask, (H, W), 0 where the object is known to be dark.
    object_model : {"pixels", "unet"}
        Final object for one image without ``support``, once the wall is found. "pixels": mean of
        the fitted object and that of `tv_deconvolve`. "unet": mean of the fitted object and that of
        `deep_image_prior`, which takes longer and tolerates more noise.
    boundary : {"padded", "circular"}
        Surroundings of the object: dark, or periodic copies.
    fit_gains : bool
        Whether to fit the relative brightness of the images.
    noise_sigma : float or array_like, optional
        Standard deviation of the noise: one number, (K,), (H, W) or (K, H, W), image units; None:
        estimated.
    background : float or array_like
        Known background: one number, (K,), (H, W) or (K, H, W), image units.
    fit_background : bool
        Whether to fit the strength of an additional background for each image.
    background_shape : array_like or None
        Shape of the additional background, (H, W), non-negative; None: uniform.
    gain : float or None
        Known image units per object unit; None: the object is scaled to a maximum of 1.
    max_iterations : int, optional
        Maximum number of iterations; all stages are shortened in proportion.
    tolerance : float
        The last stage ends when the free energy changes by less than this fraction in 25
        iterations.
    seed : int
        Seed of the random starts.
    start : array_like, mapping or None
        Initial object, (H, W), any unit; or a saved state of this solver with the same images and
        options, to resume from (see `inverse.data.checkpoints`). None: Wiener filter.
    progress : callable or None
        Called repeatedly with a text and the completed fraction; may raise `Stop`.

    Returns
    -------
    Reconstruction
        Object, status and score. ``physical_parameters`` also contains ``coefficients`` ((M,) or
        (n_walls, M), waves rms), ``image_gains`` (K,), ``free_energy``, and ``margin``: free energy
        minus that of the no-blur fit; negative favours this answer. ``background`` is (K,) for
        several images. The history is that of the best start.

    Raises
    ------
    SamplingError
        If array shapes do not match.
    SceneError
        If a value is out of range or not finite.

    See Also
    --------
    pcin : Entry point of the blind solvers.
    evidence_fit : Blind fit from random starts.
    PupilPSF : Differentiable PSF of a wave.

    Notes
    -----
    Adam minimises `Energy` over the object's pixels and the coefficients. Its value ranks the
    starts, because squared residuals alone prefer no blur to the truth. The assumed noise starts
    too large, which smooths the fit and helps it leave wrong answers, and then decreases to the
    actual noise. For small start errors the object is fitted first with fixed coefficients. A
    Gaussian prior of width ``start_error`` holds the coefficients near their start.

    With one image the status is "converged" in two cases. Either the free energy is at least 50
    below that of a fit that started without blur and has free coefficients. Or it is at most 100
    above (at 1 % noise; 20 at 5 %), the prior of ``start_error`` puts the no-blur fit at least 100
    above the answer, and the residual is at least 0.93 of the noise, because wrong answers fit
    noise. Otherwise the status is "trivial" if the object is the image itself. With several images
    it is "converged" if the rms residual in excess of the noise is below 1.4 % of the brightest
    pixel.
    """
    started = time.perf_counter()
    checked_seed(seed)
    tolerance = in_range("tolerance", tolerance, 0.0, 0.5)
    gain = None if gain is None else positive("gain", gain)
    one_of("object_model", object_model, ("pixels", "unet"))
    frames = frames_of(
        images,
        pupil_psf,
        defocus=defocus,
        walls=walls,
        noise_sigma=noise_sigma,
        background=background,
        fit_background=fit_background,
        background_shape=background_shape,
        boundary=boundary,
    )
    refined = len(frames.images) == 1 and support is None and known_object is None
    if object_model == "unet" and not refined:
        raise SceneError(
            f"object_model = 'unet' with {counted(len(frames.images), 'image')}, a support or a "
            "known object; it needs one image without these, use 'pixels'"
        )
    first = _first_coefficients(frames, pupil_psf)
    if start_error is None:
        start_error = _GIVEN_ERROR if bool(first.any()) else _UNKNOWN_ERROR
    start_error = positive("start_error", start_error, unit="waves")
    near = start_error <= _NEAR
    starts = (4 if near else 16) if starts is None else whole("starts", starts)
    stages = _shortened((near_stages if near else far_stages)(starts), max_iterations)
    kept = start if isinstance(start, Mapping) and {*BATCH, "place"} <= set(start) else None
    fit = BlindFit(
        frames,
        first,
        start_error,
        support=None if support is None else _support(support, frames),
        known=_picture("known_object", known_object, frames),
        guess=None if kept is not None else _picture("start", _object_of(start), frames),
        fit_gains=fit_gains,
    )
    if all(one.is_background() for one in frames.measured):
        state = fit.begin(first[None], 1.0)
        state.theta = torch.full_like(state.theta, 0.0 if fit.known else -math.inf)
        return _assembled(fit, state, gain, "too_few_photons", started, math.nan)
    state = fit.begin(_drawn(first, start_error, starts, seed), stages[0].noise[0])
    state, no_blur, ended = _through(fit, state, stages, tolerance, progress, kept)
    margin = float(state.energy[0]) - no_blur.energy
    if ended:
        return _assembled(fit, state, gain, "unconverged", started, margin)
    level = _refined(fit, state, object_model, boundary, seed) if refined else None
    status = _status(fit, state, margin, no_blur.held)
    return _assembled(fit, state, gain, status, started, margin, level)


def _through(
    fit: BlindFit,
    state: State,
    stages: tuple[Stage, ...],
    tolerance: float,
    progress: Progress | None,
    kept: Mapping[str, Any] | None,
) -> tuple[State, NoBlur, bool]:
    """Run all stages; return the best fit, the no-blur fit, and whether the callback stopped.

    ``kept`` is a saved state to resume from, or None.
    """
    judged = len(fit.frames.images) == 1 and not fit.known
    before = sum(stage.iterations for stage in near_stages(1)[1:]) if judged else 0
    total = before + sum(stage.iterations for stage in stages)
    report, at = Report(progress, total), 0
    report.skip(before)
    if kept is not None:
        at = int(kept["place"][0])
        state = taken_up(state, kept)
        report.no_blur = NoBlur(*(float(value) for value in kept["place"][3:]))
        report.skip(sum(stage.iterations for stage in stages[:at]) + int(kept["place"][1]))
    elif judged:
        first = NoBlurReport(progress, total)
        sharp = _no_blur_fit(fit, tolerance, first)
        if first.ended:
            return fit.best(state, 1), report.no_blur, True
        report.no_blur = NoBlur(float(sharp.energy[0]), float(fit.held(sharp.coefficients)[0]))
    for number in range(at, len(stages)):
        report.stage = number
        if kept is None:
            state = fit.best(state, stages[number].starts)
        state = fit.run(state, stages[number], tolerance, report, kept)
        kept = None
        if report.ended:
            return fit.best(state, 1), report.no_blur, True
    return state, report.no_blur, False


def _object_of(start: Any) -> Any:
    """Return the initial object of the argument ``start``, or None."""
    if not isinstance(start, Mapping):
        return start
    if "place" in start:  # ended before the first stage: all is still to do
        return None
    return started_from(start, np.shape(start.get("object", ())), torch.device("cpu"))


def _first_coefficients(frames: Frames, pupil_psf: PupilPSF) -> Tensor:
    """Return the initial coefficients, (n_walls, M)."""
    given = pupil_psf.coefficients.detach()
    if given.ndim == 1:
        given = given.expand(frames.n_walls, -1)
    if given.ndim != 2 or len(given) != frames.n_walls:
        raise SamplingError(
            f"pupil_psf.coefficients have shape {tuple(given.shape)} for "
            f"{counted(frames.n_walls, 'wall')}; give (M,) or (n_walls, M)"
        )
    return given.clone()


def _drawn(first: Tensor, start_error: float, starts: int, seed: int) -> Tensor:
    """Return random starts (B, n_walls, M) at the distance ``start_error`` from ``first``.

    If that distance is small, the first start is ``first`` itself. Coefficients are in waves.
    """
    draws = generator(seed, STARTS).standard_normal((starts, *first.shape))
    draws *= start_error / np.linalg.norm(draws, axis=-1, keepdims=True)
    if start_error <= _NEAR:
        draws[0] = 0.0
    return first + torch.from_numpy(draws).to(first)


def _shortened(stages: tuple[Stage, ...], max_iterations: int | None) -> tuple[Stage, ...]:
    """Return the stages, shortened in proportion to a total of at most ``max_iterations``."""
    total = sum(stage.iterations for stage in stages)
    if max_iterations is None or whole("max_iterations", max_iterations) >= total:
        return stages
    share = max_iterations / total
    return tuple(replace(s, iterations=max(1, int(s.iterations * share))) for s in stages)


def _picture(name: str, value: Any, frames: Frames) -> Tensor | None:
    """Return an optional image (H, W) given by the user, checked against the images."""
    if value is None:
        return None
    picture = real_array(name, value)
    shape = tuple(frames.images.shape[-2:])
    if picture.shape != shape:
        raise SamplingError(f"{name} has shape {picture.shape}, must be {shape} like the images")
    if not np.isfinite(picture).all() or picture.min() < 0.0 or picture.max() <= 0.0:
        raise SceneError(
            f"{name} spans {picture.min():g} to {picture.max():g}, must be finite and non-negative "
            "with some light; leave it out if it is unknown"
        )
    return torch.from_numpy(picture).to(frames.images)


def _support(value: Any, frames: Frames) -> Tensor:
    """Return an image (H, W) that is 1 where the object may be bright, else 0."""
    picture = _picture("support", value, frames)
    assert picture is not None
    return (picture > 0.0).to(picture)


def _no_blur_fit(fit: BlindFit, tolerance: float, report: Report) -> State:
    """Return the fit that starts from a wave without blur, with free coefficients."""
    sharp = BlindFit(
        fit.frames,
        torch.zeros_like(fit.first),
        math.inf,
        support=fit.energy.support,
        known=None,
        guess=None,
        fit_gains=fit.fit_gains,
    )
    state = sharp.begin(torch.zeros_like(fit.first)[None], 5.0)
    for stage in near_stages(1)[1:]:
        state = sharp.run(state, stage, tolerance, report)
        if report.ended:
            break
    return state


def _status(fit: BlindFit, state: State, margin: float, held: float) -> Status:
    """Return the status of the answer; the truth is not used.

    ``margin`` is its free energy minus that of the no-blur fit, and ``held`` the energy of the
    no-blur fit due to its distance from the start.
    """
    if math.isnan(margin):
        faint = min(one.sigma for one in fit.frames.measured) / fit.frames.scale
        limit = 1.0 + (_UNEXPLAINED / faint) ** 2
        return "converged" if float(state.square[0]) <= limit else "unconverged"
    fitted_noise = math.sqrt(float(state.square[0])) < _OVERFITTED
    noise = fit.frames.measured[0].sigma / fit.frames.scale
    above = margin * noise < _LITTLE_ABOVE
    by_start = margin - held < -_SURE_START and above and not fitted_noise
    if margin < -_SURE_MARGIN or by_start:
        return "converged"
    level = fit.energy.level(state.theta)[0]
    alike = registered_correlation(level, fit.frames.images[0], upsampling=1)
    return "trivial" if alike > _LIKE_THE_IMAGE else "unconverged"


def _refined(fit: BlindFit, state: State, object_model: str, boundary: str, seed: int) -> Tensor:
    """Return the object (1, H, W) of one image, refined by a solver for known walls."""
    frames = fit.frames
    data = frames.measured[0]
    kernel = frames.pupil(state.coefficients[0, 0]).detach().double().cpu().numpy()
    model = ForwardModel(kernel, shape=data.data.shape, boundary=boundary)  # type: ignore[arg-type]
    sigma: Any = data.sigma if data.weights is None else data.sigma / data.weights.sqrt()
    options: dict[str, Any] = {
        "fit_background": data.fit_background,
        "background_shape": data.background_shape,
        "gain": frames.scale,
    }
    other: Tensor
    if object_model == "unet":
        # the network's input already contains the total-variation solution
        options |= {"noise_sigma": sigma, "tv_weight": 0.0, "guide_share": 0.0, "seed": seed}
        other = deep_image_prior(data.data, model, **options).object
    else:
        # errors of the wall's modes must not be fitted, like noise
        excess = math.sqrt(max(1.0, float(state.square[0])))
        other = tv_deconvolve(data.data, model, noise_sigma=sigma * excess, **options).object
    # Both priors have different errors, so that the mean correlates better with the truth than
    # either of them. Among seven walls and objects at 1 and 5 % noise, exceptions are
    # below 0.006.
    return 0.5 * (fit.energy.level(state.theta) + other[None].to(frames.images))


def _assembled(
    fit: BlindFit,
    state: State,
    gain: float | None,
    status: Status,
    started: float,
    margin: float,
    level: Tensor | None = None,
) -> Reconstruction:
    """Assemble the reconstruction, in image units."""
    frames = fit.frames
    if level is None:
        level = fit.energy.level(state.theta)
    gains = fit.gains(state)
    seen = frames.seen(level, frames.transfer(state.coefficients))
    misfit = frames.images - (seen if gains is None else gains * seen)
    strengths = frames.backgrounds(misfit)
    square = frames.mean_square(misfit - strengths * frames.shapes)
    single = len(frames.images) == 1
    backgrounds = (strengths[0, :, 0, 0] * frames.scale).double().cpu().numpy()
    sigmas = np.array([one.sigma for one in frames.measured])
    picture = level[0].double() * frames.scale
    if gain is None:
        brightest = float(picture.max())
        gain = brightest if brightest > 0.0 else 1.0
    coefficients = state.coefficients[0].double().cpu().numpy()
    relative = (
        np.ones(len(frames.images)) if gains is None else gains[0, :, 0, 0].double().cpu().numpy()
    )
    return Reconstruction(
        object=frames.measured[0].like_input(picture / gain),
        physical_parameters={
            "gain": gain,
            "background": float(backgrounds[0]) if single else backgrounds,
            "noise_sigma": float(sigmas[0]) if single else sigmas,
            "coefficients": coefficients[0] if len(coefficients) == 1 else coefficients,
            "image_gains": relative,
            "free_energy": float(state.energy[0]),
            "margin": margin,
        },
        status=status,
        score=math.sqrt(float(square[0])),
        history=frozen(state.history),
        seconds=time.perf_counter() - started,
    )
