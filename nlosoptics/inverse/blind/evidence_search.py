"""Search for the wave of least free energy, in steps between which it can be saved and resumed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from ..._random import generator
from ...errors import SamplingError, SceneError
from ..data.arrays import check_shape
from ..data.scores import registered_correlation
from ..data.status import Status
from .free_energy import Floats, FreeEnergy, OutOfTime, Starts, joined
from .search_settings import SETTINGS, Stage
from .verdict import Verdict
from .wall_proposals import Proposals, children, random_walls

#: Callback with a text and the completed fraction; returns whether the search is to end.
Watch = Callable[[str, float], bool]
#: Free energy on an FFT grid wider than the images by the given factor, for given Noll indices.
Energies = Callable[[float, tuple[int, ...]], FreeEnergy]


@dataclass(eq=False, kw_only=True)
class Place:
    """Position and results of a search after a step.

    ``turn``, ``count``, ``met``: number of the round, -1 before the first one, of repetitions of
    the step, and of rounds that found the best answer. ``sharp``: free energy without blur; NaN if
    not needed. ``step``: name of the next step. ``modes``: Noll indices of ``answers``. ``pool``:
    starts of the current round; empty before its first step. ``answers``: best starts so far, best
    first, each with another object; empty before the first one. ``history``: energy, residual and
    change after each improvement or round.
    """

    turn: int = -1
    count: int = 0
    met: int = 0
    sharp: float = math.nan
    step: str = "reference"
    modes: tuple[int, ...]
    pool: Starts
    answers: Starts
    history: dict[str, list[float]] = field(
        default_factory=lambda: {"objective": [], "residual": [], "change": []}
    )

    def saved(self) -> dict[str, Any]:
        """Return all that a resumed search needs, as arrays."""
        state: dict[str, Any] = {
            "place": [self.turn, self.count, self.met, self.sharp, list(PHASES).index(self.step)],
            "modes": self.modes,
            "history": list(self.history.values()),
        }
        for name, starts in (("pool", self.pool), ("answers", self.answers)):
            state |= {f"{name}_{key}": values for key, values in vars(starts).items()}
        return state

    def resume(self, state: Any) -> None:
        """Take over a saved state; the starts of this place have the shapes of the fit."""
        if not isinstance(state, Mapping):
            raise SceneError(
                f"start of type {type(state).__name__} is no saved state; give a state of "
                "evidence_fit, or leave it out"
            )
        if missing := [name for name in self.saved() if name not in state]:
            raise SceneError(
                f"start holds no {missing[0]}; give a state of evidence_fit, or leave it out"
            )
        modes = tuple(np.asarray(state["modes"], dtype=int).tolist())
        for part in ("pool", "answers"):
            arrays: dict[str, Floats] = {}
            for name, mine in vars(self.pool).items():
                arrays[name] = np.array(state[f"{part}_{name}"], dtype=mine.dtype)
                wanted = mine.shape[1:]
                if part == "answers" and name == "coefficients":
                    wanted = (wanted[0] // len(self.modes) * len(modes),)
                if arrays[name].shape[1:] != wanted:
                    raise SamplingError(
                        f"start's {name} have shape {arrays[name].shape[1:]} for each start, this "
                        f"fit's {wanted}; it belongs to other images or modes, leave it out"
                    )
            setattr(self, part, Starts(**arrays))
        numbers = np.asarray(state["place"], dtype=float)
        check_shape("start's place", numbers, (5,), "in this version; leave it out")
        self.turn, self.count, self.met, step = map(int, numbers[[0, 1, 2, 4]])
        self.sharp, self.step, self.modes = float(numbers[3]), list(PHASES)[step], modes
        self.history = dict(zip(self.history, np.asarray(state["history"]).tolist(), strict=True))


class Search:
    """Search of one fit, step by step; each step draws from its own stream of random numbers.

    ``energies``: returns the free energy for a padding and Noll indices. ``verdict``: tests of
    answers. ``modes``: given Noll indices. ``first`` (M,): given coefficients of all walls, waves
    rms; zeros if there are none. ``start_error``: expected rms error of the given coefficients,
    waves; None: they are only one more start. ``strength``: known rms of the walls' waves, waves.
    ``proposals``: proposed walls for one image; None: there are none. ``rounds``: largest number of
    rounds; None: the default. ``seed``: seed of the random numbers. ``state``: saved state to
    resume from.

    ``place``: position and results.
    """

    def __init__(
        self,
        energies: Energies,
        verdict: Verdict,
        modes: tuple[int, ...],
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
        self._energy = self._prior = energies(SETTINGS.padding, modes)
        if start_error is not None:
            self._prior = self._energy.about(first, start_error)
        self._several = verdict.several
        self._noisy = verdict.vague and start_error is None
        usual = int(self._noisy or not self._several) if proposals is None else 2
        self._rounds = SETTINGS.rounds[usual] if rounds is None else rounds
        self._last = SETTINGS.finish if self._several else SETTINGS.free
        #: sum of squares of a point spread above which walls are penalised
        self._sharpness = math.inf
        if not self._several and start_error is None and self._expected_length() > SETTINGS.weak:
            self._sharpness = self._expected_sharpness()
        self._flat = self._energy.starts(np.zeros((1, self._energy.size)), SETTINGS.free.first)
        self.place = Place(modes=modes, pool=self._flat[:0], answers=self._flat[:0])
        if state is not None:
            self.place.resume(state)

    @property
    def margins(self) -> tuple[float, float]:
        """Energies of no blur and of the best answer of another object, minus the best one's."""
        energies = self.place.answers.energy
        if self._several or not len(energies):
            return math.nan, math.nan
        rival = float(energies[1] - energies[0]) if len(energies) > 1 else math.inf
        return self.place.sharp - float(energies[0]), rival

    def status(self) -> tuple[Status, tuple[str, ...]]:
        """Return the status of the best answer, and the reason against "converged"."""
        margin, rival = self.margins
        best, effective = self.best(), float(self.energy().terms(self.best()).effective[0])
        return self._verdict.status(
            best, effective=effective, margin=margin, rival=rival, rounds=self.place.met
        )

    def energy(self) -> FreeEnergy:
        """Return the free energy with the best answer's modes."""
        return self._wider(self.place.modes)

    def best(self) -> Starts:
        """Return the best answer so far; before the first one, an object without blur."""
        return self.place.answers[:1] if len(self.place.answers) else self._flat

    def run(self, watch: Watch) -> bool:
        """Make steps until the search ends or ``watch`` asks it to; return whether it ended.

        A step that runs out of time leaves the place as it was before.
        """
        names = list(PHASES)
        while self.place.step != "end":
            name, count = self.place.step, self.place.count
            part = (names.index(name) + min(count, 12) / 13.0) / len(names)
            turn = self.place.turn + part if self.place.turn >= 0 else 0.1 * part - 0.1
            if watch(PHASES[name].text, (turn + 0.1) / (self._rounds + 0.1)):
                return False
            history = {name: values.copy() for name, values in self.place.history.items()}
            before = replace(self.place, history=history)
            stream = len(names) * (self.place.turn + 1) + names.index(name)
            try:
                step = PHASES[name].work(self, generator(self._seed, 100 * stream + count))
            except OutOfTime:
                self.place = before
                return False
            self.place.count = count + 1 if step == name else 0
            self.place.step = step
        return True

    def finish_early(self) -> None:
        """Fit an answer quickly; the search ended before it had one."""
        pool = self.place.pool
        if not len(pool):
            pool = self._energy.starts(self._first[None], self._last.first)
        free = replace(pool.best(1), radius=np.array([np.inf]))
        self._offer(self._energy.descend(free, self._last))

    def reference(self, random: Generator) -> str:
        """Fit without blur, which an answer for one image has to beat."""
        if not self._several and self._error is not None:
            walls = self._energy.starts(np.zeros((1, self._energy.size)), SETTINGS.near[1].first)
            for stage in SETTINGS.near[1:]:
                walls = self._energy.descend(walls, stage)
            prior = self._prior.held(walls.coefficients)
            self.place.sharp = float(walls.energy[0] + prior[0])
        elif not self._several:
            # one wall stays without blur, the others only start near it
            drawn = random_walls(5, self._energy.size, np.array([0.1]), random)
            drawn[0] *= SETTINGS.sharp / 0.1
            drawn[1] = 0.0
            radius = np.array([SETTINGS.sharp, *[np.inf] * 4])
            starts = self._energy.starts(drawn, SETTINGS.release.first, radius)
            starts = self._energy.descend(starts, SETTINGS.release)
            sharp, near = starts[:1], starts[1:].best(1)
            starts = self._settled(joined([sharp, near]))
            self.place.sharp = float(starts.energy[0])
            self._offer(starts[1:])
        if self._error is not None:
            return "near"
        return "given" if self._first.any() else self._next()

    def near(self, random: Generator) -> str:
        """Fit from given coefficients of known error."""
        assert self._error is not None  # the step exists only then
        count, pool = self.place.count, self.place.pool
        if count == 0:
            lengths = np.array([self._error])
            walls = random_walls(SETTINGS.near_starts, self._energy.size, lengths, random)
            walls[0] = 0.0
            pool = self._prior.starts(self._first + walls, SETTINGS.near[0].first)
        pool = self._prior.descend(pool, SETTINGS.near[count])
        if count < 2:
            self.place.pool = pool.best(1 if count else len(pool))
            return "near"
        self._offer(pool, met=self._verdict.rounds)
        return "widen" if self._several else "end"

    def given(self, _: Generator) -> str:
        """Fit from given coefficients of unknown error, one start among others."""
        settle = SETTINGS.settle if self._several else SETTINGS.compare
        pool = self._energy.starts(self._first[None], SETTINGS.near[0].first)
        pool = self._energy.descend(self._energy.descend(pool, SETTINGS.near[0]), settle)
        self._offer(self._settled(pool), met=1)
        return "widen" if self._several else self._next()

    def propose(self, random: Generator) -> str:
        """Fit proposed walls, with objects of their own."""
        assert self._proposals is not None  # the step exists only then
        walls = self._proposals.walls(SETTINGS.proposals, random)
        return self._pooled(walls, *SETTINGS.proposed)

    def gather(self, random: Generator) -> str:
        """Fit random walls, the best ones then with the prior that ranks answers."""
        modes, starts, settings = len(self._energy.modes), SETTINGS.starts, SETTINGS
        slow = self._several and self.place.turn > 0
        stage = settings.gather_slowly if slow else settings.gather
        if self._noisy:
            stage = settings.gather_noisy
        strengths = settings.strengths if self._strength is None else [self._strength]
        lengths = np.resize(strengths, starts) * random.uniform(*settings.lengths, starts)
        many = self._energy.size // modes
        walls = random_walls(starts * many, modes, np.repeat(lengths, many), random)
        return self._pooled(walls.reshape(starts, -1), stage)

    def settle(self, _: Generator) -> str:
        """Fit the best walls with the prior that ranks answers."""
        stage = SETTINGS.settle if self._several else SETTINGS.release
        pool = self._searched().descend(self.place.pool, stage)
        self.place.pool = self._ranked(pool, SETTINGS.pool)
        return "neighbours"

    def neighbours(self, random: Generator) -> str:
        """Fit children of the best walls, with objects of their own.

        The descent alone can stop in a local minimum whose object is right within a few per cent.
        """
        pool, several, energy = self.place.pool, self._several, self._searched()
        most = SETTINGS.generations[not several or self._noisy]
        fits = several and not self._noisy and self._verdict.fits(pool)
        if fits or self.place.count == most:
            return "finish"
        litter = SETTINGS.litter if several else SETTINGS.litter_of_one
        twin = np.ones(energy.size) if several else energy.twin
        walls = children(pool[: litter // 3], litter, twin, random)
        stage = SETTINGS.settle if several else SETTINGS.compare
        both = joined([pool, energy.descend(energy.starts(walls, stage.first), stage)])
        self.place.pool = self._ranked(both, SETTINGS.pool)
        before, now = (float(self._scores(part[:1])[0]) for part in (pool, self.place.pool))
        ahead = several or self.place.pool.energy[0] < self.place.answers.energy[0]
        more = before - now >= SETTINGS.standstill
        if more or not (ahead or self._same(self.place.pool, self.place.answers)):
            return "neighbours"
        return "finish"

    def finish(self, _: Generator) -> str:
        """Fit the best walls of a round a last time, and compare them with those before."""
        several = self._several
        pool = self.place.pool[:2] if several else self._different(self.place.pool)
        self._offer(self._ranked(self._settled(pool), len(pool)), met=1)
        if not several:
            return self._next()
        # a wrong wall that noise hides can need more modes: a right one is sought first
        last = self.place.met > 1 or self.place.turn + 1 == self._rounds
        return "widen" if last or not self._noisy else self._next()

    def widen(self, _: Generator) -> str:
        """Add modes while the residual has structure and they lower the energy."""
        place, best = self.place, self.best()
        tops = [top for top in SETTINGS.tops if top > max(self._energy.modes)]
        if place.count == len(tops) or not self._verdict.structured(best):
            return self._next()
        added = [mode for mode in range(4, tops[place.count] + 1) if mode not in place.modes]
        modes = (*place.modes, *added)
        wide = self._wider(modes)
        walls = best.coefficients.reshape(-1, len(place.modes))
        wider = np.pad(walls, ((0, 0), (0, len(added)))).reshape(1, -1)
        more = wide.descend(replace(best, coefficients=wider), SETTINGS.finish)
        # Schwarz (1978): a parameter costs half the logarithm of the number of data
        least = 0.5 * math.log(self._verdict.pixels) * (wide.size - walls.size)
        if float(best.energy[0] - more.energy[0]) > least:
            place.answers, place.modes = more, modes
            self._record()
        return "widen"

    def _next(self) -> str:
        """Return the first step of the next round, or the end."""
        place = self.place
        place.turn += 1
        done = len(place.answers) and self.status()[0] == "converged"
        if done or place.turn == self._rounds:
            return "end"
        return "gather" if self._proposals is None else "propose"

    def _pooled(self, walls: Floats, *stages: Stage) -> str:
        """Begin a round with walls; return its next step."""
        energy = self._searched()
        pool = energy.starts(walls, stages[0].first)
        for stage in stages:
            pool = energy.descend(pool, stage)
        ranked = len(stages) > 1  # by the prior that compares answers
        few = 8 if self._several else 20
        self.place.pool = self._ranked(pool, SETTINGS.pool) if ranked else pool.best(few)
        return "neighbours" if ranked else "settle"

    def _offer(self, starts: Starts, met: int = 0) -> None:
        """Add starts, best first, to the answers.

        ``met`` is the number of rounds that the first of them counts for.
        """
        place, old = self.place, self.place.answers
        if not self._several:
            every = joined([old, starts])
            place.answers = self._different(self._ranked(every, len(every)))
        elif not len(old) or starts.energy[0] < old.energy[0]:
            place.answers, place.modes = starts[:1], self._energy.modes
        if self._same(place.answers, starts):
            place.met = met + (place.met if len(old) and self._same(place.answers, old) else 0)
        self._record()

    def _record(self) -> None:
        """Add the best answer to the history."""
        best, history = self.place.answers[:1], self.place.history
        energy = float(best.energy[0])
        before = history["objective"][-1] if history["objective"] else math.inf
        history["objective"].append(energy)
        history["residual"].append(math.sqrt(float(best.chi_square[0].mean())))
        change = (before - energy) / max(abs(energy), 1.0) if math.isfinite(before) else 1.0
        history["change"].append(change)

    def _same(self, first: Starts, second: Starts) -> bool:
        """Return whether the first starts of two sets have the same object."""
        objects = (self._energy.objects(starts[:1])[0] for starts in (first, second))
        return registered_correlation(*objects) > SETTINGS.same_object

    def _different(self, starts: Starts) -> Starts:
        """Return the first starts of different objects."""
        rows: list[int] = []
        for row in range(len(starts)):
            if not any(self._same(starts[[row]], starts[[other]]) for other in rows):
                rows.append(row)
        return starts[rows[: SETTINGS.answers]]

    def _settled(self, starts: Starts) -> Starts:
        """Fit answers a last time; those for one image until no energy decreases much."""
        starts = self._energy.descend(starts, self._last)
        for _ in range(0 if self._several else SETTINGS.repeats):
            before, starts = starts.energy, self._energy.descend(starts, self._last)
            if (before - starts.energy).max() < SETTINGS.standstill:
                break
        return starts

    def _ranked(self, starts: Starts, count: int) -> Starts:
        """Return the ``count`` starts of least score, least first."""
        return starts[np.argsort(self._scores(starts), kind="stable")[:count]]

    def _scores(self, starts: Starts) -> Floats:
        """Return the energies (B,), increased where the point spread is unexpectedly sharp.

        Without this, one image draws the search to waves that approach no blur.
        """
        if self._sharpness == math.inf:
            return starts.energy
        excess = np.log(self._searched().sharpness(starts.coefficients) / self._sharpness)
        penalty = SETTINGS.too_sharp * self._verdict.pixels
        return starts.energy + penalty * np.maximum(excess, 0.0)

    def _expected_length(self) -> float:
        """Return the norm of the coefficients that is known or proposed, waves rms; else NaN."""
        if self._strength is not None:
            return self._strength
        return math.nan if self._proposals is None else self._proposals.density.length

    def _expected_sharpness(self) -> float:
        """Return the sum of squares that the point spreads of most expected walls exceed."""
        random = generator(self._seed, 12)
        if self._proposals is None:
            lengths = np.array([self._expected_length()])
            walls = random_walls(SETTINGS.expected, self._energy.size, lengths, random)
        else:
            walls = self._proposals.walls(SETTINGS.expected, random)
        return float(np.quantile(self._searched().sharpness(walls), SETTINGS.spread_out))

    def _wider(self, modes: tuple[int, ...]) -> FreeEnergy:
        same = modes == self._energy.modes
        return self._energy if same else self._energies(SETTINGS.padding, modes)

    def _searched(self) -> FreeEnergy:
        """Return the energy that a round descends."""
        return self._energies(SETTINGS.narrow, self._energy.modes)


class Phase(NamedTuple):
    """Step of a search: text for the progress callback, and function that returns the next one."""

    text: str
    work: Callable[[Search, Generator], str]


#: Steps by name, in their order.
PHASES = {
    "reference": Phase("no blur", Search.reference),
    "near": Phase("about the given wall", Search.near),
    "given": Phase("about the given wall", Search.given),
    "propose": Phase("proposed walls", Search.propose),
    "gather": Phase("random walls", Search.gather),
    "settle": Phase("best walls", Search.settle),
    "neighbours": Phase("near the best walls", Search.neighbours),
    "finish": Phase("best walls", Search.finish),
    "widen": Phase("more modes", Search.widen),
    "end": Phase("done", lambda search, random: "end"),
}
