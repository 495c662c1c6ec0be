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
from typing import NamedTuple

import numpy as np
import torch
from numpy.random import Generator
from torch import Tensor, nn

from ...errors import MissingExtraError
from ...psf.wave.zernikes import zernike, zernike_order
from ..wave.frames import Frames
from ..wave.pupil_psf import PupilPSF
from ..wave.pupil_waves import DEFOCUS, ZernikeWaves
from .free_energy import Floats

#: File of the trained weights.
WEIGHTS = Path(__file__).with_name("wall_proposals.safetensors")
Turn = Callable[[Tensor], Tensor]

#: Noll indices of the proposed coefficients, n = 2..5.
MODES = tuple(range(4, 22))
#: Pixels of the network's image along each side, at Nyquist's pitch.
SIDE = 64
#: Number of Gaussians.
PARTS = 16


class Mixture(NamedTuple):
    """Gaussians over the coefficients of B images, waves rms.

    ``weights`` (B, PARTS): logarithms of the weights, of which the exponentials add up to 1.
    ``means``, ``deviations`` (B, PARTS, M): means and standard deviations of the coefficients of
    `MODES`.
    """

    weights: Tensor
    means: Tensor
    deviations: Tensor


class WallNetwork(nn.Module):
    """Network of convolutions and attention from images to `Mixture`; 2.5 million weights."""

    def __init__(self) -> None:
        super().__init__()
        side = SIDE // 4
        self.layers = nn.Sequential(
            nn.PixelUnshuffle(2),
            nn.Conv2d(16, 64, 3, padding=1),
            _Residual(64),
            _Residual(64),
            nn.Conv2d(64, 128, 3, stride=2, padding=1),
            _Places(128, side),
            _Residual(128),
            _Residual(128),
            _Residual(128),
            nn.Conv2d(128, 192, 3, stride=2, padding=1),
            _Attention(192, 6),
            _Attention(192, 6),
            nn.GroupNorm(8, 192),
            nn.SiLU(),
            nn.Conv2d(192, 64, 3, stride=2, padding=1),
            nn.Flatten(),
            nn.Linear(64 * (side // 4) ** 2, 256),
            nn.SiLU(),
            nn.Linear(256, PARTS * (2 * len(MODES) + 1)),
        )

    def forward(self, images: Tensor, noise: Tensor) -> Mixture:
        """Return the mixtures of images (B, SIDE, SIDE) with a dark background.

        ``noise`` (B,) is the standard deviation of their noise, in the images' unit.
        """
        found = self.layers(channels(images, noise)).float().unflatten(1, (PARTS, -1))
        weights, means, spreads = found.split([1, len(MODES), len(MODES)], dim=2)
        deviations = 0.01 + (spreads - 2.0).clamp(max=1.0).exp()
        return Mixture(weights[..., 0].log_softmax(dim=1), means, deviations)


def channels(images: Tensor, noise: Tensor) -> Tensor:
    """Return what the network sees, (B, 4, SIDE, SIDE).

    The image; the logarithm of its spectrum's power over the noise; the transform of that, which
    separates object and point spread; and the image with an even spectrum.
    """
    bright = images.amax(dim=(1, 2), keepdim=True).clamp(min=1e-12)
    scaled, level = images / bright, noise.view(-1, 1, 1) / bright
    spectrum = torch.fft.fft2(scaled * _taper().to(images.device))
    size = spectrum.real.square() + spectrum.imag.square()
    power = size / (level * SIDE).square()
    logarithm = torch.log1p(power)
    lags = torch.fft.ifft2(logarithm).real
    lags[:, 0, 0] = 0.0
    even = torch.fft.ifft2(spectrum * (power / ((1.0 + power) * size.sqrt().clamp(min=1e-9)))).real
    centred = torch.fft.fftshift(torch.stack([logarithm / 4.0 - 0.5, 16.0 * lags], 1), (2, 3))
    return torch.cat([4.0 * scaled[:, None] - 0.5, centred, 40.0 * even[:, None]], dim=1)


@cache
def twin_signs() -> Tensor:
    """Return the signs (M,) that convert a wave to its twin, -1 for even radial orders."""
    return torch.tensor([-1.0 if zernike_order(mode)[0] % 2 == 0 else 1.0 for mode in MODES])


@cache
def _taper() -> Tensor:
    """Return a window (SIDE, SIDE) that falls to 0 over 4 pixels at the edges."""
    rise = np.sin(0.5 * np.pi * np.minimum(1.0, (np.arange(SIDE // 2) + 0.5) / 4)) ** 2
    window = np.concatenate([rise, rise[::-1]])
    return torch.from_numpy(np.outer(window, window).astype(np.float32))


class _Residual(nn.Module):
    """Two 3 x 3 convolutions, whose result is added to what they are given."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.GroupNorm(8, width),
            nn.SiLU(),
            nn.Conv2d(width, width, 3, padding=1),
            nn.GroupNorm(8, width),
            nn.SiLU(),
            nn.Conv2d(width, width, 3, padding=1),
        )

    def forward(self, given: Tensor) -> Tensor:
        added: Tensor = self.layers(given)
        return given + added


class _Places(nn.Module):
    """Trained values of each place, since frequencies and lags differ in what they tell."""

    def __init__(self, width: int, side: int) -> None:
        super().__init__()
        self.values = nn.Parameter(torch.zeros(width, side, side))

    def forward(self, given: Tensor) -> Tensor:
        return given + self.values


class _Attention(nn.Module):
    """Attention among all places, then two layers on each place."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.before, self.between = nn.LayerNorm(width), nn.LayerNorm(width)
        self.three, self.mixed = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.layer = nn.Sequential(
            nn.Linear(width, 2 * width), nn.SiLU(), nn.Linear(2 * width, width)
        )

    def forward(self, given: Tensor) -> Tensor:
        places = given.flatten(2).transpose(1, 2)
        three = self.three(self.before(places)).unflatten(2, (3, self.heads, -1))
        query, key, value = three.permute(2, 0, 3, 1, 4)
        seen = nn.functional.scaled_dot_product_attention(query, key, value)
        places = places + self.mixed(seen.transpose(1, 2).flatten(2))
        places = places + self.layer(self.between(places))
        found: Tensor = places.transpose(1, 2).unflatten(2, given.shape[2:])
        return found


class WallProposals:
    """Density of the waves of one image, from eight turned and mirrored copies of it.

    ``image`` (SIDE, SIDE): image at Nyquist's pitch with a dark background. ``noise``: standard
    deviation of its noise, image units. ``network``: trained network.

    ``mean`` (M,): most likely coefficients of `MODES`, waves rms; their twin is as
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
