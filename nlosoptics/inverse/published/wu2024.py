"""Physics-constrained inverse network (PCIN) as published by Wu et al. 2024."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.utils import vector_to_parameters

from ..._checks import in_range, one_of, positive, whole
from ..._progress import Progress
from ..._random import checked_seed, generator
from ...errors import SamplingError, SceneError
from ...imaging.forward_model import ForwardModel
from ..data.arrays import real_array
from ..data.driver import History, Solver, reconstructed, solved
from ..data.measurement import measured
from ..data.noisy_image import NoisyImage
from ..data.reconstruction import Reconstruction, beside, registered_correlation
from ..wave.frames import fitting, known_defoci
from ..wave.pupil_psf import PupilPSF
from .unet import UNetObject

NetworkInput = Literal["image", "reconstruction", "noise"]

GUIDE, ANGLES = 602, 603  # streams of the random network input and of the random angles


@fitting()
def wu2024_fit(
    images: Any,
    pupil_psf: PupilPSF,
    *,
    defocus: Any = None,
    start: Reconstruction | None = None,
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
    start : Reconstruction or None
        Warm start from an earlier result of this function for a similar object, which provides
        angles and network. None: cold start with random angles and weights.
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
        max_iterations = 4000 if start is None else 1800
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
    if not isinstance(start, Reconstruction | None):
        raise SceneError(
            f"start of type {type(start).__name__} is no Reconstruction; give one that wu2024_fit "
            "returned, or leave it out"
        )
    if defocus is not None:
        defocus = np.atleast_1d(real_array("defocus", defocus))
    optics = _Optics(pupil_psf, known_defoci(defocus, 1).tolist())

    def solve(data: NoisyImage) -> dict[str, Any]:
        fit = _Pcin(data, optics, rate, tv_weight, 2 * alternate, max_iterations)
        guide = fit.image
        if network_input == "noise":
            noise = generator(seed, GUIDE).uniform(size=(8, *guide.shape))
            guide = torch.from_numpy(noise).to(guide)
        if start is None:
            network = UNetObject(guide, base=base, depth=depth, seed=seed)
            fit.begin(_random_angles(pupil_psf, start_rms, seed), network)
        else:
            fit.begin(*_from_earlier(start, pupil_psf, guide))
        fit.feeds_back = network_input == "reconstruction"
        return solved(fit, progress)

    model = optics.model(pupil_psf.coefficients)
    return reconstructed(solve, image, model, pupil_psf.shape)


class _Optics:
    """Point spread of given coefficients, at a known defocus."""

    def __init__(self, pupil_psf: PupilPSF, defocus: list[float]) -> None:
        self.pupil_psf, self.defocus = pupil_psf, defocus

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


class _Pcin(Solver):
    """Alternating fits of angles and network; an iteration is a step of either.

    A turn of ``turn`` iterations fits first the angles, then the network. ``image`` (H, W): image
    over its range, minus the background that best fits it alone. Gain and background take their
    least-squares values.
    """

    report = "pcin, Wu 2024: residual {residual:.3f}"
    feeds_back = False

    def __init__(
        self,
        data: NoisyImage,
        optics: _Optics,
        rate: float,
        tv_weight: float,
        turn: int,
        max_iterations: int,
    ) -> None:
        self.data, self.optics, self.rate, self.tv_weight = data, optics, rate, tv_weight
        self.turn, self.max_iterations = turn, max_iterations
        self.unit = float(data.data.max() - data.data.min())
        shape = data.background_shape * data.fit_background
        arrays = (data.without_background() / self.unit, data.weights, shape)
        device = optics.pupil_psf.coefficients.device
        self.image, self.weights, self.shape = (
            torch.from_numpy(values).to(device, torch.float32) for values in arrays
        )
        self.power = (self.weights * self.image.square()).sum()
        self.norm = (self.weights * self.shape.square()).sum() or 1.0

    def begin(self, angles: Tensor, network: UNetObject) -> None:
        """Set angles and network, with their optimisers."""
        self.angles, self.network = angles.requires_grad_(), network
        self.adams = (
            torch.optim.Adam([self.angles], self.rate),
            torch.optim.Adam(network.parameters(), self.rate, fused=True),
        )

    def step(self) -> tuple[float, float, float]:
        """Make one step of Adam on the loss of the paper's eq. 9.

        The loss is the squared error plus total variation, summed over the pixels. Step 1 of the
        paper moves the angles with the object held, step 2 the network with the angles held.
        """
        half = self.turn // 2
        first = self.count % self.turn < half
        if self.count % half == 0:
            with torch.no_grad():
                self.held = self.network() if first else self.optics.transfer(self.angles)
        picture = self.held if first else self.network()
        transfer = self.optics.transfer(self.angles) if first else self.held
        gain, residual = self.misfit(picture, transfer)
        square = (self.weights * residual.square()).sum()
        loss = square + self.tv_weight * gain * total_variation(picture)
        before = self.angles.detach().clone()
        adam = self.adams[0 if first else 1]
        adam.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        adam.step()
        change = (self.angles.detach() - before).norm() / before.norm().clamp_min(1e-30)
        rms = math.sqrt(square.item() / self.data.counted)
        noise = self.data.sigma / self.unit
        if self.feeds_back and (self.count + 1) % self.turn == 0:
            with torch.no_grad():
                self.network.set_guide(self.network())
        return loss.item(), rms / noise if noise > 0.0 else rms, change.item()

    def misfit(self, picture: Tensor, transfer: Tensor) -> tuple[Tensor, Tensor]:
        """Return the best gain of a modelled image, and the residual (H, W); differentiable.

        The image is that of eq. 8 of the paper without noise. If the fitted gain is negative or
        tiny, it is clamped to a tenth of the image contrast, to keep a useful gradient.
        """
        seen = torch.fft.irfft2(torch.fft.rfft2(picture) * transfer, s=picture.shape)
        seen = seen - (self.weights * self.shape * seen).sum() / self.norm * self.shape
        norm = (self.weights * seen.square()).sum().clamp_min(torch.finfo(seen.dtype).tiny)
        least = 0.1 * (self.power / norm.detach()).sqrt()
        gain = ((self.weights * seen * self.image).sum() / norm).clamp_min(least)
        return gain, self.image - gain * seen

    def level(self) -> NDArray[np.float64]:
        """Return the object (H, W) in image units."""
        with torch.no_grad():
            picture = self.network()
            gain = self.misfit(picture, self.optics.transfer(self.angles))[0].item()
        return np.asarray(gain * self.unit * picture.double().cpu().numpy())

    def answer(self, level: NDArray[np.float64], history: History) -> dict[str, Any]:
        """Return image model, background and status, and the parameters of angles and network."""
        coefficients = self.angles.detach()
        model = self.optics.model(coefficients)
        flat = _Optics(self.optics.pupil_psf, [0.0]).model(torch.zeros_like(coefficients))
        same = registered_correlation(level, self.data.data) > 0.95
        reason = (
            "the object is the image itself, as without blur" if same else "no test of the wall"
        )
        network = self.network.network
        weights = [part.detach().reshape(-1) for part in network.parameters()]
        return {
            "model": model,
            "background": beside(self.data, level, model)[0],
            "status": "ambiguous" if same else "unconverged",
            "reasons": (f'{reason}; give several images to recipe "evidence"',),
            "coefficients": coefficients.to(torch.float64).cpu().numpy(),
            "network_weights": torch.cat(weights).cpu().numpy(),
            "network_base": float(network.base),
            "network_depth": float(network.depth),
            "strehl": float(model.kernel.max() / flat.kernel.max()),
            "iterations": float(self.count),
        }


def total_variation(picture: Tensor) -> Tensor:
    """Return the isotropic total variation of an object (H, W), without its borders.

    Gradients below 1e-3 enter quadratically, since the square root has an infinite slope at 0.
    """
    down, along = picture.diff(dim=-2)[:, :-1], picture.diff(dim=-1)[:-1]
    return ((down.square() + along.square() + 1e-6).sqrt() - 1e-3).sum()


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
    weights, wanted_weights = found["network_weights"], list(network.network.parameters())
    count = sum(part.numel() for part in wanted_weights)
    if np.size(weights) != count:
        raise SamplingError(
            f"start has {np.size(weights)} network_weights, must be {count}; give a Reconstruction "
            "that wu2024_fit returned"
        )
    vector_to_parameters(torch.from_numpy(np.array(weights)).to(guide), wanted_weights)
    angles = torch.from_numpy(np.array(found["coefficients"])).to(pupil_psf.coefficients)
    return angles, network
