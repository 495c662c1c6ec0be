"""Tests of blind answers: does the model explain the images, and does nothing else do as well."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..data.status import Status
from ..wave.frames import Frames
from .free_energy import Starts


@dataclass(frozen=True)
class Limits:
    """Limits of the tests; residuals are rms and relative to the images' range, norms waves rms."""

    # Residual beyond the noise of a right answer, due to modes that are not fitted: a constant, and
    # the increase per wave of the wall's rms, up to one wave.
    model_error: tuple[float, float] = (0.004, 0.010)
    # The same after modes were added, due to the change of the wave over the field. Right answers
    # had up to 0.0038 at 0.5 waves and 0.0063 at 1 wave, wrong ones at least 0.0073 at 0.5 waves.
    complete_error: tuple[float, float] = (0.004, 0.003)
    # Share of the largest limit above that noise may add before the residual says nothing, and
    # rounds that must then find the same object. In 54 fits of two images at 5 % noise, where it
    # adds one and a half times the limit, three wrong answers had the residual of right ones.
    vague: float = 0.5
    met: int = 2
    well: float = 0.6  # of the limit, below which the search of a round ends early
    excess: float = 3.0  # standard errors of the mean squared residual
    # One image. Free energy below that of a wave without blur; in 84 fits at 1 % noise, wrong
    # answers were below by at most 38.
    sure: float = 70.0
    # Margin per pixel to the fit that takes the image for the object, at a noise of `sharp_noise`
    # of the range or more, and its increase per factor e of less noise. Most wrong answers had at
    # most 0.082 at 1 % noise (0.086 for 32 x 32 pixels) and 0.130 at 0.3 %, most right ones more.
    sharp: tuple[float, float] = (0.092, 0.045)
    sharp_noise: float = 0.01
    # By this the energy of different walls must then exceed the answer's: two wrong answers with
    # margins of 0.095 and 0.112 had different walls within 76 and 53 after one round.
    rival: float = 100.0
    # Norm relative to the expected one. For walls of one wave, answers at 0.23 to 0.3 of it have
    # less energy than all others that the search finds, and are wrong.
    length: float = 0.6
    # A wall of known error. The energy is below that of the fit without blur by `near`; or the
    # prior of the coefficients puts that fit above the answer by `by_prior`, while the answer's own
    # energy is higher by at most 1 over the relative noise (errors of the modes weigh more if the
    # noise is low), and its residual is at least `overfitted` times the noise.
    near: float = 50.0
    by_prior: float = 100.0
    overfitted: float = 0.93
    no_blur: float = 0.12  # norm below which an answer counts as without blur


LIMITS = Limits()


class Verdict:
    """Tests of the answers of one fit; the truth is not used.

    ``frames``: the images. ``modes``: Noll indices of the given modes. ``several``: whether the
    images themselves exclude a wave without blur: by known defoci, or by a known object.
    """

    def __init__(self, frames: Frames, modes: tuple[int, ...], several: bool) -> None:
        self._frames, self.modes, self.several = frames, modes, several
        self.pixels = int(frames.counted.sum())
        self._power = float(np.mean(frames.sigmas**2))

    @property
    def vague(self) -> bool:
        """Whether noise hides the residual that a wrong wall leaves in several images."""
        return self.several and self._noise() > (LIMITS.vague * sum(LIMITS.complete_error)) ** 2

    def _noise(self) -> float:
        """Return three standard errors of the mean squared residual."""
        return LIMITS.excess * math.sqrt(2.0 / self.pixels) * self._power

    def model_error(self, best: Starts) -> float:
        """Estimate the residual beyond the noise, rms relative to the images' range."""
        beyond = (best.chi_square[0] - 1.0) * self._frames.sigmas**2
        return math.sqrt(max(float(beyond.mean()), 0.0))

    def model_limit(self, best: Starts, complete: bool) -> float:
        """Return the largest accepted `model_error`; ``complete`` if modes were added as needed.

        It includes three standard errors of the mean squared residual.
        """
        length = min(float(np.linalg.norm(best.coefficients[0])), 1.0)
        least, more = LIMITS.complete_error if complete else LIMITS.model_error
        return math.sqrt((least + more * length) ** 2 + self._noise())

    def well(self, pool: Starts) -> bool:
        """Return whether the best start of a pool for several images needs no children."""
        return self.model_error(pool) <= LIMITS.well * self.model_limit(pool, complete=False)

    def alone(self, rival: float) -> bool:
        """Return whether no different wall explains one image nearly as well as the answer.

        ``rival`` is the energy of the best of them minus the answer's; NaN before a search.
        """
        return rival > LIMITS.rival

    def structured(self, best: Starts) -> bool:
        """Return whether the residual exceeds the noise, so that the model lacks something."""
        excess = LIMITS.excess * math.sqrt(2.0 / self.pixels)
        return float(np.average(best.chi_square[0], weights=self._frames.counted)) > 1.0 + excess

    def doubts(self, modes: tuple[int, ...], met: int) -> tuple[str, ...]:
        """Return the reason to doubt an answer whose residual is `vague`, or nothing.

        ``modes`` are its Noll indices, and ``met`` is the number of rounds that found it.
        """
        hides = "noise hides the residual that a wrong wall would leave, and"
        if len(modes) > len(self.modes):
            return (
                f"{hides} this wall needs {len(modes)} modes where {len(self.modes)} were given, "
                "as wrong ones do; expose longer, or give more modes",
            )
        if met < LIMITS.met:
            return (
                f"{hides} only {met} of the search's rounds found this object, must be "
                f"{LIMITS.met}; expose longer, or allow more max_iterations",
            )
        return ()

    def faults(
        self,
        best: Starts,
        margins: tuple[float, float],
        rival: float,
        *,
        expected: float,
        held: float,
        start_error: float | None,
    ) -> tuple[str, ...]:
        """Return the reason against an answer, or nothing if it passes all tests.

        ``best``: the answer, one start. ``margins`` (float, float): its free energy minus those of
        the fits that start without blur and that stay sharp. ``rival``: for one image the least
        free energy of a different wall minus that of the answer; NaN if none was searched for.
        ``expected``: expected norm of the coefficients, waves rms; NaN if unknown. ``held``: energy
        that the prior of the coefficients would add to the former. ``start_error``: expected rms
        error of the given coefficients, waves; None without such a prior.
        """
        error, most = self.model_error(best), self.model_limit(best, complete=self.several)
        if error > most:
            return (
                f"wall and object leave {100 * error:.2g} % of the images' range beyond the noise, "
                f"limit {100 * most:.2g} %; check the defocus and the pupil, or give more modes",
            )
        if self.several:
            return ()
        margin, sharp = margins
        sharply = (
            f"a wave without blur explains the image nearly as well: its free energy is above the "
            f"answer's by {-margin:.3g} only; give a second image with a known defocus",
        )
        noise = float(self._frames.sigmas[0])
        if start_error is None:
            finer = max(0.0, math.log(LIMITS.sharp_noise / noise))
            limit = self.pixels * (LIMITS.sharp[0] + LIMITS.sharp[1] * finer)
            if margin < -LIMITS.sure:
                return ()
            if sharp >= -limit:
                return sharply
            length = float(np.linalg.norm(best.coefficients[0]))
            if not length >= LIMITS.length * expected:
                known = f"{expected:.2g} waves rms" if expected > 0.0 else "unknown strength"
                return (
                    f"a wave of {known} is expected, that of the answer has {length:.2g} waves "
                    f"rms, as wrong answers have; give a second image with a known defocus",
                )
            if not self.alone(rival):
                return (
                    f"another wall explains the image nearly as well: its free energy is above the "
                    f"answer's by {rival:.3g} only; give a second image with a known defocus",
                )
            return ()
        fitted_noise = math.sqrt(float(best.chi_square[0, 0])) < LIMITS.overfitted
        by_prior = margin - held < -LIMITS.by_prior and margin * noise < 1.0
        sure = margin < -LIMITS.near or (by_prior and not fitted_noise)
        return () if sure else sharply

    def status(self, best: Starts, margin: float, faults: tuple[str, ...]) -> Status:
        """Return the status of an answer; ``faults`` is the result of `faults`."""
        if not faults:
            return "converged"
        weak = float(np.linalg.norm(best.coefficients[0])) < LIMITS.no_blur
        return "ambiguous" if not self.several and (weak or margin == 0.0) else "unconverged"
