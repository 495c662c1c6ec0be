"""Waves that a trained network proposes for one image, as starts of a search.

The network has seen images of 64 x 64 pixels at Nyquist's pitch. Others are resampled, and cut out
about their light or surrounded by black. Its training script
``train_proposals.py`` is in the history (commit b2dc0d51).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch
from numpy.random import Generator
from torch import Tensor

from ...errors import MissingExtraError
from ...psf.wave.zernikes import zernike
from ..wave.frames import Frames
from ..wave.pupil_psf import PupilPSF
from ..wave.pupil_waves import DEFOCUS, ZernikeWaves
from .free_energy import Floats
from .wall_network import MODES, SIDE, WallNetwork, twin_signs

#: File of the trained weights.
WEIGHTS = Path(__file__).with_name("wall_proposals.safetensors")
Turn = Callable[[Tensor], Tensor]


class WallProposals:
    """Density of the waves of one image, from eight turned and mirrored copies of it.

    ``image`` (SIDE, SIDE): image at Nyquist's pitch with a dark background. ``noise``: standard
    deviation of its noise, image units. ``network``: trained network.

    ``mean`` (M,): most likely coefficients of `wall_network.MODES`, waves rms; their twin is as
    likely. ``length``: expected norm of the coefficients, waves rms.
    """

    def __init__(self, image: Tensor, noise: float, network: WallNetwork) -> None:
        turns = _turns()
        with torch.no_grad():
            looks = torch.stack([turn(image) for turn, _ in turns])
            found = network(looks, torch.full((len(looks),), noise))
        back = torch.stack([matrix for _, matrix in turns])
        means = torch.einsum("lpm,lmn->lpn", found.means, back).flatten(0, 1)
        # each turn exchanges modes of one order or changes signs
        deviations = torch.einsum("lpm,lmn->lpn", found.deviations, back.abs()).flatten(0, 1)
        weights = found.weights.exp().flatten() / len(looks)
        parts = (weights, means, deviations)
        self._parts: list[Floats] = [one.double().numpy() for one in parts]
        self.mean = self._meeting()
        squares = (np.square(self._parts[1]) + np.square(self._parts[2])).sum(axis=1)
        self.length = math.sqrt(float(self._parts[0] @ squares / self._parts[0].sum()))

    def walls(self, count: int, random: Generator) -> Floats:
        """Return coefficients (count, M), waves rms: the mean, and draws from the density.

        Each Gaussian that is drawn gives its mean first, then draws with half its deviations.
        """
        weights, means, deviations = self._parts
        rows = random.choice(len(weights), size=count, p=weights / weights.sum())
        spread = 0.5 * deviations[rows]
        spread[np.unique(rows, return_index=True)[1]] = 0.0
        walls: Floats = means[rows] + spread * random.normal(size=spread.shape)
        walls[0] = self.mean
        return walls

    def _meeting(self) -> Floats:
        """Return the coefficients near which most looks propose theirs.

        From each proposal a mean shift with the proposals and their twins leads to a maximum of the
        density; that of the largest one is kept.
        """
        weights, means, deviations = self._parts
        every = np.concatenate([means, means * twin_signs().double().numpy()])
        # twice as wide as proposed, so that the looks meet
        precision = (2.0 * np.tile(deviations, (2, 1))) ** -2
        shares = np.log(np.tile(weights, 2)) + 0.5 * np.log(precision).sum(axis=1)

        def chances(at: Floats) -> Floats:
            found: Floats = shares - 0.5 * (np.square(at[:, None] - every) * precision).sum(axis=2)
            return found

        at = means
        for _ in range(5):
            logarithms = chances(at)
            pull = np.exp(logarithms - logarithms.max(axis=1, keepdims=True))
            at = (pull @ (precision * every)) / (pull @ precision)
        best: Floats = at[int(np.logaddexp.reduce(chances(at), axis=1).argmax())]
        return best


@dataclass(frozen=True, eq=False)
class Proposals:
    """Source of proposed walls for one fit.

    ``density``: proposals for the image. ``frames``: the image. ``pupil_psf``: its point spread.
    """

    density: WallProposals
    frames: Frames
    pupil_psf: PupilPSF

    @property
    def length(self) -> float:
        """Expected norm of the coefficients, waves rms."""
        return self.density.length

    def walls(self, count: int, random: Generator) -> Floats:
        """Return proposed coefficients of the fit, (count, M) waves rms, the mean first.

        Modes that the network does not know are 0. A known defocus is subtracted.
        """
        walls, optics = self.density.walls(count, random), self.pupil_psf.optics
        found = np.zeros((count, len(self.pupil_psf.modes)))
        signed = walls * np.sign(optics.image_distance)
        for column, mode in enumerate(self.pupil_psf.modes):
            if mode in MODES:
                found[:, column] = signed[:, MODES.index(mode)]
                if mode == DEFOCUS:
                    found[:, column] -= self.frames.defocus[0] / optics.wavelength
        return found


def wall_proposals(frames: Frames, pupil_psf: PupilPSF) -> Proposals | None:
    """Return the proposals for one image, or None where the network does not apply.

    It applies to one image through a full circular pupil without a known wave, of pixels no wider
    than Nyquist's, and of 24 to 96 pixels at Nyquist's pitch along each side.
    """
    optics, waves = pupil_psf.optics, pupil_psf.waves
    scale = optics.pitch / optics.nyquist_pitch
    sides = [side * scale for side in frames.shape]
    known = isinstance(waves, ZernikeWaves) and waves.rest is not None
    if (
        len(frames.images) > 1
        or scale > 1.02
        or min(sides) < 24
        or max(sides) > 96
        or known
        or optics.transmission is not None
        or not set(pupil_psf.modes) & set(MODES)
    ):
        return None
    image, noise = at_nyquist(frames.images[0], float(frames.sigmas[0]), scale)
    return Proposals(WallProposals(image, noise, trained_network()), frames, pupil_psf)


def at_nyquist(image: Floats, noise: float, scale: float) -> tuple[Tensor, float]:
    """Resample an image to SIDE x SIDE pixels at Nyquist's pitch; return it and its noise.

    ``image`` (H, W): image, any unit. ``noise``: standard deviation of its noise, image units.
    ``scale``: its pitch relative to Nyquist's, at most about 1.

    The median of the edges becomes 0, and so does all that surrounds the image. A longer side is
    cut to SIDE pixels about the centroid of the light.
    """
    edges = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
    dark = torch.from_numpy(image - np.median(edges))
    whole = 192  # pixels at Nyquist's pitch of the transform that resamples
    period = round(whole / scale)
    spectrum = torch.fft.fft2(dark, s=(period, period))
    half = whole // 2
    kept = torch.zeros((whole, whole), dtype=spectrum.dtype)
    inside = torch.fft.fftfreq(whole, 1.0 / whole).long()
    inside = inside[inside.abs() < min(half, (period + 1) // 2)]
    kept[inside[:, None], inside] = spectrum[inside[:, None], inside]
    if period == whole:
        kept = spectrum
    found = torch.fft.ifft2(kept).real * (whole / period) ** 2
    sides = [max(1, round(side * scale)) for side in image.shape]
    found = found[: sides[0], : sides[1]]
    light = found.clamp(min=0.0)
    made = torch.zeros(SIDE, SIDE)
    given, put = [], []
    for axis, side in enumerate(sides):
        along = light.sum(dim=1 - axis)
        middle = float((along * torch.arange(side)).sum() / along.sum().clamp(min=1e-12))
        first = min(max(round(middle) - SIDE // 2, 0), max(side - SIDE, 0))
        given.append(slice(first, first + SIDE))
        room = max(SIDE - side, 0) // 2
        put.append(slice(room, room + min(side, SIDE)))
    made[put[0], put[1]] = found[given[0], given[1]].float()
    return made, noise * min(1.0, scale)


@cache
def trained_network() -> WallNetwork:
    """Return the network with the weights of the package; raise if safetensors is missing."""
    try:
        from safetensors.torch import load_file
    except ImportError:
        raise MissingExtraError(
            "networks are files of safetensors, which is not installed; "
            "pip install 'nlosoptics[inverse]'"
        ) from None
    network, weights = WallNetwork(), load_file(WEIGHTS)
    network.load_state_dict({name: values.float() for name, values in weights.items()})
    return network.train(False).requires_grad_(False)


@cache
def _turns() -> list[tuple[Turn, Tensor]]:
    """Return the eight turns and reflections of an image, each with its matrix (M, M).

    Coefficients of the turned image, times the matrix, are those of the image.
    """
    axis = (np.arange(SIDE) + 0.5) / SIDE * 2.0 - 1.0
    u, v = np.meshgrid(axis, axis)
    rho = np.hypot(u, v)
    inside = torch.from_numpy(rho < 1.0)
    basis = [torch.from_numpy(zernike(mode, rho, np.arctan2(v, u))) for mode in MODES]
    plain = torch.stack([one[inside] for one in basis])
    found: list[tuple[Turn, Tensor]] = []
    for mirrored in (False, True):
        for quarters in range(4):

            def turn(image: Tensor, mirrored: bool = mirrored, quarters: int = quarters) -> Tensor:
                return torch.rot90(image.flip(1) if mirrored else image, quarters)

            turned = torch.stack([turn(one)[inside] for one in basis])
            # rows: each mode of the image, turned, as a sum of modes
            matrix = torch.linalg.lstsq(plain.T, turned.T).solution
            found.append((turn, matrix.round().float()))
    return found
