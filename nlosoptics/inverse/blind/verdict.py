"""Tests of blind answers: does the model explain the images, and does nothing else do as well."""

from __future__ import annotations

import math

import numpy as np

from ..data.status import Status
from ..wave.frames import Frames
from .free_energy import Starts

#: Largest rms residual beyond the noise of a right answer, relative to the images' range: a
#: constant, and the increase per wave of the wall's rms, up to one wave. With the given modes alone
#: it is due to modes that are not fitted.
_MODEL_ERROR = (0.004, 0.010)
#: The limit after modes were added, due to the change of the wave over the field. The largest error
#: of right answers was 0.0038 at 0.5 waves and 0.0063 at 1 wave. The least one of wrong answers
#: (correlation below 0.9) was 0.0073 at 0.5 waves.
_COMPLETE_ERROR = (0.004, 0.003)
#: Share of the largest limit above that noise may add before `Verdict.vague` is true. In 54 fits
#: of two images at 5 % noise, where it adds one and a half times the limit, three answers were
#: wrong with a residual as small as that of right ones.
_VAGUE = 0.5
#: Number of rounds of a search that must then find the same object.
_LEAST_MET = 2
#: Fraction of the largest `Verdict.model_error` below which the search of a round ends early.
_WELL = 0.6
#: An answer for one image counts as right if its free energy is below that of a wave without blur
#: by at least this. In 84 fits at 1 % noise, the margin of wrong answers was at most 38.
_SURE_MARGIN = 70.0
#: Margin per pixel relative to the fit that takes the image for the object: its value at a noise of
#: `_SHARP_NOISE` of the image's maximum or more, and the increase per factor e of less noise. The
#: margin of most wrong answers was at most 0.082 at 1 % noise (0.086 for 32 x 32 pixels) and 0.130
#: at 0.3 %; most right answers exceeded it. `_LEAST_RIVAL` is for the other wrong ones.
_SHARP_MARGIN = (0.092, 0.045)
_SHARP_NOISE = 0.01
#: By this the free energy of different walls must then exceed the answer's. For most right answers
#: the search found no different wall. Two wrong ones, of half a wave and with margins per pixel of
#: 0.095 and 0.112, had different walls within 76 and 53 after one round.
_LEAST_RIVAL = 100.0
#: Smallest norm of the coefficients for one image relative to the expected one: walls of less
#: approach no blur. For walls of one wave such answers, at 0.23 to 0.3 of the expected norm, have
#: less energy than all others that the search finds, and are wrong.
_LEAST_LENGTH = 0.6
#: Criteria for one image and a wall of known error. The free energy is below that of the no-blur
#: fit by at least NEAR_MARGIN. Or the prior of the coefficients puts the no-blur fit above the
#: answer by at least BY_PRIOR; then the answer's own energy may be higher, by at most LITTLE_ABOVE
#: over the relative noise: errors of the modes weigh more if the noise is low. Its residual must
#: then be at least OVERFITTED times the noise, because wrong answers fit the noise.
_NEAR_MARGIN = 50.0
_BY_PRIOR = 100.0
_LITTLE_ABOVE = 1.0
_OVERFITTED = 0.93
#: Norm of the coefficients, waves rms, below which an answer counts as without blur.
_NO_BLUR = 0.12
#: Standard errors by which the squared residuals of an incomplete model exceed the noise.
_EXCESS = 3.0


class Verdict:
    """Tests of the answers of one fit; the truth is not used.

    Parameters
    ----------
    frames : Frames
        The images.
    modes : tuple of int
        Noll indices of the given modes.
    several : bool
        Whether the images themselves exclude a wave without blur: by known defoci, by several
        walls, or by a known object.
    """

    def __init__(self, frames: Frames, modes: tuple[int, ...], several: bool) -> None:
        self._frames, self.modes, self.several = frames, modes, several
        self.pixels = int(frames.counted.sum())
        self._power = float(np.mean(frames.sigmas**2))

    @property
    def vague(self) -> bool:
        """Whether noise hides the residual that a wrong wall leaves in several images."""
        return self.several and self._noise() > (_VAGUE * sum(_COMPLETE_ERROR)) ** 2

    def _noise(self) -> float:
        """Return three standard errors of the mean squared residual."""
        return _EXCESS * math.sqrt(2.0 / self.pixels) * self._power

    def model_error(self, best: Starts) -> float:
        """Estimate the residual beyond the noise, rms relative to the images' range."""
        beyond = (best.chi_square[0] - 1.0) * self._frames.sigmas**2
        return math.sqrt(max(float(beyond.mean()), 0.0))

    def model_limit(self, best: Starts, complete: bool) -> float:
        """Return the largest accepted `model_error`; ``complete`` if modes were added as needed.

        It includes three standard errors of the mean squared residual.
        """
        walls = best.coefficients[0].reshape(self._frames.n_walls, -1)
        length = min(float(np.linalg.norm(walls, axis=1).mean()), 1.0)
        least, more = _COMPLETE_ERROR if complete else _MODEL_ERROR
        return math.sqrt((least + more * length) ** 2 + self._noise())

    def well(self, pool: Starts) -> bool:
        """Return whether the best start of a pool for several images needs no children."""
        return self.model_error(pool) <= _WELL * self.model_limit(pool, complete=False)

    def alone(self, rival: float) -> bool:
        """Return whether no different wall explains one image nearly as well as the answer.

        ``rival`` is the energy of the best of them minus the answer's; NaN before a search.
        """
        return rival > _LEAST_RIVAL

    def structured(self, best: Starts) -> bool:
        """Return whether the residual exceeds the noise, so that the model lacks something."""
        excess = _EXCESS * math.sqrt(2.0 / self.pixels)
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
        if met < _LEAST_MET:
            return (
                f"{hides} only {met} of the search's rounds found this object, must be "
                f"{_LEAST_MET}; expose longer, or allow more max_iterations",
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

        Parameters
        ----------
        best : Starts
            The answer, one start.
        margins : (float, float)
            Its free energy minus those of the fits that start without blur and that stay sharp.
        rival : float
            For one image the least free energy of a different wall minus that of the answer; NaN if
            none was searched for.
        expected : float
            Expected norm of the coefficients, waves rms; NaN if unknown.
        held : float
            Energy that the prior of the coefficients would add to the former.
        start_error : float or None
            Expected rms error of the given coefficients, waves; None without such a prior.
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
            finer = max(0.0, math.log(_SHARP_NOISE / noise))
            limit = self.pixels * (_SHARP_MARGIN[0] + _SHARP_MARGIN[1] * finer)
            if margin < -_SURE_MARGIN:
                return ()
            if sharp >= -limit:
                return sharply
            length = float(np.linalg.norm(best.coefficients[0]))
            if not length >= _LEAST_LENGTH * expected:
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
        fitted_noise = math.sqrt(float(best.chi_square[0, 0])) < _OVERFITTED
        by_prior = margin - held < -_BY_PRIOR and margin * noise < _LITTLE_ABOVE
        sure = margin < -_NEAR_MARGIN or (by_prior and not fitted_noise)
        return () if sure else sharply

    def status(self, best: Starts, margin: float, faults: tuple[str, ...]) -> Status:
        """Return the status of an answer; ``faults`` is the result of `faults`."""
        if not faults:
            return "converged"
        weak = float(np.linalg.norm(best.coefficients[0])) < _NO_BLUR
        return "trivial" if not self.several and (weak or margin == 0.0) else "unconverged"
