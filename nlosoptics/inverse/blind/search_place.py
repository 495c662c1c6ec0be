"""Position and results of a search for walls, which can be saved and resumed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from ...errors import SamplingError, SceneError
from ..data.arrays import check_shape
from .free_energy import Floats, Starts

#: Texts of all steps, in their order.
TEXTS = {
    "reference": "no blur",
    "near": "about the given wall",
    "given": "about the given wall",
    "gather": "random walls",
    "settle": "best walls",
    "neighbours": "near the best walls",
    "finish": "best walls",
    "widen": "more modes",
    "propose": "proposed walls",
    "end": "done",
}
STEPS = tuple(TEXTS)
HISTORY = ("objective", "residual", "change")
NUMBERS = ("turn", "count", "met", "floor", "sharp", "held", "rival")


@dataclass(eq=False, kw_only=True)
class Place:
    """Position and results of a search after a step.

    ``turn``, ``count``, ``met``: number of the round, -1 before the first one, of repetitions of
    the step, and of rounds that found the best answer; the last one for several images with much
    noise. ``step``: name of the next step. ``floor``, ``sharp``: free energies of the fits that
    start without blur and that have no blur; NaN if not needed. ``held``: energy that the prior of
    the coefficients would add to the former. ``rival``: for one image the least free energy of
    walls of another point spread, minus that of the best answer; NaN before the end of the first
    round. ``modes``: Noll indices of ``best``. ``pool``: starts of the current round; empty before
    its first step. ``best``: best answer so far, one start; empty before the first one.
    ``history``: energy, residual and change after each improvement or round.
    """

    turn: int = -1
    count: int = 0
    met: int = 0
    step: str = "reference"
    floor: float = math.nan
    sharp: float = math.nan
    held: float = math.nan
    rival: float = math.nan
    modes: tuple[int, ...]
    pool: Starts
    best: Starts
    history: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in HISTORY})

    def saved(self) -> dict[str, Any]:
        """Return all that a resumed search needs, as arrays."""
        arrays: dict[str, Any] = {
            "place": [STEPS.index(self.step), *(getattr(self, name) for name in NUMBERS)],
            "modes": self.modes,
            "history": np.array([self.history[name] for name in HISTORY]),
        }
        for name, starts in (("pool", self.pool), ("best", self.best)):
            arrays |= {f"{name}_{key}": values for key, values in vars(starts).items()}
        return arrays

    @classmethod
    def of(cls, state: Any, like: Starts, modes: int) -> Place:
        """Return the place of a saved state.

        ``like`` are starts of the resumed fit, with ``modes`` coefficients.
        """
        if not isinstance(state, Mapping):
            raise SceneError(
                f"start of type {type(state).__name__} is no saved state; give a state of "
                "evidence_fit, or leave it out"
            )
        names = [f"{part}_{entry.name}" for part in ("pool", "best") for entry in fields(Starts)]
        names += ["place", "modes", "history"]
        missing = [name for name in names if name not in state]
        if missing:
            raise SceneError(
                f"start holds no {missing[0]}; give a state of evidence_fit, or leave it out"
            )

        def kept(part: str, count: int) -> Starts:
            arrays: dict[str, Floats] = {}
            for name, mine in vars(like).items():
                arrays[name] = np.array(state[f"{part}_{name}"], dtype=mine.dtype)
                given, wanted = arrays[name].shape[1:], mine.shape[1:]
                if name == "coefficients":
                    wanted = (count,)
                if given != wanted:
                    raise SamplingError(
                        f"start's {name} have shape {given} for each start, this fit's {wanted}; "
                        "it belongs to other images or modes, leave it out"
                    )
            return Starts(**arrays)

        wide = tuple(np.asarray(state["modes"], dtype=int).tolist())
        numbers = np.asarray(state["place"], dtype=float)
        check_shape("start's place", numbers, (8,), "in this version; leave it out")
        step, turn, count, met, *energies = numbers.tolist()
        return cls(
            step=STEPS[int(step)],
            **dict(zip(NUMBERS, [int(turn), int(count), int(met), *energies], strict=True)),
            modes=wide,
            pool=kept("pool", modes),
            best=kept("best", len(wide)),
            history=dict(zip(HISTORY, np.asarray(state["history"]).tolist(), strict=True)),
        )
