"""Stages of a blind fit: number of starts, assumed noise, and steps of object and coefficients."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..._progress import Progress
from ...errors import SamplingError
from ..data import checkpoints
from ..data.checkpoints import adam_state, take_up_adam
from ..wave.frames import Frames
from .energy import Energy, KnownObjectEnergy

_OBJECT_STEP = 0.05
_GAIN_STEP = 0.01
_BETAS = (0.9, 0.99)
_CHECK_EVERY = 25
#: Tensors that make up a batch of fits.
BATCH = ("theta", "coefficients", "log_gains", "variances", "energy", "square")


@dataclass(frozen=True, kw_only=True)
class Stage:
    """Settings of one stage of the fit.

    Parameters
    ----------
    starts : int
        Number of best starts that are continued.
    iterations : int
        Number of iterations.
    noise : (float, float)
        First and last ratio of the assumed noise to the actual one. In between it changes
        geometrically, and the last value is reached after 0.7 of the iterations.
    step : float
        Step of the coefficients, waves; 0 keeps them fixed.
    """

    starts: int
    iterations: int
    noise: tuple[float, float]
    step: float


def near_stages(starts: int) -> tuple[Stage, ...]:
    """Return the stages for coefficients known to some tenths of a wave."""
    return (
        Stage(starts=starts, iterations=200, noise=(5.0, 5.0), step=0.0),
        Stage(starts=starts, iterations=400, noise=(5.0, 1.0), step=0.01),
        Stage(starts=1, iterations=200, noise=(1.0, 1.0), step=0.004),
    )


def far_stages(starts: int) -> tuple[Stage, ...]:
    """Return the stages for unknown walls."""
    return (
        Stage(starts=starts, iterations=200, noise=(30.0, 4.0), step=0.016),
        Stage(starts=max(1, starts // 4), iterations=300, noise=(4.0, 1.0), step=0.016),
        Stage(starts=1, iterations=300, noise=(1.0, 1.0), step=0.005),
    )


@dataclass(eq=False, kw_only=True)
class State:
    """Batch of B fits with objects, coefficients, image gains, energies and history."""

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

    def chosen(self, which: Tensor) -> State:
        """Return the fits with the indices ``which``."""
        return State(
            theta=self.theta.detach()[which].clone(),
            coefficients=self.coefficients.detach()[which].clone(),
            log_gains=self.log_gains.detach()[which].clone(),
            variances=self.variances[which].clone(),
            energy=self.energy[which].clone(),
            square=self.square[which].clone(),
            history=self.history,
            settled=self.settled,
        )


class BlindFit:
    """Data, prior and energy shared by all stages of a blind fit."""

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

    def begin(self, coefficients: Tensor, factor: float) -> State:
        """Return the initial batch, with objects Wiener-filtered by their point spreads.

        ``coefficients`` (B, n_walls, M) are in waves; ``factor`` is the ratio of assumed to actual
        noise.
        """
        count = len(coefficients)
        with torch.no_grad():
            level = self.energy.wiener(self.frames.transfer(coefficients), factor)
            if self.guess is not None and not self.known:
                bright = level.clamp_min(0.0).mean((-2, -1), keepdim=True)
                level = self.guess * (bright / self.guess.mean())
        zeros = torch.zeros(count).to(self.frames.images)
        return State(
            theta=self.energy.theta(level),
            coefficients=coefficients,
            log_gains=torch.zeros(count, len(self.frames.images)).to(zeros),
            variances=self.energy.first_variances(count),
            energy=zeros,
            square=zeros,
        )

    def best(self, state: State, count: int) -> State:
        """Return the ``count`` fits of lowest energy."""
        if count >= len(state.theta):
            count = len(state.theta)
        return state.chosen(state.energy.argsort()[:count])

    def held(self, coefficients: Tensor) -> Tensor:
        """Return the prior energy (B,) of coefficients (B, n_walls, M).

        It increases with the squared distance from the initial coefficients.
        """
        return self._stiffness * (coefficients - self.first).square().sum((-2, -1))

    def gains(self, state: State) -> Tensor | None:
        """Return the relative brightness of the images, (B, K, 1, 1), with geometric mean 1."""
        if not self.fit_gains:
            return None
        logs = state.log_gains - state.log_gains.mean(-1, keepdim=True)
        return logs.exp()[..., None, None]

    def run(
        self,
        state: State,
        stage: Stage,
        tolerance: float,
        report: Report,
        kept: Mapping[str, Any] | None = None,
    ) -> State:
        """Run one stage, from its beginning or from the saved state ``kept``."""
        moves = stage.step > 0.0
        groups: list[dict[str, Any]] = [
            {"params": [state.theta.requires_grad_()], "lr": _OBJECT_STEP}
        ]
        if self.fit_gains:
            groups.append({"params": [state.log_gains.requires_grad_()], "lr": _GAIN_STEP})
        if moves:
            groups.append({"params": [state.coefficients.requires_grad_()], "lr": stage.step})
        optimiser = torch.optim.Adam(groups, betas=_BETAS)
        steps = [group["lr"] for group in groups]
        still = None if moves else self.frames.transfer(state.coefficients).detach()
        final = stage.noise == (1.0, 1.0)
        lowest, last, first = None, math.inf, 0
        if kept is not None:
            take_up_adam("fit", optimiser, kept)
            first, last = int(kept["place"][1]), float(kept["place"][2])
        for iteration in range(first, stage.iterations):
            done = iteration / max(1, stage.iterations - 1)
            factor = stage.noise[0] * (stage.noise[1] / stage.noise[0]) ** min(1.0, done / 0.7)
            pace = _pace(done)
            for group, step in zip(optimiser.param_groups, steps, strict=True):
                group["lr"] = pace * step
            level = self.energy.level(state.theta)
            transfer = self.frames.transfer(state.coefficients) if still is None else still
            energy, square = self.energy(
                level, transfer, state.variances, factor, self.gains(state)
            )
            energy = energy + self.held(state.coefficients)
            optimiser.zero_grad()
            energy.sum().backward()  # type: ignore[no-untyped-call]
            state.energy, state.square = energy.detach(), square
            if final and (lowest is None or float(state.energy[0]) < float(lowest.energy[0])):
                lowest = state.chosen(torch.zeros(1, dtype=torch.int64))
            optimiser.step()
            self._record(state)
            if final and iteration % _CHECK_EVERY == _CHECK_EVERY - 1:
                now = float(state.energy.min())
                if abs(last - now) <= tolerance * abs(now):
                    state.settled = True
                    break
                last = now
            place = (iteration + 1, last)
            if not report.tell(self, state, factor, optimiser, place):
                break
        found = state if lowest is None else lowest
        found.settled = state.settled
        return found.chosen(torch.arange(len(found.theta)))

    @staticmethod
    def _record(state: State) -> None:
        at = int(state.energy.argmin())
        objective = float(state.energy[at])
        before = state.history["objective"][-1] if state.history["objective"] else math.inf
        state.history["objective"].append(objective)
        state.history["residual"].append(math.sqrt(float(state.square[at])))
        state.history["change"].append(
            abs(before - objective) / max(abs(objective), 1e-30) if before < math.inf else 1.0
        )


@dataclass(frozen=True)
class NoBlur:
    """Result of the fit that starts without blur; NaN if there was none.

    Parameters
    ----------
    energy : float
        Free energy, without a prior of the coefficients.
    held : float
        Energy that the prior of the coefficients would add; see `BlindFit.held`.
    """

    energy: float = math.nan
    held: float = math.nan


class Report:
    """Progress reports of a staged fit, with states to resume from.

    Parameters
    ----------
    progress : callable or None
        Callback of the user.
    total : int
        Number of iterations of all stages.

    Attributes
    ----------
    stage : int
        Number of the current stage.
    no_blur : NoBlur
        Result of the fit that starts without blur.
    ended : bool
        Whether the callback asked the fit to stop.
    """

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0
        self.stage, self.no_blur, self.ended = 0, NoBlur(), False

    def skip(self, iterations: int) -> None:
        """Count iterations that a resumed fit has completed before."""
        self._done += iterations

    def tell(
        self,
        fit: BlindFit,
        state: State,
        factor: float,
        adam: torch.optim.Adam,
        place: tuple[int, float],
    ) -> bool:
        """Count one iteration and report now and then; return False if the fit is to stop."""
        self._done += 1
        if self._done % _CHECK_EVERY:
            return True
        at = int(state.energy.argmin())
        self.ended = not checkpoints.goes_on(
            self._progress,
            f"staged fit: residual {math.sqrt(float(state.square[at])):.3f} of the noise, "
            f"free energy {float(state.energy[at]):.1f} at noise x {factor:.2g}",
            min(1.0, self._done / self._total),
            lambda: self._state(fit, state, adam, place),
        )
        return not self.ended

    def _state(
        self, fit: BlindFit, state: State, adam: torch.optim.Adam, place: tuple[int, float]
    ) -> checkpoints.State:
        """Return the state to resume from, with the object of the best start."""
        at = int(state.energy.argmin())
        with torch.no_grad():
            level = fit.energy.level(state.theta)[at] * fit.frames.scale
        return checkpoints.state_of(
            level,
            **{name: getattr(state, name) for name in BATCH},
            **adam_state("fit", adam),
            place=[self.stage, *place, self.no_blur.energy, self.no_blur.held],
        )


class NoBlurReport(Report):
    """Report of the fit without blur, which runs first and cannot be resumed midway."""

    def _state(
        self, fit: BlindFit, state: State, adam: torch.optim.Adam, place: tuple[int, float]
    ) -> checkpoints.State:
        with torch.no_grad():
            return checkpoints.state_of(
                fit.energy.level(state.theta)[0] * fit.frames.scale, place=[]
            )


def taken_up(state: State, kept: Mapping[str, Any]) -> State:
    """Restore a batch of fits from a saved state.

    Parameters
    ----------
    state : State
        Batch of the new fit; its tensors are replaced.
    kept : mapping
        Saved state.

    Raises
    ------
    SamplingError
        If the saved state belongs to other images or walls.
    """
    for name in BATCH:
        mine = getattr(state, name)
        values = torch.as_tensor(np.array(kept[name]), dtype=mine.dtype, device=mine.device)
        if values.shape[1:] != mine.shape[1:]:
            raise SamplingError(
                f"start's {name} has shape {tuple(values.shape)}, this fit's has "
                f"{tuple(mine.shape)}; it belongs to other images, leave it out"
            )
        setattr(state, name, values)
    return state


def _pace(done: float) -> float:
    """Return the factor of the steps: 1 in the first half of a stage, then a cosine to 5 %."""
    if done < 0.5:
        return 1.0
    return 0.05 + 0.475 * (1.0 + math.cos(2.0 * math.pi * (done - 0.5)))
