"""Object and walls by stages: object first, then both, many starts judged by their free energy."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .._checks import positive, whole
from .._random import checked_seed, generator
from ..errors import SamplingError, SceneError
from ._threads import single_thread
from .blind_energy import Energy, KnownObjectEnergy
from .blind_frames import Frames, frames_of
from .pupil_psf import PupilPSF
from .reconstructions import Reconstruction, Status
from .registration import registered_correlation

Progress = Callable[[float, str], None]

STARTS = 603  # stream of the random generator
#: rms error of a start, waves: of coefficients that are given, and of none.
_GIVEN_ERROR = 0.1
_UNKNOWN_ERROR = 0.5
#: Start errors above this are too far for an object of the start's own point spread.
_NEAR = 0.25
_OBJECT_STEP = 0.05
_GAIN_STEP = 0.01
_BETAS = (0.9, 0.99)
#: Free energy below that of no blur which tells an answer from chance, and mean squared residual
#: over noise of several images above which they are not explained.
_SURE_MARGIN = 100.0
_EXPLAINED = 1.6
#: An object as like the image as this, without a margin, is the image itself.
_LIKE_THE_IMAGE = 0.95
_TOLERANCE = 2e-5
_CHECK_EVERY = 25


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One round of the fit.

    Parameters
    ----------
    starts : int
        How many of the best go in.
    iterations : int
    noise : (float, float)
        Factor by which the noise is taken for larger, first and last; geometric between, reached
        after 0.7 of the iterations.
    step : float
        Of the coefficients, waves; 0 keeps them.
    """

    starts: int
    iterations: int
    noise: tuple[float, float]
    step: float


def near_stages(starts: int) -> tuple[Stage, ...]:
    """Rounds for coefficients that are known to some tenth of a wave."""
    return (
        Stage(starts=starts, iterations=200, noise=(5.0, 5.0), step=0.0),
        Stage(starts=starts, iterations=400, noise=(5.0, 1.0), step=0.01),
        Stage(starts=1, iterations=200, noise=(1.0, 1.0), step=0.004),
    )


def far_stages(starts: int) -> tuple[Stage, ...]:
    """Rounds for walls of which nothing is known."""
    return (
        Stage(starts=starts, iterations=200, noise=(30.0, 4.0), step=0.016),
        Stage(starts=max(1, starts // 4), iterations=300, noise=(4.0, 1.0), step=0.016),
        Stage(starts=1, iterations=300, noise=(1.0, 1.0), step=0.005),
    )


@single_thread()
def staged_fit(
    images: Any,
    pupil_psf: PupilPSF,
    *,
    defocus: Any = None,
    walls: Any = None,
    start_error: float | None = None,
    starts: int | None = None,
    known_object: Any = None,
    start_object: Any = None,
    support: Any = None,
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
    progress: Progress | None = None,
) -> Reconstruction:
    """Object and walls from one or more images, by stages.

    Parameters
    ----------
    images : ndarray or Tensor
        (K, H, W) or (H, W), any unit: one object, by one wall with K known defoci, or by several.
    pupil_psf : PupilPSF
        Zernike leaves, (M,) or (n_walls, M); their values are where the fit starts. Of the images'
        shape or larger.
    defocus : array_like, optional
        (K,), known further defocus of each image, m rms (Noll 4).
    walls : array_like of int, optional
        (K,), the wall of each image, 0, 1, ...; by default one wall for all.
    start_error : float, optional
        rms distance of the start from the truth to be expected, waves. By default 0.1, and 0.5
        where all coefficients are 0, which is: nothing is known. Rather too large than too small.
    starts : int, optional
        Starts tried, drawn with that error; by default 4, and 16 above 0.25 waves.
    known_object : array_like, optional
        (H, W): the object of the images is known, and the walls alone are fitted.
    start_object : array_like, optional
        (H, W), where the object starts, in any unit; by default a Wiener filter's answer.
    support : array_like, optional
        (H, W), 0 where the object is known to be dark.
    boundary : {"padded", "circular"}
        What lies around the object: nothing, or its own periodic copies.
    fit_gains : bool
        Whether the images' relative brightness is unknown.
    noise_sigma : float or array_like, optional
        One, (K,), (H, W) or (K, H, W), image units; None: estimated.
    background : float or array_like
        Known background, likewise.
    fit_background : bool
        Whether each image has a further background of unknown strength.
    background_shape : array_like or None
        (H, W), shape of it; None: uniform.
    gain : float or None
        Known image units per object unit; None: the object's largest value becomes 1.
    max_iterations : int, optional
        Shortens all stages in proportion.
    tolerance : float
        Relative change of the free energy in 25 iterations at which the last stage ends.
    seed : int
        Of the starts.
    progress : callable or None
        Called with the fraction done and a line of text.

    Returns
    -------
    Reconstruction
        ``physical_parameters`` also holds ``coefficients`` ((M,) or (n_walls, M), waves rms),
        ``image_gains`` (K,), ``free_energy``, and ``margin``: by how much that is above the one of
        a start at no blur (below 0: the answer is better). ``background`` is (K,) of several
        images. History is that of the best start.

    Raises
    ------
    SamplingError
        If an array does not fit the others.
    SceneError
        If a value is out of range or not finite.

    Notes
    -----
    Adam on the pixels of the object and on the coefficients, under `Energy`, whose value orders the
    starts: squared residuals alone prefer no blur to the truth. The noise is taken for larger at
    first, which blurs what is fitted and lets the fit out of wrong answers, then falls to what it
    is, where the residual is to be the noise. Near starts have their object fitted first, with the
    coefficients kept; the coefficients are held to their start by a Gaussian prior of
    ``start_error``.

    One image: "converged" where the free energy is 100 or more below that of a fit which started
    at no blur, "trivial" where the object is the image itself. Several: "converged" where the mean
    squared residual is below 1.6 of the noise's.
    """
    started = time.perf_counter()
    checked_seed(seed)
    gain = None if gain is None else positive("gain", gain)
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
    first = _first_coefficients(frames, pupil_psf)
    if start_error is None:
        start_error = _GIVEN_ERROR if bool(first.any()) else _UNKNOWN_ERROR
    start_error = positive("start_error", start_error, unit="waves")
    near = start_error <= _NEAR
    starts = (4 if near else 16) if starts is None else whole("starts", starts)
    stages = _shortened((near_stages if near else far_stages)(starts), max_iterations)
    fit = _Fit(
        frames,
        first,
        start_error,
        support=_picture("support", support, frames),
        known=_picture("known_object", known_object, frames),
        guess=_picture("start_object", start_object, frames),
        fit_gains=fit_gains,
    )
    report = _Report(progress, sum(s.iterations for s in stages))
    if all(one.is_background() for one in frames.measured):
        state = fit.begin(first[None], 1.0)
        state.theta = torch.full_like(state.theta, -math.inf)
        return _assembled(fit, state, gain, "too_few_photons", started, math.nan)
    floor = _no_blur_energy(fit, tolerance) if len(frames.images) == 1 and not fit.known else None
    state = fit.begin(_drawn(first, start_error, starts, seed), stages[0].noise[0])
    for stage in stages:
        state = fit.run(fit.best(state, stage.starts), stage, tolerance, report)
    margin = math.nan if floor is None else float(state.energy[0]) - floor
    return _assembled(fit, state, gain, _status(fit, state, margin), started, margin)


@dataclass(eq=False, kw_only=True)
class _State:
    """A batch of fits."""

    theta: Tensor
    coefficients: Tensor
    log_gains: Tensor
    variances: Tensor
    energy: Tensor
    square: Tensor
    history: dict[str, list[float]] = field(
        default_factory=lambda: {"objective": [], "residual": [], "change": []}
    )
    settled: bool = False

    def chosen(self, which: Tensor) -> _State:
        """Some of the fits."""
        return _State(
            theta=self.theta.detach()[which].clone(),
            coefficients=self.coefficients.detach()[which].clone(),
            log_gains=self.log_gains.detach()[which].clone(),
            variances=self.variances[which].clone(),
            energy=self.energy[which].clone(),
            square=self.square[which].clone(),
            history=self.history,
            settled=self.settled,
        )


class _Fit:
    """What the stages share: data, prior and energy."""

    def __init__(
        self,
        frames: Frames,
        first: Tensor,
        start_error: float,
        *,
        support: Tensor | None,
        known: Tensor | None,
        guess: Tensor | None,
        fit_gains: bool,
    ) -> None:
        self.frames = frames
        self.first = first
        self.guess = guess
        self.fit_gains = fit_gains and len(frames.images) > 1
        self.known = known is not None
        self.energy = Energy(frames, support) if known is None else KnownObjectEnergy(frames, known)
        self._stiffness = first.shape[-1] / (2.0 * start_error**2)

    def begin(self, coefficients: Tensor, factor: float) -> _State:
        """Objects by the start's point spreads."""
        count = len(coefficients)
        with torch.no_grad():
            level = self.energy.wiener(self.frames.transfer(coefficients), factor)
            if self.guess is not None and not self.known:
                bright = level.clamp_min(0.0).mean((-2, -1), keepdim=True)
                level = self.guess * (bright / self.guess.mean())
        zeros = torch.zeros(count).to(self.frames.images)
        return _State(
            theta=self.energy.theta(level),
            coefficients=coefficients,
            log_gains=torch.zeros(count, len(self.frames.images)).to(zeros),
            variances=self.energy.first_variances(count),
            energy=zeros,
            square=zeros,
        )

    def best(self, state: _State, count: int) -> _State:
        """The fits of lowest energy."""
        if count >= len(state.theta):
            count = len(state.theta)
        return state.chosen(state.energy.argsort()[:count])

    def gains(self, state: _State) -> Tensor | None:
        """Relative brightness of the images, their logarithms' mean 0, (B, K, 1, 1)."""
        if not self.fit_gains:
            return None
        logs = state.log_gains - state.log_gains.mean(-1, keepdim=True)
        return logs.exp()[..., None, None]

    def run(self, state: _State, stage: Stage, tolerance: float, report: _Report | None) -> _State:
        """One stage."""
        moves = stage.step > 0.0
        groups = [{"params": [state.theta.requires_grad_()], "lr": _OBJECT_STEP}]
        if self.fit_gains:
            groups.append({"params": [state.log_gains.requires_grad_()], "lr": _GAIN_STEP})
        if moves:
            groups.append({"params": [state.coefficients.requires_grad_()], "lr": stage.step})
        optimiser = torch.optim.Adam(groups, betas=_BETAS)
        steps = [group["lr"] for group in groups]
        kept = None if moves else self.frames.transfer(state.coefficients).detach()
        final = stage.noise == (1.0, 1.0)
        lowest, last = None, math.inf
        for iteration in range(stage.iterations):
            done = iteration / max(1, stage.iterations - 1)
            factor = stage.noise[0] * (stage.noise[1] / stage.noise[0]) ** min(1.0, done / 0.7)
            pace = (
                1.0 if done < 0.5 else 0.05 + 0.475 * (1.0 + math.cos(2 * math.pi * (done - 0.5)))
            )
            for group, step in zip(optimiser.param_groups, steps, strict=True):
                group["lr"] = pace * step
            level = self.energy.level(state.theta)
            transfer = self.frames.transfer(state.coefficients) if kept is None else kept
            energy, square = self.energy(
                level, transfer, state.variances, factor, self.gains(state)
            )
            offset = (state.coefficients - self.first).square().sum((-2, -1))
            energy = energy + self._stiffness * offset
            optimiser.zero_grad()
            energy.sum().backward()
            state.energy, state.square = energy.detach(), square
            if final and (lowest is None or float(state.energy[0]) < float(lowest.energy[0])):
                lowest = state.chosen(torch.zeros(1, dtype=torch.int64))
            optimiser.step()
            self._record(state, last)
            if report is not None:
                report.tell(state, factor)
            if final and iteration % _CHECK_EVERY == _CHECK_EVERY - 1:
                now = float(state.energy.min())
                if abs(last - now) <= tolerance * abs(now):
                    state.settled = True
                    break
                last = now
        found = state if lowest is None else lowest
        found.settled = state.settled
        return found.chosen(torch.arange(len(found.theta)))

    @staticmethod
    def _record(state: _State, last: float) -> None:
        at = int(state.energy.argmin())
        objective = float(state.energy[at])
        before = state.history["objective"][-1] if state.history["objective"] else math.inf
        state.history["objective"].append(objective)
        state.history["residual"].append(math.sqrt(float(state.square[at])))
        state.history["change"].append(
            abs(before - objective) / max(abs(objective), 1e-30) if before < math.inf else 1.0
        )


class _Report:
    """Fraction done, told now and then."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def tell(self, state: _State, factor: float) -> None:
        """After each iteration."""
        self._done += 1
        if self._progress is not None and self._done % _CHECK_EVERY == 0:
            at = int(state.energy.argmin())
            self._progress(
                min(1.0, self._done / self._total),
                f"staged fit: residual {math.sqrt(float(state.square[at])):.3f} of the noise, "
                f"free energy {float(state.energy[at]):.1f} at noise x {factor:.2g}",
            )


def _pace(done: float) -> float:
    """Share of the step: all of it for half of the stage, then a cosine down to 5 %."""
    if done < 0.5:
        return 1.0
    return 0.05 + 0.475 * (1.0 + math.cos(2.0 * math.pi * (done - 0.5)))


def _first_coefficients(frames: Frames, pupil_psf: PupilPSF) -> Tensor:
    """Where the fit starts, (n_walls, M)."""
    given = pupil_psf.coefficients.detach()
    if given.ndim == 1:
        given = given.expand(frames.n_walls, -1)
    if given.ndim != 2 or len(given) != frames.n_walls:
        raise SamplingError(
            f"pupil_psf.coefficients have shape {tuple(given.shape)} for {frames.n_walls} walls; "
            "give (M,) or (n_walls, M)"
        )
    return given.clone()


def _drawn(first: Tensor, start_error: float, starts: int, seed: int) -> Tensor:
    """Starts (B, n_walls, M) at the expected distance; what is given is the first of them."""
    draws = generator(seed, STARTS).standard_normal((starts, *first.shape))
    draws *= start_error / np.linalg.norm(draws, axis=-1, keepdims=True)
    if start_error <= _NEAR:
        draws[0] = 0.0
    return first + torch.from_numpy(draws).to(first)


def _shortened(stages: tuple[Stage, ...], max_iterations: int | None) -> tuple[Stage, ...]:
    """Stages of so many iterations in all, at most."""
    total = sum(stage.iterations for stage in stages)
    if max_iterations is None or whole("max_iterations", max_iterations) >= total:
        return stages
    share = max_iterations / total
    return tuple(replace(s, iterations=max(1, int(s.iterations * share))) for s in stages)


def _picture(name: str, value: Any, frames: Frames) -> Tensor | None:
    """A picture that came with the images, on their pixels."""
    if value is None:
        return None
    if isinstance(value, Tensor):
        value = value.detach().cpu().numpy()
    picture = np.asarray(value, dtype=np.float64)
    shape = tuple(frames.images.shape[-2:])
    if picture.shape != shape:
        raise SamplingError(f"{name} has shape {picture.shape}, must be {shape} like the images")
    if not np.isfinite(picture).all() or picture.min() < 0.0 or picture.max() <= 0.0:
        raise SceneError(
            f"{name} spans {picture.min():g} to {picture.max():g}, must be finite and non-negative "
            "with some light; leave it out where it is unknown"
        )
    return torch.from_numpy(picture).to(frames.images)


def _no_blur_energy(fit: _Fit, tolerance: float) -> float:
    """Free energy of the fit that starts at no blur, its coefficients free."""
    sharp = _Fit(
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
        state = sharp.run(state, stage, tolerance, None)
    return float(state.energy[0])


def _status(fit: _Fit, state: _State, margin: float) -> Status:
    """Whether the answer can be trusted, without the truth."""
    if math.isnan(margin):
        return "converged" if float(state.square[0]) <= _EXPLAINED else "unconverged"
    if margin < -_SURE_MARGIN:
        return "converged"
    level = fit.energy.level(state.theta)[0].double().cpu().numpy()
    alike = registered_correlation(level, fit.frames.measured[0].data, upsampling=1)
    return "trivial" if alike > _LIKE_THE_IMAGE else "unconverged"


def _assembled(
    fit: _Fit, state: _State, gain: float | None, status: Status, started: float, margin: float
) -> Reconstruction:
    """What is returned, in image units."""
    frames = fit.frames
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
    relative = np.ones(len(frames.images)) if gains is None else gains[0, :, 0, 0].double().numpy()
    records = {name: np.asarray(values) for name, values in state.history.items()}
    for record in records.values():
        record.flags.writeable = False
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
        history=records,
        seconds=time.perf_counter() - started,
    )
