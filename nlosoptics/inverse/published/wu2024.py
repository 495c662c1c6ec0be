"""Physics-constrained inverse network (PCIN) as published by Wu et al. 2024."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor, nn

from ..._checks import in_range, one_of, positive, whole
from ..._progress import Progress
from ..._random import checked_seed, generator
from ...errors import SamplingError, SceneError
from ...imaging.forward_model import ForwardModel
from ..data._threads import gradients, single_thread
from ..data.adam import descend, joined, spread
from ..data.arrays import real_array
from ..data.driver import Iterate, Run, Solver, reconstructed, solved
from ..data.measurement import measured
from ..data.noisy_image import NoisyImage
from ..data.reconstruction import Reconstruction, beside
from ..data.scaled_images import ScaledImage, total_variation
from ..data.scores import registered_correlation
from ..wave.frames import known_defoci
from ..wave.pupil_psf import PupilPSF
from .unet import UNetObject

NetworkInput = Literal["image", "reconstruction", "noise"]

GUIDE, ANGLES = 602, 603  # streams of the random network input and of the random angles


@single_thread()
@gradients()
def wu2024_fit(
    images: Any,
    pupil_psf: PupilPSF,
    *,
    defocus: Any = None,
    start: Reconstruction | Mapping[str, Any] | None = None,
    start_rms: float | None = None,
    base: int = 8,
    depth: int = 4,
    alternate: int = 10,
    network_input: NetworkInput = "image",
    learning_rate: float = 0.01,
    tv_weight: float = 1e-3,
    max_iterations: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Reconstruction:
    """Fit object and wall to one image by the method of Wu et al. 2024, for comparison [1]_.

    The method is the physics-constrained inverse network (PCIN): an untrained U-net represents the
    object, and the angles at which light leaves the exit pupil represent the wall. Use
    `evidence_fit` to reconstruct objects.

    Parameters
    ----------
    images : Measurement, ndarray or Tensor
        Camera image, (H, W) or (1, H, W), with its noise and background.
    pupil_psf : PupilPSF
        Point spread function (PSF) of shape (H, W) as a function of coefficients, which take the
        role of the angles. It is not modified.
    defocus : sequence of one float, or None
        Known additional defocus of the image, m rms over the pupil, see `evidence_fit`.
    start : Reconstruction, mapping or None
        Reconstruction: warm start from an earlier result of this function for a similar object,
        which provides angles and network. Mapping: saved state of this solver with the same image
        and options (see `Stop`), from which the fit resumes with the same result bit for bit. None:
        cold start with random angles and weights.
    start_rms : float or None
        Strength of a cold start's random angles: the rms wave aberration, waves; by default 0.5.
    base : {8, 16, 32}
        Number of channels of the U-net at full resolution. Not used in a warm start.
    depth : int
        Number of times that the U-net halves the resolution, 1 to 8. Not used in a warm start.
    alternate : int
        Number of steps that fit the angles, followed by the same number of steps that fit the
        network.
    network_input : {"image", "reconstruction", "noise"}
        Input of the network while it is fitted: the camera image, the last reconstruction, or eight
        channels of random noise, as for a deep image prior [2]_.
    learning_rate : float
        Learning rate of the optimiser (Adam) for angles and network weights.
    tv_weight : float
        Weight of the total variation in the minimised function (equation 9 of the paper), for an
        image with range 1.
    max_iterations : int or None
        Maximum number of steps for angles and network together. None: 4000 for a cold start, 1800
        for a warm start.
    seed : int
        Seed of the random angles and weights.
    progress : callable or None
        Function that is called after each change between angles and network, with a text and the
        completed fraction, 0 to 1. It may raise `Stop` to end the fit.

    Returns
    -------
    Reconstruction
        Object, status and score. ``physical_parameters`` also contains the fitted ``coefficients``
        in the shape and unit of ``pupil_psf.coefficients``, ``network_weights`` (n,) float32,
        ``network_base``, ``network_depth``, ``strehl`` (peak of the PSF relative to that without
        aberration) and ``iterations``. The status is "ambiguous" if the object is the image itself
        (a correlation of 0.95 or more), otherwise "unconverged" (see Notes).

    See Also
    --------
    pcin : Reconstruction via an unknown wall.
    evidence_fit : Fit of object and unknown wall to one or more images.
    PupilPSF : Differentiable PSF of a wave.

    Notes
    -----
    The theory pages of the documentation list the statements of the paper's section 2.2, and what
    this function does. It departs from the paper in these points:

    - The radiance of the exit angles, equations 4 to 7, is not in the model. Angles act on the
      phase of the pupil only (equation 3), and its amplitude is 1.
    - Step 2 of the text feeds "the reconstruction image" to the network. The default feeds the
      camera image, as step 1 and the paper's figure do; ``network_input="reconstruction"`` follows
      the text.
    - Gain and background of the image take their least-squares values in every step, the object is
      between 0 and 1, and the image is periodic, as equation 8 implies.

    The paper leaves some choices open, which are options here: the number of repetitions of both
    steps (``alternate``), the size of the network (``base``), the strength of the random angles
    (``start_rms``), and the weight of TV (``tv_weight``; equation 9 has the weight 1, but the scale
    of the image is not stated). The study in ``examples/pcin_study`` varies them one by one.

    In tests with random angles and one image, this method rarely came near the true object: it
    found the image itself, or another object that agrees with the image within the noise
    (`benchmarks/inverse/wu2024.py`). A residual at the noise level is therefore no sign of success,
    and the status is never "converged".

    References
    ----------
    .. [1] Wu et al., Advanced Photonics Nexus 3 (2024) 026010, section 2.2.
    .. [2] Ulyanov, Vedaldi and Lempitsky, Int. J. Comput. Vis. 128 (2020) 1867.
    """
    checked_seed(seed)
    alternate = whole("alternate", alternate)
    if max_iterations is None:
        # "approximately 1800" and "more than 4000" in the paper
        max_iterations = 1800 if isinstance(start, Reconstruction) else 4000
    max_iterations = whole("max_iterations", max_iterations)
    tv_weight = in_range("tv_weight", tv_weight, 0.0)
    rate = in_range("learning_rate", learning_rate, 0.0, 1.0, open_low=True)
    one_of("network_input", network_input, ("image", "reconstruction", "noise"))
    if not isinstance(pupil_psf, PupilPSF):
        raise SceneError(
            f"pupil_psf of type {type(pupil_psf).__name__} is no PupilPSF; build one with "
            "PupilPSF.from_zernike"
        )
    image, *others = measured(images).each()
    if others:
        raise SamplingError(
            f'images has {1 + len(others)} frames, recipe "wu2024" takes one; give one of them, or '
            'all of them to recipe "evidence"'
        )
    if defocus is not None:
        defocus = np.atleast_1d(real_array("defocus", defocus))
    optics = _Optics(pupil_psf, known_defoci(defocus, 1).tolist())

    def solve(data: NoisyImage) -> dict[str, Any]:
        scaled = ScaledImage(data, float(data.data.max() - data.data.min()))
        guide = scaled.image
        if network_input == "noise":
            noise = generator(seed, GUIDE).uniform(size=(8, *guide.shape))
            guide = torch.from_numpy(noise).to(guide)
        if isinstance(start, Reconstruction):
            angles, network = _from_earlier(start, pupil_psf, guide)
        else:
            angles = _random_angles(pupil_psf, start_rms, seed)
            network = UNetObject(guide, base=base, depth=depth, seed=seed)
        fit = _Pcin(
            data=data,
            image=scaled,
            optics=optics,
            angles=nn.Parameter(angles),
            network=network,
            learning_rate=rate,
            tv_weight=tv_weight,
            every=2 * alternate,
            feeds_back=network_input == "reconstruction",
            max_iterations=max_iterations,
        )
        return solved(fit, None if isinstance(start, Reconstruction) else start, progress)

    model = optics.model(pupil_psf.coefficients)
    return reconstructed(solve, image, model, pupil_psf.shape)


@dataclass(frozen=True)
class _Optics:
    """Point spread of given coefficients, at a known defocus."""

    pupil_psf: PupilPSF
    defocus: list[float]

    def transfer(self, coefficients: Tensor) -> Tensor:
        """Return the transfer function, differentiable."""
        return self.pupil_psf.transfer(coefficients, defocus=self.defocus)[0]

    def model(self, coefficients: Tensor) -> ForwardModel:
        """Return the numpy image model."""
        with torch.no_grad():
            kernel = self.pupil_psf(coefficients.detach(), defocus=self.defocus)[0]
        return ForwardModel(
            kernel.double().cpu().numpy(), shape=self.pupil_psf.shape, boundary="circular"
        )


@dataclass(eq=False, kw_only=True)
class _Turns(Iterate):
    """State of the fit: weights and angles with their optimisers, and the network's input.

    ``held`` is the object or the transfer function that the current phase keeps; empty if it has to
    be computed.
    """

    network: torch.optim.Adam
    angles: torch.optim.Adam
    guide: Tensor
    held: tuple[Tensor, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class _Pcin(Solver[_Turns]):
    """Alternating fits of angles and network; an iteration is a step of either.

    A turn of ``every`` iterations fits first the angles, then the network.
    """

    data: NoisyImage
    image: ScaledImage
    optics: _Optics
    angles: nn.Parameter
    network: UNetObject
    learning_rate: float
    tv_weight: float
    every: int
    feeds_back: bool
    max_iterations: int

    name, takes_object = "wu2024_fit", False
    report = "pcin, Wu 2024: residual {residual:.3f}"

    def init(self, first: Tensor | None) -> _Turns:
        """Return the initial state; a given object has no effect, network and angles start it."""
        rate = self.learning_rate
        return _Turns(
            network=torch.optim.Adam(self.network.parameters(), rate, fused=True),
            angles=torch.optim.Adam([self.angles], rate),
            guide=self.network.guide,
        )

    def resumed(self, state: _Turns) -> None:
        """Give the network its saved input."""
        self.network.guide = state.guide

    def step(self, state: _Turns) -> tuple[float, float, float]:
        """Make one step of Adam on the loss of the paper's eq. 9.

        The loss is the squared error plus total variation, summed over the pixels. Step 1 of the
        paper moves the angles with the object held, step 2 the network with the angles held.
        """
        first = state.count % self.every < self.every // 2
        if not state.held or state.count % (self.every // 2) == 0:
            with torch.no_grad():
                state.held = (self.network() if first else self.optics.transfer(self.angles),)
        (held,) = state.held
        picture = held if first else self.network()
        transfer = self.optics.transfer(self.angles) if first else held
        gain, residual = self.image.misfit(_seen(picture, transfer))
        square = self.image.weighted(residual * residual).sum()
        loss = square + self.tv_weight * gain * total_variation(picture)
        before = self.angles.detach().clone()
        descend(state.angles if first else state.network, loss)
        change = (self.angles.detach() - before).norm() / before.norm().clamp_min(1e-30)
        rms = math.sqrt(self.image.mean_square(residual.detach()).item())
        noise = self.data.sigma / self.image.unit
        ends = (state.count + 1) % self.every == 0 or state.count + 1 == self.max_iterations
        if self.feeds_back and ends:
            with torch.no_grad():
                self.network.set_guide(self.network())
            state.guide = self.network.guide
        return loss.item(), rms / noise if noise > 0.0 else rms, change.item()

    def level(self, state: _Turns) -> Tensor:
        """Return the object (H, W) in image units."""
        with torch.no_grad():
            picture = self.network()
            gain = self.image.misfit(_seen(picture, self.optics.transfer(self.angles)))[0].item()
        level: Tensor = gain * self.image.unit * picture.double()
        return level

    def answer(self, found: Run[_Turns], level: Tensor) -> dict[str, Any]:
        """Return image model, background and status, and the parameters of angles and network."""
        coefficients = self.angles.detach()
        model = self.optics.model(coefficients)
        flat = _Optics(self.optics.pupil_psf, [0.0]).model(torch.zeros_like(coefficients))
        same = registered_correlation(level, self.data.data) > 0.95
        reason = (
            "the object is the image itself, as without blur" if same else "no test of the wall"
        )
        network = self.network.network
        return {
            "model": model,
            "background": beside(self.data, level, model)[0],
            "status": "ambiguous" if same else "unconverged",
            "reasons": (f'{reason}; give several images to recipe "evidence"',),
            "coefficients": coefficients.to(torch.float64).cpu().numpy(),
            "network_weights": joined(list(network.parameters())).cpu().numpy(),
            "network_base": float(network.base),
            "network_depth": float(network.depth),
            "strehl": float(model.kernel.max() / flat.kernel.max()),
            "iterations": float(found.state.count),
        }


def _seen(picture: Tensor, transfer: Tensor) -> Tensor:
    """Return the modelled image, eq. 8 of the paper without noise."""
    seen: Tensor = torch.fft.irfft2(torch.fft.rfft2(picture) * transfer, s=picture.shape)
    return seen


def _random_angles(pupil_psf: PupilPSF, start_rms: float | None, seed: int) -> Tensor:
    """Return normally distributed angles, scaled to a given rms wave aberration, waves.

    One scaling suffices, since the wave is linear in the angles.
    """
    wanted = 0.5 if start_rms is None else positive("start_rms", start_rms)
    leaves = pupil_psf.coefficients
    drawn = torch.from_numpy(generator(seed, ANGLES).standard_normal(leaves.shape)).to(leaves)
    with torch.no_grad():
        aberration = pupil_psf.aberration(drawn) / pupil_psf.wavelength
    share = torch.as_tensor(pupil_psf.optics.share).to(aberration)
    mean = (share * aberration).sum() / share.sum()
    rms = ((share * (aberration - mean) ** 2).sum() / share.sum()).sqrt()
    return drawn * (wanted / rms)


def _from_earlier(
    start: Reconstruction, pupil_psf: PupilPSF, guide: Tensor
) -> tuple[Tensor, UNetObject]:
    """Return angles and network of an earlier result."""
    found = start.physical_parameters
    missing = {"coefficients", "network_weights", "network_base", "network_depth"} - set(found)
    if missing:
        raise SceneError(
            f"start has no {min(missing)}; give a Reconstruction that wu2024_fit returned"
        )
    wanted = tuple(pupil_psf.coefficients.shape)
    if np.shape(found["coefficients"]) != wanted:
        raise SamplingError(
            f"start has coefficients of shape {np.shape(found['coefficients'])}, pupil_psf of "
            f"{wanted}; give the pupil_psf of the earlier run"
        )
    base, depth = int(found["network_base"]), int(found["network_depth"])
    network = UNetObject(guide, base=base, depth=depth)
    spread("network_weights", found["network_weights"], list(network.network.parameters()))
    angles = torch.from_numpy(np.array(found["coefficients"])).to(pupil_psf.coefficients)
    return angles, network
