"""Search for the wave of least free energy, in steps between which it can be saved and resumed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.random import Generator

from ..._random import generator
from ..data.scores import registered_correlation
from .free_energy import Floats, FreeEnergy, OutOfTime, Stage, Starts, joined
from .random_walls import Breeding, children, random_walls
from .search_place import STEPS, TEXTS, Place
from .verdict import Verdict
from .wall_proposals import Proposals

#: Callback with a text and the completed fraction; returns whether the search is to end.
Watch = Callable[[str, float], bool]
#: Free energy on an FFT grid wider than the images by the given factor, for given Noll indices.
Energies = Callable[[float, tuple[int, ...]], FreeEnergy]

# Several images. A strong assumed noise at first gives all starts one broad basin of the energy.
_GATHER = Stage(iterations=200, kappa=1.0, first=30.0, last=3.0, share=0.9, wave_rate=0.016)
_GATHER_NOISY = Stage(iterations=200, kappa=1.0, first=12.0, last=1.5, share=0.9, wave_rate=0.016)
_GATHER_SLOWLY = Stage(iterations=500, kappa=1.0, first=60.0, last=3.0, share=0.9, wave_rate=0.016)
_SETTLE = Stage(iterations=250, kappa=0.5, first=3.0, last=1.0, share=0.5, wave_rate=0.01)
_FINISH = Stage(iterations=250, kappa=0.5, first=1.5, last=1.0, share=0.3, wave_rate=0.006)

# One image. Answers are compared at 1.5 times the noise. Errors of the model (higher modes, change
# over the field) then penalise the truth less than fitting the noise favours a wave without blur.
_TRIVIAL = Stage(iterations=400, kappa=0.5, first=3.0, last=1.5, share=0.3, wave_rate=0.008)
_RELEASE = Stage(iterations=200, kappa=0.5, first=3.0, last=1.5, share=0.5, wave_rate=0.01)
_COMPARE = Stage(iterations=150, kappa=0.5, first=5.0, last=1.5, share=0.6, wave_rate=0.015)
_FREE = Stage(iterations=200, kappa=0.5, first=2.0, last=1.5, share=0.3, wave_rate=0.005)
#: Noise assumed at the beginning of a round relative to the actual one, round by round. A strong
#: one makes the basin of most objects broad, but hides thin strokes.
_NOISES = (30.0, 10.0, 60.0, 20.0)

# Proposed walls for one image: the object first, then both.
_PROPOSED = (
    Stage(iterations=60, kappa=0.5, first=5.0, last=5.0, share=1.0, wave_rate=0.0),
    Stage(iterations=250, kappa=0.5, first=5.0, last=1.5, share=0.7, wave_rate=0.015),
)

# Given coefficients with a known error: the object first, then both, then the best start alone.
_NEAR = (
    Stage(iterations=200, kappa=0.5, first=5.0, last=5.0, share=1.0, wave_rate=0.0),
    Stage(iterations=400, kappa=0.5, first=5.0, last=1.0, share=0.7, wave_rate=0.01),
    Stage(iterations=200, kappa=0.5, first=1.0, last=1.0, share=1.0, wave_rate=0.004),
)
_NEAR_STARTS = 4

#: Norm of the coefficients of a wall without noticeable blur, waves rms.
_SHARP = 0.01
#: Ratio of FFT grid to image, so that light leaving at one edge does not re-enter at the other. A
#: narrow grid is sufficient until an answer for one image is compared with no blur.
_PADDING, _NARROW = 1.5, 1.125
#: Norms of the coefficients of initial walls, waves rms. They are rather too large than too small.
_STRENGTHS = (0.3, 0.6, 1.0)
#: Norms of initial walls relative to a known rms of the wave.
_AROUND = (0.9, 1.1, 1.4)
#: Norms of initial walls for one image relative to the above, between these limits.
_LENGTHS = (0.9, 1.5)
_STARTS = 32
#: Walls of one image that are fitted further.
_KEPT = 20
#: Best walls that a step of the search passes to the next.
_POOL = 12
#: Proposed walls of a round with one image.
_PROPOSALS = 24
#: Number of walls that show which point spreads are expected for one image, and the share of them
#: that is more spread out than the expected limit.
_EXPECTED, _SPREAD_OUT = 96, 0.1
#: Penalty of a point spread that is sharper than this limit, per pixel and factor e of its sum
#: of squares. Before they settle, right walls have up to 300 more energy than sharp wrong ones.
_TOO_SHARP = 0.2
#: Expected norm of the coefficients, waves rms, up to which sharp point spreads are right ones.
_WEAK = 0.35
#: Largest Noll indices, those of complete orders, up to which modes are added.
_TOPS = (21, 36, 45)


@dataclass(frozen=True, kw_only=True)
class Neighbourhood(Breeding):
    """Generations near the best walls, with the random changes of one to the next.

    Parameters
    ----------
    generations : int
        Largest number of generations.
    litter : int
        Number of children of each; they have a third as many parents.
    """

    generations: int
    litter: int


#: Of several images, of several with much noise, and of one.
_NEAR_SEVERAL = Neighbourhood(generations=4, litter=12, flips=0.03, noise=0.25)
_NEAR_NOISY = replace(_NEAR_SEVERAL, generations=12)
_NEAR_ONE = Neighbourhood(generations=12, litter=24, flips=0.06, noise=0.3)
#: Factors of the norm of children's coefficients.
_GROWTH = (0.95, 1.05)
#: Relative distance of point spreads beyond which two walls are different answers. In tests, that
#: of equal answers was below 0.2, and that of different ones above 0.34.
_OTHER = 0.3
#: Correlation of the objects of two rounds above which they found the same. At 5 % noise right
#: objects had 0.94 to 0.98 with each other, with point spreads up to 0.5 apart; other ones had 0.3.
_SAME_OBJECT = 0.93
#: Decrease of the score per generation below which these end. Those of one image go on unless they
#: have the point spread of the best answer so far, or are better by the second number.
_STANDSTILL, _AHEAD = 5.0, 50.0
#: Largest number of repetitions of the last fit for one image. Answers, different walls and fits
#: without blur are repeated alike, since the status compares their energies.
_REPEATS = 5
#: Default number of rounds with several images, with several with much noise, with one, and with
#: one and proposals.
_ROUNDS = (2, 4, 5, 1)
#: Number of rounds with one image after which the search ends if it found no different wall.
_ENOUGH = 2
#: Number of each step's stream of random numbers among those of a round, and how many these are.
_STREAMS = {name: number for number, name in enumerate(STEPS[:4])}
_STREAMS |= {name: number for number, name in enumerate(STEPS[4:9], start=8)}
_ROUND = 13


class Search:
    """Search of one fit, step by step; each step draws from its own stream of random numbers.

    Parameters
    ----------
    energies : callable
        Returns the free energy for a padding and Noll indices.
    verdict : Verdict
        Tests of answers.
    first : ndarray, (M,)
        Given coefficients of all walls, waves rms; zeros if there are none.
    start_error : float or None
        Expected rms error of the given coefficients, waves; None: they are only one more start.
    strength : float or None
        Known rms of the walls' waves, waves.
    proposals : Proposals or None
        Proposed walls for one image; None: there are none.
    rounds : int or None
        Largest number of rounds; None: the default.
    seed : int
        Seed of the random numbers.
    state : mapping, optional
        Saved state to resume from.

    Attributes
    ----------
    place : Place
        Position and results.
    """

    def __init__(
        self,
        energies: Energies,
        verdict: Verdict,
        *,
        first: Floats,
        start_error: float | None,
        strength: float | None,
        proposals: Proposals | None,
        rounds: int | None,
        seed: int,
        state: Any,
    ) -> None:
        self._energies, self._verdict = energies, verdict
        self._first, self._error, self._strength = first, start_error, strength
        self._proposals, self._seed = proposals, seed
        modes = verdict.modes
        self._energy = energies(_PADDING, modes)
        self._prior = self._energy
        if start_error is not None:
            self._prior = self._energy.about(first, start_error)
        self._frames = verdict.several
        self._noisy = verdict.vague and start_error is None
        usual = int(self._noisy) if self._frames else 2 if proposals is None else 3
        self._rounds = _ROUNDS[usual] if rounds is None else rounds
        #: sum of squares of a point spread above which walls are penalised
        self._sharpness = math.inf
        if not self._frames and start_error is None and self._expected_length() > _WEAK:
            self._sharpness = self._expected_sharpness()
        self._flat = self._energy.starts(np.zeros((1, self._energy.size)), _TRIVIAL.first)
        self.place = Place(modes=modes, pool=self._flat[:0], best=self._flat[:0])
        if state is not None:
            self.place = Place.of(state, self._flat, len(modes))

    @property
    def faults(self) -> tuple[str, ...]:
        """Reason against the best answer; empty if it passes all tests."""
        place = self.place
        if self._noisy and (doubts := self._verdict.doubts(place.modes, place.met)):
            return doubts
        return self._verdict.faults(
            place.best,
            self.margins,
            place.rival,
            expected=self._expected_length(),
            held=place.held,
            start_error=self._error,
        )

    @property
    def margins(self) -> tuple[float, float]:
        """Energy of the best answer minus those of the fits that start and that stay sharp."""
        place = self.place
        if not len(place.best):
            return math.nan, math.nan
        energy = float(place.best.energy[0])
        return energy - place.floor, energy - place.sharp

    def energy(self) -> FreeEnergy:
        """Return the free energy with the best answer's modes."""
        return self._wider(self.place.modes)

    def best(self) -> Starts:
        """Return the best answer so far; before the first one, an object without blur."""
        return self.place.best if len(self.place.best) else self._flat

    def run(self, watch: Watch) -> None:
        """Make steps until the search ends or ``watch`` asks it to.

        A step that runs out of time leaves the place as it was before.
        """
        while self.place.step != "end":
            now, count = self.place.step, self.place.count
            part = (STEPS.index(now) + count / 10.0) / len(STEPS)
            whole = self.place.turn + part if self.place.turn >= 0 else 0.1 * part - 0.1
            if watch(TEXTS[now], (whole + 0.1) / (self._rounds + 0.1)):
                return
            history = {name: values.copy() for name, values in self.place.history.items()}
            before = replace(self.place, history=history)
            try:
                step = getattr(self, f"_{now}")(self._random(now, count))
            except OutOfTime:
                self.place = before
                return
            self.place.count = count + 1 if step == now else 0
            self.place.step = step

    def finished(self) -> None:
        """Fit an answer quickly if the search ended before it had one."""
        if len(self.place.best):
            return
        pool, last = self.place.pool, _FINISH if self._frames else _FREE
        if not len(pool):
            pool = self._energy.starts(self._first[None], last.first)
        free = replace(pool.best(1), radius=np.array([np.inf]))
        self._offer(self._energy.descend(free, last))

    def _random(self, step: str, count: int) -> Generator:
        stream = _ROUND * (self.place.turn + 1) + _STREAMS[step]
        return generator(self._seed, 100 * stream + count)

    def _reference(self, random: Generator) -> str:
        """Fit without blur, which an answer for one image has to beat."""
        if not self._frames:
            walls = random_walls(4, self._energy.size, np.array([0.1]), random)
            walls[0] = 0.0
            if self._error is not None:
                found = self._energy.starts(walls[:1], _NEAR[1].first)
                for stage in _NEAR[1:]:
                    found = self._energy.descend(found, stage)
                self.place.held = float(self._prior.held(found.coefficients)[0])
                self.place.floor = float(found.energy[0])
            else:
                found = self._energy.starts(walls, _TRIVIAL.first)
                found = _settled(self._energy, self._energy.descend(found, _TRIVIAL).best(1))
                flat = random_walls(1, self._energy.size, np.array([_SHARP]), random)
                flat_starts = self._energy.starts(flat, _TRIVIAL.first, _SHARP)
                self.place.floor = float(found.energy[0])
                flat_starts = self._energy.descend(flat_starts, _TRIVIAL)
                self.place.sharp = float(_settled(self._energy, flat_starts).energy[0])
                self._offer(found)
        if self._error is not None:
            return "near"
        if self._first.any():
            return "given"
        return self._next()

    def _near(self, random: Generator) -> str:
        """Fit from given coefficients of known error."""
        assert self._error is not None  # the step exists only then
        count, pool = self.place.count, self.place.pool
        if count == 0:
            walls = random_walls(_NEAR_STARTS, self._energy.size, np.array([self._error]), random)
            walls[0] = 0.0
            pool = self._prior.starts(self._first + walls, _NEAR[0].first)
        pool = self._prior.descend(pool, _NEAR[count])
        if count < 2:
            self.place.pool = pool.best(1 if count else len(pool))
            return "near"
        self._offer(pool)
        return "widen" if self._frames else "end"

    def _given(self, _: Generator) -> str:
        """Fit from given coefficients of unknown error, one start among others."""
        settle = _SETTLE if self._frames else _COMPARE
        pool = self._energy.starts(self._first[None], _NEAR[0].first)
        pool = self._energy.descend(self._energy.descend(pool, _NEAR[0]), settle)
        self._offer(_settled(self._energy, pool, self._frames))
        self.place.met = 1
        return "widen" if self._frames else self._next()

    def _gather(self, random: Generator) -> str:
        """Fit random walls."""
        modes = len(self._energy.modes)
        many = self._energy.size // modes
        if self._frames:
            slow = self.place.turn > 0 and not self._noisy
            stage = _GATHER_NOISY if self._noisy else _GATHER_SLOWLY if slow else _GATHER
            lengths = np.array(self._strengths()) * (1.3 if slow else 1.0)
        else:
            stage = replace(_GATHER, first=_NOISES[self.place.turn % len(_NOISES)])
            lengths = np.resize(self._strengths(), _STARTS) * random.uniform(*_LENGTHS, _STARTS)
        lengths = np.repeat(np.resize(lengths, _STARTS), many)
        walls = random_walls(_STARTS * many, modes, lengths, random).reshape(_STARTS, -1)
        energy = self._searched()
        self.place.pool = energy.descend(energy.starts(walls, stage.first), stage)
        return "settle"

    def _propose(self, random: Generator) -> str:
        """Fit proposed walls, with objects of their own."""
        assert self._proposals is not None  # the step exists only then
        energy, walls = self._searched(), self._proposals.walls(_PROPOSALS, random)
        pool = energy.starts(walls, _PROPOSED[0].first)
        for stage in _PROPOSED:
            pool = energy.descend(pool, stage)
        self.place.pool = self._ranked(pool, _POOL)
        return "neighbours"

    def _expected_length(self) -> float:
        """Return the norm of the coefficients that is told or proposed, waves rms; else NaN."""
        if self._strength is not None:
            return self._strength
        return math.nan if self._proposals is None else self._proposals.length

    def _expected_sharpness(self) -> float:
        """Return the sum of squares that the point spreads of most expected walls exceed."""
        random = generator(self._seed, _ROUND - 1)
        if self._proposals is None:
            lengths = np.array([self._expected_length()])
            walls = random_walls(_EXPECTED, self._energy.size, lengths, random)
        else:
            walls = self._proposals.walls(_EXPECTED, random)
        return float(np.quantile(self._searched().sharpness(walls), _SPREAD_OUT))

    def _scores(self, starts: Starts) -> Floats:
        """Return the energies (B,), increased where the point spread is unexpectedly sharp.

        Without this, one image draws the search to waves that approach no blur.
        """
        if self._sharpness == math.inf:
            return starts.energy
        excess = np.log(self._searched().sharpness(starts.coefficients) / self._sharpness)
        penalty = _TOO_SHARP * self._verdict.pixels
        return starts.energy + penalty * np.maximum(excess, 0.0)

    def _ranked(self, starts: Starts, count: int) -> Starts:
        """Return the ``count`` starts of least score, least first."""
        return starts[np.argsort(self._scores(starts), kind="stable")[:count]]

    def _settle(self, _: Generator) -> str:
        """Fit the best walls with the prior that ranks answers."""
        count, stage = (8, _SETTLE) if self._frames else (_KEPT, _RELEASE)
        pool = self._searched().descend(self.place.pool.best(count), stage)
        self.place.pool = self._ranked(pool, _POOL)
        return "neighbours"

    def _neighbours(self, random: Generator) -> str:
        """Fit children of the best walls, with objects of their own.

        The descent alone can stop in a local minimum whose object is right within a few per cent.
        """
        pool, frames, energy = self.place.pool, self._frames, self._searched()
        near = _NEAR_NOISY if self._noisy else _NEAR_SEVERAL if frames else _NEAR_ONE
        well = frames and not self._noisy and self._verdict.well(pool)
        if well or self.place.count == near.generations:
            return "finish"
        twin = np.ones(energy.size) if frames else energy.twin
        walls = children(pool[: near.litter // 3], near.litter, twin, near, random)
        walls *= random.uniform(*_GROWTH, size=(len(walls), 1))
        stage = _SETTLE if frames else _COMPARE
        both = joined([pool, energy.descend(energy.starts(walls, stage.first), stage)])
        self.place.pool = self._ranked(both, _POOL)
        before, now = (float(self._scores(one[:1])[0]) for one in (pool, self.place.pool))
        if before - now >= _STANDSTILL:
            return "neighbours"
        if frames:
            return "finish"
        # on the narrow grid the best answer so far has another energy
        best, found = energy.descend(self.place.best, _FREE), self.place.pool[:1]
        ahead = found.energy[0] < best.energy[0] - _AHEAD
        same = energy.apart(found, best.coefficients)[0] < _OTHER
        return "finish" if ahead or same else "neighbours"

    def _finish(self, _: Generator) -> str:
        place, before = self.place, self.place.best
        found = self._ranked(_settled(self._energy, place.pool[:2], self._frames), 1)
        if self._noisy:
            self._count(found)
        self._offer(found)
        if self._frames:
            # a wrong wall that noise hides can need more modes: a right one is sought first
            last = place.met > 1 or place.turn + 1 == self._rounds
            return "widen" if last or not self._noisy else self._next()
        # energies of the narrow grid are compared among themselves
        energy = self._searched()
        other = energy.apart(place.pool, place.best.coefficients) > _OTHER
        walls = _settled(energy, joined([place.pool[other].best(4), before, place.best]))
        other = energy.apart(walls, walls[-1:].coefficients) > _OTHER
        found = walls.energy[other].min(initial=math.inf) - walls.energy[-1]
        lowered = float(before.energy[0] - place.best.energy[0])
        place.rival = float(np.fmin(place.rival + lowered, found))
        return self._next()

    def _count(self, found: Starts) -> None:
        """Count a round that found the best answer, or start anew with a better one."""
        place, best = self.place, self.place.best
        if not len(best):
            place.met = 1
            return
        if self._energy.known:  # any two rounds have its object
            equal = place.modes == self._energy.modes
            same = equal and self._energy.apart(found, best.coefficients)[0] < _OTHER
        else:
            one, other = (self._energy.objects(starts)[0] for starts in (found, best))
            same = registered_correlation(one, other) > _SAME_OBJECT
        if same:
            place.met += 1
        elif found.energy[0] < best.energy[0]:
            place.met = 1

    def _widen(self, _: Generator) -> str:
        """Add modes while the residual has structure and they lower the energy."""
        place = self.place
        tops = [top for top in _TOPS if top > max(self._energy.modes)]
        if place.count < len(tops) and self._verdict.structured(place.best):
            added = [mode for mode in range(4, tops[place.count] + 1) if mode not in place.modes]
            modes = (*place.modes, *added)
            wide = self._wider(modes)
            walls = place.best.coefficients.reshape(-1, len(place.modes))
            wider = np.pad(walls, ((0, 0), (0, len(added)))).reshape(1, -1)
            found = wide.descend(replace(place.best, coefficients=wider), _FINISH)
            # Schwarz (1978): a parameter costs half the logarithm of the number of data
            least = 0.5 * math.log(self._verdict.pixels) * (wide.size - walls.size)
            if float(place.best.energy[0] - found.energy[0]) > least:
                self._offer(found, modes)
            return "widen"
        return self._next()

    def _next(self) -> str:
        """Return the first step of the next round, or the end."""
        place = self.place
        place.turn += 1
        if place.turn == self._rounds or (len(place.best) and not self.faults):
            return "end"
        if place.turn == _ENOUGH and self._verdict.alone(place.rival):
            return "end"
        return "gather" if self._proposals is None else "propose"

    def _offer(self, found: Starts, modes: tuple[int, ...] | None = None) -> None:
        """Keep the start of least score, and record it in the history."""
        place, best = self.place, self._ranked(found, 1)
        if not len(place.best) or self._scores(best)[0] < self._scores(place.best)[0]:
            place.best, place.modes = best, self._energy.modes if modes is None else modes
        now, history = float(place.best.energy[0]), place.history
        before = history["objective"][-1] if history["objective"] else math.inf
        history["objective"].append(now)
        history["residual"].append(math.sqrt(float(place.best.chi_square[0].mean())))
        change = (before - now) / max(abs(now), 1.0) if math.isfinite(before) else 1.0
        history["change"].append(change)

    def _wider(self, modes: tuple[int, ...]) -> FreeEnergy:
        return self._energy if modes == self._energy.modes else self._energies(_PADDING, modes)

    def _searched(self) -> FreeEnergy:
        """Return the energy that a round descends."""
        return self._energy if self._frames else self._energies(_NARROW, self._energy.modes)

    def _strengths(self) -> tuple[float, ...]:
        """Return the norms of initial walls, used in turn, waves rms."""
        if self._strength is not None:
            known = self._strength
            return tuple(known * factor for factor in _AROUND) if self._frames else (known,)
        return _STRENGTHS


def _settled(energy: FreeEnergy, starts: Starts, frames: bool = False) -> Starts:
    """Fit answers a last time; those for one image until no energy decreases much."""
    found = energy.descend(starts, _FINISH if frames else _FREE)
    for _ in range(0 if frames else _REPEATS):
        before, found = found.energy, energy.descend(found, _FREE)
        if (before - found.energy).max() < _STANDSTILL:
            break
    return found
