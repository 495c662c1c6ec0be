"""Status of blind answers: do the images fit, is there no blur or another answer, do rounds agree.

Squared residuals and free energies are sums over values with independent errors. Each limit is a
number of standard errors of such a sum.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..data.status import Status
from ..wave.frames import Frames
from .free_energy import Starts


@dataclass(frozen=True)
class Limits:
    """Limits of the tests.

    ``errors``: standard errors that count as a difference. The mean of n squared residuals has the
    standard error sqrt(2/n). The prior of differences is no exact law of pictures, so that it errs
    by about 1 in the energy of each value of the object that the images determine. A margin between
    two answers of n such values each then has the standard error sqrt(2 n), far above the ln(1000)
    by which a model without errors would decide. ``unexplained``: power of the residual beyond the
    noise, over that of the images' detail, up to which it is due to modes that are not fitted and
    harmless. ``rounds``: rounds that must find the same object if noise hides a larger residual.
    """

    errors: float = 3.0
    unexplained: float = 1e-3
    rounds: int = 2


LIMITS = Limits()


class Verdict:
    """Tests of the answers of one fit; the truth is not used.

    ``frames``: the images. ``several``: whether the images themselves exclude a wave without blur:
    by known defoci, by several walls, or by a known object. ``known``: whether the object is known.
    """

    def __init__(self, frames: Frames, several: bool, known: bool) -> None:
        self.several, self.pixels = several, int(frames.counted.sum())
        self._counted, self._powers = frames.counted, frames.sigmas**2
        detail = np.mean(frames.images.var(axis=(1, 2)) - self._powers)
        self._harmless = LIMITS.unexplained * max(float(detail), 0.0)
        #: standard errors of the mean squared residual, over the noise
        self._scatter = LIMITS.errors * math.sqrt(2.0 / self.pixels)
        #: whether noise hides the residual that a wrong wall leaves in several images
        self.vague = several and not known
        self.vague &= self._scatter * float(self._powers.mean()) > self._harmless
        #: rounds that must find the same object
        self.rounds = LIMITS.rounds if self.vague else 1

    def model_error(self, best: Starts) -> float:
        """Estimate the residual beyond the noise, rms relative to the images' range."""
        beyond = (best.chi_square[0] - 1.0) * self._powers
        return math.sqrt(max(float(beyond.mean()), 0.0))

    def model_limit(self) -> float:
        """Return the largest accepted `model_error`."""
        return math.sqrt(self._harmless + self._scatter * float(self._powers.mean()))

    def fits(self, best: Starts) -> bool:
        """Return whether the best of some answers explains the images."""
        return self.model_error(best) <= self.model_limit()

    def structured(self, best: Starts) -> bool:
        """Return whether the residual exceeds the noise, so that the model lacks something."""
        return float(np.average(best.chi_square[0], weights=self._counted)) > 1.0 + self._scatter

    def status(
        self, best: Starts, *, effective: float, margin: float, rival: float, rounds: int
    ) -> tuple[Status, tuple[str, ...]]:
        """Return the status of an answer, and the reason against "converged".

        ``best``: the answer. ``effective``: number of values of its object that the images
        determine. ``margin``, ``rival``: for one image, energies of no blur and of the best answer
        of another object, minus that of the answer; NaN if there is none. ``rounds``: number of
        rounds that found this object.
        """
        if not self.fits(best):
            return "does_not_fit", (
                f"wall and object leave {100 * self.model_error(best):.2g} % of the images' range "
                f"beyond the noise, limit {100 * self.model_limit():.2g} %; check the defocus and "
                "the pupil, or give more modes",
            )
        if rounds < self.rounds:
            return "ambiguous", (
                f"{rounds} of the search's rounds found this object, must be {self.rounds}; "
                "expose "
                "longer, or allow more max_iterations",
            )
        limit = LIMITS.errors * math.sqrt(2.0 * effective)
        for energy, other in ((margin, "a wave without blur"), (rival, "another object")):
            if energy <= limit:
                return "ambiguous", (
                    f"{other} explains the image nearly as well: its free energy is above the "
                    f"answer's by {energy:.3g}, must be {limit:.3g}; give a second image with a "
                    "known defocus",
                )
        return "converged", ()
