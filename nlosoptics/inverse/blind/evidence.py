"""Blind fit of object and wall from random starts, ranked by the evidence (object marginalised)."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from ..._checks import in_range, positive, whole
from ..._progress import Progress
from ..._random import checked_seed, generator
from ...errors import SamplingError, SceneError
from ..data._threads import single_thread
from ..data.checkpoints import State, goes_on, state_of
from ..data.reconstruction import Reconstruction, frozen
from ..data.status import Status
from ..wave.frames import Frames, frames_of
from ..wave.pupil_psf import PupilPSF
from .evidence_search import Island, Watch, evolve, gather, refine, sharp, without_blur
from .free_energy import Floats, FreeEnergy, Starts

#: Smallest range of the known defoci, waves rms, at which a wave without blur cannot explain all
#: images.
_DIVERSE = 0.1
#: Norms of the coefficients of initial walls, waves rms. They are rather too large than too small.
_STRENGTHS = (0.3, 0.6, 1.0)
#: Norms of initial walls relative to a known rms of the wave.
_AROUND = (0.9, 1.1, 1.4)
_STARTS = 32
#: Largest rms residual beyond the noise of a right answer, relative to the images' range: a
#: constant, and the increase per wave of the wall's rms, up to one wave, due to modes that are not
#: fitted. Answers for stronger walls were more often wrong.
_MODEL_ERROR = (0.004, 0.010)
#: Fraction of the largest `_model_error` below which the search of a round ends early.
_WELL = 0.6
_NEAR_FRAMES = 4
#: An answer for one image counts as right if its free energy is below that of a wave without blur
#: by at least this. In 84 fits at 1 % noise, the margin of wrong answers was at most 38.
_SURE_MARGIN = 70.0
#: Margin per pixel relative to the fit that takes the image for the object: its value at a noise of
#: `_SHARP_NOISE` of the image's maximum or more, and the increase per factor e of less noise. The
#: margin of wrong answers was at most 0.082 at 1 % noise (0.086 for 32 x 32 pixels) and 0.130 at
#: 0.3 %; most right answers exceeded it.
_SHARP_MARGIN = (0.092, 0.045)
_SHARP_NOISE = 0.01
#: Norm of the coefficients, waves rms, below which an answer counts as without blur.
_NO_BLUR = 0.12
#: Smallest norm of the coefficients relative to the fixed norm of the search.
_LEAST_LENGTH = 0.7
_GENERATIONS = 6
_ROUNDS_OF_FRAMES = 2
_ISLANDS = (
    Island(radius=0.6),
    Island(radius=0.35, kappa=1.0),
    Island(radius=0.6, first=20.0, wave_rate=0.032),
    Island(radius=0.9, kappa=1.0, first=20.0),
)


@single_thread()
def evidence_fit(
    images: Any,
    pupil_psf: PupilPSF,
    *,
    defocus: Any = None,
    noise_sigma: Any = None,
    background: Any = 0.0,
    fit_background: bool = True,
    gain: float | None = None,
    strength: float | None = None,
    max_iterations: int | None = None,
    max_seconds: float | None = None,
    seed: int = 0,
    start: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Fit object and wall to images from random starts, by maximising the evidence.

    Use two frames, one with a known additional defocus of half a wave rms (one wave for walls of
    one wave rms). A wave without blur then cannot explain both, and most random starts end at the
    truth. With one frame the search takes many times longer, and the answer is reliable only if
    ``status`` is "converged".

    Parameters
    ----------
    images : ndarray or Tensor
        Square images, (K, H, H) or (H, H), any unit, of the same object via the same wall and with
        the same gain. The object must lie inside the frame.
    pupil_psf : PupilPSF
        Point spread from `PupilPSF.from_zernike`, of which only modes and lengths are used. Its
        pitch must not exceed the Nyquist pitch.
    defocus : array_like, optional
        Known additional defocus of each image, (K,), m rms (Noll 4).
    noise_sigma : float or array_like, optional
        Standard deviation of the noise: one number, (K,), (H, H) or (K, H, H), image units. Of a
        noise map only the mean precision (1/variance) is used. None: estimated.
    background : float or array_like
        Known background: one number, (K,), (H, H) or (K, H, H), image units.
    fit_background : bool
        Whether to fit an additional uniform background for each image.
    gain : float or None
        Known image units per object unit; None: the object is scaled to a maximum of 1.
    strength : float or None
        Rms of the wall's wave, waves. None: unknown; several values are tried.
    max_iterations : int, optional
        Maximum number of search rounds; by default 2 with a defocused frame, otherwise 4. A round
        optimises 32 random walls, or about 400 walls and variations of the best for one frame.
    max_seconds : float, optional
        Time after which no further round or generation starts, s. The result then depends on the
        speed of the machine.
    seed : int
        Seed of the random starts.
    start : mapping, optional
        Saved state of this solver with the same images and options; see `inverse.data.checkpoints`.
        Completed rounds are skipped, and the saved ``coefficients`` are an additional start.
    progress : callable or None
        Called repeatedly with a text and the completed fraction. It may raise `Stop`, which ends
        the search after the current descent.

    Returns
    -------
    Reconstruction
        Object, status and score. ``physical_parameters`` also contains

        - ``coefficients`` (M,), waves rms,
        - ``free_energy`` of the answer,
        - ``margin``: free energy minus that of fits started without blur; negative values favour
          the answer; NaN with a defocused frame,
        - ``sharp_margin``: free energy minus that of a fit that takes the image for the object;
          NaN with a defocused frame,
        - ``model_error``: rms of the residual in excess of the noise, over the images' range.

        ``background`` is (K,) for several images. The history has one entry per round.

    Raises
    ------
    SamplingError
        If array shapes do not match, the frame is not square, or the pixels are too wide.
    SceneError
        If a value is out of range or not finite.

    See Also
    --------
    pcin : Entry point of the blind solvers.
    staged_fit : Blind fit of one or more images in stages.
    PupilPSF : Differentiable PSF of a wave.

    Notes
    -----
    The answer is the start with the least free energy (`FreeEnergy`). Squared residuals would
    prefer no blur to the truth for one frame.

    With defocused frames the status is "converged" if ``model_error`` is at most 0.004, plus 0.01
    times the wall's rms in waves (counted up to one wave). With one frame it is "converged" if
    ``margin`` is below -70, or ``sharp_margin`` is below -0.092 per pixel (-0.14 at 0.3 % noise),
    because fits without blur can also find a weak wall. It is "trivial" if the answer has almost no
    blur, or is the one that starting without blur leads to.
    """
    started = time.perf_counter()
    checked_seed(seed)
    gain = None if gain is None else positive("gain", gain)
    if strength is not None:
        strength = in_range("strength", strength, 0.0, 10.0, open_low=True, unit="waves")
    rounds = None if max_iterations is None else whole("max_iterations", max_iterations)
    seconds = math.inf if max_seconds is None else positive("max_seconds", max_seconds, unit="s")
    frames = frames_of(
        images,
        pupil_psf,
        defocus=defocus,
        walls=None,
        noise_sigma=noise_sigma,
        background=background,
        fit_background=fit_background,
        background_shape=None,
        boundary="padded",
    )
    left_out = frames.images.numel() - frames.counted
    if left_out:
        raise SamplingError(
            f"{left_out} of {frames.images.numel()} pixels have infinite noise, but the evidence "
            "fit cannot ignore pixels; crop the images, or use recipe='staged'"
        )
    rows, columns = frames.images.shape[-2:]
    if rows != columns:
        raise SamplingError(
            f"images have {rows} x {columns} pixels, must be square for the evidence fit; crop them"
        )
    search = _Search(frames, pupil_psf, strength, seed, started + seconds, progress, start)
    if all(one.is_background() for one in frames.measured):
        return search.result(None, gain, "too_few_photons", started)
    if search.diverse:
        best = search.of_frames(_ROUNDS_OF_FRAMES if rounds is None else rounds)
    else:
        best = search.of_one(len(_ISLANDS) if rounds is None else rounds)
    return search.result(best, gain, search.status(best), started)


class _Search:
    """State of one evidence fit: options, current round and best result."""

    def __init__(
        self,
        frames: Frames,
        pupil_psf: PupilPSF,
        strength: float | None,
        seed: int,
        deadline: float,
        progress: Progress | None,
        start: Mapping[str, Any] | None,
    ) -> None:
        self._frames, self._pupil, self._strength = frames, pupil_psf, strength
        self._behind, self._start = _from_state(start, len(pupil_psf.modes))
        # a resumed search must not draw the walls of completed rounds again
        self._random = generator(seed, self._behind)
        self._deadline, self._progress = deadline, progress
        self._sigmas = np.array([one.sigma for one in frames.measured]) / frames.scale
        defoci = frames.defocus.double().cpu().numpy()
        self.diverse = bool(np.ptp(defoci) >= _DIVERSE * pupil_psf.wavelength)
        self._defoci = defoci
        self._energy = self._on_grid(1.5)
        self._margin, self._sharp_margin = math.nan, math.nan
        self._rounds, self._ended = 0, False
        self._best: Starts | None = None
        self._history: dict[str, list[float]] = {"objective": [], "residual": [], "change": []}

    def of_frames(self, rounds: int) -> Starts:
        """Return the best wall for images of different defocus, after up to ``rounds`` rounds."""
        pool = self._kept(frames=True)
        for turn in range(min(self._behind, rounds - 1), rounds):
            self._rounds = turn
            late = self._tell("random walls", turn / rounds)
            if pool is None and self._ended:
                pool = self._finished(np.zeros(self._energy.modes), frames=True)
            if late and pool is not None:
                break
            strengths = _STRENGTHS if self._strength is None else self._around()
            if turn:
                strengths = tuple(1.3 * s for s in strengths)
            born = gather(
                self._energy, np.array(strengths), _STARTS, slow=turn > 0, random=self._random
            )
            found = refine(
                self._energy,
                born,
                np.ones(self._energy.modes),
                self._random,
                least_length=0.0,
                generations=_NEAR_FRAMES,
                enough=lambda best: self._model_error(best) <= _WELL * self._model_limit(best),
                watch=self._share_of(turn, rounds, 0.5),
                frames=True,
            )
            pool = self._better(pool, found)
            if self._model_error(pool) <= self._model_limit(pool):
                break
        assert pool is not None  # at least one round
        self._tell_end()
        return pool

    def of_one(self, rounds: int) -> Starts:
        """Return the best wall for a single image, which a wave without blur explains too."""
        reference = without_blur(self._energy, self._random)
        floor = float(reference.energy[0])
        levels = (floor, float(sharp(self._energy, self._random).energy[0]))
        narrow = self._on_grid(1.125)
        pool = self._better(self._kept(frames=False), reference)
        self._margin, self._sharp_margin = (float(pool.energy[0]) - e for e in levels)
        for turn in range(min(self._behind, rounds - 1), rounds):
            self._rounds = turn
            if self._tell("walls and their children", turn / rounds):
                break
            island = self._island(turn)
            born = evolve(
                narrow, island, narrow.twin, self._random, self._share_of(turn, rounds, 0.0, 0.7)
            )
            found = refine(
                self._energy,
                born.best(8),
                narrow.twin,
                self._random,
                least_length=_LEAST_LENGTH * island.radius,
                generations=_GENERATIONS,
                enough=lambda best: best.energy[0] - floor < -2.0 * _SURE_MARGIN,
                watch=self._share_of(turn, rounds, 0.7),
            )
            pool = self._better(pool, found)
            self._margin, self._sharp_margin = (float(pool.energy[0]) - e for e in levels)
            if self._sure_of_one():
                break
        self._tell_end()
        return pool

    def status(self, best: Starts) -> Status:
        """Return the status of the answer; the truth is not used."""
        if self._ended:
            return "unconverged"
        if self.diverse:
            right = self._model_error(best) <= self._model_limit(best)
            return "converged" if right else "unconverged"
        if self._sure_of_one():
            return "converged"
        weak = float(np.linalg.norm(best.coefficients[0])) < _NO_BLUR
        return "trivial" if weak or self._margin == 0.0 else "unconverged"

    def _sure_of_one(self) -> bool:
        """Return whether the free energy for one image excludes all known wrong answers."""
        pixels = self._frames.images[0].numel()
        finer = max(0.0, math.log(_SHARP_NOISE / self._energy.sigma))
        limit = pixels * (_SHARP_MARGIN[0] + _SHARP_MARGIN[1] * finer)
        return self._margin < -_SURE_MARGIN or self._sharp_margin < -limit

    def result(
        self, best: Starts | None, gain: float | None, status: Status, started: float
    ) -> Reconstruction:
        """Return the reconstruction in image units; it has no object if no wall was found."""
        frames, data = self._frames, self._frames.measured[0]
        if best is None:
            level = np.zeros(frames.images.shape[-2:])
            backgrounds = np.array([m.background_strength(m.data) for m in frames.measured])
            scores = [
                m.score(m.background(b)) for m, b in zip(frames.measured, backgrounds, strict=True)
            ]
            found = {"coefficients": np.zeros(self._energy.modes), "free_energy": math.nan}
            square, error = float(np.mean(np.square(scores))), math.nan
        else:
            level = self._energy.objects(best)[0].astype(np.float64) * frames.scale
            backgrounds = self._energy.background(best)[0] * frames.scale
            square, error = float(best.chi_square[0].mean()), self._model_error(best)
            found = {
                "coefficients": best.coefficients[0].astype(np.float64),
                "free_energy": float(best.energy[0]),
            }
        if gain is None:
            gain = float(level.max()) if level.max() > 0.0 else 1.0
        single = len(frames.measured) == 1
        sigmas = self._sigmas * frames.scale
        return Reconstruction(
            object=data.like_input(data.data.new_tensor(level / gain)),
            physical_parameters={
                "gain": gain,
                "background": float(backgrounds[0]) if single else backgrounds,
                "noise_sigma": float(sigmas[0]) if single else sigmas,
                "margin": self._margin,
                "sharp_margin": self._sharp_margin,
                "model_error": error,
                **found,
            },
            status=status,
            score=math.sqrt(square),
            history=frozen(self._history),
            seconds=time.perf_counter() - started,
        )

    def _on_grid(self, padding: float) -> FreeEnergy:
        """Return the free energy on an FFT grid ``padding`` times as wide as the image."""
        n = int(self._frames.images.shape[-1])
        return FreeEnergy(
            self._frames.images.double().cpu().numpy(),
            self._sigmas,
            self._pupil,
            self._defoci,
            grid=8 * math.ceil(padding * n / 8),
            fit_background=self._frames.fit_background,
        )

    def _island(self, turn: int) -> Island:
        island = _ISLANDS[turn % len(_ISLANDS)]
        if self._strength is None:
            return island
        around = self._around()
        return replace(island, radius=around[(turn + 1) % len(around)])

    def _around(self) -> tuple[float, ...]:
        assert self._strength is not None
        return tuple(self._strength * factor for factor in _AROUND)

    def _better(self, pool: Starts | None, found: Starts) -> Starts:
        """Return the start of least energy, and record it in the history."""
        best = found.best(1)
        if pool is not None and pool.energy[0] <= best.energy[0]:
            best = pool
        self._best = best
        now = float(best.energy[0])
        before = self._history["objective"][-1] if self._history["objective"] else math.inf
        self._history["objective"].append(now)
        self._history["residual"].append(math.sqrt(float(best.chi_square[0].mean())))
        change = (before - now) / max(abs(now), 1.0) if math.isfinite(before) else 1.0
        self._history["change"].append(change)
        return best

    def _model_error(self, best: Starts) -> float:
        """Estimate the residual beyond the noise, rms relative to the images' range."""
        beyond: Floats = (best.chi_square[0] - 1.0) * self._sigmas**2
        return math.sqrt(max(float(beyond.mean()), 0.0))

    def _model_limit(self, best: Starts) -> float:
        """Return the largest accepted `_model_error`.

        It includes three standard errors of the mean squared residual.
        """
        count = self._frames.images[0].numel() * len(self._sigmas)
        noise = 3.0 * math.sqrt(2.0 / count) * float(np.mean(self._sigmas**2))
        length = min(float(np.linalg.norm(best.coefficients[0])), 1.0)
        return math.sqrt((_MODEL_ERROR[0] + _MODEL_ERROR[1] * length) ** 2 + noise)

    def _share_of(self, turn: int, rounds: int, first: float, last: float = 1.0) -> Watch:
        """Return a callback that converts progress within part of a round to overall progress.

        The part extends from ``first`` to ``last``, fractions of round ``turn``.
        """
        return lambda text, done: self._tell(text, (turn + first + (last - first) * done) / rounds)

    def _kept(self, *, frames: bool) -> Starts | None:
        """Return the result of the wall in the saved state, or None without a saved state."""
        return None if self._start is None else self._finished(self._start, frames=frames)

    def _finished(self, wall: Floats, *, frames: bool) -> Starts:
        """Return the result of one wall with coefficients (M,)."""
        found = refine(
            self._energy,
            self._energy.starts(wall[None], 3.0),
            np.ones(self._energy.modes),
            self._random,
            least_length=0.0,
            generations=0,
            enough=lambda _: True,
            watch=lambda *_: True,
            frames=frames,
        )
        self._best = found.best(1)
        return self._best

    def _state(self) -> State:
        """Return the state to resume from: best wall, its object, number of completed rounds."""
        best = self._best
        if best is None:
            best = self._energy.starts(np.zeros((1, self._energy.modes)), 3.0)
        level = self._energy.objects(best)[0].astype(np.float64) * self._frames.scale
        return state_of(
            torch.from_numpy(level), coefficients=best.coefficients[0], rounds=self._rounds
        )

    def _tell(self, text: str, done: float) -> bool:
        """Report progress; return whether to stop, by the callback's request or the time limit."""
        if not self._ended:
            self._ended = not goes_on(self._progress, f"evidence: {text}", done, self._state)
        return self._ended or time.perf_counter() > self._deadline

    def _tell_end(self) -> None:
        """Report the end of the search; a request to stop has no effect any more."""
        if not self._ended:
            goes_on(self._progress, "evidence: done", 1.0, self._state)


def _from_state(start: Mapping[str, Any] | None, modes: int) -> tuple[int, Floats | None]:
    """Return the number of completed rounds and the wall (M,) of a saved state."""
    if start is None:
        return 0, None
    if not isinstance(start, Mapping) or not {"coefficients", "rounds"} <= set(start):
        raise SceneError("start holds no wall; give a state of evidence_fit, or leave it out")
    wall = np.asarray(start["coefficients"], dtype=np.float64)
    if wall.shape != (modes,) or not np.isfinite(wall).all():
        raise SamplingError(
            f"start has coefficients of shape {wall.shape}, must be ({modes},) and finite; it "
            "belongs to another pupil_psf, leave it out"
        )
    return int(start["rounds"]), wall
